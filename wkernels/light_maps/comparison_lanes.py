"""Comparisons of a run of receivers with a light map; see ``receiver_lanes.py`` for how such code is written.

Every function does what the one of the same name in ``light_map.py`` or ``filtering.py`` does, in the same order of
operations, so that both agree to the bit where the receivers do.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.light_map import BORDER, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, ReceiverRun


@wp.struct
class SpreadRun:
    """The 2 x 2 matrix of each lane that takes a tap to texels, by rows."""

    xx: Floats
    xy: Floats
    yx: Floats
    yy: Floats


@wp.func
def tap_depth_lane(
    dx: float,
    dy: float,
    depth: float,
    bias: float,
    rise_x: float,
    rise_y: float,
    rise_0: float,
    scale_x: float,
    scale_y: float,
):
    """``tap_depth`` of one lane."""
    scale = scale_x * dx + scale_y * dy + 1.0
    rise = rise_x * dx + rise_y * dy + rise_0
    # one division for both cases; where scale is 0 or less its outcome is not used
    plane = (rise - wp.where(scale >= 1.0, 0.0, bias / scale)) / scale
    return wp.where(scale >= 1.0, plane - bias, wp.where(scale > 0.0, wp.max(depth, plane), depth))


@wp.func
def texel_depth_lane(
    dx: float, dy: float, bias: float, rise_x: float, rise_y: float, rise_0: float, scale_x: float, scale_y: float
):
    """``receiver_depth_at`` of one lane."""
    scale = scale_x * dx + scale_y * dy + 1.0
    rise = rise_x * dx + rise_y * dy + rise_0
    return wp.where(scale > 0.0, rise / scale - bias, float(wp.inf))


@wp.func
def first_texels(light_map: LightMap, receivers: ReceiverRun):
    """Where in the map each lane's layer begins; the first for lanes without one, which must not index outside."""
    layers = receivers.layer
    layer_begin = light_map.layer_begin
    begin = Ints(layer_begin[0])
    if light_map.layers > 1:
        for k in range(LANES):
            begin[k] = layer_begin[wp.max(layers[k], 0)]
    return begin


@wp.func
def compare_nearest_run(views: LaneViews, light_map: LightMap, receivers: ReceiverRun):
    """``compare_nearest``: the hard shadow test of each lane; lanes without a receiver keep their visibility."""
    depth = views.depth
    resolution = light_map.resolution
    pitch = light_map.pitch
    layers = receivers.layer
    begin = first_texels(light_map, receivers)
    xs = receivers.x
    ys = receivers.y
    own = receivers.depth
    visible = receivers.visible
    for k in range(LANES):
        column = int(wp.floor(xs[k]))
        row = int(wp.floor(ys[k]))
        inside_x = wp.clamp(column, 0, resolution - 1)
        inside_y = wp.clamp(row, 0, resolution - 1)
        beyond = wp.where(inside_x != column, 1, wp.where(inside_y != row, 1, 0))
        stored = wp.abs(depth[begin[k] + inside_y * pitch + inside_x])
        lit = wp.where(own[k] <= wp.where(beyond != 0, float(wp.inf), stored), 1.0, 0.0)
        visible[k] = wp.where(layers[k] >= 0, lit, visible[k])
    return visible


@wp.func
def compare_nearest_taps(
    views: LaneViews,
    light_map: LightMap,
    receivers: ReceiverRun,
    spread: SpreadRun,
    taps: wp.array(dtype=wp.vec2),
):
    """One comparison per tap with the nearest texel.

    Returns (taps lit, sum of the stored depths of the others, how many of these are of moving casters).
    """
    depth = views.depth
    resolution = light_map.resolution
    pitch = light_map.pitch
    begin = first_texels(light_map, receivers)
    xs = receivers.x
    ys = receivers.y
    own = receivers.depth
    bias = receivers.bias
    rise_x = receivers.rise_x
    rise_y = receivers.rise_y
    rise = receivers.rise
    scale_x = receivers.scale_x
    scale_y = receivers.scale_y
    xx = spread.xx
    xy = spread.xy
    yx = spread.yx
    yy = spread.yy
    in_perspective = receivers.in_perspective
    last = float(resolution) - BORDER
    lit = Floats(0.0)
    hidden_depth = Floats(0.0)
    moving = Ints(0)
    for i in range(taps.shape[0]):
        tap = taps[i]
        tap_x = tap[0]
        tap_y = tap[1]
        if in_perspective == 0:
            for k in range(LANES):
                x = wp.clamp(xs[k] + (xx[k] * tap_x + xy[k] * tap_y), BORDER, last)
                y = wp.clamp(ys[k] + (yx[k] * tap_x + yy[k] * tap_y), BORDER, last)
                tagged = depth[begin[k] + int(y) * pitch + int(x)]
                stored = wp.abs(tagged)
                plane = rise_x[k] * (x - xs[k]) + rise_y[k] * (y - ys[k]) + rise[k] - bias[k]
                lit[k] = lit[k] + wp.where(plane <= stored, 1.0, 0.0)
                hidden_depth[k] = hidden_depth[k] + wp.where(plane > stored, stored, 0.0)
                moving[k] = moving[k] + wp.where(plane > stored, wp.where(tagged < 0.0, 1, 0), 0)
            continue
        for k in range(LANES):
            x = wp.clamp(xs[k] + (xx[k] * tap_x + xy[k] * tap_y), BORDER, last)
            y = wp.clamp(ys[k] + (yx[k] * tap_x + yy[k] * tap_y), BORDER, last)
            tagged = depth[begin[k] + int(y) * pitch + int(x)]
            stored = wp.abs(tagged)
            plane = tap_depth_lane(
                x - xs[k], y - ys[k], own[k], bias[k], rise_x[k], rise_y[k], rise[k], scale_x[k], scale_y[k]
            )
            lit[k] = lit[k] + wp.where(plane <= stored, 1.0, 0.0)
            hidden_depth[k] = hidden_depth[k] + wp.where(plane > stored, stored, 0.0)
            moving[k] = moving[k] + wp.where(plane > stored, wp.where(tagged < 0.0, 1, 0), 0)
    return lit, hidden_depth, moving


@wp.func
def compare_bilinear_taps(
    views: LaneViews,
    light_map: LightMap,
    receivers: ReceiverRun,
    spread: SpreadRun,
    taps: wp.array(dtype=wp.vec2),
):
    """``compare_bilinear`` at each tap, summed."""
    depth = views.depth
    resolution = light_map.resolution
    pitch = light_map.pitch
    begin = first_texels(light_map, receivers)
    xs = receivers.x
    ys = receivers.y
    bias = receivers.bias
    rise_x = receivers.rise_x
    rise_y = receivers.rise_y
    rise = receivers.rise
    scale_x = receivers.scale_x
    scale_y = receivers.scale_y
    xx = spread.xx
    xy = spread.xy
    yx = spread.yx
    yy = spread.yy
    last = float(resolution) - 0.5
    beyond = float(wp.inf)
    lit = Floats(0.0)
    for i in range(taps.shape[0]):
        tap = taps[i]
        tap_x = tap[0]
        tap_y = tap[1]
        for k in range(LANES):
            at_x = wp.clamp(xs[k] + (xx[k] * tap_x + xy[k] * tap_y), 0.5, last)
            at_y = wp.clamp(ys[k] + (yx[k] * tap_x + yy[k] * tap_y), 0.5, last)
            x = xs[k] + (at_x - xs[k]) - 0.5
            y = ys[k] + (at_y - ys[k]) - 0.5
            left = wp.floor(x)
            upper = wp.floor(y)
            fx = x - left
            fy = y - upper
            # rounding may put the outer column or row beyond the map, where all is lit
            c0 = wp.max(int(left), 0)
            c1 = wp.min(int(left) + 1, resolution - 1)
            r0 = begin[k] + wp.max(int(upper), 0) * pitch
            r1 = begin[k] + wp.min(int(upper) + 1, resolution - 1) * pitch
            no_c0 = wp.where(left < 0.0, beyond, 0.0)
            no_c1 = wp.where(left > last - 1.0, beyond, 0.0)
            no_r0 = wp.where(upper < 0.0, beyond, 0.0)
            no_r1 = wp.where(upper > last - 1.0, beyond, 0.0)
            dx0 = left + 0.5 - xs[k]
            dx1 = left + 1.0 + 0.5 - xs[k]
            dy0 = upper + 0.5 - ys[k]
            dy1 = upper + 1.0 + 0.5 - ys[k]
            z00 = texel_depth_lane(dx0, dy0, bias[k], rise_x[k], rise_y[k], rise[k], scale_x[k], scale_y[k])
            z10 = texel_depth_lane(dx1, dy0, bias[k], rise_x[k], rise_y[k], rise[k], scale_x[k], scale_y[k])
            z01 = texel_depth_lane(dx0, dy1, bias[k], rise_x[k], rise_y[k], rise[k], scale_x[k], scale_y[k])
            z11 = texel_depth_lane(dx1, dy1, bias[k], rise_x[k], rise_y[k], rise[k], scale_x[k], scale_y[k])
            s00 = wp.where(z00 <= wp.max(wp.abs(depth[r0 + c0]), wp.max(no_c0, no_r0)), 1.0, 0.0)
            s10 = wp.where(z10 <= wp.max(wp.abs(depth[r0 + c1]), wp.max(no_c1, no_r0)), 1.0, 0.0)
            s01 = wp.where(z01 <= wp.max(wp.abs(depth[r1 + c0]), wp.max(no_c0, no_r1)), 1.0, 0.0)
            s11 = wp.where(z11 <= wp.max(wp.abs(depth[r1 + c1]), wp.max(no_c1, no_r1)), 1.0, 0.0)
            lit[k] = lit[k] + wp.lerp(wp.lerp(s00, s10, fx), wp.lerp(s01, s11, fx), fy)
    return lit
