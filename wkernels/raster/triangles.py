"""Triangles on the screen: projection, and the exact coverage and depth functions of every drawing kernel."""

from __future__ import annotations

import warp as wp

from wkernels.scene.cutouts import OPAQUE, Cutouts, is_cut_out
from wkernels.scene.views import View

SUBPIXELS = wp.constant(256)
HALF_PIXEL = wp.constant(128)
PIXEL_STEP = wp.constant(wp.int64(256))
GUARD_PIXELS = wp.constant(16384.0)  # snapped coordinates stay below 2^23, edge functions below 2^49
NO_TRIANGLE = wp.constant(-1)
CULL_NONE, CULL_BACK, CULL_FRONT = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.func
def to_homogeneous_pixels(view: View, position_ws: wp.vec3):
    """(x w, y w, linear depth, w) with x and y in pixels, row 0 at the top."""
    clip = view.ws_to_ss * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    return wp.vec4(
        0.5 * (clip[0] + clip[3]) * float(view.width), 0.5 * (clip[3] - clip[1]) * float(view.height), clip[2], clip[3]
    )


@wp.func
def needs_clipping(h: wp.vec4, near: float):
    """Whether a vertex lies outside the near plane or the guard band, or is not finite."""
    inside = h[2] >= near and h[3] > 0.0 and wp.abs(h[0]) <= GUARD_PIXELS * h[3] and wp.abs(h[1]) <= GUARD_PIXELS * h[3]
    return not inside


@wp.kernel
def project_vertices(first: int, points_ws: wp.array(dtype=wp.vec3), view: View, screen_out: wp.array(dtype=wp.vec4)):
    """Screen vertex (x, y in pixels, linear depth / w, 1 / w); the last is -1 where the vertex needs clipping."""
    i = first + wp.tid()
    h = to_homogeneous_pixels(view, points_ws[i])
    if needs_clipping(h, view.near):
        screen_out[i] = wp.vec4(0.0, 0.0, 0.0, -1.0)
    else:
        over_w = 1.0 / h[3]
        screen_out[i] = wp.vec4(h[0] * over_w, h[1] * over_w, h[2] * over_w, over_w)


@wp.kernel
def flag_clipped(
    first: int, screen: wp.array(dtype=wp.vec4), indices: wp.array(dtype=int), clipped_out: wp.array(dtype=wp.uint8)
):
    """1 where a triangle has vertices on both sides of the near plane or the guard band."""
    t = first + wp.tid()
    a = screen[indices[3 * t]][3]
    b = screen[indices[3 * t + 1]][3]
    c = screen[indices[3 * t + 2]][3]
    flag = wp.uint8(0)
    if a < 0.0 or b < 0.0 or c < 0.0:
        flag = wp.uint8(1)
    clipped_out[t] = flag


@wp.func
def is_finite_position(p: wp.vec3):
    """Whether all coordinates are finite (a NaN compares false)."""
    return wp.abs(p[0]) + wp.abs(p[1]) + wp.abs(p[2]) < 3.0e38


@wp.struct
class ScreenTriangles:
    """Projected triangles: those of the mesh, then the fans of the clipped ones."""

    screen: wp.array(dtype=wp.vec4)  # x, y in pixels, linear depth / w, 1 / w (-1: was clipped)
    first_vertex: int  # where the mesh's vertices begin in it: those of many views lie one after the other
    indices: wp.array(dtype=int)
    count: int
    clip_screen: wp.array(dtype=wp.vec4)
    clip_corners: wp.array(dtype=wp.vec3i)
    clip_triangle: wp.array(dtype=int)
    width: int
    height: int
    far: float
    cull: int
    peels: int  # 1: only what lies farther than ``nearer`` is drawn
    nearer: wp.array2d(dtype=float)  # (H, W) depths
    over: int  # 1: drawn over what the targets hold, which are not cleared
    cutouts: Cutouts  # ``view`` and ``points_ws`` are given where there are any
    view: View
    points_ws: wp.array(dtype=wp.vec3)


@wp.func
def is_peeled(triangles: ScreenTriangles, depth: float, y: int, x: int):
    """Whether a depth counts as part of what is nearer than what is to be drawn."""
    result = False
    if triangles.peels != 0:
        result = depth <= triangles.nearer[y, x]
    return result


@wp.func
def is_cut(triangles: ScreenTriangles, t: int, y: int, x: int):
    """Whether triangle ``t`` of the mesh is not there at a pixel's centre.

    Its coordinates there are ratios of edge functions of homogeneous pixels (Olano and Greer 1997), which hold for what
    lies behind the eye too: pieces of clipped triangles are cut as the whole would be.
    """
    cut = bool(False)
    if triangles.cutouts.count > 0:
        a = triangles.indices[3 * t]
        if triangles.cutouts.texture[a] != OPAQUE:
            b = triangles.indices[3 * t + 1]
            c = triangles.indices[3 * t + 2]
            h_a = to_homogeneous_pixels(triangles.view, triangles.points_ws[a])
            h_b = to_homogeneous_pixels(triangles.view, triangles.points_ws[b])
            h_c = to_homogeneous_pixels(triangles.view, triangles.points_ws[c])
            centre = wp.vec2(float(x) + 0.5, float(y) + 0.5)
            p_a = wp.vec2(h_a[0], h_a[1]) - centre * h_a[3]
            p_b = wp.vec2(h_b[0], h_b[1]) - centre * h_b[3]
            p_c = wp.vec2(h_c[0], h_c[1]) - centre * h_c[3]
            w_a = p_b[0] * p_c[1] - p_b[1] * p_c[0]
            w_b = p_c[0] * p_a[1] - p_c[1] * p_a[0]
            w_c = p_a[0] * p_b[1] - p_a[1] * p_b[0]
            cut = is_cut_out(triangles.cutouts, a, b, c, w_a, w_b, w_c)
    return cut


@wp.struct
class Setup:
    """One triangle ready to be tested against pixels, wound so that inside all edge functions are positive."""

    a: wp.vec4
    b: wp.vec4
    c: wp.vec4
    ax: wp.int64
    ay: wp.int64
    bx: wp.int64
    by: wp.int64
    cx: wp.int64
    cy: wp.int64
    over_area: float
    front: int  # 1 where the triangle faces the view, before it was wound
    x0: int  # pixels whose centres the bounding box holds, clamped to the screen; x1 < x0 where there are none
    y0: int
    x1: int
    y1: int


@wp.func
def snap(pixels: float):
    """Screen coordinate in 1/256 pixel."""
    return wp.int64(wp.floor(pixels * float(SUBPIXELS) + 0.5))


@wp.func
def set_up(triangles: ScreenTriangles, t: int):
    """Fetches, orients, snaps and bounds triangle ``t``; an empty box where it is culled or has no area."""
    s = Setup()
    s.x0 = 0
    s.x1 = -1
    s.y0 = 0
    s.y1 = -1
    a = wp.vec4()
    b = wp.vec4()
    c = wp.vec4()
    if t < triangles.count:
        a = triangles.screen[triangles.first_vertex + triangles.indices[3 * t]]
        b = triangles.screen[triangles.first_vertex + triangles.indices[3 * t + 1]]
        c = triangles.screen[triangles.first_vertex + triangles.indices[3 * t + 2]]
    else:
        corners = triangles.clip_corners[t - triangles.count]
        a = triangles.clip_screen[corners[0]]
        b = triangles.clip_screen[corners[1]]
        c = triangles.clip_screen[corners[2]]
    if a[3] < 0.0 or b[3] < 0.0 or c[3] < 0.0:
        return s
    low_x = wp.max(wp.min(wp.min(a[0], b[0]), c[0]), -1.0)
    high_x = wp.min(wp.max(wp.max(a[0], b[0]), c[0]), float(triangles.width) + 1.0)
    low_y = wp.max(wp.min(wp.min(a[1], b[1]), c[1]), -1.0)
    high_y = wp.min(wp.max(wp.max(a[1], b[1]), c[1]), float(triangles.height) + 1.0)
    # snapping moves a vertex by up to 1/512 pixel, so the box is taken a little wider than the float coordinates say
    x0 = wp.max(int(wp.ceil(low_x - 0.502)), 0)
    x1 = wp.min(int(wp.floor(high_x - 0.498)), triangles.width - 1)
    y0 = wp.max(int(wp.ceil(low_y - 0.502)), 0)
    y1 = wp.min(int(wp.floor(high_y - 0.498)), triangles.height - 1)
    if x1 < x0 or y1 < y0:
        return s
    s.a = a
    s.b = b
    s.c = c
    s.ax = snap(a[0])
    s.ay = snap(a[1])
    s.bx = snap(b[0])
    s.by = snap(b[1])
    s.cx = snap(c[0])
    s.cy = snap(c[1])
    area = (s.bx - s.ax) * (s.cy - s.ay) - (s.by - s.ay) * (s.cx - s.ax)
    # rows run downwards, so a triangle that is counter-clockwise seen from the view has negative area here
    front = area < wp.int64(0)
    if area == wp.int64(0) or (front and triangles.cull == CULL_FRONT) or (not front and triangles.cull == CULL_BACK):
        return s
    if front:
        s.b = c
        s.c = b
        other_x = s.bx
        other_y = s.by
        s.bx = s.cx
        s.by = s.cy
        s.cx = other_x
        s.cy = other_y
        area = -area
    s.front = wp.where(front, 1, 0)
    s.over_area = 1.0 / float(area)
    s.x0 = x0
    s.x1 = x1
    s.y0 = y0
    s.y1 = y1
    return s


@wp.func
def edge(ax: wp.int64, ay: wp.int64, bx: wp.int64, by: wp.int64, x: wp.int64, y: wp.int64):
    """Twice the signed area of (a, b, point), in squared subpixels; positive to the inside of edge a -> b."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@wp.func
def top_left_bias(ax: wp.int64, ay: wp.int64, bx: wp.int64, by: wp.int64):
    """0 for a top or left edge, which owns the pixel centres on it, else -1."""
    bias = wp.int64(-1)
    if by < ay or (by == ay and bx > ax):
        bias = wp.int64(0)
    return bias


@wp.func
def triangle_id(triangles: ScreenTriangles, t: int):
    """Index in the mesh of a triangle or of the one that a clipped piece was cut from."""
    result = t
    if t >= triangles.count:
        result = triangles.clip_triangle[t - triangles.count]
    return result


@wp.func
def interpolate_depth(s: Setup, e_a: wp.int64, e_b: wp.int64, e_c: wp.int64):
    """Linear depth, perspective correct, from the edge functions opposite a, b and c, all >= 0."""
    l_a = float(e_a)
    l_b = float(e_b)
    l_c = float(e_c)
    return (l_a * s.a[2] + l_b * s.b[2] + l_c * s.c[2]) / (l_a * s.a[3] + l_b * s.b[3] + l_c * s.c[3])
