"""Proofs that a receiver sees all of a light or none of it, so that no further ray has to be cast.

Both are conservative: a proof that succeeds is exact, one that fails says nothing. Rays that follow must give the same
answer, so every bound is wider than the rays' own rounding.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.scene.lights import Light

SHAFT_SECTIONS = wp.constant(24)
SHAFT_SLACK = wp.constant(1.0e-5)  # tangent; some hundred float32 roundings
PROOF_FACES = wp.constant(3)


@wp.struct
class LightHull:
    """What encloses all samples of a light: corners whose convex hull holds them, and the corners' box.

    Directional lights store unit-length-or-more directions, to be scaled by ``reach``.
    """

    corners: wp.array(dtype=wp.vec3)
    low: wp.vec3
    high: wp.vec3
    is_point: float  # 1 points, 0 directions
    reach: float  # ray length that leaves the scene, for directions
    span: float  # size of what is around the eye, by which positions are rounded


def light_hull(light: Light, reach: float, device: str, span: float | None = None) -> LightHull:
    """The hull of a light, rebased world.

    Args:
        light: The light.
        reach: Length of a ray that leaves the scene.
        device: Warp device.
        span: Size of what is around the eye; ``reach`` unless given.
    """
    corners = light.hull
    out = LightHull()
    out.corners = wp.array(corners[:, :3].astype(np.float32), dtype=wp.vec3, device=device)
    out.low, out.high = wp.vec3(*corners[:, :3].min(axis=0)), wp.vec3(*corners[:, :3].max(axis=0))
    out.is_point = float(corners[0, 3])
    out.reach, out.span = reach, reach if span is None else span
    return out


@wp.func
def section(hull: LightHull, origin_ws: wp.vec3, t: float, use_high: bool):
    """Low or high corner of the box that holds the shaft's cross-section at parameter t."""
    corner = wp.where(use_high, hull.high, hull.low)
    target = corner * wp.where(hull.is_point > 0.0, 1.0, hull.reach) + origin_ws * (1.0 - hull.is_point)
    return origin_ws + (target - origin_ws) * t


@wp.struct
class Shaft:
    """A pyramid with its apex at a receiver that holds every way to the light: dot(side, way) >= 0 for its four sides.

    Zero sides, where no pyramid is narrow enough, hold everything.
    """

    left: wp.vec3
    right: wp.vec3
    bottom: wp.vec3
    top: wp.vec3


@wp.struct
class ShaftFrame:
    """The shaft's axis and the two directions across, and the slopes along these that hold every way to the light."""

    axis: wp.vec3
    u: wp.vec3
    v: wp.vec3
    low_u: float
    high_u: float
    low_v: float
    high_v: float
    narrow: int  # 0: some way is nearly across the axis, and no slopes hold it


@wp.func
def shaft_frame(hull: LightHull, origin_ws: wp.vec3):
    """The frame around the hull's corners, its first direction across along the hull's first edge."""
    corners = hull.corners.shape[0]
    axis = wp.vec3()
    for i in range(corners):
        axis += hull.corners[i] - origin_ws * hull.is_point
    axis = wp.normalize(axis)
    edge = hull.corners[1 % corners] - hull.corners[0]
    u = edge - axis * wp.dot(edge, axis)
    if wp.length(u) <= 1.0e-3 * wp.length(edge):
        u = wp.cross(axis, wp.where(wp.abs(axis[0]) < 0.6, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)))
    u = wp.normalize(u)
    v = wp.cross(axis, u)
    out = ShaftFrame()
    out.axis = axis
    out.u = u
    out.v = v
    low_u = float(wp.inf)
    low_v = float(wp.inf)
    high_u = float(-wp.inf)
    high_v = float(-wp.inf)
    narrow = bool(True)
    slack = float(0.0)
    for i in range(corners):
        way = hull.corners[i] - origin_ws * hull.is_point
        depth = wp.dot(way, axis)
        narrow = narrow and depth > 1.0e-2 * wp.length(way)
        size = (wp.length(origin_ws) + wp.length(hull.corners[i])) * hull.is_point
        slack = wp.max(slack, SHAFT_SLACK * (1.0 + size / depth))
        low_u = wp.min(low_u, wp.dot(way, u) / depth)
        low_v = wp.min(low_v, wp.dot(way, v) / depth)
        high_u = wp.max(high_u, wp.dot(way, u) / depth)
        high_v = wp.max(high_v, wp.dot(way, v) / depth)
    if narrow:
        out.low_u = low_u - slack
        out.high_u = high_u + slack
        out.low_v = low_v - slack
        out.high_v = high_v + slack
        out.narrow = 1
    return out


@wp.func
def shaft_of(frame: ShaftFrame):
    """The pyramid of a frame's slopes."""
    shaft = Shaft()
    if frame.narrow != 0:
        shaft.left = wp.normalize(frame.u - frame.axis * frame.low_u)
        shaft.right = wp.normalize(frame.axis * frame.high_u - frame.u)
        shaft.bottom = wp.normalize(frame.v - frame.axis * frame.low_v)
        shaft.top = wp.normalize(frame.axis * frame.high_v - frame.v)
    return shaft


@wp.func
def shaft_to_light(hull: LightHull, origin_ws: wp.vec3):
    """The pyramid around the hull's corners, two of its sides parallel to the hull's first edge."""
    return shaft_of(shaft_frame(hull, origin_ws))


@wp.func
def is_beyond(side: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, least: float):
    """Whether three points lie outside a plane through the apex, by more than ``least``."""
    return wp.max(wp.max(wp.dot(side, a), wp.dot(side, b)), wp.dot(side, c)) <= -least


@wp.func
def may_touch(shaft: Shaft, casters: wp.uint64, face: int, origin_ws: wp.vec3):
    """Whether no side of the shaft separates it from a triangle."""
    a = wp.mesh_eval_position(casters, face, 1.0, 0.0) - origin_ws
    b = wp.mesh_eval_position(casters, face, 0.0, 1.0) - origin_ws
    c = wp.mesh_eval_position(casters, face, 0.0, 0.0) - origin_ws
    least = 2.0e-6 * (wp.length(a) + wp.length(b) + wp.length(c)) + 1.0e-30
    outside = is_beyond(shaft.left, a, b, c, least) or is_beyond(shaft.right, a, b, c, least)
    outside = outside or is_beyond(shaft.bottom, a, b, c, least) or is_beyond(shaft.top, a, b, c, least)
    return not outside


@wp.func
def is_behind(casters: wp.uint64, face: int, origin_ws: wp.vec3, normal_ws: wp.vec3):
    """Whether a triangle lies wholly behind the receiver's plane, or in it."""
    a = wp.mesh_eval_position(casters, face, 1.0, 0.0) - origin_ws
    b = wp.mesh_eval_position(casters, face, 0.0, 1.0) - origin_ws
    c = wp.mesh_eval_position(casters, face, 0.0, 0.0) - origin_ws
    return is_beyond(normal_ws, a, b, c, 0.0)


@wp.func
def proves_lit(casters: wp.uint64, origin_ws: wp.vec3, normal_ws: wp.vec3, hull: LightHull):
    """Whether no caster can touch any segment from the point to the light: a conservative test, exact when true.

    The shaft to the light is covered by boxes that grow towards it. Of the triangles in a box those do not count that a
    side of the shaft separates from it, or that lie behind the receiver's plane while all of the light is in front.
    """
    in_front = bool(True)
    for i in range(hull.corners.shape[0]):
        way = hull.corners[i] - origin_ws * hull.is_point
        in_front = in_front and wp.dot(way, normal_ws) > 0.0
    shaft = shaft_to_light(hull, origin_ws)
    lit = bool(True)
    begin = float(0.0)
    for k in range(SHAFT_SECTIONS):
        if lit:
            end = float(k + 1) / float(SHAFT_SECTIONS)
            end = end * end  # thinner boxes where the shaft is thin
            low = wp.min(
                wp.min(section(hull, origin_ws, begin, False), section(hull, origin_ws, end, False)),
                wp.min(section(hull, origin_ws, begin, True), section(hull, origin_ws, end, True)),
            )
            high = wp.max(
                wp.max(section(hull, origin_ws, begin, False), section(hull, origin_ws, end, False)),
                wp.max(section(hull, origin_ws, begin, True), section(hull, origin_ws, end, True)),
            )
            rounding = (wp.length(low) + wp.length(high)) * 1.0e-6
            margin = wp.vec3(rounding, rounding, rounding)
            query = wp.mesh_query_aabb(casters, low - margin, high + margin)
            face = int(0)
            while wp.mesh_query_aabb_next(query, face):
                if may_touch(shaft, casters, face, origin_ws):
                    if not in_front or not is_behind(casters, face, origin_ws, normal_ws):
                        lit = False
                        break
            begin = end
    return lit


@wp.func
def face_blocks(casters: wp.uint64, face: int, origin_ws: wp.vec3, way: wp.vec3, limit: float):
    """Whether a segment along ``way`` crosses the open triangle, from either side, before parameter ``limit``."""
    a = wp.mesh_eval_position(casters, face, 1.0, 0.0) - origin_ws
    b = wp.mesh_eval_position(casters, face, 0.0, 1.0) - origin_ws
    c = wp.mesh_eval_position(casters, face, 0.0, 0.0) - origin_ws
    e_a = wp.dot(wp.cross(b, c), way)
    e_b = wp.dot(wp.cross(c, a), way)
    e_c = wp.dot(wp.cross(a, b), way)
    least = 1.0e-5 * (wp.abs(e_a) + wp.abs(e_b) + wp.abs(e_c))
    same = (e_a > least and e_b > least and e_c > least) or (e_a < -least and e_b < -least and e_c < -least)
    normal = wp.cross(b - a, c - a)
    slope = wp.dot(normal, way)
    height = wp.dot(normal, a)
    return same and slope * height > 0.0 and wp.abs(height) < wp.abs(slope) * limit


@wp.func
def proves_dark(casters: wp.uint64, origin_ws: wp.vec3, hull: LightHull):
    """Whether one triangle alone hides every corner of the light's hull, and so, being convex, all of it."""
    dark = bool(False)
    corners = hull.corners.shape[0]
    for k in range(PROOF_FACES):
        if not dark:
            way = hull.corners[(k * corners) / PROOF_FACES] - origin_ws * hull.is_point
            length = wp.length(way)
            limit = wp.where(hull.is_point > 0.0, length * (1.0 - 1.0e-5), hull.reach)
            hit = wp.mesh_query_ray(casters, origin_ws, way / wp.max(length, 1.0e-30), limit)
            if hit.result:
                dark = bool(True)
                for i in range(corners):
                    corner_way = hull.corners[i] - origin_ws * hull.is_point
                    far = wp.where(hull.is_point > 0.0, 0.99999, hull.reach / wp.max(wp.length(corner_way), 1.0e-30))
                    dark = dark and face_blocks(casters, hit.face, origin_ws, corner_way, far)
    return dark
