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

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.caster_tree import CasterTree, Eight
from wkernels.gbuffer import GBuffer
from wkernels.geometry import CASTS, RECEIVES
from wkernels.light_proofs import LightHull, shaft_to_light
from wkernels.rays import NO_RECEIVER, PROVEN_DARK, PROVEN_LIT, TRACED, ray_origin

LANES = wp.constant(64)
GROUPS = wp.constant(4)  # of 64 samples, per walk of the tree
Floats = wp.types.vector(length=LANES, dtype=wp.float32)
Stack = wp.types.vector(length=96, dtype=wp.int32)  # 7 siblings for each of at most 10 levels, and the last one's 8
ROUNDING = wp.constant(4.0e-6)  # of box and corner coordinates against the shaft's sides, relative to the scene's size
BEFORE_SAMPLE = wp.constant(1.0 - 1.0e-6)  # share of the way at which a caster still hides a sample


@wp.struct
class SampleRuns:
    """Samples of a light in runs of 64; the last run repeats its last sample with weight 0."""

    x: wp.array(dtype=Floats)
    y: wp.array(dtype=Floats)
    z: wp.array(dtype=Floats)
    weight: wp.array(dtype=Floats)


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
def edge_planes(a: wp.vec3, b: wp.vec3, c: wp.vec3, origin_ws: wp.vec3, is_point: float):
    """Planes of a triangle whose corners are relative to the receiver."""
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
def hide(hidden: Floats, x: Floats, y: Floats, z: Floats, planes: EdgePlanes, limit: float):
    """``hidden`` (a lane is hidden where it is >= 0), with one more triangle."""
    a_x, a_y, a_z = planes.a[0], planes.a[1], planes.a[2]
    b_x, b_y, b_z = planes.b[0], planes.b[1], planes.b[2]
    c_x, c_y, c_z = planes.c[0], planes.c[1], planes.c[2]
    a_0, b_0, c_0 = planes.offset[0], planes.offset[1], planes.offset[2]
    height = planes.height
    for k in range(LANES):
        e_a = x[k] * a_x + y[k] * a_y + z[k] * a_z - a_0
        e_b = x[k] * b_x + y[k] * b_y + z[k] * b_z - b_0
        e_c = x[k] * c_x + y[k] * c_y + z[k] * c_z - c_0
        before = (e_a + e_b + e_c) * limit - height
        hidden[k] = wp.max(hidden[k], wp.min(wp.min(e_a, e_b), wp.min(e_c, before)))
    return hidden


@wp.func
def behind_surface(x: Floats, y: Floats, z: Floats, position_ws: wp.vec3, normal_ws: wp.vec3, casts: int):
    """1 for the samples that the receiver's own surface hides, -1 for the others."""
    n_x, n_y, n_z = normal_ws[0], normal_ws[1], normal_ws[2]
    p_x, p_y, p_z = position_ws[0], position_ws[1], position_ws[2]
    out = Floats(-1.0)
    if casts != 0:
        for k in range(LANES):
            facing = n_x * (x[k] - p_x) + n_y * (y[k] - p_y) + n_z * (z[k] - p_z)
            out[k] = wp.where(facing <= 0.0, 1.0, -1.0)
    return out


@wp.func
def count_hidden(hidden: Floats):
    """How many lanes are hidden."""
    out = int(0)
    for k in range(LANES):
        out += wp.where(hidden[k] >= 0.0, 1, 0)
    return out


@wp.func
def add_seen(sums: wp.vec2, hidden: Floats, weight: Floats):
    """(weight of the samples that are seen, of all)."""
    seen = sums[0]
    total = sums[1]
    for k in range(LANES):
        total += weight[k]
        seen += wp.where(hidden[k] >= 0.0, 0.0, weight[k])
    return wp.vec2(seen, total)


@wp.func
def reach_beyond(side: wp.vec3, low_x: Eight, low_y: Eight, low_z: Eight, high_x: Eight, high_y: Eight, high_z: Eight):
    """How far eight boxes reach to the inner side of a plane through the receiver."""
    x = wp.max(low_x * side[0], high_x * side[0])
    y = wp.max(low_y * side[1], high_y * side[1])
    z = wp.max(low_z * side[2], high_z * side[2])
    return x + y + z


@wp.func
def along(side: wp.vec3, x: Eight, y: Eight, z: Eight):
    """Eight products with a direction."""
    return x * side[0] + y * side[1] + z * side[2]


@wp.kernel
def trace_shafts(
    first: int,
    gbuffer: GBuffer,
    tree: CasterTree,
    samples: SampleRuns,
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
    position = gbuffer.position_ws[y, column]
    normal = gbuffer.normal_ws[y, column]
    origin = ray_origin(gbuffer, y, column)
    casts = flags & CASTS
    ahead = bool(True)
    for i in range(hull.corners.shape[0]):
        ahead = ahead and wp.dot(hull.corners[i] - origin * hull.is_point, normal) > 0.0
    shaft = shaft_to_light(hull, origin)
    own_side = wp.vec3()
    if ahead:
        own_side = normal  # all of the light is in front, and so is all that can hide it
    limit = wp.where(hull.is_point > 0.0, BEFORE_SAMPLE, hull.reach)
    slack = ROUNDING * hull.reach
    touched = int(0)
    sums = wp.vec2(0.0, 0.0)
    all_hidden = bool(True)
    runs = samples.x.shape[0]
    for run in range(0, runs, GROUPS):
        run_1 = wp.min(run + 1, runs - 1)
        run_2 = wp.min(run + 2, runs - 1)
        run_3 = wp.min(run + 3, runs - 1)
        groups = wp.min(GROUPS, runs - run)
        x_0 = samples.x[run]
        y_0 = samples.y[run]
        z_0 = samples.z[run]
        x_1 = samples.x[run_1]
        y_1 = samples.y[run_1]
        z_1 = samples.z[run_1]
        x_2 = samples.x[run_2]
        y_2 = samples.y[run_2]
        z_2 = samples.z[run_2]
        x_3 = samples.x[run_3]
        y_3 = samples.y[run_3]
        z_3 = samples.z[run_3]
        from_ws = position * hull.is_point
        hidden_0 = behind_surface(x_0, y_0, z_0, from_ws, normal, casts)
        hidden_1 = behind_surface(x_1, y_1, z_1, from_ws, normal, casts)
        hidden_2 = behind_surface(x_2, y_2, z_2, from_ws, normal, casts)
        hidden_3 = behind_surface(x_3, y_3, z_3, from_ws, normal, casts)
        stack = Stack()
        top = int(0)
        if tree.levels > 0:
            stack[0] = tree.levels - 1
            top = 1
        while top > 0:
            top -= 1
            level = stack[top] & 15
            index = stack[top] >> 4
            if level > 0:
                at = tree.level_begin[level] + index
                low_x = tree.low_x[at] - Eight(origin[0])
                low_y = tree.low_y[at] - Eight(origin[1])
                low_z = tree.low_z[at] - Eight(origin[2])
                high_x = tree.high_x[at] - Eight(origin[0])
                high_y = tree.high_y[at] - Eight(origin[1])
                high_z = tree.high_z[at] - Eight(origin[2])
                least = wp.min(
                    wp.min(
                        reach_beyond(shaft.left, low_x, low_y, low_z, high_x, high_y, high_z),
                        reach_beyond(shaft.right, low_x, low_y, low_z, high_x, high_y, high_z),
                    ),
                    wp.min(
                        reach_beyond(shaft.bottom, low_x, low_y, low_z, high_x, high_y, high_z),
                        reach_beyond(shaft.top, low_x, low_y, low_z, high_x, high_y, high_z),
                    ),
                )
                least = wp.min(least, reach_beyond(own_side, low_x, low_y, low_z, high_x, high_y, high_z))
                begin = index * 8
                for k in range(wp.min(8, tree.level_size[level - 1] - begin)):
                    if least[k] >= -slack:
                        stack[top] = ((begin + k) << 4) | (level - 1)
                        top += 1
            else:
                a_x = tree.triangle[index, 0] - Eight(origin[0])
                a_y = tree.triangle[index, 1] - Eight(origin[1])
                a_z = tree.triangle[index, 2] - Eight(origin[2])
                b_x = tree.triangle[index, 3] - Eight(origin[0])
                b_y = tree.triangle[index, 4] - Eight(origin[1])
                b_z = tree.triangle[index, 5] - Eight(origin[2])
                c_x = tree.triangle[index, 6] - Eight(origin[0])
                c_y = tree.triangle[index, 7] - Eight(origin[1])
                c_z = tree.triangle[index, 8] - Eight(origin[2])
                least = Eight(1.0e30)
                for s in range(4):
                    side = shaft.left
                    if s == 1:
                        side = shaft.right
                    if s == 2:
                        side = shaft.bottom
                    if s == 3:
                        side = shaft.top
                    farthest = wp.max(along(side, a_x, a_y, a_z), along(side, b_x, b_y, b_z))
                    least = wp.min(least, wp.max(farthest, along(side, c_x, c_y, c_z)))
                above = Eight(1.0)
                if ahead:
                    above = wp.max(along(normal, a_x, a_y, a_z), along(normal, b_x, b_y, b_z))
                    above = wp.max(above, along(normal, c_x, c_y, c_z))
                tested = int(0)
                for k in range(8):
                    if least[k] >= -slack and above[k] > 0.0:
                        a = wp.vec3(a_x[k], a_y[k], a_z[k])
                        b = wp.vec3(b_x[k], b_y[k], b_z[k])
                        c = wp.vec3(c_x[k], c_y[k], c_z[k])
                        planes = edge_planes(a, b, c, origin, hull.is_point)
                        if planes.height > 0.0:  # seen edge on it hides nothing
                            tested += 1
                            hidden_0 = hide(hidden_0, x_0, y_0, z_0, planes, limit)
                            if groups > 1:
                                hidden_1 = hide(hidden_1, x_1, y_1, z_1, planes, limit)
                            if groups > 2:
                                hidden_2 = hide(hidden_2, x_2, y_2, z_2, planes, limit)
                            if groups > 3:
                                hidden_3 = hide(hidden_3, x_3, y_3, z_3, planes, limit)
                touched += tested
                if tested > 0 and prove != 0:
                    # shorter lists are repeated in the last groups, so that all four can be asked
                    if count_hidden(hidden_0) == LANES:
                        rest = count_hidden(hidden_1) + count_hidden(hidden_2) + count_hidden(hidden_3)
                        if rest == 3 * LANES or groups == 1:
                            top = 0
        sums = add_seen(sums, hidden_0, samples.weight[run])
        if groups > 1:
            sums = add_seen(sums, hidden_1, samples.weight[run_1])
        if groups > 2:
            sums = add_seen(sums, hidden_2, samples.weight[run_2])
        if groups > 3:
            sums = add_seen(sums, hidden_3, samples.weight[run_3])
    visible = sums[0] / wp.max(sums[1], 1.0e-30)
    proof = TRACED
    if prove != 0:
        if touched == 0 and ahead:
            proof = PROVEN_LIT
        elif visible == 0.0:
            proof = PROVEN_DARK
    visibility_out[y, column] = visible
    proof_out[y, column] = proof
