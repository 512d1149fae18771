"""The CUDA rasteriser: a thread per triangle and row stripe; depth and triangle meet in one 64-bit atomic minimum."""

from __future__ import annotations

import warp as wp

from wkernels.raster.scratch import Scratch
from wkernels.raster.triangles import (
    HALF_PIXEL,
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

STRIPES = 16
BACKGROUND_KEY = wp.constant(wp.uint64(0x7F800000FFFFFFFF))  # +inf depth, triangle -1


@wp.func
def draw_rows(
    triangles: ScreenTriangles, t: int, stripe: int, stripes: int, row_0: int, key_out: wp.array2d(dtype=wp.uint64)
):
    """Every ``stripes``-th row of one triangle into the 64-bit (depth, triangle) minimum, from row ``row_0`` on."""
    s = set_up(triangles, t)
    bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
    bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
    bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
    owner = triangle_id(triangles, t)
    low = wp.uint64(owner)
    for y in range(s.y0 + stripe, s.y1 + 1, stripes):
        py = wp.int64(y * SUBPIXELS + HALF_PIXEL)
        px = wp.int64(s.x0 * SUBPIXELS + HALF_PIXEL)
        e_a = edge(s.bx, s.by, s.cx, s.cy, px, py) + bias_a
        e_b = edge(s.cx, s.cy, s.ax, s.ay, px, py) + bias_b
        e_c = edge(s.ax, s.ay, s.bx, s.by, px, py) + bias_c
        for x in range(s.x0, s.x1 + 1):
            if (e_a | e_b | e_c) >= wp.int64(0):
                depth = interpolate_depth(s, e_a - bias_a, e_b - bias_b, e_c - bias_c)
                peeled = is_peeled(triangles, depth, y, x)
                if depth <= triangles.far and not peeled and not is_cut(triangles, owner, y, x):
                    high = wp.uint64(wp.cast(depth, wp.uint32))  # order of positive floats = order of their bits
                    wp.atomic_min(key_out, row_0 + y, x, (high << wp.uint64(32)) | low)
            e_a += (s.by - s.cy) * PIXEL_STEP
            e_b += (s.cy - s.ay) * PIXEL_STEP
            e_c += (s.ay - s.by) * PIXEL_STEP


@wp.kernel
def draw_stripe(
    first: int,
    triangles: ScreenTriangles,
    begin: int,
    row_0: int,
    stripes: int,
    key_out: wp.array2d(dtype=wp.uint64),
):
    """CUDA: ``draw_rows`` of one triangle from the ``begin``-th on."""
    i, stripe = wp.tid()
    draw_rows(triangles, begin + first + i, stripe, stripes, row_0, key_out)


@wp.kernel
def split_key(
    first: int,
    key: wp.array2d(dtype=wp.uint64),
    with_triangles: int,
    depth_out: wp.array2d(dtype=float),
    triangle_out: wp.array2d(dtype=int),
):
    """Depth and triangle of the winning key."""
    row, x = wp.tid()
    y = first + row
    depth_out[y, x] = wp.cast(wp.uint32(key[y, x] >> wp.uint64(32)), float)
    if with_triangles != 0:
        triangle_out[y, x] = int(wp.uint32(key[y, x] & wp.uint64(0xFFFFFFFF)))


def draw_stripes(
    scratch: Scratch,
    triangles: ScreenTriangles,
    total: int,
    with_triangles: int,
    depth_out: wp.array,
    triangle_out: wp.array,
) -> None:
    """Clears the targets and draws ``total`` projected triangles on CUDA."""
    key = scratch.array("key", (triangles.height, triangles.width), wp.uint64)
    key.fill_(BACKGROUND_KEY)
    scratch.launch(draw_stripe, (total, STRIPES), [triangles, 0, 0, STRIPES], [key])
    scratch.launch(split_key, key.shape, [key, with_triangles], [depth_out, triangle_out])
