"""Shadow rays against the casters' triangles: the exact answers that everything else is measured by.

Origins are moved off their own surface by the rounding error of their position, towards the side that is seen; nothing else
is biased. A sample behind the seen side of a casting surface is hidden by that surface and needs no ray.
"""

from __future__ import annotations

import warp as wp

from wkernels.gbuffer import GBuffer, is_back_lit
from wkernels.geometry import RECEIVES
from wkernels.light_map import to_light

ORIGIN_ERROR = wp.constant(4.0e-6)  # relative to the coordinates and the eye distance: a few float32 roundings
SHAFT_SECTIONS = wp.constant(10)
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


@wp.func
def ray_origin(gbuffer: GBuffer, y: int, x: int):
    """The receiver point, lifted off its surface by its rounding error."""
    p = gbuffer.position_ws[y, x]
    size = wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.max(wp.abs(p[2]), wp.abs(gbuffer.depth[y, x])))
    return p + gbuffer.normal_ws[y, x] * (ORIGIN_ERROR * size)


@wp.func
def is_occluded(casters: wp.uint64, origin_ws: wp.vec3, light_ws: wp.vec4, reach: float):
    """Whether any caster lies between a point and a light sample."""
    way = to_light(light_ws, origin_ws)
    length = wp.length(way)
    blocked = bool(False)
    if length > 0.0:
        end = wp.where(light_ws[3] > 0.0, length * (1.0 - 1.0e-6), reach)
        blocked = wp.mesh_query_ray_anyhit(casters, origin_ws, way / length, end)
    return blocked


@wp.kernel
def trace_point(
    first: int,
    gbuffer: GBuffer,
    casters: wp.uint64,
    light_ws: wp.vec4,
    reach: float,
    visibility_out: wp.array2d(dtype=float),
):
    """Hard visibility of one light sample, 0 or 1."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        if is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
        elif casters != wp.uint64(0):
            if is_occluded(casters, ray_origin(gbuffer, y, x), light_ws, reach):
                visible = 0.0
    visibility_out[y, x] = visible


@wp.func
def section(hull: LightHull, origin_ws: wp.vec3, t: float, use_high: bool):
    """Low or high corner of the box that holds the shaft's cross-section at parameter t."""
    corner = wp.where(use_high, hull.high, hull.low)
    target = corner * wp.where(hull.is_point > 0.0, 1.0, hull.reach) + origin_ws * (1.0 - hull.is_point)
    return origin_ws + (target - origin_ws) * t


@wp.func
def proves_lit(casters: wp.uint64, origin_ws: wp.vec3, normal_ws: wp.vec3, hull: LightHull):
    """Whether no caster can touch any segment from the point to the light: a conservative test, exact when true.

    The shaft is covered by boxes that grow towards the light; a triangle that lies behind the receiver's plane does not count
    where the whole light is in front of that plane.
    """
    in_front = bool(True)
    for i in range(hull.corners.shape[0]):
        way = hull.corners[i] - origin_ws * hull.is_point
        in_front = in_front and wp.dot(way, normal_ws) > 0.0
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
            query = wp.mesh_query_aabb(casters, low, high)
            face = int(0)
            while wp.mesh_query_aabb_next(query, face):
                a = wp.mesh_eval_position(casters, face, 1.0, 0.0) - origin_ws
                b = wp.mesh_eval_position(casters, face, 0.0, 1.0) - origin_ws
                c = wp.mesh_eval_position(casters, face, 0.0, 0.0) - origin_ws
                highest = wp.max(wp.max(wp.dot(a, normal_ws), wp.dot(b, normal_ws)), wp.dot(c, normal_ws))
                if not in_front or highest > 0.0:
                    lit = False
            begin = end
    return lit


@wp.func
def face_blocks(casters: wp.uint64, face: int, origin_ws: wp.vec3, way: wp.vec3, limit: float):
    """Whether the open triangle is crossed by the segment of direction ``way`` before parameter ``limit`` (double-sided)."""
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


PROVEN_LIT, PROVEN_DARK, TRACED, NO_RECEIVER = wp.constant(1), wp.constant(2), wp.constant(0), wp.constant(3)


@wp.kernel
def trace_light(
    first: int,
    gbuffer: GBuffer,
    casters: wp.uint64,
    samples_ws: wp.array(dtype=wp.vec4),
    weights: wp.array(dtype=float),
    hull: LightHull,
    prove: int,
    visibility_out: wp.array2d(dtype=float),
    proof_out: wp.array2d(dtype=int),
):
    """Weighted share of the light samples that a receiver sees, all samples in one go (Heckbert and Herf 1997 by rays).

    Pixels that a proof settles cast no further ray; a proof never changes the result.
    """
    row, x = wp.tid()
    y = first + row
    proof = NO_RECEIVER
    visible = float(1.0)
    count = samples_ws.shape[0]
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        proof = TRACED
        origin = ray_origin(gbuffer, y, x)
        normal = gbuffer.normal_ws[y, x]
        if prove != 0 and casters == wp.uint64(0):
            proof = PROVEN_LIT
        elif prove != 0:
            behind = bool(True)  # the whole hull is behind a casting surface
            ahead = bool(True)
            for i in range(hull.corners.shape[0]):
                way = hull.corners[i] - gbuffer.position_ws[y, x] * hull.is_point
                hidden = is_back_lit(gbuffer, y, x, way)
                behind = behind and hidden
                ahead = ahead and not hidden
            if behind:
                proof = PROVEN_DARK
            elif ahead and proves_lit(casters, origin, normal, hull):
                proof = PROVEN_LIT
            elif ahead and proves_dark(casters, origin, hull):
                proof = PROVEN_DARK
        if proof == PROVEN_DARK:
            visible = 0.0
        if proof == TRACED:
            seen = float(0.0)
            total = float(0.0)
            for s in range(count):
                light = samples_ws[s]
                total += weights[s]
                lit = not is_back_lit(gbuffer, y, x, to_light(light, gbuffer.position_ws[y, x]))
                if lit and casters != wp.uint64(0):
                    lit = not is_occluded(casters, origin, light, hull.reach)
                if lit:
                    seen += weights[s]
            visible = seen / wp.max(total, 1.0e-30)
    proof_out[y, x] = proof
    visibility_out[y, x] = visible


@wp.kernel
def binomial_standard_error(
    first: int, visibility: wp.array2d(dtype=float), count: float, error_out: wp.array2d(dtype=float)
):
    """sqrt(psi (1 - psi) / (n - 1)); 1 where n = 1 says nothing (Scherzer et al. 2009, equation 3)."""
    row, x = wp.tid()
    y = first + row
    v = visibility[y, x]
    error = float(1.0)
    if count > 1.5:
        error = wp.sqrt(wp.max(v * (1.0 - v), 0.0) / (count - 1.0))
    error_out[y, x] = error
