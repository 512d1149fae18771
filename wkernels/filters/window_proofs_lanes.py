"""Windows of a run of receivers judged by a map's pyramid: ``window_proofs.judge_window``, 16 at a time."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, flat_floats
from wkernels.filters.pyramid import DepthPyramid
from wkernels.filters.window_proofs import ALL_DARK, ALL_LIT, PLANE_ROUNDING, UNDECIDED
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, ReceiverRun


@wp.struct
class WindowRun:
    """The window of each lane [texels]."""

    x0: Floats
    y0: Floats
    x1: Floats
    y1: Floats


@wp.struct
class LanePyramid:
    """Views of a pyramid; they own no memory and must not outlive it."""

    ranges: wp.array(dtype=float)  # flat: least and greatest of each square
    begin: wp.array(dtype=int)  # flat (levels, layers)
    levels: int


def lane_pyramid(pyramid: DepthPyramid) -> LanePyramid:
    """Views of what lane kernels read, on the CPU."""
    out = LanePyramid()
    out.ranges, out.begin = flat_floats(pyramid.ranges), pyramid.levels.begin.flatten()
    out.levels = pyramid.levels.levels
    return out


@wp.func
def judge_windows_run(
    views: LaneViews,
    light_map: LightMap,
    pyramid: LanePyramid,
    receivers: ReceiverRun,
    windows: WindowRun,
    reads: int,
):
    """``judge_window`` of each lane; UNDECIDED for lanes without a receiver."""
    depth = views.depth
    ranges = pyramid.ranges
    begin = pyramid.begin
    layers = light_map.layers
    resolution = light_map.resolution
    last = resolution - 1
    map_pitch = light_map.pitch
    layer = receivers.layer
    left = Ints(0)
    top = Ints(0)
    right = Ints(0)
    bottom = Ints(0)
    within = Ints(0)
    level = Ints(0)
    x0s = windows.x0
    y0s = windows.y0
    x1s = windows.x1
    y1s = windows.y1
    for k in range(LANES):
        l = int(wp.floor(x0s[k]))
        t = int(wp.floor(y0s[k]))
        r = int(wp.floor(x1s[k]))
        b = int(wp.floor(y1s[k]))
        within[k] = wp.where(wp.min(l, t) >= 0, wp.where(wp.max(r, b) <= last, 1, 0), 0)
        left[k] = wp.clamp(l, 0, last)
        top[k] = wp.clamp(t, 0, last)
        right[k] = wp.clamp(r, 0, last)
        bottom[k] = wp.clamp(b, 0, last)
    for i in range(pyramid.levels - 1):
        wide = int(0)
        for k in range(LANES):
            across = (right[k] >> i) - (left[k] >> i)
            down = (bottom[k] >> i) - (top[k] >> i)
            more = wp.where(wp.max(across, down) >= reads, 1, 0)
            level[k] = level[k] + more
            wide += more
        if wide == 0:
            break
    at_0 = Ints(0)
    pitch = Ints(0)
    on_map = int(0)
    for k in range(LANES):
        own = level[k]
        at_0[k] = begin[own * layers + wp.max(layer[k], 0)]
        pitch[k] = wp.where(own == 0, map_pitch, (resolution + (1 << own) - 1) >> own)
        on_map += wp.where(own == 0, 1, 0)
    least = Floats(wp.inf)
    greatest = Floats(-wp.inf)
    for i in range(reads):
        for j in range(reads):
            if on_map > 0:
                for k in range(LANES):
                    own = level[k]
                    row = wp.min((top[k] >> own) + i, bottom[k] >> own)
                    column = wp.min((left[k] >> own) + j, right[k] >> own)
                    at = at_0[k] + row * pitch[k] + column
                    held = wp.abs(depth[wp.where(own == 0, at, 0)])
                    least[k] = wp.where(own == 0, wp.min(least[k], held), least[k])
                    greatest[k] = wp.where(own == 0, wp.max(greatest[k], held), greatest[k])
            if on_map < LANES:
                for k in range(LANES):
                    own = level[k]
                    row = wp.min((top[k] >> own) + i, bottom[k] >> own)
                    column = wp.min((left[k] >> own) + j, right[k] >> own)
                    at = 2 * wp.where(own == 0, 0, at_0[k] + row * pitch[k] + column)
                    least[k] = wp.where(own == 0, least[k], wp.min(least[k], ranges[at]))
                    greatest[k] = wp.where(own == 0, greatest[k], wp.max(greatest[k], ranges[at + 1]))
    xs = receivers.x
    ys = receivers.y
    own_depth = receivers.depth
    bias = receivers.bias
    rise_x = receivers.rise_x
    rise_y = receivers.rise_y
    rise = receivers.rise
    scale_x = receivers.scale_x
    scale_y = receivers.scale_y
    judged = Ints(0)
    for k in range(LANES):
        dx0 = float(left[k]) - xs[k]
        dy0 = float(top[k]) - ys[k]
        dx1 = float(right[k] + 1) - xs[k]
        dy1 = float(bottom[k] + 1) - ys[k]
        sx0 = scale_x[k] * dx0
        sx1 = scale_x[k] * dx1
        sy0 = scale_y[k] * dy0
        sy1 = scale_y[k] * dy1
        rx0 = rise_x[k] * dx0
        rx1 = rise_x[k] * dx1
        ry0 = rise_y[k] * dy0
        ry1 = rise_y[k] * dy1
        s00 = sx0 + sy0 + 1.0
        s10 = sx1 + sy0 + 1.0
        s01 = sx0 + sy1 + 1.0
        s11 = sx1 + sy1 + 1.0
        z00 = (rx0 + ry0 + rise[k]) / s00
        z10 = (rx1 + ry0 + rise[k]) / s10
        z01 = (rx0 + ry1 + rise[k]) / s01
        z11 = (rx1 + ry1 + rise[k]) / s11
        lowest = wp.min(wp.min(z00, z10), wp.min(z01, z11))
        highest = wp.max(wp.max(z00, z10), wp.max(z01, z11))
        least_scale = wp.min(wp.min(s00, s10), wp.min(s01, s11))
        scale_size = wp.max(wp.abs(sx0), wp.abs(sx1)) + wp.max(wp.abs(sy0), wp.abs(sy1)) + 1.0
        rise_size = wp.max(wp.abs(rx0), wp.abs(rx1)) + wp.max(wp.abs(ry0), wp.abs(ry1)) + wp.abs(rise[k])
        size = wp.max(wp.abs(lowest), wp.abs(highest))
        slack = PLANE_ROUNDING * (rise_size + size * scale_size) / least_scale
        bounded = least_scale > 16.0 * PLANE_ROUNDING * scale_size
        high = wp.where(bounded, wp.max(highest + (slack - bias[k]), own_depth[k]), float(wp.inf))
        low = wp.where(bounded, wp.min(lowest - (slack + bias[k]), own_depth[k]), -float(wp.inf))
        dark = wp.where(low > greatest[k], wp.where(within[k] != 0, ALL_DARK, UNDECIDED), UNDECIDED)
        judged[k] = wp.where(layer[k] >= 0, wp.where(high <= least[k], ALL_LIT, dark), UNDECIDED)
    return judged
