"""A technique that conforms, by rays: the healthy patient that ``broken.py`` makes ill, one fault at a time.

Soft shadows by N rays per pixel (Heckbert and Herf 1997), with no shortcut at all.
Known artefacts: N rays give N + 1 levels.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Limit, Params, Technique, setting
from wkernels.frame.session import Session as Frame
from wkernels.rays.single_rays import binomial_standard_error, trace_light
from wkernels.workspace.products import Product


class Honest(Technique):
    """N shadow rays a pixel."""

    name = "honest"
    family = "reference"
    paper = ("heckbert1997",)
    products = (Product.G_BUFFER, Product.LIGHT_SAMPLES, Product.RAY_STRUCTURE)
    bias_sign = "none"
    limits = (Limit(equals="ray_cast_point_shadow", light_scale=0.0),)

    class Params(Params):
        """How many rays."""

        samples: int = setting(64, "points on the light", unit="rays per pixel", ge=1, le=1024)

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        samples = frame.light_samples(self.params.samples)
        proof = frame.buffer("proof", visibility.shape, wp.int32)
        error = frame.standard_error = frame.buffer("error", visibility.shape, wp.float32)
        inputs = [gbuffer, frame.caster_mesh(), samples.points_ws, samples.weights, frame.light_hull(), 0]
        frame.launch(trace_light, visibility.shape, inputs, [visibility, proof])
        frame.launch(binomial_standard_error, visibility.shape, [visibility, float(self.params.samples)], [error])
        return visibility
