"""One frame's step of a shadow buffer: a hard test added to what each pixel remembers, or a start where it is new.

Sources: Scherzer et al. 2009, sections 3.1 to 3.3, equations 1 to 7; what a technique deviates in is a setting. The
plain kernel; ``shadow_buffer_lanes.py`` has the CPU's.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.estimators import add_test, hidden_share, standard_error
from wkernels.filtering import LightFootprint, pcss_visibility, penumbra_ratio, penumbra_spread, texels_per_ratio
from wkernels.gbuffer import GBuffer
from wkernels.geometry import RECEIVES
from wkernels.light_map import Bias, LightMap, Receiver, locate, receiver_depth_at, stored_depth
from wkernels.neighbourhood_filter import pixels_per_length
from wkernels.shadow_buffer import (
    TEXEL_TYPES,
    ShadowRecord,
    Storage,
    fetch_record,
    refine_blocker,
    shadow_test,
    write_record,
)
from wkernels.views import View

FULL_WIDTH_ERROR = wp.constant(0.25)  # standard error of about five tests
UNROTATED = wp.constant(wp.mat22(1.0, 0.0, 0.0, 1.0))


@wp.struct
class UpdateSettings:
    """How a frame's shadow tests are added to a shadow buffer."""

    bias: Bias
    storage: Storage
    weight: float  # of this frame's light sample
    light_size: float  # L: scene units, or 2 tan(angle / 2)
    has_history: int
    has_movers: int
    starts_with_pcss: int
    start_weight: float
    blocker_taps: wp.array(dtype=wp.vec2)
    filter_taps: wp.array(dtype=wp.vec2)
    first_blockers: float  # k of equation 7
    depth_epsilon: float  # scene units
    texel_steps: float  # BILINEAR or NEAREST
    smooths: int
    narrows: int
    error_threshold: float  # t


@wp.func
def search_meets_mover(
    light_map: LightMap,
    footprint: LightFootprint,
    receiver: Receiver,
    position_ws: wp.vec3,
    taps: wp.array(dtype=wp.vec2),
) -> int:
    """1 where the blocker search of ``pcss_visibility`` finds a blocker that moves, else 0."""
    axes = texels_per_ratio(light_map, footprint, receiver.layer, position_ws)
    spread = penumbra_spread(light_map, footprint, receiver, axes, footprint.nearest_depth[receiver.layer])
    result = int(0)
    for i in range(taps.shape[0]):
        offset = spread * taps[i]
        column = int(wp.floor(receiver.x + offset[0]))
        row = int(wp.floor(receiver.y + offset[1]))
        stored = stored_depth(light_map, receiver.layer, column, row)
        if stored < 0.0 and receiver_depth_at(receiver, offset[0], offset[1]) > -stored:
            result = 1
    return result


@wp.func
def update_pixel(
    x: int,
    y: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    settings: UpdateSettings,
    previous_view: View,
    previous: wp.array2d(dtype=Any),
    current_out: wp.array2d(dtype=Any),
    psi_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """``update_shadow_buffer`` of one pixel."""
    record = ShadowRecord()
    psi = float(0.0)
    error = float(0.0)
    half_width = float(0.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        normal_ws = gbuffer.normal_ws[y, x]

        test = shadow_test(gbuffer, y, x, light_map, settings.bias)
        moves = test.moves
        if settings.has_history != 0 and moves == 0:
            record = fetch_record(
                previous,
                previous_view,
                position_ws,
                normal_ws,
                settings.depth_epsilon,
                settings.storage.rounding,
                settings.texel_steps,
            )
        is_new = record.n <= 0.0
        is_estimated = is_new and settings.starts_with_pcss != 0
        if is_estimated:
            visible = 1.0 - test.tau
            if test.receiver.layer >= 0:
                found = pcss_visibility(
                    light_map,
                    footprint,
                    test.receiver,
                    position_ws,
                    settings.blocker_taps,
                    settings.filter_taps,
                    UNROTATED,
                    0,
                )
                visible = found[0]
                if found[1] > 0.0:
                    record.blocker_rise = wp.clamp(1.0 - found[1] / test.receiver.plane_depth[2], 0.0, 1.0)
                if settings.has_movers != 0 and moves == 0:
                    moves = search_meets_mover(light_map, footprint, test.receiver, position_ws, settings.blocker_taps)
            record.n = settings.start_weight
            record.rho = (1.0 - visible) * settings.start_weight
        else:
            if test.blocker_rise > 0.0:
                record.blocker_rise = refine_blocker(
                    record.blocker_rise, test.blocker_rise, record.rho + settings.first_blockers
                )
            sums = add_test(record.rho, record.n, test.tau, settings.weight, settings.storage.limit)
            record.rho = sums[0]
            record.n = sums[1]
        record.depth = gbuffer.depth[y, x]

        psi = hidden_share(record.rho, record.n)
        error = standard_error(psi, record.n)
        if settings.smooths != 0 and (is_estimated or error > settings.error_threshold) and record.blocker_rise > 0.0:
            # equation 6, from the depth of the point itself: it may be turned away from this sample, if not from all
            receiver_depth = locate(light_map, position_ws)[2]
            ratio = penumbra_ratio(footprint.is_point, receiver_depth, receiver_depth * (1.0 - record.blocker_rise))
            width_px = settings.light_size * ratio * pixels_per_length(gbuffer.view, record.depth)
            half_width = 0.5 * width_px
            if settings.narrows != 0:
                half_width = half_width * wp.min(1.0, error / FULL_WIDTH_ERROR)
        if moves != 0:
            record.n = 0.0
            record.rho = 0.0
    write_record(current_out, y, x, record, gbuffer.view.far)
    psi_out[y, x] = psi
    error_out[y, x] = error
    half_width_out[y, x] = half_width


@wp.kernel
def update_shadow_buffer(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    settings: UpdateSettings,
    previous_view: View,
    previous: wp.array2d(dtype=Any),
    current_out: wp.array2d(dtype=Any),
    psi_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """One shadow test a pixel, added to its history; a start where there is none.

    Args:
        first: Tile offset.
        gbuffer: Receivers, (H, W).
        light_map: Depths from this frame's light sample.
        footprint: The light in that map, for starts and filter widths.
        settings: What is done.
        previous_view: The eye's view that ``previous`` was written for.
        previous: The last frame's texels (H, W), meaningless without history.
        current_out: This frame's.
        psi_out: Hidden share of the light, (H, W).
        error_out: Its standard error.
        half_width_out: Half the width in pixels of the filter that the pixel asks for; 0 for none.
    """
    row, x = wp.tid()
    update_pixel(
        x,
        first + row,
        gbuffer,
        light_map,
        footprint,
        settings,
        previous_view,
        previous,
        current_out,
        psi_out,
        error_out,
        half_width_out,
    )


UPDATE = {
    texel: wp.overload(
        update_shadow_buffer, {"previous": wp.array2d(dtype=texel), "current_out": wp.array2d(dtype=texel)}
    )
    for texel in TEXEL_TYPES.values()
}
"""The kernel by texel type."""
