"""The least and greatest depth of squares of a map's texels, and what they prove of all comparisons in a window.

Where the receiver's plane lies before the least depth of a window all comparisons in it are lit, where it lies behind
the greatest none is, and a filter or a search over it need not look (hierarchical shadow map: Guennebaud, Barthe and
Paulin 2006). Squares are those of ``levels``; depths are without the tag of moving casters, +inf where nothing casts.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Pairs, runs_of, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.filters.levels import MapLevels, lay_out_levels, pitch_of, side_of, sides_of
from wkernels.light_maps.light_map import LightMap, Receiver
from wkernels.light_maps.storage import MapLayout

UNDECIDED, ALL_LIT, ALL_DARK = wp.constant(0), wp.constant(1), wp.constant(2)
PLANE_ROUNDING = wp.constant(1.0e-6)  # relative to the plane's terms: four times what float32 loses in their sum


@wp.struct
class DepthPyramid:
    """Ranges of depth over a light map, of the levels from 1 on; level 0 is the map."""

    ranges: wp.array(dtype=wp.vec2)  # (levels.texels,) least and greatest
    levels: MapLevels


@wp.func
def join_ranges(a: wp.vec2, b: wp.vec2):
    """The range that holds both."""
    return wp.vec2(wp.min(a[0], b[0]), wp.max(a[1], b[1]))


@wp.func
def range_of(depth: wp.array(dtype=float), pyramid: DepthPyramid, level: int, layer: int, column: int, row: int):
    """The range of one square; ``depth`` is the map's."""
    at = pyramid.levels.begin[level, layer] + row * pitch_of(pyramid.levels, level) + column
    result = wp.vec2()
    if level == 0:
        result = wp.vec2(wp.abs(depth[at]), wp.abs(depth[at]))
    else:
        result = pyramid.ranges[at]
    return result


@wp.kernel
def find_ranges(first: int, depth: wp.array(dtype=float), level: int, pyramid: DepthPyramid):
    """The range of one square of a level, from the one below; written into the pyramid."""
    row, layer, x = wp.tid()
    y = first + row
    last = side_of(pyramid.levels, level - 1) - 1
    right = wp.min(2 * x + 1, last)
    below = wp.min(2 * y + 1, last)
    upper = join_ranges(
        range_of(depth, pyramid, level - 1, layer, 2 * x, 2 * y),
        range_of(depth, pyramid, level - 1, layer, right, 2 * y),
    )
    lower = join_ranges(
        range_of(depth, pyramid, level - 1, layer, 2 * x, below),
        range_of(depth, pyramid, level - 1, layer, right, below),
    )
    at = pyramid.levels.begin[level, layer] + y * side_of(pyramid.levels, level) + x
    pyramid.ranges[at] = join_ranges(upper, lower)


@wp.kernel
def find_first_ranges_lanes(
    first: int, depth: wp.array(dtype=Pairs), levels: MapLevels, ranges_out: wp.array(dtype=Pairs)
):
    """``find_ranges`` of a run of squares of level 1, over an even number of texels per side."""
    row, layer, run = wp.tid()
    y = first + row
    side = side_of(levels, 1)
    start = wp.min(run * LANES, side - LANES)
    begin = levels.begin[0, layer] + 2 * (y * levels.pitch + start)
    upper = depth[begin]
    lower = depth[begin + levels.pitch]
    least = Pairs()
    greatest = Pairs()
    ranges = Pairs()
    for k in range(2 * LANES):
        least[k] = wp.min(wp.abs(upper[k]), wp.abs(lower[k]))
        greatest[k] = wp.max(wp.abs(upper[k]), wp.abs(lower[k]))
    for k in range(LANES):
        ranges[2 * k] = wp.min(least[2 * k], least[2 * k + 1])
        ranges[2 * k + 1] = wp.max(greatest[2 * k], greatest[2 * k + 1])
    ranges_out[2 * (levels.begin[1, layer] + y * side + start)] = ranges


@wp.kernel
def find_ranges_lanes(
    first: int, finer: wp.array(dtype=Pairs), levels: MapLevels, level: int, ranges_out: wp.array(dtype=Floats)
):
    """``find_ranges`` of a run of 8 squares of a higher level, likewise."""
    row, layer, run = wp.tid()
    y = first + row
    side = side_of(levels, level)
    start = wp.min(run * LANES, 2 * side - LANES)
    pitch = 2 * side_of(levels, level - 1)
    begin = 2 * levels.begin[level - 1, layer] + 2 * (y * pitch + start)
    upper = finer[begin]
    lower = finer[begin + pitch]
    least = wp.min(upper, lower)
    greatest = wp.max(upper, lower)
    ranges = Floats(0.0)
    for k in range(LANES):
        even = 2 * k - k % 2
        ranges[k] = wp.where(k % 2 == 0, wp.min(least[even], least[even + 2]), wp.max(greatest[even], greatest[even + 2]))
    ranges_out[2 * (levels.begin[level, layer] + y * side) + start] = ranges


def find_pyramid(
    depth: wp.array, layout: MapLayout, *, threads: int | None = None, old: DepthPyramid | None = None
) -> DepthPyramid:
    """The pyramid of a light map.

    Args:
        depth: float32 (texels,), linear depths in the layout.
        layout: Of the map.
        threads: CPU threads; see ``wkernels.device.launch``. The result does not depend on it.
        old: Of an earlier map; its memory is taken over where it fits.
    """
    device, out = str(depth.device), DepthPyramid()
    levels = out.levels = lay_out_levels(layout, device)
    size = max(levels.texels, 1)
    fits = old is not None and old.ranges.size == size
    out.ranges = old.ranges if fits else wp.empty(size, dtype=wp.vec2, device=device)  # type: ignore[union-attr]
    sides = sides_of(levels)
    for level, side in enumerate(sides[1:], 1):
        whole = uses_lanes(device) and sides[level - 1] % 2 == 0
        if whole and level == 1 and side >= LANES:
            grid = (side, levels.layers, runs_per_row(side))
            pairs = [runs_of(depth, Pairs), levels]
            launch(find_first_ranges_lanes, grid, pairs, [runs_of(out.ranges, Pairs)], device=device, threads=threads)
        elif whole and level > 1 and 2 * side >= LANES:
            grid = (side, levels.layers, runs_per_row(2 * side))
            pairs = [runs_of(out.ranges, Pairs), levels, level]
            launch(find_ranges_lanes, grid, pairs, [runs_of(out.ranges, Floats)], device=device, threads=threads)
        else:
            launch(find_ranges, (side, levels.layers, side), [depth, level, out], device=device, threads=threads)
    return out


@wp.func
def window_range(
    light_map: LightMap, pyramid: DepthPyramid, layer: int, left: int, top: int, right: int, bottom: int, reads: int
):
    """Least and greatest depth in a window of texels or in a little more than it.

    Args:
        light_map: The map.
        pyramid: Its pyramid.
        layer: Of the map.
        left: First column; the window lies within the layer.
        top: First row.
        right: Last column, >= ``left``.
        bottom: Last row, >= ``top``.
        reads: Squares of one level that are looked at along each axis, at most, >= 1. The more, the closer they follow
            the window; as many as the window is wide give exactly its range.
    """
    level = int(0)
    while wp.max((right >> level) - (left >> level), (bottom >> level) - (top >> level)) >= reads:
        level += 1
    result = wp.vec2(wp.inf, -wp.inf)
    for row in range(top >> level, (bottom >> level) + 1):
        for column in range(left >> level, (right >> level) + 1):
            result = join_ranges(result, range_of(light_map.depth, pyramid, level, layer, column, row))
    return result


@wp.func
def plane_range(receiver: Receiver, x0: float, y0: float, x1: float, y1: float):
    """Bounds of a receiver's biased depth over a rectangle of texel offsets: on its plane, and its own.

    They hold for ``receiver_depth_at``, for filters that take the receiver's own depth towards the plane's horizon, and
    for what either loses to rounding. A rectangle that the horizon crosses has no bounds.
    """
    lowest = float(wp.inf)
    highest = float(-wp.inf)
    least_scale = float(wp.inf)
    rise_size = float(0.0)
    scale_size = float(0.0)
    for i in range(4):
        dx = wp.where(i % 2 == 0, x0, x1)
        dy = wp.where(i < 2, y0, y1)
        scale_x = receiver.plane_scale[0] * dx
        scale_y = receiver.plane_scale[1] * dy
        rise_x = receiver.plane_depth[0] * dx
        rise_y = receiver.plane_depth[1] * dy
        scale = scale_x + scale_y + 1.0
        depth = (rise_x + rise_y + receiver.plane_depth[2]) / scale
        least_scale = wp.min(least_scale, scale)
        # the ratio of two affine functions is monotone along every line on which the lower one is positive
        lowest = wp.min(lowest, depth)
        highest = wp.max(highest, depth)
        scale_size = wp.max(scale_size, wp.abs(scale_x) + wp.abs(scale_y) + 1.0)
        rise_size = wp.max(rise_size, wp.abs(rise_x) + wp.abs(rise_y) + wp.abs(receiver.plane_depth[2]))
    result = wp.vec2(-wp.inf, wp.inf)
    if least_scale > 16.0 * PLANE_ROUNDING * scale_size:
        size = wp.max(wp.abs(lowest), wp.abs(highest))
        slack = PLANE_ROUNDING * (rise_size + size * scale_size) / least_scale + receiver.bias
        lowest = wp.min(lowest - slack, receiver.depth)
        highest = wp.max(highest + (slack - 2.0 * receiver.bias), receiver.depth)
        result = wp.vec2(lowest, highest)
    return result


@wp.func
def judge_window(
    light_map: LightMap,
    pyramid: DepthPyramid,
    receiver: Receiver,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    reads: int,
):
    """What is known of all comparisons of a receiver's plane with the texels that a window touches.

    Args:
        light_map: The map.
        pyramid: Its pyramid.
        receiver: Of ``locate_receiver``, on a layer.
        x0: Left border of the window [texels]; ``compare_bilinear`` reads texels half a texel beyond its taps.
        y0: Upper border.
        x1: Right border, >= ``x0``.
        y1: Lower border, >= ``y0``.
        reads: As in ``window_range``.

    Returns:
        ALL_LIT, ALL_DARK or UNDECIDED. It holds for filters that move taps beyond the layer to its border and for those
        to which all is lit there: what sticks out is never all dark.
    """
    last = light_map.resolution - 1
    left = int(wp.floor(x0))
    top = int(wp.floor(y0))
    right = int(wp.floor(x1))
    bottom = int(wp.floor(y1))
    within = left >= 0 and top >= 0 and right <= last and bottom <= last
    left = wp.clamp(left, 0, last)
    top = wp.clamp(top, 0, last)
    right = wp.clamp(right, 0, last)
    bottom = wp.clamp(bottom, 0, last)
    stored = window_range(light_map, pyramid, receiver.layer, left, top, right, bottom, reads)
    plane = plane_range(
        receiver,
        float(left) - receiver.x,
        float(top) - receiver.y,
        float(right + 1) - receiver.x,
        float(bottom + 1) - receiver.y,
    )
    result = UNDECIDED
    if plane[1] <= stored[0]:
        result = ALL_LIT
    elif within and plane[0] > stored[1]:
        result = ALL_DARK
    return result
