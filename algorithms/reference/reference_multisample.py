"""Soft shadows by rays to many points of the light: the ground truth of every soft method.

The light is sampled N times with a low-discrepancy set; visibility is the radiance-weighted share of the samples that
no caster hides (Heckbert and Herf 1997, by ray casting instead of maps; Schwaerzler 2009, section 4.1). Rays meet the
triangles themselves: no map, no bias. The reported standard error sqrt(psi (1 - psi) / (N - 1)) (Scherzer et al. 2009,
equation 3) is that of independent samples; with a low-discrepancy set the true error is 2 to 5 times smaller at smooth
edges.

On the CPU all rays of a receiver are cast at once, against the triangles that touch the pyramid from it to the light
(``wkernels/rays/shaft_rays.py``), or, if they are at most 8 and no texture cuts anything out, against those that they
pass near (``wkernels/rays/few_rays.py``), which decides alike but within rounding; on CUDA one after the other.

Deviation: pixels that can be *proven* wholly lit (no caster touches the shaft to the light) or wholly dark (one
triangle hides the light's convex hull, or the light is behind the surface) cast no further rays; the result is the same
with the proofs off. A light without area is asked once.
Known artefacts: N samples give N + 1 levels.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from algorithms.technique import Frame, Limit, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.device.lanes import uses_lanes
from wkernels.rays.few_rays import MOST_SAMPLES, runs_of_image, trace_few
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.rays.single_rays import PROVEN_DARK, PROVEN_LIT, binomial_standard_error, trace_light
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What needs no ray, or no more than one."""

    PROVEN = "rays to the light", "a proof settles the pixel"
    RAYS_ALIKE = "rays to the light from each pixel", Because.NO_AREA


class ReferenceMultisample(Technique):
    """N shadow rays a pixel, fewer where a proof settles it."""

    name = "reference_multisample"
    family = "reference"
    paper = ("heckbert1997", "schwaerzler2009", "scherzer2009tc")
    products = (Product.G_BUFFER, Product.LIGHT_SAMPLES, Product.CASTER_TREE)
    bias_sign = "none"
    may_leave_out = (Skip.PROVEN, Skip.RAYS_ALIKE)
    limits = (Limit(equals="ray_cast_point_shadow", params={"samples": 4}, light_scale=0.0),)

    class Params(BaseParams):
        """How many points of the light, and which."""

        samples: int = setting(
            256, "points on the light", unit="rays per pixel", source="Scherzer 2009, sec. 1", ge=1, le=10**6
        )
        start: int = setting(
            0, "first point of the set: later parts of it refine an image of the earlier ones", unit="points", ge=0
        )
        sample_set: Literal["halton", "r2", "poisson_disc", "stratified", "random"] = setting(
            "halton", "point set", unit="name"
        )

    def render(self, frame: Frame) -> wp.array:
        count = self.params.samples
        if (lit := frame.lit_without_casters(standard_error=0.0 if count > 1 else 1.0)) is not None:
            return lit
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        alike = count > 1 and not frame.light.has_area and frame.leave_out(Skip.RAYS_ALIKE, count=count - 1)
        samples = frame.light_samples(1 if alike else count, self.params.sample_set, self.params.start)
        proof = frame.buffer("proof", visibility.shape, wp.int32)
        error = frame.standard_error = frame.buffer("standard error", visibility.shape, wp.float32)
        proves = frame.may_leave_out(Skip.PROVEN)
        hull = frame.light_hull()
        rest = [hull, int(proves)]
        grid: tuple[int, ...] = visibility.shape
        if not uses_lanes(frame.device):
            kernel, inputs = trace_light, [gbuffer, frame.caster_mesh(), samples.points_ws, samples.weights, *rest]
        elif len(samples.host) <= MOST_SAMPLES and frame.geometry.scene.cut_caster is None:
            kernel, inputs = trace_few, [gbuffer, frame.caster_tree(), samples.few, *rest]
            grid = runs_of_image(visibility.shape)
        else:
            kernel, inputs = trace_shafts, [gbuffer, frame.caster_tree(), samples.batches, *rest]
        with frame.timed("shadow rays"):
            frame.launch(kernel, grid, inputs, [visibility, proof])
            frame.launch(binomial_standard_error, visibility.shape, [visibility, float(count)], [error])
        frame.count_later(Skip.PROVEN, lambda: int(np.isin(proof.numpy(), (PROVEN_LIT, PROVEN_DARK)).sum()))
        return visibility
