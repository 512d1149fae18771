"""The picture of a convex shape of a few points: cut at the near plane, and its left and right border.

Corners are kept in memory that a caller lends, ``CORNERS`` from ``at`` on, as local matrices would be copied at every
access.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.clipping import Pixel, inside_distance, is_homogeneous, to_homogeneous_pixels_64
from wkernels.scene.views import View

MAX_POINTS = 16
CORNERS = wp.constant(72)  # 8 points, and 8 x 8 cuts of the near plane with the ways to 8 others, is the most
FARTHEST = wp.constant(wp.float64(1e12))  # pixels: where points go that are at infinity on the screen too
ZERO, ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))


@wp.struct
class Shapes:
    """Convex hulls of points, one after the other."""

    points_ws: wp.array(dtype=wp.vec4)  # homogeneous, or
    points_ss: wp.array(dtype=wp.vec2)  # pixels
    on_screen: int  # which of the two
    begin: wp.array(dtype=int)  # (shapes + 1,)
    depth_range: wp.array(dtype=wp.vec2)  # (shapes,), or none
    view: View


@wp.struct
class Outline:
    """What is known of a picture beside its corners."""

    count: int
    nearest: float
    farthest: float


@wp.func
def is_whole(shapes: Shapes, s: int):
    """Whether all of a shape's points are positions."""
    whole = bool(True)
    for i in range(shapes.begin[s], shapes.begin[s + 1]):
        if shapes.on_screen == 0:
            whole = whole and is_homogeneous(shapes.points_ws[i])
        else:
            p = shapes.points_ss[i]
            whole = whole and wp.abs(p[0]) + wp.abs(p[1]) < 3.0e38
    return whole


@wp.func
def pixel_of(shapes: Shapes, i: int):
    """A point in homogeneous pixels, ``to_homogeneous_pixels_64``."""
    out = Pixel(ZERO, ZERO, wp.float64(shapes.view.near), ONE, ONE)
    if shapes.on_screen == 0:
        out = to_homogeneous_pixels_64(shapes.view, shapes.points_ws[i])
    else:
        out[0] = wp.float64(shapes.points_ss[i][0])
        out[1] = wp.float64(shapes.points_ss[i][1])
    return out


@wp.func
def insert_corner(corners: wp.array(dtype=wp.vec2d), at: int, count: int, corner: wp.vec2d):
    """Puts a corner among ``count`` others in the order of y, then of x."""
    slot = at + count
    moves = int(1)
    while moves == 1:
        moves = 0
        if slot > at:
            last = corners[slot - 1]
            if last[1] > corner[1] or (last[1] == corner[1] and last[0] > corner[0]):
                corners[slot] = last
                slot -= 1
                moves = 1
    corners[slot] = corner


@wp.func
def find_outline(shapes: Shapes, s: int, corners: wp.array(dtype=wp.vec2d), at: int):
    """All corners of a shape's picture, and some points within it; none where it has a point that is no position.

    What the near plane leaves of a hull is the hull of the points behind it, and of where it cuts the ways between the
    points on both sides.
    """
    out = Outline()
    out.nearest = float(wp.inf)
    near = wp.float64(shapes.view.near)
    begin = shapes.begin[s]
    end = begin
    if is_whole(shapes, s):
        end = shapes.begin[s + 1]
    for i in range(begin, end):
        p = pixel_of(shapes, i)
        d = inside_distance(0, p, near)
        others_begin = begin
        others_end = end
        if d >= ZERO:
            others_begin = i
            others_end = i + 1
        for j in range(others_begin, others_end):
            q = pixel_of(shapes, j)
            e = inside_distance(0, q, near)
            if e >= ZERO:
                if j != i:
                    q = q + (p - q) * (e / (e - d))
                depth = float(q[2] / q[4])
                out.nearest = wp.min(out.nearest, depth)
                out.farthest = wp.max(out.farthest, depth)
                over_w = ONE / wp.max(q[3], wp.max(wp.abs(q[0]), wp.abs(q[1])) / FARTHEST)
                insert_corner(corners, at, out.count, wp.vec2d(q[0] * over_w, q[1] * over_w))
                out.count += 1
    if shapes.depth_range.shape[0] > 0:
        out.nearest = shapes.depth_range[s][0]
        out.farthest = shapes.depth_range[s][1]
    elif shapes.on_screen != 0:
        out.nearest = 0.0
        out.farthest = float(wp.inf)
    return out


@wp.func
def find_border(corners: wp.array(dtype=wp.vec2d), at: int, count: int, side: wp.float64, border_at: int):
    """The corners on the left border (``side`` -1) or the right one (1), downwards, and how many (Andrew 1979)."""
    n = int(0)
    for i in range(count):
        c = corners[at + i]
        within = int(1)
        while within == 1:
            within = 0
            if n > 1:
                a = corners[border_at + n - 2]
                b = corners[border_at + n - 1]
                # whether b lies within, or on the way from a to c
                if side * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])) <= ZERO:
                    n -= 1
                    within = 1
        corners[border_at + n] = c
        n += 1
    return n


@wp.func
def reach(
    corners: wp.array(dtype=wp.vec2d), at: int, count: int, side: wp.float64, top: wp.float64, bottom: wp.float64
):
    """How far to its side a border comes between two heights: x times ``side``; -1e300 where it does not pass there."""
    farthest = wp.float64(-1e300)
    for i in range(at, at + count):
        a = corners[i]
        if a[1] >= top and a[1] <= bottom:
            farthest = wp.max(farthest, side * a[0])
        if i + 1 < at + count:
            way = corners[i + 1] - a
            if a[1] < top and a[1] + way[1] > top:
                farthest = wp.max(farthest, side * (a[0] + way[0] * ((top - a[1]) / way[1])))
            if a[1] < bottom and a[1] + way[1] > bottom:
                farthest = wp.max(farthest, side * (a[0] + way[0] * ((bottom - a[1]) / way[1])))
    return farthest
