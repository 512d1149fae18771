"""The least and greatest depth of squares of a map's texels, and of windows (a hierarchical shadow map).

Squares are those of ``levels``; depths are without the tag of moving casters, +inf where nothing casts.
``window_proofs`` says what follows for comparisons (Guennebaud, Barthe and Paulin 2006).
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Pairs, in_floats, runs_of
from wkernels.device.twin import Twin
from wkernels.filters.levels import MapLevels, lay_out_levels, pitch_of, side_of, sides_of
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.storage import MapLayout
from wkernels.workspace.workspace import Workspace


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
def range_of_depth(depth: float):
    """The range of one texel."""
    return wp.vec2(wp.abs(depth), wp.abs(depth))


@wp.kernel
def find_first_ranges(first: int, depth: wp.array(dtype=float), levels: MapLevels, ranges_out: wp.array(dtype=wp.vec2)):
    """The range of one square of level 1."""
    row, layer, x = wp.tid()
    y = first + row
    last = levels.resolution - 1
    upper = levels.begin[0, layer] + 2 * y * levels.pitch
    lower = levels.begin[0, layer] + wp.min(2 * y + 1, last) * levels.pitch
    right = wp.min(2 * x + 1, last)
    first_column = join_ranges(range_of_depth(depth[upper + 2 * x]), range_of_depth(depth[lower + 2 * x]))
    second_column = join_ranges(range_of_depth(depth[upper + right]), range_of_depth(depth[lower + right]))
    ranges_out[levels.begin[1, layer] + y * side_of(levels, 1) + x] = join_ranges(first_column, second_column)


@wp.kernel
def find_ranges(
    first: int, finer: wp.array(dtype=wp.vec2), levels: MapLevels, level: int, ranges_out: wp.array(dtype=wp.vec2)
):
    """The range of one square of a higher level, from the one below."""
    row, layer, x = wp.tid()
    y = first + row
    side = side_of(levels, level - 1)
    upper = levels.begin[level - 1, layer] + 2 * y * side
    lower = levels.begin[level - 1, layer] + wp.min(2 * y + 1, side - 1) * side
    right = wp.min(2 * x + 1, side - 1)
    first_column = join_ranges(finer[upper + 2 * x], finer[lower + 2 * x])
    second_column = join_ranges(finer[upper + right], finer[lower + right])
    at = levels.begin[level, layer] + y * side_of(levels, level) + x
    ranges_out[at] = join_ranges(first_column, second_column)


@wp.kernel
def find_first_ranges_lanes(
    first: int, depth: wp.array(dtype=Pairs), levels: MapLevels, ranges_out: wp.array(dtype=Pairs)
):
    """``find_first_ranges`` of a run of squares, over an even number of texels per side."""
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
    """``find_ranges`` of a run of squares, likewise; 8 of them at a time."""
    row, layer, run = wp.tid()
    y = first + row
    side = side_of(levels, level)
    start = 2 * wp.min(run * LANES, side - LANES)
    pitch = 4 * side
    begin = 2 * levels.begin[level - 1, layer] + 2 * y * pitch
    for part in range(2):
        at = start + part * LANES
        least = wp.min(finer[begin + 2 * at], finer[begin + pitch + 2 * at])
        greatest = wp.max(finer[begin + 2 * at], finer[begin + pitch + 2 * at])
        ranges = Floats(0.0)
        for k in range(LANES):
            i = 2 * k - k % 2
            ranges[k] = wp.where(k % 2 == 0, wp.min(least[i], least[i + 2]), wp.max(greatest[i], greatest[i + 2]))
        ranges_out[2 * (levels.begin[level, layer] + y * side) + at] = ranges


def _has_runs(levels: MapLevels, level: int) -> bool:
    """Whether every square has four texels below it, and a row holds a run."""
    sides = sides_of(levels)
    return sides[level - 1] % 2 == 0 and sides[level] >= LANES


def _in_pairs(values: wp.array, *others: object) -> list:
    return [runs_of(values, Pairs), *others]


FIND_FIRST_RANGES = Twin(
    find_first_ranges,
    find_first_ranges_lanes,
    inputs=_in_pairs,
    outputs=_in_pairs,
    fits=lambda depth, levels, out: _has_runs(levels, 1),
)
"""(depth, levels) -> ranges, of which level 1 is written."""
FIND_RANGES = Twin(
    find_ranges,
    find_ranges_lanes,
    inputs=_in_pairs,
    outputs=in_floats,
    fits=lambda r, levels, level, out: _has_runs(levels, level),
)
"""(ranges, levels, level) -> ranges, of which one level is written."""


def find_pyramid(work: Workspace, depth: wp.array, layout: MapLayout, old: DepthPyramid | None = None) -> DepthPyramid:
    """The pyramid of a light map.

    Args:
        work: Where it runs.
        depth: float32 (texels,), linear depths in the layout.
        layout: Of the map.
        old: Of an earlier map; its memory is taken over where it fits.
    """
    out = DepthPyramid()
    levels = out.levels = lay_out_levels(layout, work.device)
    size = max(levels.texels, 1)
    fits = old is not None and old.ranges.size == size
    out.ranges = old.ranges if old and fits else wp.zeros(size, dtype=wp.vec2, device=work.device)
    for level, side in enumerate(sides_of(levels)[1:], 1):
        twin = FIND_FIRST_RANGES if level == 1 else FIND_RANGES
        inputs = [depth, levels] if level == 1 else [out.ranges, levels, level]
        work.launch(twin, (side, levels.layers, side), inputs, [out.ranges])
    return out


def pull_pyramid(work: Workspace, light_map: HostMap) -> DepthPyramid:
    """``find_pyramid`` of a map as a product."""

    def build(old: DepthPyramid | None) -> DepthPyramid:
        return find_pyramid(work, light_map.map.depth, light_map.layout, old)

    key = ("depth pyramid", light_map.slot)
    pyramid: DepthPyramid = work.product("depth pyramid", key, (light_map.map,), build)
    return pyramid


@wp.func
def range_of(depth: wp.array(dtype=float), pyramid: DepthPyramid, level: int, layer: int, column: int, row: int):
    """The range of one square of any level; ``depth`` is the map's."""
    at = pyramid.levels.begin[level, layer] + row * pitch_of(pyramid.levels, level) + column
    result = wp.vec2()
    if level == 0:
        result = range_of_depth(depth[at])
    else:
        result = pyramid.ranges[at]
    return result


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
