"""One frame's step of a shadow buffer: a hard test added to what each pixel remembers, or a start where it is new.

Sources: Scherzer et al. 2009, sections 3.1 to 3.4, equations 1 to 7; Schwaerzler 2009, section 5.2 and appendix A. What
they differ in is a setting. The plain kernel; ``shadow_buffer_lanes.py`` has the CPU's, ``shadow_buffer_step.py``
launches them.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.filters.neighbourhood_filter import pixels_per_length
from wkernels.filters.penumbra import (
    LightFootprint,
    mean_blocker_depth,
    pcss_visibility,
    penumbra_ratio,
    penumbra_spread,
    texels_per_ratio,
)
from wkernels.light_maps.light_map import Bias, LightMap, Receiver, locate, receiver_depth_at, stored_depth
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.estimators import add_test, age_sums, fade_out, hidden_share, standard_error
from wkernels.scene.geometry import MOVES, RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.sample_window import SampleWindow, shorten, window_of
from wkernels.temporal.shadow_buffer.kept_views import KeptViews, fetch_kept
from wkernels.temporal.shadow_buffer.own_umbra import is_own_umbra
from wkernels.temporal.shadow_buffer.record import (
    BILINEAR,
    TEXEL_TYPES,
    ShadowRecord,
    Storage,
    fetch_linear,
    fetch_record,
    refine_blocker,
    shadow_test,
    write_record,
)

FULL_WIDTH_ERROR = wp.constant(0.25)  # standard error of about five tests
UNROTATED = wp.constant(wp.mat22(1.0, 0.0, 0.0, 1.0))

START_SAMPLE, START_PCSS, START_SEARCH = wp.constant(0), wp.constant(1), wp.constant(2)
"""A new pixel's start: its hard test alone; percentage-closer soft shadows of the frame's map; or its hard test and a
search for blockers, which tells how wide to smooth it."""

DISOCCLUDE, AT_ONCE, GRADUAL = wp.constant(0), wp.constant(1), wp.constant(2)
"""What becomes of sums gathered under the shadow of a moving caster, where every frame starts anew: they are not stored
at all; stored, tagged and dropped in the first frame without that shadow; or faded out from there on."""


@wp.struct
class UpdateSettings:
    """How a frame's shadow tests are added to a shadow buffer."""

    bias: Bias
    storage: Storage
    light_corners: wp.array(dtype=wp.vec4)  # of its hull: what turns away from all of it is dark at once; none: tested
    window: SampleWindow
    kept: KeptViews  # where points that are new to the last frame are looked for
    weight: float  # of this frame's light sample
    light_window: float  # tests that count where the light moves, ``age_sums``; 0: all do
    effective_share: float  # independent tests that a unit of n is worth, less than 1 where weights differ
    light_size: float  # L: scene units, or 2 tan(angle / 2)
    has_history: int
    has_movers: int
    start: int  # START_SAMPLE, START_PCSS or START_SEARCH
    start_weight: float  # for START_PCSS
    stores_smoothed: int  # for START_SEARCH: asks, by a negative half width, for a start that is stored smoothed
    blocker_taps: wp.array(dtype=wp.vec2)
    filter_taps: wp.array(dtype=wp.vec2)
    search_radius: float  # texels, for START_SEARCH
    first_blockers: float  # k of equation 7
    counts_tests: int  # 1: equation 7 as printed; 0: only shadowed tests are behind the mean blocker
    depth_epsilon: float  # scene units
    relative_epsilon: float  # share of the stored depth, its rounding included
    texel_steps: float  # BILINEAR, NEAREST or LINEAR
    smooths: int
    narrows: int
    half_widths: float  # the filter's radius in penumbra widths
    error_threshold: float  # t, s_min: smoothed from this standard error up
    least_samples: float  # smoothed below this n
    movers: int  # DISOCCLUDE, AT_ONCE or GRADUAL
    decrement: float  # for GRADUAL: by how much n falls a frame
    followed_samples: float  # largest n on moving surfaces, whose history follows them; 0: they are not followed
    motion: wp.array(dtype=wp.mat44)  # (meshes,) from this frame's rebased world to the last frame's; when followed
    normal_motion: wp.array(dtype=wp.mat33)  # the same for normals, not normalised


@wp.func
def meets_mover(light_map: LightMap, receiver: Receiver, spread: wp.mat22, taps: wp.array(dtype=wp.vec2)) -> int:
    """1 where a blocker search (``mean_blocker_depth``) finds a blocker that moves, else 0."""
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
def fetch_history(
    previous: wp.array2d(dtype=Any), previous_view: View, gbuffer: GBuffer, y: int, x: int, settings: UpdateSettings
) -> ShadowRecord:
    """What the last frame knew of a pixel's point, by its own motion where moving surfaces are followed."""
    position_ws = gbuffer.position_ws[y, x]
    normal_ws = gbuffer.normal_ws[y, x]
    is_followed = settings.followed_samples > 0.0 and (gbuffer.flags[y, x] & MOVES) != 0
    if is_followed:
        mesh = gbuffer.mesh[y, x]
        position_ws = wp.transform_point(settings.motion[mesh], position_ws)
        normal_ws = wp.normalize(settings.normal_motion[mesh] * normal_ws)
    result = ShadowRecord()
    if settings.texel_steps > 0.0:
        result = fetch_record(
            previous,
            previous_view,
            position_ws,
            normal_ws,
            settings.depth_epsilon,
            settings.relative_epsilon,
            settings.texel_steps,
        )
    else:
        result = fetch_linear(previous, previous_view, position_ws, settings.depth_epsilon, settings.relative_epsilon)
    if is_followed and result.n > settings.followed_samples:
        # light and shadows pass over a surface that moves: older tests say less and less of it
        result.rho = result.rho * (settings.followed_samples / result.n)
        result.n = settings.followed_samples
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
    psi_depth_out: wp.array2d(dtype=wp.vec2),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """``update_shadow_buffer`` of one pixel."""
    record = ShadowRecord()
    psi = float(0.0)
    error = float(0.0)
    half_width = float(0.0)
    if is_own_umbra(gbuffer, y, x, settings.light_corners):
        # stores nothing, so that the lit side of an edge takes nothing from here, nor this side from there
        record.depth = gbuffer.depth[y, x]
        psi = 1.0
    elif (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]

        test = shadow_test(gbuffer, y, x, light_map, settings.bias)
        moves = test.moves
        if settings.has_history != 0 and moves == 0:
            record = fetch_history(previous, previous_view, gbuffer, y, x, settings)
            if record.n <= 0.0 and settings.kept.count > 0 and (gbuffer.flags[y, x] & MOVES) == 0:
                found_before = fetch_kept(
                    settings.kept,
                    position_ws,
                    gbuffer.normal_ws[y, x],
                    settings.depth_epsilon,
                    settings.relative_epsilon,
                    wp.where(settings.texel_steps > 0.0, settings.texel_steps, BILINEAR),
                )
                if found_before.n > 0.0:
                    record = found_before
        was_known = record.n > 0.0
        if record.of_mover != 0:
            # no shadow of a mover any more: its sums go
            sums = wp.vec2(0.0, 0.0)
            if settings.movers == GRADUAL:
                # the test that is added below counts: net, n falls by the decrement
                sums = fade_out(record.rho, record.n, settings.decrement + settings.weight)
            record.rho = sums[0]
            record.n = sums[1]
            if record.n <= 0.0:
                record.of_mover = 0
                record.blocker_rise = 0.0

        aged = age_sums(record.rho, record.n, test.tau, settings.weight, settings.light_window)
        record.rho = aged[0]
        record.n = aged[1]

        is_new = record.n <= 0.0
        is_estimated = is_new and settings.start == START_PCSS
        if is_new and settings.start != START_SAMPLE and test.receiver.layer >= 0:
            # the last frame's mean blocker is that of sums which are gone
            record.blocker_rise = 0.0
            spread = settings.search_radius * UNROTATED
            mean_depth = float(0.0)
            if is_estimated:
                axes = texels_per_ratio(light_map, footprint, test.receiver.layer, position_ws)
                nearest_depth = footprint.nearest_depth[test.receiver.layer]
                spread = penumbra_spread(light_map, footprint, test.receiver, axes, nearest_depth)
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
                test.tau = 1.0 - found[0]
                mean_depth = found[1]
            else:
                mean_depth = mean_blocker_depth(light_map, test.receiver, spread, settings.blocker_taps)[0]
            if mean_depth > 0.0:
                record.blocker_rise = wp.clamp(1.0 - mean_depth / test.receiver.plane_depth[2], 0.0, 1.0)
            if settings.has_movers != 0 and moves == 0:
                moves = meets_mover(light_map, test.receiver, spread, settings.blocker_taps)
        elif test.blocker_rise > 0.0:
            known = wp.where(settings.counts_tests != 0, record.n, record.rho) + settings.first_blockers
            record.blocker_rise = refine_blocker(record.blocker_rise, test.blocker_rise, known)
        if is_estimated:
            record.n = settings.start_weight
            record.rho = test.tau * settings.start_weight
        else:
            longest = window_of(hidden_share(record.rho, record.n), record.spread, settings.window)
            sums = shorten(record.rho, record.n, longest)
            record.rho = sums[0]
            record.n = sums[1]
            sums = add_test(record.rho, record.n, test.tau, settings.weight, settings.storage.limit)
            record.rho = sums[0]
            record.n = sums[1]
        record.depth = gbuffer.depth[y, x]

        psi = hidden_share(record.rho, record.n)
        error = standard_error(psi, record.n * settings.effective_share)
        is_uncertain = is_estimated or record.n < settings.least_samples or error > settings.error_threshold
        if settings.smooths != 0 and is_uncertain and record.blocker_rise > 0.0:
            # equation 6, from the depth of the point itself: it may be turned away from this sample, if not from all
            receiver_depth = locate(light_map, position_ws)[2]
            ratio = penumbra_ratio(footprint.is_point, receiver_depth, receiver_depth * (1.0 - record.blocker_rise))
            width_px = settings.light_size * ratio * pixels_per_length(gbuffer.view, record.depth)
            half_width = settings.half_widths * width_px
            if settings.narrows != 0:
                half_width = half_width * wp.min(1.0, error / FULL_WIDTH_ERROR)
            if settings.stores_smoothed != 0 and not was_known:
                half_width = -half_width
        if moves != 0:
            record.of_mover = 1
            if settings.movers == DISOCCLUDE:
                record = ShadowRecord()
                record.depth = gbuffer.depth[y, x]
    write_record(current_out, y, x, record, gbuffer.view.far)
    psi_depth_out[y, x] = wp.vec2(psi, record.depth)
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
    psi_depth_out: wp.array2d(dtype=wp.vec2),
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
        psi_depth_out: Hidden share of the light and linear eye depth, (H, W); (0, 0) where nothing receives.
        error_out: Its standard error.
        half_width_out: Half the width in pixels of the filter that the pixel asks for; 0 for none. Negative where the
            smoothed value is to be stored as the pixel's start.
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
        psi_depth_out,
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
