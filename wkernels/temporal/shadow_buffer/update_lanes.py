"""``update`` for a run of pixels at a time; ``docs/lanes.md`` says how such code is written.

The lanes do what nearly every pixel needs: the hard test, the history's four texels each with its depth test, the
sums, the error and the filter's width; and in runs with new pixels their start. What few pixels need is left to the
plain function, one pixel at a time: the end of a moving caster's shadow, surfaces whose motion is followed.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, flat_floats, runs_of
from wkernels.device.twin import Twin
from wkernels.filters.penumbra import NEAREST_BLOCKER, LightFootprint
from wkernels.filters.penumbra_lanes import flat_half_axes
from wkernels.light_maps.comparison_lanes import first_texels
from wkernels.light_maps.layer_lanes import to_layers
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.point_lanes import PointRun, points_of_run
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.sampling.estimators import NO_WINDOW
from wkernels.scene.views import View
from wkernels.temporal.sample_window import SAME
from wkernels.temporal.shadow_buffer.own_umbra import own_umbra_run
from wkernels.temporal.shadow_buffer.recall import recall_run
from wkernels.temporal.shadow_buffer.record_lanes import HistoryRun
from wkernels.temporal.shadow_buffer.rules import DISOCCLUDE, SampledLight, UpdateRules
from wkernels.temporal.shadow_buffer.start import START_PCSS, START_SAMPLE
from wkernels.temporal.shadow_buffer.start_lanes import start_run
from wkernels.temporal.shadow_buffer.update import FULL_WIDTH_ERROR, UPDATE_PLAIN, update_pixel


@wp.func
def depth_in_light(light_map: LightMap, points: PointRun):
    """Linear depth from the light of each lane's point, ``locate``'s; 0 where no layer covers it."""
    px = points.x
    py = points.y
    pz = points.z
    layers = to_layers(light_map, points.receives, px, py, pz)
    out = Floats(0.0)
    for layer in range(light_map.layers):
        m = light_map.ws_to_ls[layer]
        m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
        for k in range(LANES):
            z = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
            out[k] = wp.where(layers[k] == layer, z, out[k])
    return out


@wp.kernel
def update_shadow_buffer_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    flat_previous: wp.array(dtype=float),
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    half_axes: wp.array(dtype=float),
    rules: UpdateRules,
    light: SampledLight,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    psi_depth_out: wp.array2d(dtype=wp.vec2),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """``update_shadow_buffer`` of a run of pixels, for float32 texels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    held = wp.min(LANES, psi_depth_out.shape[1] - x0)
    points = points_of_run(views, eye_depth, x0, y)
    own_umbra = own_umbra_run(views, points, x0, y, rules.light_corners)
    receives = points.receives
    for k in range(LANES):
        receives[k] = receives[k] - own_umbra[k]
    receivers = locate_run(views, light_map, rules.bias, x0, y)
    layers = receivers.layer
    own = receivers.depth
    plane = receivers.rise
    visible = receivers.visible
    xs = receivers.x
    ys = receivers.y

    depth = views.depth
    begin = first_texels(light_map, receivers)
    resolution = light_map.resolution
    pitch = light_map.pitch
    tau = Floats(0.0)
    new_rise = Floats(0.0)
    moves = Ints(0)
    wanted = Ints(0)
    for k in range(LANES):
        texel_x = int(wp.floor(xs[k]))
        texel_y = int(wp.floor(ys[k]))
        inside_x = wp.clamp(texel_x, 0, resolution - 1)
        inside_y = wp.clamp(texel_y, 0, resolution - 1)
        beyond = wp.where(inside_x != texel_x, 1, wp.where(inside_y != texel_y, 1, 0))
        tagged = depth[begin[k] + inside_y * pitch + inside_x]
        stored = wp.where(beyond != 0, float(wp.inf), wp.abs(tagged))
        hidden = wp.where(layers[k] >= 0, wp.where(own[k] > stored, 1, 0), 0)
        rise = wp.clamp(1.0 - stored / wp.where(hidden != 0, plane[k], 1.0), 0.0, 1.0)
        tau[k] = wp.where(layers[k] >= 0, float(hidden), 1.0 - visible[k])
        new_rise[k] = wp.where(hidden != 0, rise, 0.0)
        moves[k] = wp.where(tagged < 0.0, hidden, 0)
        wanted[k] = wp.where(moves[k] != 0, 0, receives[k])

    history = HistoryRun()
    if rules.recall.has_history != 0:
        history = recall_run(flat_previous, previous_view, gbuffer, points, wanted, x0, y, held, rules.recall)
    rho = history.rho
    n = history.n
    rises = history.blocker_rise
    of_mover = history.of_mover
    spreads = history.spread
    on_mover = points.moves
    alone = Ints(0)  # pixels for the plain function
    alone_count = int(0)
    searches = wp.where(rules.start.method != START_SAMPLE, 1, 0)
    follows = wp.where(rules.recall.followed_samples > 0.0, 1, 0)
    is_new = Ints(0)
    starts = Ints(0)
    starting = int(0)
    weight = light.weight
    # for ``age_sums``, not in an if: that would cost more than it saves
    room = wp.where(rules.counting.light_window > 0.0, wp.max(rules.counting.light_window - weight, 0.0), NO_WINDOW)
    new_share = weight / (room + weight)
    old_share = 1.0 - new_share
    for k in range(LANES):
        ages = n[k] > room
        held_n = wp.where(ages, n[k], 1.0)
        mean = old_share * (rho[k] / held_n) + new_share * tau[k]
        count = 1.0 / (old_share * old_share / held_n + new_share * new_share / weight)
        rho[k] = wp.where(ages, wp.max(mean * count - weight * tau[k], 0.0), rho[k])
        n[k] = wp.where(ages, wp.max(count - weight, 0.0), n[k])
        alone[k] = of_mover[k] | (on_mover[k] * follows)
        alone_count += alone[k]
        is_new[k] = wp.where(n[k] <= 0.0, receives[k] * searches * (1 - alone[k]), 0)
        starts[k] = wp.where(layers[k] >= 0, is_new[k], 0)
        starting += starts[k]
    if starting > 0:
        start = start_run(views, light_map, footprint, half_axes, receivers, starts, rules.start)
        start_tau = start.tau
        start_rise = start.blocker_rise
        start_moves = start.moves
        estimated = wp.where(rules.start.method == START_PCSS, 1, 0)
        tagged_too = rules.movers.tagged
        for k in range(LANES):
            tau[k] = wp.where((starts[k] & estimated) != 0, start_tau[k], tau[k])
            # the last frame's mean blocker is that of sums which are gone, and this test is among the taps
            rises[k] = wp.where(starts[k] != 0, start_rise[k], rises[k])
            new_rise[k] = wp.where(starts[k] != 0, 0.0, new_rise[k])
            met = wp.where(start_moves[k] > 0, starts[k] * tagged_too, 0)
            moves[k] = moves[k] | met

    smoothed = int(0)
    psi = Floats(0.0)
    error = Floats(0.0)
    first_blockers = rules.mean.first_blockers
    counts_tests = rules.mean.counts_tests
    limit = rules.counting.limit
    estimates = wp.where(rules.start.method == START_PCSS, 1, 0)
    start_weight = rules.start.weight
    smooths = rules.smoothing.asks
    uncertain = Ints(0)
    largest = rules.counting.window.largest - 1.0
    agreement = rules.counting.window.agreement
    least_window = rules.counting.window.least
    varies = wp.where(agreement > 0.0, SAME, 2.0)  # no variance is larger than 1/4
    threshold = wp.where(rules.smoothing.asks != 0, rules.smoothing.error_threshold, 2.0)  # no error is larger than 1
    least_samples = wp.where(rules.smoothing.asks != 0, rules.smoothing.least_samples, 0.0)
    for k in range(LANES):
        known = wp.where(counts_tests != 0, n[k], rho[k]) + first_blockers
        refined = wp.where(rises[k] > 0.0, (new_rise[k] + rises[k] * known) / (known + 1.0), new_rise[k])
        rises[k] = wp.where(new_rise[k] > 0.0, refined, rises[k])
        before = wp.clamp(rho[k] / wp.where(n[k] > 0.0, n[k], 1.0), 0.0, 1.0)
        agreed = wp.max(agreement * before * (1.0 - before) / wp.max(spreads[k], SAME), least_window)
        longest = wp.where(spreads[k] > varies, wp.min(largest, agreed), largest)
        keeps = wp.where(n[k] > longest, longest / wp.max(n[k], 1.0e-30), 1.0)
        rho[k] = rho[k] * keeps
        n[k] = n[k] * keeps
        scale = wp.where(n[k] + weight > limit, 0.5, 1.0)
        estimated = is_new[k] * estimates
        rho[k] = wp.where(estimated != 0, start_weight * tau[k], scale * rho[k] + weight * tau[k])
        n[k] = wp.where(estimated != 0, start_weight, scale * n[k] + weight)
        share = wp.clamp(rho[k] / n[k], 0.0, 1.0)
        variance = wp.max(share * (1.0 - share), 0.0) / wp.max(n[k] - 1.0, 0.5)
        deviation = wp.sqrt(wp.where(n[k] > 1.5, variance, 1.0))
        psi[k] = wp.where(receives[k] != 0, share, float(own_umbra[k]))
        error[k] = wp.where(receives[k] != 0, deviation, 0.0)
        few = wp.where(n[k] < least_samples, receives[k], estimated * smooths)
        uncertain[k] = wp.where(error[k] > threshold, receives[k], few) * wp.where(rises[k] > 0.0, 1, 0)
        smoothed += uncertain[k]

    half_width = Floats(0.0)
    eye_depths = points.depth
    if smoothed > 0:
        light_depth = depth_in_light(light_map, points)
        base = gbuffer.view.base_dx_ws
        along = gbuffer.view.along_dx_ws
        base_x, base_y, base_z = base[0], base[1], base[2]
        along_x, along_y, along_z = along[0], along[1], along[2]
        is_point = footprint.is_point
        size = rules.smoothing.half_widths * light.size
        narrows = rules.smoothing.narrows
        stores_smoothed = rules.start.stores_smoothed
        for k in range(LANES):
            blocker = light_depth[k] * (1.0 - rises[k])
            behind = wp.max(light_depth[k] - blocker, 0.0)
            nearest = wp.max(blocker, NEAREST_BLOCKER * light_depth[k])
            ratio = wp.where(is_point > 0.0, behind / wp.where(nearest > 0.0, nearest, 1.0), behind)
            s_x = base_x + eye_depths[k] * along_x
            s_y = base_y + eye_depths[k] * along_y
            s_z = base_z + eye_depths[k] * along_z
            pixels = size * ratio / wp.max(wp.sqrt(s_x * s_x + s_y * s_y + s_z * s_z), 1.0e-30)
            narrow = wp.where(narrows != 0, wp.min(1.0, error[k] / FULL_WIDTH_ERROR), 1.0)
            turned = wp.where(stores_smoothed != 0, wp.where(is_new[k] != 0, -1.0, 1.0), 1.0)
            half_width[k] = wp.where(uncertain[k] != 0, turned * pixels * narrow, 0.0)

    far = gbuffer.view.far
    drops = wp.where(rules.movers.treatment == DISOCCLUDE, light.is_last, 0)
    for k in range(held):
        keeps = wp.where((moves[k] & drops) != 0, 0.0, float(receives[k]))
        tag = wp.where(wp.where(keeps > 0.0, moves[k], 0) != 0, -1.0, 1.0)
        current_out[y, x0 + k] = wp.vec4(rho[k] * keeps, n[k] * keeps, tag * eye_depths[k] / far, rises[k] * keeps)
        psi_depth_out[y, x0 + k] = wp.vec2(psi[k], eye_depths[k])
        error_out[y, x0 + k] = error[k]
        half_width_out[y, x0 + k] = half_width[k]
    if alone_count > 0:
        for k in range(held):
            if alone[k] != 0:
                update_pixel(
                    x0 + k,
                    y,
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


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, footprint: LightFootprint, *rules: object) -> list:
    *_, previous = rules
    views = [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING), flat_floats(previous)]
    return [*views, gbuffer, light_map, footprint, flat_half_axes(footprint), *rules]


UPDATE: dict[type, wp.Kernel | Twin] = {
    **UPDATE_PLAIN,
    wp.vec4: Twin(
        UPDATE_PLAIN[wp.vec4],
        update_shadow_buffer_lanes,
        inputs=_in_lanes,
        fits=lambda gbuffer, light_map, footprint, rules, *_: rules.recall.texel_steps > 0.0,
        tolerance=1e-4,
        flips=0.01,
    ),
}
"""What updates, by texel type."""
