"""A few rays from each receiver to a light: the reference's path on the CPU where the light has at most 8 samples.

``shaft_rays`` tests 64 samples against every triangle that touches the pyramid from a receiver to the light. A few
samples meet few of these triangles. Here each box that the pyramid meets is asked which samples' ways come near it;
boxes are taken nearest first, and a sample that is hidden asks no more. What hid a pixel's samples most often hides its
neighbour's, and is tried first (the shadow cache of Haines and Greenberg 1986, along a row of pixels).

A way is hidden by a triangle if and only if ``shaft_rays`` says so: the products are the same ones in the same order,
eight triangles at a time instead of 64 samples. Boxes grow by an eighth of their extent at each side, more than those
products are rounded by, but where a triangle's edge is seen end on, at a silhouette: there the shafts' rays take a
rounding error for a hit now and then, of which the box says that it is none.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, runs_per_row
from wkernels.raster.gbuffer import GBuffer
from wkernels.rays.caster_tree import WIDTH, CasterTree, Eight
from wkernels.rays.light_proofs import LightHull, shaft_frame, shaft_of
from wkernels.rays.shaft_culling import reach_of_children
from wkernels.rays.shaft_rays import BEFORE_SAMPLE, ROUNDING, Stack
from wkernels.rays.single_rays import NO_RECEIVER, PROVEN_DARK, PROVEN_LIT, TRACED, ray_origin
from wkernels.scene.geometry import CASTS, RECEIVES

MOST_SAMPLES = 8  # of the reference's; with more, sparse scenes lose (docs/exact_rays.md)
MOST_HELD = 64  # beyond, ``shaft_rays`` adds samples in another order
BOX_MARGIN = wp.constant(0.125)  # by which a box grows at each side, of its own extent
LEAST_WAY = wp.constant(1.0e-20)  # stands for a component 0 of a way, so that its inverse is finite
Cached = wp.types.vector(length=LANES, dtype=wp.int32)


@wp.struct
class FewSamples:
    """Samples of a light by sixteens, in their own order; lanes behind them repeat the last one with weight 0."""

    x: wp.array(dtype=Floats)
    y: wp.array(dtype=Floats)
    z: wp.array(dtype=Floats)
    weight: wp.array(dtype=Floats)
    count: int


@wp.struct
class Receiver:
    """What the rays of a pixel have in common."""

    origin: wp.vec3
    own_side: wp.vec3  # normal where all of the light is in front, and then all that can hide it; else 0
    least_height: float  # above the receiver's plane, of a triangle that may hide something
    is_point: float


@wp.func
def hidden_by_leaf(
    triangle: wp.array2d(dtype=Eight),
    leaf: int,
    receiver: Receiver,
    xs: Floats,
    ys: Floats,
    zs: Floats,
    samples: int,
    count: int,
):
    """Which of some samples, as bits, the eight triangles of a leaf hide: ``shaft_rays.edge_planes`` of all eight.

    -1 if none of them lies before the receiver, so that nothing had to be tested.
    """
    x0s = triangle[leaf, 0]
    y0s = triangle[leaf, 1]
    z0s = triangle[leaf, 2]
    x1s = triangle[leaf, 3]
    y1s = triangle[leaf, 4]
    z1s = triangle[leaf, 5]
    x2s = triangle[leaf, 6]
    y2s = triangle[leaf, 7]
    z2s = triangle[leaf, 8]
    o_x, o_y, o_z = receiver.origin[0], receiver.origin[1], receiver.origin[2]
    n_x, n_y, n_z = receiver.own_side[0], receiver.own_side[1], receiver.own_side[2]
    least = receiver.least_height
    is_point = receiver.is_point
    above = Eight()
    raised = int(0)
    for k in range(WIDTH):
        first = (x0s[k] - o_x) * n_x + (y0s[k] - o_y) * n_y + (z0s[k] - o_z) * n_z
        second = (x1s[k] - o_x) * n_x + (y1s[k] - o_y) * n_y + (z1s[k] - o_z) * n_z
        third = (x2s[k] - o_x) * n_x + (y2s[k] - o_y) * n_y + (z2s[k] - o_z) * n_z
        above[k] = wp.max(first, wp.max(second, third))
        raised += wp.where(above[k] > least, 1, 0)
    if raised == 0:
        return -1
    a_x = Eight()
    a_y = Eight()
    a_z = Eight()
    b_x = Eight()
    b_y = Eight()
    b_z = Eight()
    c_x = Eight()
    c_y = Eight()
    c_z = Eight()
    a_0 = Eight()
    b_0 = Eight()
    c_0 = Eight()
    heights = Eight()
    for k in range(WIDTH):
        x0 = x0s[k] - o_x
        y0 = y0s[k] - o_y
        z0 = z0s[k] - o_z
        x1 = x1s[k] - o_x
        y1 = y1s[k] - o_y
        z1 = z1s[k] - o_z
        x2 = x2s[k] - o_x
        y2 = y2s[k] - o_y
        z2 = z2s[k] - o_z
        u_x = y1 * z2 - z1 * y2
        u_y = z1 * x2 - x1 * z2
        u_z = x1 * y2 - y1 * x2
        v_x = y2 * z0 - z2 * y0
        v_y = z2 * x0 - x2 * z0
        v_z = x2 * y0 - y2 * x0
        w_x = y0 * z1 - z0 * y1
        w_y = z0 * x1 - x0 * z1
        w_z = x0 * y1 - y0 * x1
        height = u_x * x0 + u_y * y0 + u_z * z0
        sign = wp.where(height < 0.0, -1.0, 1.0)
        a_x[k] = u_x * sign
        a_y[k] = u_y * sign
        a_z[k] = u_z * sign
        b_x[k] = v_x * sign
        b_y[k] = v_y * sign
        b_z[k] = v_z * sign
        c_x[k] = w_x * sign
        c_y[k] = w_y * sign
        c_z[k] = w_z * sign
        a_0[k] = is_point * sign * (u_x * o_x + u_y * o_y + u_z * o_z)
        b_0[k] = is_point * sign * (v_x * o_x + v_y * o_y + v_z * o_z)
        c_0[k] = is_point * sign * (w_x * o_x + w_y * o_y + w_z * o_z)
        # seen edge on it hides nothing, nor does it behind the receiver's plane
        heights[k] = wp.where(above[k] > least, height * sign, 0.0)
    hidden = int(0)
    for s in range(count):
        if (samples & (1 << s)) == 0:
            continue
        x = xs[s]
        y = ys[s]
        z = zs[s]
        hits = int(0)
        for k in range(WIDTH):
            e_a = x * a_x[k] + y * a_y[k] + z * a_z[k] - a_0[k]
            e_b = x * b_x[k] + y * b_y[k] + z * b_z[k] - b_0[k]
            e_c = x * c_x[k] + y * c_y[k] + z * c_z[k] - c_0[k]
            before = wp.where(is_point > 0.0, (e_a + e_b + e_c) * BEFORE_SAMPLE - heights[k], 0.0)
            inside = wp.min(wp.min(e_a, e_b), wp.min(e_c, before))
            hits += wp.where(inside >= 0.0, wp.where(heights[k] > 0.0, 1, 0), 0)
        if hits > 0:
            hidden = hidden | (1 << s)
    return hidden


@wp.func
def near_box(low: wp.vec3, high: wp.vec3, inverse_x: Floats, inverse_y: Floats, inverse_z: Floats, end: float):
    """Which samples' ways, as bits, pass a box that is given from the receiver (Kay and Kajiya 1986)."""
    x0, y0, z0 = low[0], low[1], low[2]
    x1, y1, z1 = high[0], high[1], high[2]
    near = int(0)
    for k in range(LANES):
        x_in = x0 * inverse_x[k]
        x_out = x1 * inverse_x[k]
        y_in = y0 * inverse_y[k]
        y_out = y1 * inverse_y[k]
        z_in = z0 * inverse_z[k]
        z_out = z1 * inverse_z[k]
        enter = wp.max(wp.max(wp.min(x_in, x_out), wp.min(y_in, y_out)), wp.max(wp.min(z_in, z_out), 0.0))
        leave = wp.min(wp.min(wp.max(x_in, x_out), wp.max(y_in, y_out)), wp.min(wp.max(z_in, z_out), end))
        near = near | wp.where(enter <= leave, 1 << k, 0)
    return near


@wp.kernel
def trace_few(
    first: int,
    gbuffer: GBuffer,
    tree: CasterTree,
    samples: FewSamples,
    hull: LightHull,
    prove: int,
    visibility_out: wp.array2d(dtype=float),
    proof_out: wp.array2d(dtype=int),
):
    """``shaft_rays.trace_shafts`` of a run of pixels, for few samples."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    end = wp.where(hull.is_point > 0.0, 1.001, 1.0e30)
    inverse_x = Floats()
    inverse_y = Floats()
    inverse_z = Floats()
    cached = Cached(-1)  # for each sample the leaf that hid it last
    stack = Stack()
    asked = Stack()  # for each entry of it the samples that pass near
    receiver = Receiver()
    receiver.is_point = hull.is_point
    for column in range(x0, wp.min(x0 + LANES, visibility_out.shape[1])):
        flags = gbuffer.flags[y, column]
        if (flags & RECEIVES) == 0:
            visibility_out[y, column] = 1.0
            proof_out[y, column] = NO_RECEIVER
            continue
        normal = gbuffer.normal_ws[y, column]
        n_x, n_y, n_z = normal[0], normal[1], normal[2]
        position = gbuffer.position_ws[y, column] * hull.is_point
        p_x, p_y, p_z = position[0], position[1], position[2]
        origin = ray_origin(gbuffer, y, column)
        origin_point = origin * hull.is_point
        o_x, o_y, o_z = origin_point[0], origin_point[1], origin_point[2]
        ahead = bool(True)
        for i in range(hull.corners.shape[0]):
            ahead = ahead and wp.dot(hull.corners[i] - origin_point, normal) > 0.0
        receiver.origin = origin
        receiver.own_side = wp.vec3()
        receiver.least_height = -1.0
        if ahead:
            receiver.own_side = normal
            receiver.least_height = 0.0
        tested = int(0)
        total = float(0.0)
        seen = float(0.0)
        for batch in range(samples.x.shape[0]):
            xs = samples.x[batch]
            ys = samples.y[batch]
            zs = samples.z[batch]
            weights = samples.weight[batch]
            count = wp.min(LANES, samples.count - batch * LANES)
            is_open = int(0)  # samples that nothing is known to hide, as bits
            for k in range(count):
                facing = n_x * (xs[k] - p_x) + n_y * (ys[k] - p_y) + n_z * (zs[k] - p_z)
                if (flags & CASTS) == 0 or not (facing <= 0.0):
                    is_open = is_open | (1 << k)
            if tree.levels > 0 and is_open != 0:
                for k in range(count):
                    leaf = cached[k]
                    if leaf < 0 or (is_open & (1 << k)) == 0:
                        continue
                    hidden = hidden_by_leaf(tree.triangle, leaf, receiver, xs, ys, zs, is_open, count)
                    if hidden > 0:
                        is_open = is_open & ~hidden
                    for other in range(count):  # what hides a sample no longer is forgotten
                        if cached[other] == leaf and (is_open & (1 << other)) != 0:
                            cached[other] = -1
            if tree.levels > 0 and is_open != 0:
                frame = shaft_frame(hull, origin)
                shaft = shaft_of(frame)
                steepest = wp.max(wp.max(-frame.low_u, frame.high_u), wp.max(-frame.low_v, frame.high_v))
                coordinates = wp.max(hull.span, wp.max(wp.max(wp.abs(origin[0]), wp.abs(origin[1])), wp.abs(origin[2])))
                slack = ROUNDING * coordinates * (1.0 + wp.max(steepest, 0.0))
                margin = wp.vec3(slack, slack, slack)
                axis = frame.axis
                for k in range(LANES):
                    way_x = xs[k] - o_x
                    way_y = ys[k] - o_y
                    way_z = zs[k] - o_z
                    inverse_x[k] = 1.0 / wp.where(wp.abs(way_x) < LEAST_WAY, LEAST_WAY, way_x)
                    inverse_y[k] = 1.0 / wp.where(wp.abs(way_y) < LEAST_WAY, LEAST_WAY, way_y)
                    inverse_z[k] = 1.0 / wp.where(wp.abs(way_z) < LEAST_WAY, LEAST_WAY, way_z)
                stack[0] = tree.levels - 1
                asked[0] = is_open
                top = int(1)
                while top > 0:
                    top -= 1
                    wanted = asked[top] & is_open
                    if wanted == 0:
                        continue
                    level = stack[top] & 15
                    index = stack[top] >> 4
                    if level == 0:
                        hidden = hidden_by_leaf(tree.triangle, index, receiver, xs, ys, zs, wanted, count)
                        tested += wp.where(hidden >= 0, 1, 0)
                        if hidden > 0:
                            is_open = is_open & ~hidden
                            for k in range(count):
                                if (hidden & (1 << k)) != 0:
                                    cached[k] = index
                            if is_open == 0:
                                top = 0
                        continue
                    at = tree.level_begin[level] + index
                    reach = reach_of_children(tree, at, origin, shaft, receiver.own_side)
                    begin = index * WIDTH
                    floor = top
                    distances = Eight()
                    for k in range(wp.min(WIDTH, tree.level_size[level - 1] - begin)):
                        if reach[k] < -slack:
                            continue
                        low = wp.vec3(tree.low_x[at][k], tree.low_y[at][k], tree.low_z[at][k]) - origin
                        high = wp.vec3(tree.high_x[at][k], tree.high_y[at][k], tree.high_z[at][k]) - origin
                        grown = margin + BOX_MARGIN * (high - low)
                        near = wanted & near_box(low - grown, high + grown, inverse_x, inverse_y, inverse_z, end)
                        if near == 0:
                            continue
                        distance = (
                            wp.min(low[0] * axis[0], high[0] * axis[0])
                            + wp.min(low[1] * axis[1], high[1] * axis[1])
                            + wp.min(low[2] * axis[2], high[2] * axis[2])
                        )
                        slot = top  # the nearest is to be on top
                        while slot > floor and distances[slot - floor - 1] < distance:
                            distances[slot - floor] = distances[slot - floor - 1]
                            stack[slot] = stack[slot - 1]
                            asked[slot] = asked[slot - 1]
                            slot -= 1
                        distances[slot - floor] = distance
                        stack[slot] = ((begin + k) << 4) | (level - 1)
                        asked[slot] = near
                        top += 1
            for k in range(count):
                total += weights[k]
                if (is_open & (1 << k)) != 0:
                    seen += weights[k]
        visible = seen / wp.max(total, 1.0e-30)
        proof = TRACED
        if prove != 0:
            if tested == 0 and ahead and seen == total:
                proof = PROVEN_LIT
            elif visible == 0.0:
                proof = PROVEN_DARK
        visibility_out[y, column] = visible
        proof_out[y, column] = proof


def few_samples(samples: np.ndarray, weights: np.ndarray, device: str = "cpu") -> FewSamples:
    """Light samples for ``trace_few``.

    Args:
        samples: (n, 4), homogeneous, rebased world; all points or all directions; 1 <= n <= ``MOST_HELD``.
        weights: (n,).
        device: Warp device.
    """
    count = len(samples)
    assert 1 <= count <= MOST_HELD
    spare = (0, -count % int(LANES))
    points = np.pad(np.asarray(samples, dtype=np.float32)[:, :3], (spare, (0, 0)), mode="edge")
    out = FewSamples()
    out.x, out.y, out.z = (
        wp.array(np.ascontiguousarray(points[:, axis]).reshape(-1, int(LANES)), dtype=Floats, device=device)
        for axis in range(3)
    )
    held = np.pad(np.asarray(weights, np.float32), spare)
    out.weight = wp.array(held.reshape(-1, int(LANES)), dtype=Floats, device=device)
    out.count = count
    return out


def runs_of_image(shape: tuple[int, ...]) -> tuple[int, int]:
    """Grid of ``trace_few`` for an image (H, W)."""
    return shape[0], runs_per_row(shape[1])
