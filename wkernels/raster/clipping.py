"""Triangles that cross the near plane or leave the guard band, cut in homogeneous coordinates.

Sutherland-Hodgman before the division, so that vertices beside and behind the eye, and at infinity, are no special
case. In double: float32 would lose the near plane where a triangle is 1e5 times as large as its distance.
"""

from __future__ import annotations

import warp as wp

from wkernels.scene.views import View

CLIP_PLANES = wp.constant(5)
CLIP_VERTICES = wp.constant(3 + CLIP_PLANES)  # each plane adds at most one vertex to a convex polygon
CLIP_TRIANGLES = wp.constant(1 + CLIP_PLANES)
NEARLY_ZERO = wp.constant(1.0e-20)  # w of directions: so far away that it makes no difference, and divisible
GUARD_PIXELS_64 = wp.constant(wp.float64(16384.0))  # triangles.GUARD_PIXELS

Pixel = wp.types.vector(length=5, dtype=wp.float64)  # x w, y w, linear depth, w of the view, and w of the position
_Polygon = wp.types.matrix(shape=(3 + CLIP_PLANES, 5), dtype=wp.float64)


@wp.func
def to_homogeneous_pixels_64(view: View, position_ws: wp.vec4):
    """``triangles.to_homogeneous_pixels`` of a homogeneous position in double, and the position's own w.

    True depth is depth / own w, which is 1 for finite positions and next to nothing for directions.
    """
    half = wp.float64(0.5)
    own_w = wp.float64(wp.max(position_ws[3], NEARLY_ZERO))
    clip = wp.mat44d(view.ws_to_ss) * wp.vec4d(
        wp.float64(position_ws[0]), wp.float64(position_ws[1]), wp.float64(position_ws[2]), own_w
    )
    x = half * (clip[0] + clip[3]) * wp.float64(view.width)
    y = half * (clip[3] - clip[1]) * wp.float64(view.height)
    return Pixel(x, y, clip[2], clip[3], own_w)


@wp.func
def inside_distance(plane: int, h: Pixel, near: wp.float64):
    """Signed distance (any positive scale) of a homogeneous pixel position to a plane: near, then the guard band."""
    distance = h[2] - near * h[4]
    if plane == 1:
        distance = h[0] + GUARD_PIXELS_64 * h[3]
    if plane == 2:
        distance = GUARD_PIXELS_64 * h[3] - h[0]
    if plane == 3:
        distance = h[1] + GUARD_PIXELS_64 * h[3]
    if plane == 4:
        distance = GUARD_PIXELS_64 * h[3] - h[1]
    return distance


@wp.func
def is_homogeneous(p: wp.vec4):
    """Whether this is a finite position or a direction: all numbers finite, w not below 0, not all 0 (NaN is none)."""
    size = wp.abs(p[0]) + wp.abs(p[1]) + wp.abs(p[2]) + p[3]
    return size > 0.0 and size < 3.0e38 and p[3] >= 0.0


@wp.func
def clip_fan(
    a: wp.vec4,
    b: wp.vec4,
    c: wp.vec4,
    t: int,
    slot: int,
    view: View,
    screen_out: wp.array(dtype=wp.vec4),
    corners_out: wp.array(dtype=wp.vec3i),
    triangle_out: wp.array(dtype=int),
):
    """Clips triangle ``t`` into the fan of a slot; triangles that it does not need have no area."""
    polygon = _Polygon()
    kept = _Polygon()
    count = int(0)
    if is_homogeneous(a) and is_homogeneous(b) and is_homogeneous(c):
        count = 3
    near = wp.float64(view.near)
    zero = wp.float64(0.0)
    polygon[0] = to_homogeneous_pixels_64(view, a)
    polygon[1] = to_homogeneous_pixels_64(view, b)
    polygon[2] = to_homogeneous_pixels_64(view, c)
    for plane in range(CLIP_PLANES):
        n = int(0)
        for i in range(count):
            p = polygon[i]
            q = polygon[(i + 1) % count]
            dp = inside_distance(plane, p, near)
            dq = inside_distance(plane, q, near)
            if dp >= zero:
                kept[n] = p
                n += 1
                if dq < zero:
                    kept[n] = p + (q - p) * (dp / (dp - dq))
                    n += 1
            elif dq >= zero:  # always from the inside vertex, so that both triangles of an edge find the same point
                kept[n] = q + (p - q) * (dq / (dq - dp))
                n += 1
        for i in range(n):
            polygon[i] = kept[i]
        count = n
    base = slot * CLIP_VERTICES
    screen_out[base] = wp.vec4()
    for i in range(count):
        over_w = wp.float64(1.0) / polygon[i][3]
        screen_out[base + i] = wp.vec4(
            float(polygon[i][0] * over_w),
            float(polygon[i][1] * over_w),
            float(polygon[i][2] * over_w),
            float(polygon[i][4] * over_w),
        )
    for i in range(CLIP_TRIANGLES):
        corners = wp.vec3i(base, base, base)
        if i + 2 < count:
            corners = wp.vec3i(base, base + i + 1, base + i + 2)
        corners_out[slot * CLIP_TRIANGLES + i] = corners
        triangle_out[slot * CLIP_TRIANGLES + i] = t


@wp.func
def as_homogeneous(p: wp.vec3):
    """A position with w = 1."""
    return wp.vec4(p[0], p[1], p[2], 1.0)


@wp.kernel
def clip_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    clipped: wp.array(dtype=int),
    view: View,
    screen_out: wp.array(dtype=wp.vec4),
    corners_out: wp.array(dtype=wp.vec3i),
    triangle_out: wp.array(dtype=int),
):
    """``clip_fan`` of one flagged triangle."""
    k = first + wp.tid()
    t = clipped[k]
    a = as_homogeneous(points_ws[indices[3 * t]])
    b = as_homogeneous(points_ws[indices[3 * t + 1]])
    c = as_homogeneous(points_ws[indices[3 * t + 2]])
    clip_fan(a, b, c, t, k, view, screen_out, corners_out, triangle_out)


@wp.kernel
def clip_homogeneous(
    first: int,
    points_ws: wp.array(dtype=wp.vec4),
    indices: wp.array(dtype=int),
    clipped: wp.array(dtype=int),
    view: View,
    screen_out: wp.array(dtype=wp.vec4),
    corners_out: wp.array(dtype=wp.vec3i),
    triangle_out: wp.array(dtype=int),
):
    """``clip_triangles`` of homogeneous positions."""
    k = first + wp.tid()
    t = clipped[k]
    a = points_ws[indices[3 * t]]
    b = points_ws[indices[3 * t + 1]]
    c = points_ws[indices[3 * t + 2]]
    clip_fan(a, b, c, t, k, view, screen_out, corners_out, triangle_out)
