"""Projection of homogeneous positions, (x, y, z, 1) or, where something reaches to infinity, a direction (x, y, z, 0).

Depth is not told by w there: what is affine on the screen is depth / w and the position's own w / w. For finite
positions both are what ``triangles`` and ``lane_culling`` have, so that the passes that follow need not know.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.clipping import NEARLY_ZERO, is_homogeneous
from wkernels.raster.lane_culling import OUTSIDE, pack
from wkernels.raster.triangles import GUARD_PIXELS, SUBPIXELS
from wkernels.scene.views import View


@wp.func
def to_homogeneous_pixels(view: View, position_ws: wp.vec4):
    """``clipping.to_homogeneous_pixels_64`` without the own w, which is not below ``NEARLY_ZERO``."""
    clip = view.ws_to_ss * wp.vec4(position_ws[0], position_ws[1], position_ws[2], wp.max(position_ws[3], NEARLY_ZERO))
    return wp.vec4(
        0.5 * (clip[0] + clip[3]) * float(view.width), 0.5 * (clip[3] - clip[1]) * float(view.height), clip[2], clip[3]
    )


@wp.func
def planes_beyond(h: wp.vec4, position_ws: wp.vec4, near: float):
    """A bit for each plane of near and guard band that a vertex is outside of, as in ``lane_culling``; 0: inside."""
    guard = GUARD_PIXELS * h[3]
    behind = wp.where(h[2] >= near * position_ws[3], 0, 1) | wp.where(h[3] > 0.0, 0, 32)
    beside = wp.where(h[0] < -guard, 2, wp.where(h[0] > guard, 4, 0))
    above = wp.where(h[1] < -guard, 8, wp.where(h[1] > guard, 16, 0))
    return wp.where(is_homogeneous(position_ws), behind | beside | above, 1)


@wp.kernel
def project_homogeneous(
    first: int, points_ws: wp.array(dtype=wp.vec4), view: View, screen_out: wp.array(dtype=wp.vec4)
):
    """``triangles.project_vertices``: (x, y in pixels, linear depth / w, own w / w), -1 where it needs clipping."""
    i = first + wp.tid()
    h = to_homogeneous_pixels(view, points_ws[i])
    screen = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if planes_beyond(h, points_ws[i], view.near) == 0:
        over_w = 1.0 / h[3]
        own_w = wp.max(points_ws[i][3], NEARLY_ZERO)
        screen = wp.vec4(h[0] * over_w, h[1] * over_w, h[2] * over_w, own_w * over_w)
    screen_out[i] = screen


@wp.kernel
def pack_homogeneous(
    first: int,
    points_ws: wp.array(dtype=wp.vec4),
    view: View,
    perspective: int,
    vertex_out: wp.array(dtype=wp.int64),
    key_out: wp.array(dtype=float),
):
    """``lane_culling.project_lanes`` of one vertex; of volumes there are few beside the pixels that they cover."""
    i = first + wp.tid()
    h = to_homogeneous_pixels(view, points_ws[i])
    planes = planes_beyond(h, points_ws[i], view.near)
    vertex = pack(OUTSIDE, planes)
    key = float(0.0)
    if planes == 0:
        over_w = 1.0 / h[3]
        column = int(wp.floor(h[0] * over_w * float(SUBPIXELS) + 0.5))
        vertex = pack(column, int(wp.floor(h[1] * over_w * float(SUBPIXELS) + 0.5)))
        key = wp.where(perspective == 1, -wp.max(points_ws[i][3], NEARLY_ZERO), h[2]) * over_w
    vertex_out[i] = vertex
    key_out[i] = key
