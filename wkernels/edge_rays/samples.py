"""The kernel that counts edges against samples; ``tracing`` says what for, ``crossings`` how one edge counts."""

from __future__ import annotations

import warp as wp

from wkernels.edge_rays.clusters import EDGE_LANES, PARTS, TILE, EdgeFloats
from wkernels.edge_rays.crossings import crossing_of, overlaps_square, seen_part
from wkernels.edge_rays.light_plane import LightPlane, projection_from
from wkernels.raster.gbuffer import GBuffer
from wkernels.rays.light_proofs import LightHull
from wkernels.rays.ray_casters import RayCasters
from wkernels.rays.shaft_rays import BATCH, BEFORE_SAMPLE, SampleBatches, cross_unfused
from wkernels.rays.single_rays import ORIGIN_ERROR, is_occluded, ray_origin
from wkernels.scene.geometry import CASTS, RECEIVES

SAMPLES = wp.constant(BATCH)
SampleFloats = wp.types.vector(length=BATCH, dtype=wp.float32)
SampleInts = wp.types.vector(length=BATCH, dtype=wp.int32)
EdgeInts = wp.types.vector(length=EDGE_LANES, dtype=wp.int32)
HIDDEN = wp.constant(1 << 24)  # count of a sample that needs no edge to be hidden
NEAREST = wp.constant(1.0e-6)  # Z at which an edge is cut off before the receiver
SQUARE_MARGIN = wp.constant(1.0e-3)

BY_EDGES, BY_RAYS = wp.constant(0), wp.constant(1)


@wp.struct
class EdgeLists:
    """The edges of each cluster, in blocks of 16."""

    part: wp.array2d(dtype=int)  # of each pixel
    begin: wp.array(dtype=int)  # block, by tile * PARTS + part
    count: wp.array(dtype=int)  # edges
    block: wp.array2d(dtype=EdgeFloats)
    tiles_x: int


@wp.func
def hides(a: wp.vec3, b: wp.vec3, c: wp.vec3, way: wp.vec3, is_point: float):
    """Whether a triangle with corners from the receiver lies across a way, before its end if it has one."""
    e_a = wp.dot(cross_unfused(b, c), way)
    e_b = wp.dot(cross_unfused(c, a), way)
    e_c = wp.dot(cross_unfused(a, b), way)
    height = wp.dot(cross_unfused(b, c), a)
    sign = wp.where(height < 0.0, -1.0, 1.0)
    inside = wp.min(wp.min(e_a * sign, e_b * sign), e_c * sign) >= 0.0
    before = is_point == 0.0 or (e_a + e_b + e_c) * sign * BEFORE_SAMPLE >= height * sign
    return height != 0.0 and inside and before


@wp.func
def starts_in_face(casters: RayCasters, gbuffer: GBuffer, y: int, x: int, origin: wp.vec3, light_ws: wp.vec4):
    """Whether a ray meets a face where it begins, within rounding: single rays and shafts may differ on it."""
    p = gbuffer.position_ws[y, x]
    size = wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.max(wp.abs(p[2]), wp.abs(gbuffer.depth[y, x])))
    way = wp.vec3(light_ws[0], light_ws[1], light_ws[2]) - origin * light_ws[3]
    return wp.mesh_query_ray_anyhit(casters.mesh, origin, way / wp.length(way), 4.0 * ORIGIN_ERROR * size)


@wp.kernel
def trace_edges(
    first: int,
    gbuffer: GBuffer,
    first_row: int,
    lists: EdgeLists,
    light: LightPlane,
    hull: LightHull,
    samples: SampleBatches,
    piercing_ws: wp.array(dtype=wp.vec3),
    casters: RayCasters,
    total_weight: float,
    visibility_out: wp.array2d(dtype=float),
    way_out: wp.array2d(dtype=int),
):
    """Weighted share of the light samples that a receiver sees, and whether it needs all rays."""
    row, column = wp.tid()
    y = first_row + first + row
    flags = gbuffer.flags[y, column]
    way_out[y, column] = BY_EDGES
    if (flags & RECEIVES) == 0:
        visibility_out[y, column] = 1.0
        return
    normal = gbuffer.normal_ws[y, column]
    n_x, n_y, n_z = normal[0], normal[1], normal[2]
    origin = ray_origin(gbuffer, y, column)
    position = gbuffer.position_ws[y, column] * hull.is_point
    p_x, p_y, p_z = position[0], position[1], position[2]
    from_point = origin * hull.is_point
    ahead = bool(True)
    behind = bool(True)
    for i in range(hull.corners.shape[0]):
        height = wp.dot(hull.corners[i] - from_point, normal)
        ahead = ahead and height > 0.0
        behind = behind and wp.dot(hull.corners[i] - position, normal) <= 0.0
    if behind and (flags & CASTS) != 0:
        visibility_out[y, column] = 0.0
        return
    projection = projection_from(light, origin)
    if projection.usable == 0:
        way_out[y, column] = BY_RAYS
        visibility_out[y, column] = 0.0
        return
    half = 0.5 + SQUARE_MARGIN
    nearest = float(NEAREST)
    farthest = float(1.0)
    if light.is_point == 0.0:
        nearest = NEAREST * hull.span
        farthest = float(1.0e30)
    if light.is_flat == 0:
        share = light.size / wp.length(light.centre - origin)
        half = 0.5 / wp.sqrt(1.0 - share * share) + SQUARE_MARGIN
    o_x, o_y, o_z = origin[0], origin[1], origin[2]
    u_x, u_y, u_z = projection.u[0], projection.u[1], projection.u[2]
    v_x, v_y, v_z = projection.v[0], projection.v[1], projection.v[2]
    w_x, w_y, w_z = projection.z[0], projection.z[1], projection.z[2]
    handed = wp.sign(wp.dot(projection.u, wp.cross(projection.v, projection.z)))
    cluster = ((y / TILE) * lists.tiles_x + column / TILE) * PARTS + lists.part[y, column]
    listed = lists.count[cluster]
    f_x, f_y, f_z = from_point[0], from_point[1], from_point[2]
    seen = float(0.0)
    edges = int(0)
    us = SampleFloats()
    vs = SampleFloats()
    counts = SampleInts()
    from_u = EdgeFloats()
    from_v = EdgeFloats()
    from_z = EdgeFloats()
    to_u = EdgeFloats()
    to_v = EdgeFloats()
    to_z = EdgeFloats()
    weights = EdgeFloats()
    kept = EdgeInts()
    for batch in range(samples.x.shape[0]):
        xs = samples.x[batch]
        ys = samples.y[batch]
        zs = samples.z[batch]
        edges = int(0)
        for block in range((listed + EDGE_LANES - 1) / EDGE_LANES):
            at = lists.begin[cluster] + block
            a_x = lists.block[at, 0]
            a_y = lists.block[at, 1]
            a_z = lists.block[at, 2]
            b_x = lists.block[at, 3]
            b_y = lists.block[at, 4]
            b_z = lists.block[at, 5]
            p_0 = lists.block[at, 6]
            p_1 = lists.block[at, 7]
            p_2 = lists.block[at, 8]
            p_3 = lists.block[at, 9]
            q_0 = lists.block[at, 10]
            q_1 = lists.block[at, 11]
            q_2 = lists.block[at, 12]
            q_3 = lists.block[at, 13]
            p_turn = lists.block[at, 14]
            q_turn = lists.block[at, 15]
            left = listed - block * EDGE_LANES
            count = int(0)
            for k in range(EDGE_LANES):
                x1 = a_x[k] - o_x
                y1 = a_y[k] - o_y
                z1 = a_z[k] - o_z
                x2 = b_x[k] - o_x
                y2 = b_y[k] - o_y
                z2 = b_z[k] - o_z
                p_side = p_3[k] - (p_0[k] * o_x + p_1[k] * o_y + p_2[k] * o_z)
                q_side = q_3[k] - (q_0[k] * o_x + q_1[k] * o_y + q_2[k] * o_z)
                weight = wp.where(p_side > 0.0, p_turn[k], -p_turn[k]) + wp.where(q_side > 0.0, q_turn[k], -q_turn[k])
                from_u[k] = x1 * u_x + y1 * u_y + z1 * u_z
                from_v[k] = x1 * v_x + y1 * v_y + z1 * v_z
                from_z[k] = x1 * w_x + y1 * w_y + z1 * w_z
                to_u[k] = x2 * u_x + y2 * u_y + z2 * u_z
                to_v[k] = x2 * v_x + y2 * v_y + z2 * v_z
                to_z[k] = x2 * w_x + y2 * w_y + z2 * w_z
                low = wp.min(from_z[k], to_z[k])
                high = wp.max(from_z[k], to_z[k])
                # outside of a side of the pyramid with both ends; right for ends behind the receiver, too
                right = wp.min(from_u[k] - half * from_z[k], to_u[k] - half * to_z[k])
                left_of = wp.max(from_u[k] + half * from_z[k], to_u[k] + half * to_z[k])
                above = wp.min(from_v[k] - half * from_z[k], to_v[k] - half * to_z[k])
                below = wp.max(from_v[k] + half * from_z[k], to_v[k] + half * to_z[k])
                outside = wp.max(wp.max(right, -left_of), wp.max(above, -below))
                outside = wp.max(outside, wp.max(nearest - high, low - farthest))
                weights[k] = wp.where(outside > 0.0, 0.0, wp.where(k < left, weight, 0.0))
            for k in range(EDGE_LANES):
                kept[count] = k
                count += wp.where(weights[k] != 0.0, 1, 0)
            for i in range(count):
                k = kept[i]
                edge = seen_part(
                    wp.vec3(from_u[k], from_v[k], from_z[k]),
                    wp.vec3(to_u[k], to_v[k], to_z[k]),
                    weights[k] * handed,
                    nearest,
                    farthest,
                )
                if not overlaps_square(edge, half):
                    continue
                if edges == 0:
                    for s in range(SAMPLES):
                        x = xs[s] - f_x
                        y_s = ys[s] - f_y
                        z = zs[s] - f_z
                        depth = 1.0 / (x * w_x + y_s * w_y + z * w_z)
                        us[s] = (x * u_x + y_s * u_y + z * u_z) * depth
                        vs[s] = (x * v_x + y_s * v_y + z * v_z) * depth
                        counts[s] = 0
                edges += 1
                crossing = crossing_of(edge, -half)
                low_v = crossing.low_v
                high_v = crossing.high_v
                at_u = crossing.anchor_u
                at_v = crossing.anchor_v
                du = crossing.du
                dv = crossing.dv
                step = crossing.step
                if crossing.at_border != 0:
                    for s in range(SAMPLES):
                        side = du * (vs[s] - at_v) - dv * (us[s] - at_u)
                        bound = wp.where(side > 0.0, low_v, high_v)
                        counts[s] = counts[s] + wp.where(vs[s] >= bound, step, 0)
                else:
                    for s in range(SAMPLES):
                        side = du * (vs[s] - at_v) - dv * (us[s] - at_u)
                        passed = wp.where(side < 0.0, wp.where(vs[s] < high_v, step, 0), 0)
                        counts[s] = counts[s] + wp.where(vs[s] >= low_v, passed, 0)
        held = samples.weight[batch]
        if edges == 0 and ahead and piercing_ws.shape[0] == 0:
            light_ws = wp.vec4(xs[0], ys[0], zs[0], hull.is_point)
            dark = is_occluded(casters, origin, light_ws, hull.reach)
            if dark:
                if starts_in_face(casters, gbuffer, y, column, origin, light_ws):
                    way_out[y, column] = BY_RAYS
            visibility_out[y, column] = wp.where(dark, 0.0, 1.0)
            return
        if edges == 0:
            for s in range(SAMPLES):
                counts[s] = 0
        if not ahead and (flags & CASTS) != 0:
            for s in range(SAMPLES):
                facing = n_x * (xs[s] - p_x) + n_y * (ys[s] - p_y) + n_z * (zs[s] - p_z)
                counts[s] = wp.where(facing <= 0.0, HIDDEN, counts[s])
        for i in range(piercing_ws.shape[0] / 3):
            a = piercing_ws[3 * i] - origin
            b = piercing_ws[3 * i + 1] - origin
            c = piercing_ws[3 * i + 2] - origin
            for s in range(SAMPLES):
                if hides(a, b, c, wp.vec3(xs[s], ys[s], zs[s]) - from_point, hull.is_point):
                    counts[s] = HIDDEN
        least = int(HIDDEN)
        for s in range(SAMPLES):
            least = wp.min(least, counts[s])
        if least == HIDDEN:
            continue
        one = int(SAMPLES)
        other = int(-1)
        beyond = int(-1)
        for s in range(SAMPLES):
            one = wp.min(one, wp.where(counts[s] == least, s, SAMPLES))
            other = wp.max(other, wp.where(counts[s] == least, s, -1))
            beyond = wp.max(beyond, wp.where(counts[s] > least, wp.where(counts[s] < HIDDEN, s, -1), -1))
        light_ws = wp.vec4(xs[one], ys[one], zs[one], hull.is_point)
        hidden = is_occluded(casters, origin, light_ws, hull.reach)
        agreed = bool(True)
        if hidden:
            agreed = not starts_in_face(casters, gbuffer, y, column, origin, light_ws)
        if other != one and agreed:
            light_ws = wp.vec4(xs[other], ys[other], zs[other], hull.is_point)
            agreed = is_occluded(casters, origin, light_ws, hull.reach) == hidden
        if beyond >= 0 and agreed:
            light_ws = wp.vec4(xs[beyond], ys[beyond], zs[beyond], hull.is_point)
            agreed = is_occluded(casters, origin, light_ws, hull.reach)
        if not agreed:
            way_out[y, column] = BY_RAYS
        if not hidden:
            for s in range(SAMPLES):
                seen += wp.where(counts[s] == least, held[s], 0.0)
    visibility_out[y, column] = seen / wp.max(total_weight, 1.0e-30)
