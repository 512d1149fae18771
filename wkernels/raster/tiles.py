"""The plain CPU rasteriser: 32 x 32 pixel tiles, one pixel at a time.

It draws views under any projection, and is the twin that the lane rasteriser is tested against. Triangles are counted
and listed per tile by chunks that own their lists, then each tile is drawn by one thread, in triangle order.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.raster.scratch import Scratch
from wkernels.raster.triangles import (
    HALF_PIXEL,
    NO_TRIANGLE,
    PIXEL_STEP,
    SUBPIXELS,
    ScreenTriangles,
    edge,
    interpolate_depth,
    is_cut,
    is_peeled,
    set_up,
    top_left_bias,
    triangle_id,
)

TILE = wp.constant(32)
CHUNKS = 32


@wp.kernel
def count_tiles(
    first: int,
    triangles: ScreenTriangles,
    total: int,
    chunks: int,
    tiles_x: int,
    tiles: int,
    box_out: wp.array(dtype=wp.vec4ub),
    counts_out: wp.array2d(dtype=int),  # (tiles, chunks)
):
    """Tile bounds of every triangle of one chunk, and how many triangles of the chunk each tile gets."""
    chunk = first + wp.tid()
    for tile in range(tiles):
        counts_out[tile, chunk] = 0
    begin = int(wp.int64(total) * wp.int64(chunk) / wp.int64(chunks))
    end = int(wp.int64(total) * wp.int64(chunk + 1) / wp.int64(chunks))
    for t in range(begin, end):
        s = set_up(triangles, t)
        box = wp.vec4ub(wp.uint8(1), wp.uint8(0), wp.uint8(0), wp.uint8(0))
        if s.x1 >= s.x0:
            box = wp.vec4ub(wp.uint8(s.x0 / TILE), wp.uint8(s.y0 / TILE), wp.uint8(s.x1 / TILE), wp.uint8(s.y1 / TILE))
            for y in range(s.y0 / TILE, s.y1 / TILE + 1):
                for x in range(s.x0 / TILE, s.x1 / TILE + 1):
                    counts_out[y * tiles_x + x, chunk] += 1
        box_out[t] = box


@wp.kernel
def list_tiles(
    first: int,
    box: wp.array(dtype=wp.vec4ub),
    total: int,
    chunks: int,
    tiles_x: int,
    next_slot: wp.array2d(dtype=int),  # (tiles, chunks), advanced
    list_out: wp.array(dtype=int),
):
    """Writes the triangles of one chunk into the tiles' lists, each in triangle order."""
    chunk = first + wp.tid()
    begin = int(wp.int64(total) * wp.int64(chunk) / wp.int64(chunks))
    end = int(wp.int64(total) * wp.int64(chunk + 1) / wp.int64(chunks))
    for t in range(begin, end):
        b = box[t]
        for y in range(int(b[1]), int(b[3]) + 1):
            for x in range(int(b[0]), int(b[2]) + 1):
                tile = y * tiles_x + x
                slot = next_slot[tile, chunk]
                next_slot[tile, chunk] = slot + 1
                list_out[slot] = t


@wp.kernel
def draw_tile(
    first: int,
    triangles: ScreenTriangles,
    tiles_x: int,
    tile_begin: wp.array(dtype=int),
    tile_list: wp.array(dtype=int),
    with_triangles: int,
    depth_out: wp.array2d(dtype=float),
    triangle_out: wp.array2d(dtype=int),
):
    """Clears one tile, unless it is drawn over, and draws its triangles, keeping the nearest depth.

    Ties go to the lower triangle index.
    """
    tile = first + wp.tid()
    left = (tile % tiles_x) * TILE
    top = (tile / tiles_x) * TILE
    right = wp.min(left + TILE, triangles.width) - 1
    bottom = wp.min(top + TILE, triangles.height) - 1
    if triangles.over == 0:
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                depth_out[y, x] = wp.inf
    if with_triangles != 0 and triangles.over == 0:
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                triangle_out[y, x] = NO_TRIANGLE
    for k in range(tile_begin[tile], tile_begin[tile + 1]):
        s = set_up(triangles, tile_list[k])
        x0 = wp.max(s.x0, left)
        x1 = wp.min(s.x1, right)
        y0 = wp.max(s.y0, top)
        y1 = wp.min(s.y1, bottom)
        px = wp.int64(x0 * SUBPIXELS + HALF_PIXEL)
        py = wp.int64(y0 * SUBPIXELS + HALF_PIXEL)
        bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
        bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
        bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
        row_a = edge(s.bx, s.by, s.cx, s.cy, px, py) + bias_a
        row_b = edge(s.cx, s.cy, s.ax, s.ay, px, py) + bias_b
        row_c = edge(s.ax, s.ay, s.bx, s.by, px, py) + bias_c
        dx_a = (s.by - s.cy) * PIXEL_STEP
        dx_b = (s.cy - s.ay) * PIXEL_STEP
        dx_c = (s.ay - s.by) * PIXEL_STEP
        dy_a = (s.cx - s.bx) * PIXEL_STEP
        dy_b = (s.ax - s.cx) * PIXEL_STEP
        dy_c = (s.bx - s.ax) * PIXEL_STEP
        for y in range(y0, y1 + 1):
            e_a = row_a
            e_b = row_b
            e_c = row_c
            for x in range(x0, x1 + 1):
                if (e_a | e_b | e_c) >= wp.int64(0):
                    depth = interpolate_depth(s, e_a - bias_a, e_b - bias_b, e_c - bias_c)
                    old = depth_out[y, x]
                    if depth <= old and depth <= triangles.far and not is_peeled(triangles, depth, y, x):
                        t = triangle_id(triangles, tile_list[k])
                        if not is_cut(triangles, t, y, x):
                            if with_triangles != 0:
                                if depth < old or t < triangle_out[y, x]:
                                    triangle_out[y, x] = t
                            depth_out[y, x] = depth
                e_a += dx_a
                e_b += dx_b
                e_c += dx_c
            row_a += dy_a
            row_b += dy_b
            row_c += dy_c


def list_triangles(scratch: Scratch, triangles: ScreenTriangles, total: int) -> tuple[int, int, wp.array, wp.array]:
    """Which tiles ``total`` projected triangles touch, on the CPU.

    Returns:
        Tiles, tiles per row, each tile's begin in the list (tiles + 1,), and the list, in triangle order.
    """
    tiles_x, tiles_y = -(-triangles.width // TILE), -(-triangles.height // TILE)
    tiles = tiles_x * tiles_y
    box = scratch.array("box", (total,), wp.vec4ub)
    counts = scratch.array("tile counts", (tiles, CHUNKS), int)
    scratch.launch(count_tiles, CHUNKS, [triangles, total, CHUNKS, tiles_x, tiles], [box, counts], tile=1)
    starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
    begin = scratch.array("tile begin", (tiles + 1,), int)
    begin.numpy()[:] = starts[::CHUNKS]
    counts.numpy().ravel()[:] = starts[:-1]
    listed = scratch.array("tile list", (int(starts[-1]),), int)
    scratch.launch(list_tiles, CHUNKS, [box, total, CHUNKS, tiles_x, counts], [listed], tile=1)
    return tiles, tiles_x, begin, listed


def draw_tiles(
    scratch: Scratch,
    triangles: ScreenTriangles,
    total: int,
    with_triangles: int,
    depth_out: wp.array,
    triangle_out: wp.array,
) -> None:
    """Clears the targets and draws ``total`` projected triangles on the CPU."""
    tiles, tiles_x, begin, listed = list_triangles(scratch, triangles, total)
    scratch.launch(draw_tile, tiles, [triangles, tiles_x, begin, listed, with_triangles], [depth_out, triangle_out])
