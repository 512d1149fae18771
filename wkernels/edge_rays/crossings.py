"""What one edge, as a receiver sees it before the light, adds to the depth complexity of the light's samples.

Complexity is counted along a path to each sample: up the left border of the light's square, then right along the
sample's v. An edge that the path crosses adds its weight, so that counts differ from the true ones by one number for
all samples. On which side of the path's corner an edge passes drops out: an edge that crosses the border counts where
the sample lies above it, one that does not where the sample lies right of it. What is left are tests of a vertex, which
all edges at the vertex answer alike, and one side for each sample and edge: rounding may misplace a sample that lies on
an edge, and no other.
"""

from __future__ import annotations

import warp as wp


@wp.struct
class SeenEdge:
    """The part of an edge between receiver and light, on the light's plane."""

    a: wp.vec2
    b: wp.vec2
    weight: int
    visible: int  # 0: there is no such part


@wp.func
def seen_part(a: wp.vec3, b: wp.vec3, weight: float, nearest: float, farthest: float):
    """An edge with ends (U, V, Z), cut off at both ends of Z."""
    out = SeenEdge()
    from_z = a[2]
    to_z = b[2]
    low = wp.min(from_z, to_z)
    high = wp.max(from_z, to_z)
    out.visible = wp.where(high > nearest and low < farthest, 1, 0)
    p = a
    q = b
    if low < nearest or high > farthest:
        scale = 1.0 / wp.max(high - low, 1.0e-37)
        at_near = wp.clamp((nearest - from_z) * scale * wp.sign(to_z - from_z), 0.0, 1.0)
        at_far = wp.clamp((farthest - from_z) * scale * wp.sign(to_z - from_z), 0.0, 1.0)
        way = b - a
        if from_z < nearest:
            p = a + way * at_near
            p[2] = nearest
        elif from_z > farthest:
            p = a + way * at_far
            p[2] = farthest
        if to_z < nearest:
            q = a + way * at_near
            q[2] = nearest
        elif to_z > farthest:
            q = a + way * at_far
            q[2] = farthest
    # where nothing is visible, any numbers that are finite
    p_z = wp.max(p[2], nearest)
    q_z = wp.max(q[2], nearest)
    out.a = wp.vec2(p[0] / p_z, p[1] / p_z)
    out.b = wp.vec2(q[0] / q_z, q[1] / q_z)
    out.weight = int(weight)
    return out


@wp.func
def overlaps_square(edge: SeenEdge, half: float):
    """Whether the box of an edge reaches into the square from -half to half."""
    low = wp.min(edge.a, edge.b)
    high = wp.max(edge.a, edge.b)
    return edge.visible != 0 and wp.max(low[0], low[1]) < half and wp.min(high[0], high[1]) > -half


@wp.struct
class Crossing:
    """An edge as all samples test it, from its end with the lesser u at the border, else with the lesser v."""

    low_v: float
    high_v: float
    anchor_u: float  # an end of it, the nearer one to the middle of the light, where rounding is least
    anchor_v: float
    du: float
    dv: float
    step: int
    at_border: int


@wp.func
def crossing_of(edge: SeenEdge, border: float):
    """An edge against a square whose left border is at u = ``border``."""
    out = Crossing()
    a = edge.a
    b = edge.b
    step = edge.weight
    if (a[0] <= border) != (b[0] <= border):
        out.at_border = 1
        if b[0] <= border:
            a = edge.b
            b = edge.a
            step = -step
    else:
        step = -step
        if b[1] < a[1]:
            a = edge.b
            b = edge.a
            step = -step
    out.low_v = wp.min(a[1], b[1])
    out.high_v = wp.max(a[1], b[1])
    nearer = wp.where(wp.abs(a[0]) + wp.abs(a[1]) < wp.abs(b[0]) + wp.abs(b[1]), a, b)
    out.anchor_u = nearer[0]
    out.anchor_v = nearer[1]
    out.du = b[0] - a[0]
    out.dv = b[1] - a[1]
    out.step = step
    return out
