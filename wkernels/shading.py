"""Diffuse shading of a G-buffer, for people to look at; no number is measured on it."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.gbuffer import GBuffer
from wkernels.launch import launch
from wkernels.light_map import to_light
from wkernels.lights import Light

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
    launch(shade_diffuse, gbuffer.depth.shape, inputs, [color_out], device=device, threads=threads)
