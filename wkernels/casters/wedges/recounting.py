"""Faces between a receiver and the light's centre, counted by the very edges whose side the receiver is on.

Hard volumes are drawn on a grid of 1/256 pixel. Next to their sides a drawn count may be that of the other side, while
an edge's share of the light is signed by the side that the receiver is on: together they would be wrong by the whole
light (Assarsson et al. 2003, section 4.4, have their stencil and their wedges drawn from the same polygons). The few
receivers that close are counted again, face by face, and sides are told from determinants in double that an edge and
both its faces share.
"""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.light_shapes import Sight
from wkernels.scene.views import View

PIXELS = wp.constant(1.0 / 64.0)
"""Distance from a hard volume's side, pixels, up to which its count is not trusted: four steps of the grid."""
ROUNDING = wp.constant(2e-6)
"""What float32 may lose of a receiver's place, share of its distances from origin and light."""
PIECES = wp.constant(16)
"""Of the way to the light, each with a box of its own."""
CLOSEST = wp.constant(wp.float64(1e-5))
"""Share of the way to the light below which a face is the receiver's own surface."""
ZERO, ONE = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))


@wp.func
def blur_of(view: View, sight: Sight, depth: float, position_ws: wp.vec3):
    """By how much an edge at w = 1 may be shifted on the light against what was drawn, half sizes."""
    pixel = depth * wp.length(view.along_dx_ws) + wp.length(view.base_dx_ws)
    return (PIXELS * pixel + ROUNDING * (wp.length(position_ws) + depth)) * sight.reach


@wp.func
def passes_centre(x0: float, y0: float, x1: float, y1: float, w: float, blur: float):
    """Whether an edge passes the light's centre so close that its side may be the other one.

    Args:
        x0, y0, x1, y1: Its ends on the light.
        w: The lesser of their w.
        blur: ``blur_of`` the receiver.
    """
    along_x = x1 - x0
    along_y = y1 - y0
    cross = x0 * y1 - y0 * x1
    near = cross * cross * w * w <= blur * blur * (along_x * along_x + along_y * along_y)
    between = x0 * x1 + y0 * y1 <= 0.0
    first = (x0 * x0 + y0 * y0) * w * w <= 4.0 * blur * blur
    last = (x1 * x1 + y1 * y1) * w * w <= 4.0 * blur * blur
    return wp.where(near, wp.where(between, 1, wp.where(first, 1, wp.where(last, 1, 0))), 0)


@wp.func
def is_left(points_ws: wp.array(dtype=wp.vec3), i: int, j: int, position_ws: wp.vec3d, to_light: wp.vec3d):
    """Whether the way to the light's centre lies to the left of the edge from i to j, seen from behind the light.

    The same determinant for both directions of an edge, so that exactly one of them is true.
    """
    a = wp.vec3d(points_ws[wp.min(i, j)]) - position_ws
    b = wp.vec3d(points_ws[wp.max(i, j)]) - position_ws
    left = wp.dot(wp.cross(a, b), to_light) >= ZERO
    return left == (i < j)


@wp.func
def way_to_face(
    points_ws: wp.array(dtype=wp.vec3),
    i: int,
    j: int,
    k: int,
    position_ws: wp.vec3d,
    to_light: wp.vec3d,
):
    """Where the face (i, j, k) lies on the line to the light, in lengths of ``to_light``; -1 if it does not."""
    left = is_left(points_ws, i, j, position_ws, to_light)
    way = -ONE
    if left == is_left(points_ws, j, k, position_ws, to_light) and left == is_left(
        points_ws, k, i, position_ws, to_light
    ):
        a = wp.vec3d(points_ws[i])
        normal = wp.cross(wp.vec3d(points_ws[j]) - a, wp.vec3d(points_ws[k]) - a)
        slope = wp.dot(normal, to_light)
        if slope != ZERO:
            way = wp.dot(normal, a - position_ws) / slope
    return way


@wp.func
def count_hiding_faces(
    mesh_id: wp.uint64,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    turns: wp.array(dtype=wp.int8),
    own: int,
    position_ws: wp.vec3,
    light_ws: wp.vec4d,
    reach: float,
):
    """How many faces that count lie between a receiver and the light's centre, but for its own.

    Args:
        mesh_id: The casters' ``wp.Mesh``.
        points_ws: The casters' vertices, in which those of one position have one number.
        indices: int32 (3 T,).
        turns: int8 (T,), ``counted_turns``.
        own: The receiver's triangle, -1 for none.
        position_ws: The receiver.
        light_ws: The light's centre, w = 0 for a direction.
        reach: Length of a way that leaves the scene.
    """
    at = wp.vec3d(position_ws)
    to_light = wp.vec3d(light_ws[0], light_ws[1], light_ws[2]) - at * light_ws[3]
    length = ONE
    if light_ws[3] == ZERO:
        length = wp.float64(reach)
    count = int(0)
    # a face is counted in the piece of the way that it lies on: boxes around pieces hold fewer than one around all
    for piece in range(PIECES):
        low = length * wp.float64(piece) / wp.float64(PIECES)
        high = length * wp.float64(piece + 1) / wp.float64(PIECES)
        start = wp.vec3(at + to_light * low)
        end = wp.vec3(at + to_light * high)
        slack = wp.vec3(1.0, 1.0, 1.0) * (ROUNDING * (wp.length(start) + wp.length(end)))
        if piece == 0:
            low = CLOSEST * length
        query = wp.mesh_query_aabb(mesh_id, wp.min(start, end) - slack, wp.max(start, end) + slack)
        face = int(0)
        while wp.mesh_query_aabb_next(query, face):
            if turns[face] != wp.int8(0) and face != own:
                i = indices[3 * face]
                j = indices[3 * face + 1]
                k = indices[3 * face + 2]
                way = way_to_face(points_ws, i, j, k, at, to_light)
                if way >= low and way < high:
                    count += 1
    return count
