"""One frame's step of a shadow buffer: a hard test added to what each pixel remembers, or a start where it is new.

Sources: Scherzer et al. 2009, sections 3.1 to 3.4, equations 1 to 7; Schwaerzler 2009, section 5.2 and appendix A. What
they differ in is in ``rules``. The plain kernel; ``update_lanes`` has the CPU's, ``step`` launches them.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.filters.neighbourhood_filter import pixels_per_length
from wkernels.filters.penumbra import LightFootprint, penumbra_ratio
from wkernels.light_maps.light_map import LightMap, locate
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.estimators import add_test, age_sums, fade_out, hidden_share, standard_error
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.sample_window import shorten, window_of
from wkernels.temporal.shadow_buffer.own_umbra import is_own_umbra
from wkernels.temporal.shadow_buffer.recall import recall_pixel
from wkernels.temporal.shadow_buffer.record import (
    TEXEL_TYPES,
    ShadowRecord,
    refine_blocker,
    shadow_test,
    write_record,
)
from wkernels.temporal.shadow_buffer.rules import DISOCCLUDE, GRADUAL, SampledLight, UpdateRules
from wkernels.temporal.shadow_buffer.start import START_PCSS, START_SAMPLE, start_pixel

FULL_WIDTH_ERROR = wp.constant(0.25)  # standard error of about five tests


@wp.func
def update_pixel(
    x: int,
    y: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    rules: UpdateRules,
    light: SampledLight,
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
    if is_own_umbra(gbuffer, y, x, rules.light_corners):
        # stores nothing, so that the lit side of an edge takes nothing from here, nor this side from there
        record.depth = gbuffer.depth[y, x]
        psi = 1.0
    elif (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]

        test = shadow_test(gbuffer, y, x, light_map, rules.bias)
        moves = test.moves
        if rules.recall.has_history != 0 and moves == 0:
            record = recall_pixel(previous, previous_view, gbuffer, y, x, rules.recall)
        was_known = record.n > 0.0
        if record.of_mover != 0:
            # no shadow of a mover any more: its sums go
            sums = wp.vec2(0.0, 0.0)
            if rules.movers.treatment == GRADUAL:
                # the test that is added below counts: net, n falls by the decrement
                sums = fade_out(record.rho, record.n, rules.movers.decrement + light.weight)
            record.rho = sums[0]
            record.n = sums[1]
            if record.n <= 0.0:
                record.of_mover = 0
                record.blocker_rise = 0.0

        aged = age_sums(record.rho, record.n, test.tau, light.weight, rules.counting.light_window)
        record.rho = aged[0]
        record.n = aged[1]

        is_new = record.n <= 0.0
        is_estimated = is_new and rules.start.method == START_PCSS
        if is_new and rules.start.method != START_SAMPLE and test.receiver.layer >= 0:
            started = start_pixel(
                light_map, footprint, test.receiver, position_ws, test.tau, moves, rules.movers.tagged, rules.start
            )
            test.tau = started.tau
            # the last frame's mean blocker is that of sums which are gone
            record.blocker_rise = started.blocker_rise
            moves = started.moves
        elif test.blocker_rise > 0.0:
            known = wp.where(rules.mean.counts_tests != 0, record.n, record.rho) + rules.mean.first_blockers
            record.blocker_rise = refine_blocker(record.blocker_rise, test.blocker_rise, known)
        if is_estimated:
            record.n = rules.start.weight
            record.rho = test.tau * rules.start.weight
        else:
            longest = window_of(hidden_share(record.rho, record.n), record.spread, rules.counting.window)
            sums = shorten(record.rho, record.n, longest)
            record.rho = sums[0]
            record.n = sums[1]
            sums = add_test(record.rho, record.n, test.tau, light.weight, rules.counting.limit)
            record.rho = sums[0]
            record.n = sums[1]
        record.depth = gbuffer.depth[y, x]

        psi = hidden_share(record.rho, record.n)
        error = standard_error(psi, record.n)
        is_uncertain = (
            is_estimated or record.n < rules.smoothing.least_samples or error > rules.smoothing.error_threshold
        )
        if rules.smoothing.asks != 0 and is_uncertain and record.blocker_rise > 0.0:
            # equation 6, from the depth of the point itself: it may be turned away from this sample, if not from all
            receiver_depth = locate(light_map, position_ws)[2]
            ratio = penumbra_ratio(footprint.is_point, receiver_depth, receiver_depth * (1.0 - record.blocker_rise))
            width_px = light.size * ratio * pixels_per_length(gbuffer.view, record.depth)
            half_width = rules.smoothing.half_widths * width_px
            if rules.smoothing.narrows != 0:
                half_width = half_width * wp.min(1.0, error / FULL_WIDTH_ERROR)
            if rules.start.stores_smoothed != 0 and not was_known:
                half_width = -half_width
        if moves != 0:
            record.of_mover = 1
            if rules.movers.treatment == DISOCCLUDE and light.is_last != 0:
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
    rules: UpdateRules,
    light: SampledLight,
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
        rules: What is done.
        light: Whose sample it is.
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
        rules,
        light,
        previous_view,
        previous,
        current_out,
        psi_depth_out,
        error_out,
        half_width_out,
    )


UPDATE_PLAIN = {
    texel: wp.overload(
        update_shadow_buffer, {"previous": wp.array2d(dtype=texel), "current_out": wp.array2d(dtype=texel)}
    )
    for texel in TEXEL_TYPES.values()
}
"""The kernel by texel type."""
