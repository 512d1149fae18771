"""Hard shadows by one ray per pixel: the exact answer that every hard method is scored against.

A ray from the receiver to the light's centre (or along the light's direction) asks the casters' triangles whether any
of them lies between (Schwaerzler 2009, section 2.2.3). There is no map and no bias; origins are lifted by their
rounding error only. Soft lights are reduced to their centre.

Known artefacts: none of its own; facets of smooth bodies shadow each other at the terminator, as their triangles do.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Frame, Technique
from wkernels.rays.single_rays import trace_point
from wkernels.workspace.products import Product


class RayCastPointShadow(Technique):
    """One shadow ray a pixel."""

    name = "ray_cast_point_shadow"
    family = "reference"
    paper = ("schwaerzler2009",)
    products = (Product.G_BUFFER, Product.RAY_STRUCTURE)
    hard = True
    bias_sign = "none"

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        casters = frame.caster_mesh()
        with frame.timed("shadow rays"):
            light_ws = wp.vec4(*frame.light.centre)
            frame.launch(trace_point, visibility.shape, [gbuffer, casters, light_ws, frame.reach], [visibility])
        return visibility
