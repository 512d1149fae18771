"""Receivers of a run of pixels in a light map: ``light_map.locate_receiver``, 16 at a time.

``docs/lanes.md`` says how such code is written. Lanes beyond the end of a row hold pixels of the next one, or
nothing of use at the image's end; they are not written.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, Vectors, flat_floats, runs_of
from wkernels.light_maps.layer_lanes import to_layers
from wkernels.light_maps.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, ROUNDING, Bias, LightMap
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES


@wp.struct
class LaneViews:
    """Views of a G-buffer and a light map, if there is one; they own no memory and must not outlive either."""

    width: int
    flags: wp.array(dtype=Ints)  # a run from every pixel on
    position_ws: wp.array(dtype=Vectors)  # a run from every component on
    normal_ws: wp.array(dtype=Vectors)
    depth: wp.array(dtype=float)  # of all layers, to be fetched from anywhere


@wp.struct
class ReceiverRun:
    """``Receiver`` of each lane. Lanes without a receiver hold zeros, but for a layer of -1 and their visibility."""

    count: int  # lanes with a receiver
    in_perspective: int  # lanes whose plane_scale is not 0: 0 in maps of directional lights
    visible: Floats  # 0 back-lit, else 1
    layer: Ints
    x: Floats
    y: Floats
    depth: Floats
    bias: Floats
    rise_x: Floats  # plane_depth
    rise_y: Floats
    rise: Floats
    scale_x: Floats  # plane_scale
    scale_y: Floats
    density_x: Floats  # texels_per_length
    density_y: Floats


def lane_views(gbuffer: GBuffer, light_map: LightMap | None = None) -> LaneViews:
    """Views of what lane kernels read, on the CPU."""
    out = LaneViews()
    out.width = gbuffer.flags.shape[1]
    out.flags = runs_of(gbuffer.flags, Ints, PADDING)
    out.position_ws = runs_of(gbuffer.position_ws, Vectors, 3 * PADDING)
    out.normal_ws = runs_of(gbuffer.normal_ws, Vectors, 3 * PADDING)
    if light_map is not None:
        out.depth = flat_floats(light_map.depth)
    return out


def in_lane_views(gbuffer: GBuffer, light_map: LightMap, *others: object) -> list:
    """The inputs of a lane kernel whose twin's begin with a G-buffer and a light map (``Twin.inputs``)."""
    return [lane_views(gbuffer, light_map), light_map, *others]


@wp.func
def is_read(layers: Ints, layer: int):
    """Whether any lane is on a layer; neighbours mostly share theirs."""
    count = int(0)
    for k in range(LANES):
        count += wp.where(layers[k] == layer, 1, 0)
    return count > 0


@wp.func
def locate_run(views: LaneViews, light_map: LightMap, bias: Bias, x0: int, y: int):
    """The receivers of pixels x0, x0 + 1, ... of row y, as ``locate_receiver`` finds them for a plain kernel."""
    begin = y * views.width + x0
    flags = views.flags[begin]
    position_ws = views.position_ws[3 * begin]
    normal_ws = views.normal_ws[3 * begin]
    light = light_map.light_ws
    light_x, light_y, light_z, light_w = light[0], light[1], light[2], light[3]
    px = Floats(0.0)
    py = Floats(0.0)
    pz = Floats(0.0)
    nx = Floats(0.0)
    ny = Floats(0.0)
    nz = Floats(0.0)
    wanted = Ints(0)
    visible = Floats(0.0)
    for k in range(LANES):
        flag = flags[k]
        x_ws = position_ws[3 * k]
        y_ws = position_ws[3 * k + 1]
        z_ws = position_ws[3 * k + 2]
        n_x = normal_ws[3 * k]
        n_y = normal_ws[3 * k + 1]
        n_z = normal_ws[3 * k + 2]
        facing = n_x * (light_x - x_ws * light_w) + n_y * (light_y - y_ws * light_w) + n_z * (light_z - z_ws * light_w)
        receives = wp.where((flag & RECEIVES) != 0, 1, 0)
        back_lit = wp.where((flag & CASTS) != 0, wp.where(facing <= 0.0, receives, 0), 0)
        px[k] = x_ws
        py[k] = y_ws
        pz[k] = z_ws
        nx[k] = n_x
        ny[k] = n_y
        nz[k] = n_z
        wanted[k] = receives - back_lit
        visible[k] = float(1 - back_lit)

    run = ReceiverRun()
    run.visible = visible
    layers = to_layers(light_map, wanted, px, py, pz)
    run.layer = layers
    count = int(0)
    for k in range(LANES):
        count += wp.where(layers[k] >= 0, 1, 0)
    run.count = count
    if count == 0:
        return run

    density_x = Floats(0.0)
    density_y = Floats(0.0)
    resolution = float(light_map.resolution)
    for layer in range(light_map.layers):
        if light_map.layers > 1 and not is_read(layers, layer):
            continue
        m = light_map.ws_to_ls[layer]
        m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
        m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
        m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
        right = light_map.right_ws[layer]
        up = light_map.up_ws[layer]
        right_x = wp.dot(wp.vec3(m00, m01, m02), right)
        right_w = wp.dot(wp.vec3(m30, m31, m32), right)
        up_y = wp.dot(wp.vec3(m10, m11, m12), up)
        up_w = wp.dot(wp.vec3(m30, m31, m32), up)
        for k in range(LANES):
            x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
            y_ls = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
            w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
            half = 0.5 * resolution / w
            across = half * wp.abs(right_x - right_w * x / w)
            down = half * wp.abs(up_y - up_w * y_ls / w)
            density_x[k] = wp.where(layers[k] == layer, across, density_x[k])
            density_y[k] = wp.where(layers[k] == layer, down, density_y[k])
    run.density_x = density_x
    run.density_y = density_y

    if bias.kind == BIAS_NORMAL:
        qx = Floats(0.0)
        qy = Floats(0.0)
        qz = Floats(0.0)
        constant = bias.constant
        for k in range(LANES):
            lift = constant * (1.0 / wp.max(wp.min(density_x[k], density_y[k]), 1.0e-30))
            qx[k] = px[k] + nx[k] * lift
            qy[k] = py[k] + ny[k] * lift
            qz[k] = pz[k] + nz[k] * lift
        moved = to_layers(light_map, wanted, qx, qy, qz)
        for k in range(LANES):
            px[k] = wp.where(moved[k] == layers[k], qx[k], px[k])
            py[k] = wp.where(moved[k] == layers[k], qy[k], py[k])
            pz[k] = wp.where(moved[k] == layers[k], qz[k], pz[k])

    xs = Floats(0.0)
    ys = Floats(0.0)
    rise = Floats(0.0)
    rise_x = Floats(0.0)
    rise_y = Floats(0.0)
    scale_x = Floats(0.0)
    scale_y = Floats(0.0)
    for layer in range(light_map.layers):
        if light_map.layers > 1 and not is_read(layers, layer):
            continue
        m = light_map.ws_to_ls[layer]
        m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
        m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
        m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
        m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
        for k in range(LANES):
            x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
            y_ls = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
            z = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
            w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
            xs[k] = wp.where(layers[k] == layer, (0.5 + 0.5 * x / w) * resolution, xs[k])
            ys[k] = wp.where(layers[k] == layer, (0.5 - 0.5 * y_ls / w) * resolution, ys[k])
            rise[k] = wp.where(layers[k] == layer, z, rise[k])
        if bias.kind == BIAS_SLOPE:
            for k in range(LANES):
                # ``plane_of_receiver``, whose helper axis makes one entry of the cross product 0
                steep = wp.abs(nx[k]) > 0.6
                c_x = wp.where(steep, nz[k], 0.0)
                c_y = wp.where(steep, 0.0, -nz[k])
                c_z = wp.where(steep, -nx[k], ny[k])
                length = wp.sqrt(c_x * c_x + c_y * c_y + c_z * c_z)
                e_x = c_x / length
                e_y = c_y / length
                e_z = c_z / length
                f_x = ny[k] * e_z - nz[k] * e_y
                f_y = nz[k] * e_x - nx[k] * e_z
                f_z = nx[k] * e_y - ny[k] * e_x
                w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
                x = (m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03) / w
                y_ls = (m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13) / w
                z = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
                z1 = m20 * e_x + m21 * e_y + m22 * e_z
                z2 = m20 * f_x + m21 * f_y + m22 * f_z
                w1 = m30 * e_x + m31 * e_y + m32 * e_z
                w2 = m30 * f_x + m31 * f_y + m32 * f_z
                d1_x = m00 * e_x + m01 * e_y + m02 * e_z - x * w1
                d1_y = m10 * e_x + m11 * e_y + m12 * e_z - y_ls * w1
                d2_x = m00 * f_x + m01 * f_y + m02 * f_z - x * w2
                d2_y = m10 * f_x + m11 * f_y + m12 * f_z - y_ls * w2
                det = d1_x * d2_y - d1_y * d2_x
                size = wp.sqrt(d1_x * d1_x + d1_y * d1_y) * wp.sqrt(d2_x * d2_x + d2_y * d2_y)
                step = 2.0 / (resolution * det)
                sx = -(d2_y * step * w1 - d1_y * step * w2)
                sy = -(d2_x * step * w1 - d1_x * step * w2)
                rx = (d2_y * step * z1 - d1_y * step * z2) * w + sx * z
                ry = (d2_x * step * z1 - d1_x * step * z2) * w + sy * z
                here = wp.where(wp.abs(det) > 1.0e-5 * size, layers[k], -1)
                rise_x[k] = wp.where(here == layer, rx, rise_x[k])
                rise_y[k] = wp.where(here == layer, ry, rise_y[k])
                scale_x[k] = wp.where(here == layer, sx, scale_x[k])
                scale_y[k] = wp.where(here == layer, sy, scale_y[k])
    run.x = xs
    run.y = ys
    run.rise = rise
    run.rise_x = rise_x
    run.rise_y = rise_y
    run.scale_x = scale_x
    run.scale_y = scale_y

    biases = Floats(0.0)
    depths = Floats(0.0)
    rounding = wp.where(bias.kind == BIAS_NONE, 0.0, ROUNDING)
    per_footprint = wp.where(bias.kind == BIAS_CONSTANT, bias.constant, 0.0)
    per_slope = wp.where(bias.kind == BIAS_SLOPE, bias.slope * 0.5, 0.0)
    in_perspective = int(0)
    for k in range(LANES):
        in_perspective += wp.where(scale_x[k] != 0.0, 1, wp.where(scale_y[k] != 0.0, 1, 0))
    run.in_perspective = in_perspective
    for k in range(LANES):
        slope = wp.abs(rise_x[k] - rise[k] * scale_x[k]) + wp.abs(rise_y[k] - rise[k] * scale_y[k])
        footprint = 1.0 / wp.max(wp.min(density_x[k], density_y[k]), 1.0e-30)
        biases[k] = rounding * rise[k] + per_footprint * footprint + per_slope * slope
        depths[k] = rise[k] - biases[k]
    run.bias = biases
    run.depth = depths
    return run
