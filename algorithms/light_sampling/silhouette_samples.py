"""Exact visibility of N light samples from the silhouette edges before them, with at most three rays a pixel.

Edges of the casters that no point of the light sees as a silhouette are dropped once for a light; of the others, those
near a receiver's way to the light say by how much the casters' depth complexity differs between samples. Of samples
with the least, one ray decides: all of them are lit, or none; all others are hidden (Laine, Aila, Assarsson, Lehtinen
and Akenine-Moeller 2005). Samples and answers are those of ``reference_multisample``, but for samples that lie on an
edge within rounding: about one of a million. The reported standard error is that of independent samples (Scherzer et
al. 2009, equation 3).

Deviations: edges are found in a tree of boxes for clusters of receivers instead of a hemicube of the light's; samples
lie anywhere on the light, and complexity is counted along a path that all of them share (``wkernels/edge_rays``), so
that there are no lookup tables and every light with an area will do. An edge weighs what its faces say, whatever their
orientation, so that open, branching and flipped surfaces are exact. Triangles that reach into the light are tested one
by one; with more than 64 of them, and from receivers that see the light too flat or from too near, every sample gets
its ray. Two further rays a pixel check the first. A light without area is asked once; on CUDA rays go one by one.
Known artefacts: N samples give N + 1 levels.
"""

from __future__ import annotations

from typing import Literal

import warp as wp

from algorithms.technique import Frame, Limit, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.device.lanes import uses_lanes
from wkernels.edge_rays.potential import pull_edge_set
from wkernels.edge_rays.tracing import trace_silhouettes
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.rays.single_rays import binomial_standard_error, trace_light
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What one ray stands for, and where every sample needs its own."""

    RAYS_ALIKE = "rays to the light from each pixel", Because.NO_AREA
    EDGES = "silhouette edges", "a texture cuts a caster out, and every sample gets its ray"
    UNSURE = "silhouette edges of receivers", "rays disagree with them, or they cannot be projected"


class SilhouetteSamples(Technique):
    """Silhouette edges and a ray or three."""

    name = "silhouette_samples"
    family = "light_sampling"
    paper = ("laine2005", "scherzer2009tc")
    products = (
        Product.G_BUFFER,
        Product.LIGHT_SAMPLES,
        Product.CASTER_EDGES,
        Product.CASTER_TREE,
        Product.RAY_STRUCTURE,
    )
    bias_sign = "none"
    may_leave_out = (Skip.RAYS_ALIKE, Skip.EDGES, Skip.UNSURE)
    limits = (
        Limit(equals="ray_cast_point_shadow", params={"samples": 4}, light_scale=0.0),
        Limit(
            equals="reference_multisample",
            params={"samples": 64},
            other_params={"samples": 64},
            tolerance=1e-6,
            flips=1e-3,
        ),
    )

    class Params(BaseParams):
        """How many points of the light, and which."""

        samples: int = setting(
            64, "points on the light", unit="samples per pixel", source="Laine 2005, sec. 4", ge=1, le=10**6
        )
        sample_set: Literal["halton", "r2", "poisson_disc", "stratified", "random"] = setting(
            "halton", "point set on the light", unit="name", source="Scherzer 2009, sec. 4"
        )

    def render(self, frame: Frame) -> wp.array:
        count = self.params.samples
        if (lit := frame.lit_without_casters(standard_error=0.0 if count > 1 else 1.0)) is not None:
            return lit
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        error = frame.standard_error = frame.buffer("standard error", visibility.shape, wp.float32)
        has_area = frame.light.has_area
        alike = count > 1 and not has_area and frame.leave_out(Skip.RAYS_ALIKE, count=count - 1)
        samples = frame.light_samples(1 if alike else count, self.params.sample_set)
        hull, shape = frame.light_hull(), visibility.shape
        cut = frame.geometry.scene.cut_caster is not None
        if cut:
            frame.tell(Skip.EDGES)
        if has_area and not cut and frame.geometry.caster_triangles and uses_lanes(frame.device):
            tree, casters = frame.caster_tree(), frame.caster_mesh()
            known = pull_edge_set(frame, frame.geometry, frame.light, tree)
            with frame.timed("silhouettes"):
                given = known, tree, casters, samples, frame.light, hull
                by_rays = trace_silhouettes(frame, gbuffer, *given, visibility)
            frame.tell(Skip.UNSURE, count=lambda: by_rays)
        else:
            proof = frame.buffer("proof", shape, wp.int32)
            if uses_lanes(frame.device):
                kernel, inputs = trace_shafts, [gbuffer, frame.caster_tree(), samples.batches, hull, 1]
            else:
                points = [samples.points_ws, samples.weights]
                kernel, inputs = trace_light, [gbuffer, frame.caster_mesh(), *points, hull, 1]
            with frame.timed("shadow rays"):
                frame.launch(kernel, shape, inputs, [visibility, proof])
        frame.launch(binomial_standard_error, shape, [visibility, float(count)], [error])
        return visibility
