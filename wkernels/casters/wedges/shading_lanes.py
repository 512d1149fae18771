"""``shading.shade`` of runs of 16 pixels; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.coverage import beyond_in_disc, beyond_in_square, enters, enters_disc, leaves, leaves_disc
from wkernels.casters.wedges.light_shapes import DISC, SQUARE, LightShape, see_light
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.recounting import blur_of, passes_centre
from wkernels.casters.wedges.shading import UNTRUSTED, lit_share, shade
from wkernels.device.lanes import LANES, Floats, Ints, runs_of, store_run
from wkernels.device.twin import Twin
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.scene.geometry import RECEIVES


@wp.struct
class SightRun:
    """``Sight`` and ``blur_of`` of each lane; lanes without a receiver see a light of depth 0, which nothing hides."""

    count: int  # lanes with a receiver
    u_x: Floats
    u_y: Floats
    u_z: Floats
    v_x: Floats
    v_y: Floats
    v_z: Floats
    w_x: Floats
    w_y: Floats
    w_z: Floats
    o_u: Floats
    o_v: Floats
    o_w: Floats
    depth: Floats
    nearest: Floats
    blur: Floats


@wp.func
def see_light_run(gbuffer: GBuffer, light: LightShape, flags: Ints, x0: int, y: int):
    """How the pixels x0, x0 + 1, ... of row y see the light."""
    out = SightRun()
    for k in range(wp.min(LANES, gbuffer.depth.shape[1] - x0)):
        if (flags[k] & RECEIVES) != 0:
            position_ws = gbuffer.position_ws[y, x0 + k]
            sight = see_light(light, position_ws)
            out.count += 1
            out.u_x[k] = sight.row_u[0]
            out.u_y[k] = sight.row_u[1]
            out.u_z[k] = sight.row_u[2]
            out.v_x[k] = sight.row_v[0]
            out.v_y[k] = sight.row_v[1]
            out.v_z[k] = sight.row_v[2]
            out.w_x[k] = sight.row_w[0]
            out.w_y[k] = sight.row_w[1]
            out.w_z[k] = sight.row_w[2]
            out.o_u[k] = sight.offset[0]
            out.o_v[k] = sight.offset[1]
            out.o_w[k] = sight.offset[2]
            out.depth[k] = sight.depth
            out.nearest[k] = sight.nearest
            out.blur[k] = blur_of(gbuffer.view, sight, gbuffer.depth[y, x0 + k], position_ws)
    return out


@wp.kernel
def shade_lanes(
    first: int,
    gbuffer: GBuffer,
    flags: wp.array(dtype=Ints),  # a run from every pixel on
    light: LightShape,
    edges: WedgeEdges,
    near: NearLists,
    counts: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """``shade`` of a run of pixels."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    tile = tile_at(near.lists, y, x0)
    begin = near.lists.begin[tile]
    end = near.end[tile]
    flag = flags[y * visibility_out.shape[1] + x0]
    sights = SightRun()
    if begin < end:
        sights = see_light_run(gbuffer, light, flag, x0, y)
    # members of a struct are not kept in registers
    u_x = sights.u_x
    u_y = sights.u_y
    u_z = sights.u_z
    v_x = sights.v_x
    v_y = sights.v_y
    v_z = sights.v_z
    w_x = sights.w_x
    w_y = sights.w_y
    w_z = sights.w_z
    o_u = sights.o_u
    o_v = sights.o_v
    o_w = sights.o_w
    depth = sights.depth
    nearest = sights.nearest
    blur = sights.blur
    total = Floats(0.0)
    untrusted = Ints(0)
    u0 = Floats(0.0)
    v0 = Floats(0.0)
    w0 = Floats(0.0)
    u1 = Floats(0.0)
    v1 = Floats(0.0)
    w1 = Floats(0.0)
    low = Floats(0.0)
    high = Floats(0.0)
    if sights.count == 0:
        end = begin
    for i in range(begin, end):
        e = near.lists.shape[i]
        a = edges.ends[2 * e]
        b = edges.ends[2 * e + 1]
        a_x, a_y, a_z = a[0], a[1], a[2]
        b_x, b_y, b_z = b[0], b[1], b[2]
        weight = edges.weight[e]
        hit = int(0)
        for k in range(LANES):
            p = u_x[k] * a_x + u_y[k] * a_y + u_z[k] * a_z + o_u[k]
            q = v_x[k] * a_x + v_y[k] * a_y + v_z[k] * a_z + o_v[k]
            r = w_x[k] * a_x + w_y[k] * a_y + w_z[k] * a_z + o_w[k]
            s = u_x[k] * b_x + u_y[k] * b_y + u_z[k] * b_z + o_u[k]
            t = v_x[k] * b_x + v_y[k] * b_y + v_z[k] * b_z + o_v[k]
            o = w_x[k] * b_x + w_y[k] * b_y + w_z[k] * b_z + o_w[k]
            # beyond one side of the square around the light, or not between receiver and light: no share
            beside = wp.where(p > r, wp.where(s > o, 1, 0), 0) | wp.where(-p > r, wp.where(-s > o, 1, 0), 0)
            beside = beside | wp.where(q > r, wp.where(t > o, 1, 0), 0)
            beside = beside | wp.where(-q > r, wp.where(-t > o, 1, 0), 0)
            beside = beside | wp.where(wp.max(r, o) <= nearest[k], 1, 0)
            beside = beside | wp.where(wp.min(r, o) >= depth[k], 1, 0)
            hit += 1 - beside
            u0[k] = p
            v0[k] = q
            w0[k] = r
            u1[k] = s
            v1[k] = t
            w1[k] = o
        if hit == 0:
            continue
        for k in range(LANES):
            least = nearest[k]
            far = depth[k]
            from_ = enters(0.0, w0[k] - least, w1[k] - least)
            to = leaves(1.0, w0[k] - least, w1[k] - least)
            low[k] = enters(from_, far - w0[k], far - w1[k])
            high[k] = leaves(to, far - w0[k], far - w1[k])
        if light.shape == SQUARE:
            for k in range(LANES):
                from_ = enters(enters(low[k], w0[k] - u0[k], w1[k] - u1[k]), w0[k] + u0[k], w1[k] + u1[k])
                low[k] = enters(enters(from_, w0[k] - v0[k], w1[k] - v1[k]), w0[k] + v0[k], w1[k] + v1[k])
                to = leaves(leaves(high[k], w0[k] - u0[k], w1[k] - u1[k]), w0[k] + u0[k], w1[k] + u1[k])
                high[k] = leaves(leaves(to, w0[k] - v0[k], w1[k] - v1[k]), w0[k] + v0[k], w1[k] + v1[k])
        else:
            for k in range(LANES):
                d_u = u1[k] - u0[k]
                d_v = v1[k] - v0[k]
                d_w = w1[k] - w0[k]
                l_u = v0[k] * w1[k] - w0[k] * v1[k]
                l_v = w0[k] * u1[k] - u0[k] * w1[k]
                l_w = u0[k] * v1[k] - v0[k] * u1[k]
                c_a = d_u * d_u + d_v * d_v - d_w * d_w
                c_b = u0[k] * d_u + v0[k] * d_v - w0[k] * d_w
                c_c = u0[k] * u0[k] + v0[k] * v0[k] - w0[k] * w0[k]
                c_d = l_u * l_u + l_v * l_v - l_w * l_w
                low[k] = wp.max(low[k], enters_disc(c_a, c_b, c_c, c_d, d_w))
                high[k] = wp.min(high[k], leaves_disc(c_a, c_b, c_c, c_d, d_w))
        for k in range(LANES):
            from_ = low[k]
            to = high[k]
            some = from_ < to
            from_ = wp.where(some, from_, 0.0)
            to = wp.where(some, to, 0.0)
            f_w = w0[k] + from_ * (w1[k] - w0[k])
            t_w = w0[k] + to * (w1[k] - w0[k])
            f_x = (u0[k] + from_ * (u1[k] - u0[k])) / f_w
            f_y = (v0[k] + from_ * (v1[k] - v0[k])) / f_w
            t_x = (u0[k] + to * (u1[k] - u0[k])) / t_w
            t_y = (v0[k] + to * (v1[k] - v0[k])) / t_w
            in_square = beyond_in_square(f_x, f_y, t_x, t_y)
            in_disc = beyond_in_disc(f_x, f_y, t_x, t_y)
            share = wp.where(light.shape == DISC, in_disc, in_square)
            total[k] = total[k] + wp.where(some, weight * share, 0.0)
            close = passes_centre(f_x, f_y, t_x, t_y, wp.min(f_w, t_w), blur[k])
            untrusted[k] = untrusted[k] + wp.where(some, close, 0)
    visible = Floats(1.0)
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        if (flag[k] & RECEIVES) != 0:
            sight = see_light(light, gbuffer.position_ws[y, x0 + k])
            whole = 1.0 - float(counts[y, x0 + k]) + sight.turn * total[k]
            visible[k] = lit_share(light, sight, gbuffer, y, x0 + k, whole)
            if untrusted[k] > 0:
                visible[k] = UNTRUSTED
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, *others: object) -> list:
    return [gbuffer, runs_of(gbuffer.flags, Ints, PADDING), *others]


SHADE = Twin(shade, shade_lanes, inputs=_in_lanes, tolerance=2e-5, flips=1e-3)
