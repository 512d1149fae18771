"""Which boxes and triangles of a ``CasterTree`` touch the pyramid from a receiver to a light, eight at a time."""

from __future__ import annotations

import warp as wp

from wkernels.rays.caster_tree import CasterTree, Eight
from wkernels.rays.light_proofs import SHAFT_SLACK, Shaft, ShaftFrame


@wp.func
def reach_of_children(tree: CasterTree, at: int, origin: wp.vec3, shaft: Shaft, own_side: wp.vec3):
    """How far each child of a node reaches into the shaft and before the receiver's plane; negative: not at all."""
    low_xs = tree.low_x[at]
    low_ys = tree.low_y[at]
    low_zs = tree.low_z[at]
    high_xs = tree.high_x[at]
    high_ys = tree.high_y[at]
    high_zs = tree.high_z[at]
    o_x, o_y, o_z = origin[0], origin[1], origin[2]
    l_x, l_y, l_z = shaft.left[0], shaft.left[1], shaft.left[2]
    r_x, r_y, r_z = shaft.right[0], shaft.right[1], shaft.right[2]
    b_x, b_y, b_z = shaft.bottom[0], shaft.bottom[1], shaft.bottom[2]
    t_x, t_y, t_z = shaft.top[0], shaft.top[1], shaft.top[2]
    n_x, n_y, n_z = own_side[0], own_side[1], own_side[2]
    out = Eight()
    for k in range(8):
        x0 = low_xs[k] - o_x
        y0 = low_ys[k] - o_y
        z0 = low_zs[k] - o_z
        x1 = high_xs[k] - o_x
        y1 = high_ys[k] - o_y
        z1 = high_zs[k] - o_z
        left = wp.max(x0 * l_x, x1 * l_x) + wp.max(y0 * l_y, y1 * l_y) + wp.max(z0 * l_z, z1 * l_z)
        right = wp.max(x0 * r_x, x1 * r_x) + wp.max(y0 * r_y, y1 * r_y) + wp.max(z0 * r_z, z1 * r_z)
        bottom = wp.max(x0 * b_x, x1 * b_x) + wp.max(y0 * b_y, y1 * b_y) + wp.max(z0 * b_z, z1 * b_z)
        top = wp.max(x0 * t_x, x1 * t_x) + wp.max(y0 * t_y, y1 * t_y) + wp.max(z0 * t_z, z1 * t_z)
        own = wp.max(x0 * n_x, x1 * n_x) + wp.max(y0 * n_y, y1 * n_y) + wp.max(z0 * n_z, z1 * n_z)
        out[k] = wp.min(wp.min(wp.min(left, right), wp.min(bottom, top)), own)
    return out


@wp.struct
class LeafView:
    """A leaf's triangles in the frame of a shaft: along u, along v and along the axis, from the receiver."""

    a_u: Eight
    a_v: Eight
    a_d: Eight
    b_u: Eight
    b_v: Eight
    b_d: Eight
    c_u: Eight
    c_v: Eight
    c_d: Eight
    above: Eight  # highest corner above the receiver's plane


@wp.func
def view_leaf(tree: CasterTree, leaf: int, origin: wp.vec3, frame: ShaftFrame, normal: wp.vec3):
    """The triangles of a leaf as ``LeafView``."""
    a_xs = tree.triangle[leaf, 0]
    a_ys = tree.triangle[leaf, 1]
    a_zs = tree.triangle[leaf, 2]
    b_xs = tree.triangle[leaf, 3]
    b_ys = tree.triangle[leaf, 4]
    b_zs = tree.triangle[leaf, 5]
    c_xs = tree.triangle[leaf, 6]
    c_ys = tree.triangle[leaf, 7]
    c_zs = tree.triangle[leaf, 8]
    o_x, o_y, o_z = origin[0], origin[1], origin[2]
    u_x, u_y, u_z = frame.u[0], frame.u[1], frame.u[2]
    v_x, v_y, v_z = frame.v[0], frame.v[1], frame.v[2]
    d_x, d_y, d_z = frame.axis[0], frame.axis[1], frame.axis[2]
    n_x, n_y, n_z = normal[0], normal[1], normal[2]
    a_u = Eight()
    a_v = Eight()
    a_d = Eight()
    b_u = Eight()
    b_v = Eight()
    b_d = Eight()
    c_u = Eight()
    c_v = Eight()
    c_d = Eight()
    above = Eight()
    for k in range(8):
        x0 = a_xs[k] - o_x
        y0 = a_ys[k] - o_y
        z0 = a_zs[k] - o_z
        x1 = b_xs[k] - o_x
        y1 = b_ys[k] - o_y
        z1 = b_zs[k] - o_z
        x2 = c_xs[k] - o_x
        y2 = c_ys[k] - o_y
        z2 = c_zs[k] - o_z
        a_u[k] = x0 * u_x + y0 * u_y + z0 * u_z
        a_v[k] = x0 * v_x + y0 * v_y + z0 * v_z
        a_d[k] = x0 * d_x + y0 * d_y + z0 * d_z
        b_u[k] = x1 * u_x + y1 * u_y + z1 * u_z
        b_v[k] = x1 * v_x + y1 * v_y + z1 * v_z
        b_d[k] = x1 * d_x + y1 * d_y + z1 * d_z
        c_u[k] = x2 * u_x + y2 * u_y + z2 * u_z
        c_v[k] = x2 * v_x + y2 * v_y + z2 * v_z
        c_d[k] = x2 * d_x + y2 * d_y + z2 * d_z
        above[k] = wp.max(
            x0 * n_x + y0 * n_y + z0 * n_z,
            wp.max(x1 * n_x + y1 * n_y + z1 * n_z, x2 * n_x + y2 * n_y + z2 * n_z),
        )
    out = LeafView()
    out.a_u = a_u
    out.a_v = a_v
    out.a_d = a_d
    out.b_u = b_u
    out.b_v = b_v
    out.b_d = b_d
    out.c_u = c_u
    out.c_v = c_v
    out.c_d = c_d
    out.above = above
    return out


@wp.func
def reach_of_triangles(leaf: LeafView, slopes: wp.vec4, narrow: int):
    """How far each triangle reaches into the shaft of some slopes (low u, high u, low v, high v); negative: not."""
    if narrow == 0:  # no slopes hold the light
        return Eight(1.0e30)
    low_u, high_u, low_v, high_v = slopes[0], slopes[1], slopes[2], slopes[3]
    out = Eight()
    a_u = leaf.a_u
    a_v = leaf.a_v
    a_d = leaf.a_d
    b_u = leaf.b_u
    b_v = leaf.b_v
    b_d = leaf.b_d
    c_u = leaf.c_u
    c_v = leaf.c_v
    c_d = leaf.c_d
    for k in range(8):
        left = wp.max(wp.max(a_u[k] - low_u * a_d[k], b_u[k] - low_u * b_d[k]), c_u[k] - low_u * c_d[k])
        right = wp.max(wp.max(high_u * a_d[k] - a_u[k], high_u * b_d[k] - b_u[k]), high_u * c_d[k] - c_u[k])
        bottom = wp.max(wp.max(a_v[k] - low_v * a_d[k], b_v[k] - low_v * b_d[k]), c_v[k] - low_v * c_d[k])
        top = wp.max(wp.max(high_v * a_d[k] - a_v[k], high_v * b_d[k] - b_v[k]), high_v * c_d[k] - c_v[k])
        out[k] = wp.min(wp.min(left, right), wp.min(bottom, top))
    return out


@wp.func
def slopes_of_group(low: wp.vec3, high: wp.vec3, from_ws: wp.vec3, frame: ShaftFrame):
    """Slopes that hold the ways to all samples within a box, no wider than the frame's."""
    low_u = float(wp.inf)
    low_v = float(wp.inf)
    high_u = float(-wp.inf)
    high_v = float(-wp.inf)
    for i in range(8):
        corner = wp.vec3(
            wp.where((i & 1) != 0, high[0], low[0]),
            wp.where((i & 2) != 0, high[1], low[1]),
            wp.where((i & 4) != 0, high[2], low[2]),
        )
        way = corner - from_ws
        depth = wp.dot(way, frame.axis)
        if depth <= 0.0:  # a loose box around samples beside the receiver
            return wp.vec4(frame.low_u, frame.high_u, frame.low_v, frame.high_v)
        low_u = wp.min(low_u, wp.dot(way, frame.u) / depth)
        high_u = wp.max(high_u, wp.dot(way, frame.u) / depth)
        low_v = wp.min(low_v, wp.dot(way, frame.v) / depth)
        high_v = wp.max(high_v, wp.dot(way, frame.v) / depth)
    return wp.vec4(
        wp.max(low_u - SHAFT_SLACK, frame.low_u),
        wp.min(high_u + SHAFT_SLACK, frame.high_u),
        wp.max(low_v - SHAFT_SLACK, frame.low_v),
        wp.min(high_v + SHAFT_SLACK, frame.high_v),
    )
