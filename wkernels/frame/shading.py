"""Diffuse shading of a G-buffer, for people to look at; no number is measured on it."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, Vectors, flat_floats, runs_of
from wkernels.device.launch import launch
from wkernels.device.twin import Twin
from wkernels.raster.gbuffer import PADDING, GBuffer, to_light
from wkernels.scene.lights import Light

AMBIENT = 0.25  # share of the light's colour that reaches every surface
SKY = wp.constant(wp.vec3(0.62, 0.72, 0.84))


@wp.kernel
def shade_diffuse(
    first: int,
    gbuffer: GBuffer,
    mesh_diffuse: wp.array(dtype=wp.vec3),
    light_ws: wp.vec4,
    light_color: wp.vec3,
    ambient: float,
    visibility: wp.array2d(dtype=float),
    color_out: wp.array2d(dtype=wp.vec3),
):
    """diffuse * (visibility * N.L + ambient) * light colour."""
    row, x = wp.tid()
    y = first + row
    mesh = gbuffer.mesh[y, x]
    color = SKY
    if mesh >= 0:
        way = wp.normalize(to_light(light_ws, gbuffer.position_ws[y, x]))
        facing = wp.max(wp.dot(gbuffer.normal_ws[y, x], way), 0.0)
        # a little of the view direction in the ambient term keeps shadowed shapes readable
        sky = 0.5 + 0.5 * gbuffer.normal_ws[y, x][1]
        light = (1.0 - ambient) * facing * visibility[y, x] + ambient * (0.6 + 0.4 * sky)
        color = wp.cw_mul(mesh_diffuse[mesh], light_color) * light
    color_out[y, x] = color


@wp.kernel
def shade_diffuse_lanes(
    first: int,
    position_ws: wp.array(dtype=Vectors),  # a run from every component on
    normal_ws: wp.array(dtype=Vectors),
    mesh: wp.array(dtype=Ints),
    mesh_diffuse: wp.array(dtype=float),  # flat (3 M,)
    light_ws: wp.vec4,
    light_color: wp.vec3,
    ambient: float,
    visibility: wp.array2d(dtype=float),
    color_out: wp.array2d(dtype=wp.vec3),
):
    """``shade_diffuse`` of a run of pixels."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    begin = y * visibility.shape[1] + x0
    held = wp.min(LANES, visibility.shape[1] - x0)
    positions = position_ws[3 * begin]
    normals = normal_ws[3 * begin]
    meshes = mesh[begin]
    l_x, l_y, l_z, l_w = light_ws[0], light_ws[1], light_ws[2], light_ws[3]
    c_x, c_y, c_z = light_color[0], light_color[1], light_color[2]
    lit = Floats(0.0)
    red = Floats(0.0)
    green = Floats(0.0)
    blue = Floats(0.0)
    for k in range(held):
        lit[k] = visibility[y, x0 + k]
    for k in range(LANES):
        to_x = l_x - positions[3 * k] * l_w
        to_y = l_y - positions[3 * k + 1] * l_w
        to_z = l_z - positions[3 * k + 2] * l_w
        length = wp.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
        toward = normals[3 * k] * to_x + normals[3 * k + 1] * to_y + normals[3 * k + 2] * to_z
        facing = wp.max(toward / wp.where(length > 0.0, length, 1.0), 0.0)
        sky = 0.5 + 0.5 * normals[3 * k + 1]
        light = (1.0 - ambient) * facing * lit[k] + ambient * (0.6 + 0.4 * sky)
        at = 3 * wp.max(meshes[k], 0)
        seen = meshes[k] >= 0
        red[k] = wp.where(seen, mesh_diffuse[at] * c_x * light, SKY[0])
        green[k] = wp.where(seen, mesh_diffuse[at + 1] * c_y * light, SKY[1])
        blue[k] = wp.where(seen, mesh_diffuse[at + 2] * c_z * light, SKY[2])
    for k in range(held):
        color_out[y, x0 + k] = wp.vec3(red[k], green[k], blue[k])


def _in_lanes(gbuffer: GBuffer, mesh_diffuse: wp.array, *others: object) -> list:
    images = [runs_of(image, Vectors, 3 * PADDING) for image in (gbuffer.position_ws, gbuffer.normal_ws)]
    return [*images, runs_of(gbuffer.mesh, Ints, PADDING), flat_floats(mesh_diffuse), *others]


SHADE = Twin(
    shade_diffuse,
    shade_diffuse_lanes,
    inputs=_in_lanes,
    fits=lambda gbuffer, mesh_diffuse, *others: mesh_diffuse.size > 0,
    tolerance=2e-6,
)


def shade(
    gbuffer: GBuffer,
    mesh_diffuse: wp.array,
    light: Light,
    visibility: wp.array,
    color_out: wp.array,
    device: str,
    threads: int | None,
) -> None:
    """Fills ``color_out`` (H, W) with linear RGB; the light's colour is scaled to a brightest channel of 1."""
    radiance = np.asarray(light.radiance, dtype=float)
    tint = radiance / max(float(radiance.max()), 1e-12)
    inputs = [gbuffer, mesh_diffuse, wp.vec4(*light.centre), wp.vec3(*tint), AMBIENT, visibility]
    launch(SHADE, gbuffer.depth.shape, inputs, [color_out], device=device, threads=threads)
