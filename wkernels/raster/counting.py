"""Counting coverage instead of keeping the nearest: how often each pixel is covered before or behind a given depth.

What shadow volumes and depth complexity need. The plain kernels: tiles on the CPU, as the twin of ``lane_counting`` and
for projections that it does not know, and atomic additions on CUDA.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.scratch import Scratch
from wkernels.raster.tiles import TILE, list_triangles
from wkernels.raster.triangles import (
    HALF_PIXEL,
    PIXEL_STEP,
    SUBPIXELS,
    ScreenTriangles,
    edge,
    interpolate_depth,
    set_up,
    top_left_bias,
)

COUNT_ALL, COUNT_NEARER, COUNT_FARTHER = wp.constant(0), wp.constant(1), wp.constant(2)
STRIPES = 16


@wp.struct
class Counted:
    """What is counted."""

    depth: wp.array2d(dtype=float)  # linear depth of what is seen; not read for COUNT_ALL
    test: int  # COUNT_ALL, COUNT_NEARER (depth < limit * seen) or COUNT_FARTHER (all others)
    limit: float
    front: int  # what a front face adds, and a back face
    back: int


@wp.func
def is_counted(counted: Counted, depth: float, y: int, x: int):
    """Whether a surface of this depth passes the test."""
    result = counted.test == COUNT_ALL
    if counted.test != COUNT_ALL:
        result = (depth < counted.limit * counted.depth[y, x]) == (counted.test == COUNT_NEARER)
    return result


@wp.kernel
def count_tile(
    first: int,
    triangles: ScreenTriangles,
    counted: Counted,
    tiles_x: int,
    tile_begin: wp.array(dtype=int),
    tile_list: wp.array(dtype=int),
    count_out: wp.array2d(dtype=int),
):
    """Clears one tile and counts its triangles."""
    tile = first + wp.tid()
    left = (tile % tiles_x) * TILE
    top = (tile / tiles_x) * TILE
    right = wp.min(left + TILE, triangles.width) - 1
    bottom = wp.min(top + TILE, triangles.height) - 1
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            count_out[y, x] = 0
    for k in range(tile_begin[tile], tile_begin[tile + 1]):
        s = set_up(triangles, tile_list[k])
        weight = wp.where(s.front == 1, counted.front, counted.back)
        bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
        bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
        bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
        for y in range(wp.max(s.y0, top), wp.min(s.y1, bottom) + 1):
            py = wp.int64(y * SUBPIXELS + HALF_PIXEL)
            for x in range(wp.max(s.x0, left), wp.min(s.x1, right) + 1):
                px = wp.int64(x * SUBPIXELS + HALF_PIXEL)
                e_a = edge(s.bx, s.by, s.cx, s.cy, px, py)
                e_b = edge(s.cx, s.cy, s.ax, s.ay, px, py)
                e_c = edge(s.ax, s.ay, s.bx, s.by, px, py)
                if ((e_a + bias_a) | (e_b + bias_b) | (e_c + bias_c)) >= wp.int64(0):
                    if is_counted(counted, interpolate_depth(s, e_a, e_b, e_c), y, x):
                        count_out[y, x] += weight


@wp.kernel
def count_stripe(
    first: int, triangles: ScreenTriangles, counted: Counted, stripes: int, count_out: wp.array2d(dtype=int)
):
    """CUDA: adds every ``stripes``-th row of one triangle to the counts."""
    i, stripe = wp.tid()
    s = set_up(triangles, first + i)
    weight = wp.where(s.front == 1, counted.front, counted.back)
    bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
    bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
    bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
    for y in range(s.y0 + stripe, s.y1 + 1, stripes):
        py = wp.int64(y * SUBPIXELS + HALF_PIXEL)
        px = wp.int64(s.x0 * SUBPIXELS + HALF_PIXEL)
        e_a = edge(s.bx, s.by, s.cx, s.cy, px, py)
        e_b = edge(s.cx, s.cy, s.ax, s.ay, px, py)
        e_c = edge(s.ax, s.ay, s.bx, s.by, px, py)
        for x in range(s.x0, s.x1 + 1):
            if ((e_a + bias_a) | (e_b + bias_b) | (e_c + bias_c)) >= wp.int64(0):
                if is_counted(counted, interpolate_depth(s, e_a, e_b, e_c), y, x):
                    wp.atomic_add(count_out, y, x, weight)  # integers: any order gives the same sum
            e_a += (s.by - s.cy) * PIXEL_STEP
            e_b += (s.cy - s.ay) * PIXEL_STEP
            e_c += (s.ay - s.by) * PIXEL_STEP


def count_plainly(
    scratch: Scratch, triangles: ScreenTriangles, total: int, counted: Counted, count_out: wp.array
) -> None:
    """Clears the target and counts ``total`` projected triangles, in tiles on the CPU, in stripes on CUDA."""
    if wp.get_device(scratch.device).is_cpu:
        tiles, tiles_x, begin, listed = list_triangles(scratch, triangles, total)
        scratch.launch(count_tile, tiles, [triangles, counted, tiles_x, begin, listed], [count_out])
        return
    count_out.zero_()
    scratch.launch(count_stripe, (total, STRIPES), [triangles, counted, STRIPES], [count_out])
