"""``history`` for a run of pixels at a time; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, flat_floats, runs_of
from wkernels.device.twin import Twin
from wkernels.light_maps.comparison_lanes import first_texels
from wkernels.light_maps.light_map import BIAS_SLOPE, LightMap
from wkernels.light_maps.point_lanes import points_of_run
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.scene.views import View
from wkernels.temporal.confidence.blending import LEAST_CONFIDENCE
from wkernels.temporal.confidence.history import ConfidentSettings, add_confident_test
from wkernels.temporal.shadow_buffer.record_lanes import HistoryRun, PlaceRun, fetch_run, place_run


@wp.kernel
def add_confident_test_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    flat_previous: wp.array(dtype=float),
    gbuffer: GBuffer,
    light_map: LightMap,
    settings: ConfidentSettings,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
):
    """``add_confident_test`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    points = points_of_run(views, eye_depth, x0, y)
    receives = points.receives
    receivers = locate_run(views, light_map, settings.bias, x0, y)
    layers = receivers.layer
    own = receivers.depth
    visible = receivers.visible
    xs = receivers.x
    ys = receivers.y
    rise = receivers.rise
    rise_x = receivers.rise_x
    rise_y = receivers.rise_y
    scale_x = receivers.scale_x
    scale_y = receivers.scale_y
    scales = wp.where(settings.bias.kind == BIAS_SLOPE, settings.scales_bias, 0)
    per_slope = wp.where(scales != 0, settings.bias.slope, 0.0)

    depth = views.depth
    resolution = light_map.resolution
    pitch = light_map.pitch
    begin = first_texels(light_map, receivers)
    tau = Floats(0.0)
    moves = Ints(0)
    wanted = Ints(0)
    nearness = Floats(0.0)
    for k in range(LANES):
        left = wp.floor(xs[k])
        upper = wp.floor(ys[k])
        inside_x = wp.clamp(int(left), 0, resolution - 1)
        inside_y = wp.clamp(int(upper), 0, resolution - 1)
        beyond = wp.where(inside_x != int(left), 1, wp.where(inside_y != int(upper), 1, 0))
        tagged = depth[begin[k] + inside_y * pitch + inside_x]
        stored = wp.where(beyond != 0, float(wp.inf), wp.abs(tagged))
        off_x = wp.abs(xs[k] - left - 0.5)
        off_y = wp.abs(ys[k] - upper - 0.5)
        # ``spare_bias``
        slope_x = wp.abs(rise_x[k] - rise[k] * scale_x[k])
        slope_y = wp.abs(rise_y[k] - rise[k] * scale_y[k])
        spare = per_slope * (slope_x * (0.5 - off_x) + slope_y * (0.5 - off_y))
        hidden = wp.where(layers[k] >= 0, wp.where(own[k] + spare > stored, 1, 0), 0)
        tau[k] = wp.where(layers[k] >= 0, float(hidden), 1.0 - visible[k])
        moves[k] = wp.where(tagged < 0.0, hidden, 0)
        wanted[k] = wp.where(moves[k] != 0, 0, receives[k])
        nearness[k] = wp.where(layers[k] >= 0, 1.0 - 2.0 * wp.max(off_x, off_y), 1.0)
    history = HistoryRun()
    places = PlaceRun()
    if settings.has_history != 0:
        places = place_run(previous_view, points, wanted, settings.texel_steps)
        history = fetch_run(flat_previous, previous_view, points, places, 0.0, settings.depth_epsilon)
    held_rho = history.rho
    held_n = history.n
    held_blur = history.blocker_rise
    share_x = places.share_x
    share_y = places.share_y

    memory = settings.blending.memory
    recursive = settings.blending.recursive
    most = settings.blending.blur
    growth = settings.blending.growth
    greatest = settings.blending.power
    kept = Floats(0.0)
    blurs = Floats(0.0)
    powers = Ints(0)
    for k in range(LANES):
        # ``kept_frames`` and ``chosen_power``
        blur = held_blur[k] + 0.5 * (share_x[k] * (1.0 - share_x[k]) + share_y[k] * (1.0 - share_y[k]))
        above = wp.where(blur > most, blur - most, 0.0)
        by_memory = wp.min(held_n[k], memory)
        kept[k] = wp.where(above > 0.0, wp.min(by_memory, most / wp.where(above > 0.0, above, 1.0)), by_memory)
        grown = wp.clamp(int(growth * wp.sqrt(kept[k])) - 1, 0, greatest)
        powers[k] = wp.where(recursive != 0, greatest, grown)
        blurs[k] = blur
    confidence = Floats(1.0)
    for i in range(greatest):
        for k in range(LANES):
            confidence[k] = wp.where(i < powers[k], confidence[k] * nearness[k], confidence[k])

    rho = Floats(0.0)
    n = Floats(0.0)
    psi = Floats(0.0)
    for k in range(LANES):
        # ``blend_shares``
        sure = wp.max(confidence[k], LEAST_CONFIDENCE)
        known = wp.where(kept[k] > 0.0, 1, 0)
        share = wp.where(known != 0, held_rho[k] / wp.where(known != 0, held_n[k], 1.0), 0.0)
        m = float(powers[k])
        least = wp.max(sure, 1.0 / (memory + 1.0))
        weight = wp.where(recursive != 0, least, sure / (2.0 / ((m + 1.0) * (m + 2.0))))
        old = wp.where(recursive != 0, wp.where(known != 0, 1.0 - weight, 0.0), kept[k])
        n[k] = old + weight
        blurs[k] = blurs[k] * old / n[k]
        rho[k] = wp.clamp(share, 0.0, 1.0) * old + weight * tau[k]
        psi[k] = wp.where(receives[k] != 0, wp.clamp(rho[k] / n[k], 0.0, 1.0), 0.0)

    far = gbuffer.view.far
    eye_depths = points.depth
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        keeps = wp.where(moves[k] != 0, 0.0, float(receives[k]))
        current_out[y, x0 + k] = wp.vec4(
            rho[k] * keeps, n[k] * keeps, eye_depths[k] / far, blurs[k] * float(receives[k])
        )
        visibility_out[y, x0 + k] = 1.0 - psi[k]


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, *others: object) -> list:
    *_, previous = others
    views = [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING), flat_floats(previous)]
    return [*views, gbuffer, light_map, *others]


ADD_CONFIDENT_TEST = Twin(add_confident_test, add_confident_test_lanes, inputs=_in_lanes, tolerance=1e-4, flips=0.01)
