"""Rays from each receiver to all samples of a light at once: the reference's path on the CPU.

``rays.trace_light`` sends one ray after the other. Here the casters' tree is walked once for a receiver, with the
pyramid that holds every way to the light (``light_proofs.shaft_to_light``): a box outside of it, or behind the
receiver's plane, holds nothing that any ray could hit. What is left are the few triangles that touch the pyramid, and
each of them is tested against 64 rays in one lane loop: a way is hidden where it lies on the inner side of the three
planes through the receiver and an edge, and crosses the triangle's plane before its sample. Edges are evaluated without
fused operations, so that two triangles find exactly opposite numbers at the edge they share, and no ray slips through.

Receivers whose pyramid is empty are proven lit, and those of which every ray was hidden end the walk early.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.raster.gbuffer import GBuffer
from wkernels.rays.caster_tree import WIDTH, CasterTree
from wkernels.rays.light_proofs import LightHull, shaft_frame, shaft_of
from wkernels.rays.shaft_culling import reach_of_children, reach_of_triangles, slopes_of_group, view_leaf
from wkernels.rays.single_rays import NO_RECEIVER, PROVEN_DARK, PROVEN_LIT, TRACED, ray_origin
from wkernels.scene.cutouts import OPAQUE, is_cut_out
from wkernels.scene.geometry import CASTS, RECEIVES

GROUP_LANES = wp.constant(64)  # samples of a group, which meet a triangle in one step
GROUPS = wp.constant(4)  # per walk of the tree
BATCH = 256  # samples of one walk
Floats = wp.types.vector(length=BATCH, dtype=wp.float32)
Masks = wp.types.vector(length=WIDTH, dtype=wp.int32)
Slopes = wp.types.vector(length=4 * GROUPS, dtype=wp.float32)
Stack = wp.types.vector(length=96, dtype=wp.int32)  # 7 siblings for each of at most 10 levels, and the last one's 8
ROUNDING = wp.constant(4.0e-6)  # of box and corner coordinates against the shaft's sides, relative to their size
BEFORE_SAMPLE = wp.constant(1.0 - 1.0e-6)  # share of the way at which a caster still hides a sample


@wp.struct
class SampleBatches:
    """Samples of a light in batches of 256, in groups of 64; the last ones repeat the last sample with weight 0."""

    x: wp.array(dtype=Floats)
    y: wp.array(dtype=Floats)
    z: wp.array(dtype=Floats)
    weight: wp.array(dtype=Floats)
    low: wp.array(dtype=wp.vec3)  # box of each group
    high: wp.array(dtype=wp.vec3)
    groups: int


@wp.struct
class EdgePlanes:
    """A triangle as seen from a receiver: a way is hidden where all three products, less their offsets, are >= 0."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    offset: wp.vec3  # for samples at points: of the planes' products with the receiver's own position
    height: float  # six times the volume to the receiver, >= 0


@wp.func
def cross_unfused(a: wp.vec3, b: wp.vec3):
    """Cross product of which cross(b, a) is the exact opposite."""
    x1 = a[1] * b[2]
    x2 = a[2] * b[1]
    y1 = a[2] * b[0]
    y2 = a[0] * b[2]
    z1 = a[0] * b[1]
    z2 = a[1] * b[0]
    return wp.vec3(x1 - x2, y1 - y2, z1 - z2)


@wp.func
def edge_planes(tree: CasterTree, leaf: int, k: int, origin_ws: wp.vec3, is_point: float):
    """Planes of triangle ``k`` of a leaf."""
    a = wp.vec3(tree.triangle[leaf, 0][k], tree.triangle[leaf, 1][k], tree.triangle[leaf, 2][k]) - origin_ws
    b = wp.vec3(tree.triangle[leaf, 3][k], tree.triangle[leaf, 4][k], tree.triangle[leaf, 5][k]) - origin_ws
    c = wp.vec3(tree.triangle[leaf, 6][k], tree.triangle[leaf, 7][k], tree.triangle[leaf, 8][k]) - origin_ws
    out = EdgePlanes()
    out.a = cross_unfused(b, c)
    out.b = cross_unfused(c, a)
    out.c = cross_unfused(a, b)
    out.height = wp.dot(out.a, a)
    if out.height < 0.0:
        out.a = -out.a
        out.b = -out.b
        out.c = -out.c
        out.height = -out.height
    out.offset = is_point * wp.vec3(wp.dot(out.a, origin_ws), wp.dot(out.b, origin_ws), wp.dot(out.c, origin_ws))
    return out


@wp.func
def cut_corner(tree: CasterTree, slot: int):
    """Where the vertices of the triangle in a slot of the leaves begin if it is cut out, else -1."""
    at = 3 * tree.order[slot]
    if tree.cutouts.texture[tree.indices[at]] == OPAQUE:
        at = -1
    return at


@wp.func
def meets_cut_triangle(tree: CasterTree, at: int, planes: EdgePlanes, way: wp.vec3, is_point: float):
    """Whether a way meets a cut-out triangle where it is there: a way's products are its coordinates on it."""
    w_a = wp.dot(planes.a, way) - planes.offset[0]
    w_b = wp.dot(planes.b, way) - planes.offset[1]
    w_c = wp.dot(planes.c, way) - planes.offset[2]
    meets = wp.min(wp.min(w_a, w_b), w_c) >= 0.0
    if meets and is_point != 0.0:
        meets = (w_a + w_b + w_c) * BEFORE_SAMPLE >= planes.height
    if meets:
        b = tree.indices[at + 1]
        meets = not is_cut_out(tree.cutouts, tree.indices[at], b, tree.indices[at + 2], w_a, w_b, w_c)
    return meets


@wp.kernel
def trace_shafts(
    first: int,
    gbuffer: GBuffer,
    tree: CasterTree,
    samples: SampleBatches,
    hull: LightHull,
    prove: int,
    visibility_out: wp.array2d(dtype=float),
    proof_out: wp.array2d(dtype=int),
):
    """``rays.trace_light``: weighted share of the light samples that a receiver sees, and how that was found."""
    row, column = wp.tid()
    y = first + row
    flags = gbuffer.flags[y, column]
    if (flags & RECEIVES) == 0:
        visibility_out[y, column] = 1.0
        proof_out[y, column] = NO_RECEIVER
        return
    normal = gbuffer.normal_ws[y, column]
    n_x, n_y, n_z = normal[0], normal[1], normal[2]
    position = gbuffer.position_ws[y, column] * hull.is_point
    p_x, p_y, p_z = position[0], position[1], position[2]
    origin = ray_origin(gbuffer, y, column)
    origin_point = origin * hull.is_point
    ahead = bool(True)
    for i in range(hull.corners.shape[0]):
        ahead = ahead and wp.dot(hull.corners[i] - origin_point, normal) > 0.0
    own_side = wp.vec3()
    least_height = float(-1.0)
    if ahead:
        own_side = normal  # all of the light is in front, and so is all that can hide it
        least_height = 0.0
    frame = shaft_frame(hull, origin)
    shaft = shaft_of(frame)
    steepest = wp.max(wp.max(-frame.low_u, frame.high_u), wp.max(-frame.low_v, frame.high_v))
    # what is far from a receiver is rounded by less than the shaft is widened: it is what lies near that needs slack
    coordinates = wp.max(hull.span, wp.max(wp.max(wp.abs(origin[0]), wp.abs(origin[1])), wp.abs(origin[2])))
    slack = ROUNDING * coordinates * (1.0 + wp.max(steepest, 0.0))  # sides of slope t are 1 + t long or less
    cuts = tree.cutouts.count > 0
    touched = int(0)
    seen = float(0.0)
    total = float(0.0)
    stack = Stack()
    kept = Masks()
    slopes = Slopes()
    hidden = Floats()  # a sample is hidden where this is >= 0
    for batch in range(samples.x.shape[0]):
        xs = samples.x[batch]
        ys = samples.y[batch]
        zs = samples.z[batch]
        groups = wp.min(GROUPS, samples.groups - batch * GROUPS)
        open_groups = int(0)
        for g in range(groups):
            base = g * GROUP_LANES
            visible_lanes = int(0)
            if (flags & CASTS) != 0:
                for k in range(GROUP_LANES):
                    facing = n_x * (xs[base + k] - p_x) + n_y * (ys[base + k] - p_y) + n_z * (zs[base + k] - p_z)
                    hidden[base + k] = wp.where(facing <= 0.0, 1.0, -1.0)
                    visible_lanes += wp.where(facing <= 0.0, 0, 1)
            else:
                for k in range(GROUP_LANES):
                    hidden[base + k] = -1.0
                visible_lanes = GROUP_LANES
            if visible_lanes > 0:
                open_groups = open_groups | (1 << g)
            at = batch * GROUPS + g
            own = slopes_of_group(samples.low[at], samples.high[at], origin_point, frame)
            for i in range(4):
                slopes[4 * g + i] = own[i]
        top = int(0)
        if tree.levels > 0 and open_groups != 0:
            stack[0] = tree.levels - 1
            top = 1
        while top > 0:
            top -= 1
            level = stack[top] & 15
            index = stack[top] >> 4
            if level > 0:
                reach = reach_of_children(tree, tree.level_begin[level] + index, origin, shaft, own_side)
                begin = index * WIDTH
                for k in range(wp.min(WIDTH, tree.level_size[level - 1] - begin)):
                    if reach[k] >= -slack:
                        stack[top] = ((begin + k) << 4) | (level - 1)
                        top += 1
                continue
            leaf = view_leaf(tree, index, origin, frame, own_side)
            above = leaf.above
            touches = Masks()
            for g in range(groups):
                if (open_groups & (1 << g)) == 0:
                    continue
                own = wp.vec4(slopes[4 * g], slopes[4 * g + 1], slopes[4 * g + 2], slopes[4 * g + 3])
                reach = reach_of_triangles(leaf, own, frame.narrow)
                for k in range(WIDTH):
                    touches[k] = touches[k] | wp.where(reach[k] >= -slack, 1 << g, 0)
            count = int(0)
            for k in range(WIDTH):
                kept[count] = k
                count += wp.where(touches[k] != 0, wp.where(above[k] > least_height, 1, 0), 0)
            for i in range(count):
                k = kept[i]
                planes = edge_planes(tree, index, k, origin, hull.is_point)
                if planes.height == 0.0:  # seen edge on, it hides nothing
                    continue
                touched += 1
                if cuts:
                    cut_at = cut_corner(tree, index * WIDTH + k)
                    if cut_at >= 0:
                        for lane in range(groups * GROUP_LANES):  # one way after the other: few ask the texture
                            if hidden[lane] < 0.0 and (touches[k] & (1 << (lane / GROUP_LANES))) != 0:
                                way = wp.vec3(xs[lane], ys[lane], zs[lane])
                                if meets_cut_triangle(tree, cut_at, planes, way, hull.is_point):
                                    hidden[lane] = 1.0
                        continue
                a_x, a_y, a_z = planes.a[0], planes.a[1], planes.a[2]
                b_x, b_y, b_z = planes.b[0], planes.b[1], planes.b[2]
                c_x, c_y, c_z = planes.c[0], planes.c[1], planes.c[2]
                a_0, b_0, c_0 = planes.offset[0], planes.offset[1], planes.offset[2]
                height = planes.height
                for g in range(groups):
                    if (touches[k] & (1 << g)) == 0:
                        continue
                    base = g * GROUP_LANES
                    if hull.is_point == 0.0:  # directions: no offsets, and no end of the way
                        for lane in range(GROUP_LANES):
                            x = xs[base + lane]
                            y_s = ys[base + lane]
                            z = zs[base + lane]
                            e_a = x * a_x + y_s * a_y + z * a_z
                            e_b = x * b_x + y_s * b_y + z * b_z
                            e_c = x * c_x + y_s * c_y + z * c_z
                            hidden[base + lane] = wp.max(hidden[base + lane], wp.min(wp.min(e_a, e_b), e_c))
                        continue
                    for lane in range(GROUP_LANES):
                        x = xs[base + lane]
                        y_s = ys[base + lane]
                        z = zs[base + lane]
                        e_a = x * a_x + y_s * a_y + z * a_z - a_0
                        e_b = x * b_x + y_s * b_y + z * b_z - b_0
                        e_c = x * c_x + y_s * c_y + z * c_z - c_0
                        before = (e_a + e_b + e_c) * BEFORE_SAMPLE - height
                        inside = wp.min(wp.min(e_a, e_b), wp.min(e_c, before))
                        hidden[base + lane] = wp.max(hidden[base + lane], inside)
            if count > 0 and prove != 0:
                for g in range(groups):
                    base = g * GROUP_LANES
                    open_lanes = int(0)
                    for k in range(GROUP_LANES):
                        open_lanes += wp.where(hidden[base + k] >= 0.0, 0, 1)
                    if open_lanes == 0:
                        open_groups = open_groups & ~(1 << g)
                if open_groups == 0:
                    top = 0
        weights = samples.weight[batch]
        for k in range(groups * GROUP_LANES):
            total += weights[k]
            seen += wp.where(hidden[k] >= 0.0, 0.0, weights[k])
    visible = seen / wp.max(total, 1.0e-30)
    proof = TRACED
    if prove != 0:
        if touched == 0 and ahead:
            proof = PROVEN_LIT
        elif visible == 0.0:
            proof = PROVEN_DARK
    visibility_out[y, column] = visible
    proof_out[y, column] = proof


def sample_batches(samples: np.ndarray, weights: np.ndarray, device: str = "cpu") -> SampleBatches:
    """Light samples for ``trace_shafts``, neighbours on the light in the same group.

    Args:
        samples: (n, 4), homogeneous, rebased world; all points or all directions; n >= 1.
        weights: (n,).
        device: Warp device.
    """
    points = np.asarray(samples, dtype=np.float32)[:, :3]
    order = np.concatenate(_compact_groups(points, np.arange(len(points))))
    padded = np.concatenate([order, np.repeat(order[-1:], -len(order) % BATCH)])
    by_batch = points[padded].reshape(-1, BATCH, 3)
    held = np.concatenate([np.asarray(weights, np.float32)[order], np.zeros(len(padded) - len(order), np.float32)])
    out = SampleBatches()
    out.x, out.y, out.z = (
        wp.array(np.ascontiguousarray(by_batch[:, :, axis]), dtype=Floats, device=device) for axis in range(3)
    )
    out.weight = wp.array(held.reshape(-1, BATCH), dtype=Floats, device=device)
    by_group = points[padded].reshape(-1, int(GROUP_LANES), 3)
    out.low = wp.array(by_group.min(axis=1), dtype=wp.vec3, device=device)
    out.high = wp.array(by_group.max(axis=1), dtype=wp.vec3, device=device)
    out.groups = -(-len(order) // int(GROUP_LANES))
    return out


def _compact_groups(points: np.ndarray, which: np.ndarray) -> list[np.ndarray]:
    """Splits samples in half along their longest extent, in whole groups, until a group is left."""
    lanes = int(GROUP_LANES)
    if len(which) <= lanes:
        return [which]
    axis = int(np.argmax(np.ptp(points[which], axis=0)))
    ordered = which[np.argsort(points[which, axis], kind="stable")]
    half = -(-len(which) // lanes) // 2 * lanes
    return [*_compact_groups(points, ordered[:half]), *_compact_groups(points, ordered[half:])]
