"""Soft shadows from one hard shadow map per light sample, averaged: accumulation of hard images.

The light is replaced by N points; each gets its own depth map and one comparison per pixel, and visibility is the
radiance-weighted share of the points that are seen (Heckbert and Herf 1997, with depth maps instead of their
accumulation of projected polygons; Scherzer et al. 2009, section 3.1, equations 1 and 2). The reported standard error
is equation 3, sqrt(psi (1 - psi) / (N - 1)), that of independent samples; low-discrepancy points do 2 to 5 times
better at smooth edges.

Maps are kept from frame to frame while light and casters stand still, as far as memory allows (``Session.light_map``).
Deviation: one map is drawn, and counted N times, where the light has no area.
Known artefacts: N samples give N + 1 levels, fewer than about 9 look like as many hard shadows; every map's own
aliasing and bias, which N different maps blur but do not remove.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
import warp as wp

from algorithms.technique import Frame, MapParams, Technique, setting
from wkernels.device.lanes import LANES
from wkernels.device.twin import Twin
from wkernels.light_maps.comparison_lanes import compare_nearest_run
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest
from wkernels.light_maps.receiver_lanes import LaneViews, in_lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.estimators import standard_error
from wkernels.scene.geometry import RECEIVES
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What a light without an area saves."""

    MAPS = "light depth maps", Because.NO_AREA


@wp.kernel
def add_comparison(
    first: int, gbuffer: GBuffer, light_map: LightMap, bias: Bias, weight: float, seen_out: wp.array2d(dtype=float)
):
    """Adds ``weight`` to the pixels that one light sample sees; those that receive nothing count as lit."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        visible = compare_nearest(light_map, receiver)
    seen_out[y, x] = seen_out[y, x] + weight * visible


@wp.kernel
def add_comparison_lanes(
    first: int, views: LaneViews, light_map: LightMap, bias: Bias, weight: float, seen_out: wp.array2d(dtype=float)
):
    """``add_comparison`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        visible = compare_nearest_run(views, light_map, receivers)
    for k in range(wp.min(LANES, seen_out.shape[1] - x0)):
        seen_out[y, x0 + k] = seen_out[y, x0 + k] + weight * visible[k]


ADD_COMPARISON = Twin(add_comparison, add_comparison_lanes, inputs=in_lane_views, flips=1e-3)


@wp.kernel
def average(
    first: int,
    gbuffer: GBuffer,
    seen: wp.array2d(dtype=float),
    total: float,
    count: float,
    visibility_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
):
    """Visibility as the seen share of ``total`` weight, and its standard error for ``count`` samples."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        visible = seen[y, x] / wp.max(total, 1.0e-30)
    visibility_out[y, x] = visible
    error_out[y, x] = standard_error(1.0 - visible, count)


class MultiShadowMap(Technique):
    """N maps over the light, averaged."""

    name = "multi_shadow_map"
    family = "light_sampling"
    paper = ("heckbert1997", "scherzer2009tc")
    products = (Product.G_BUFFER, Product.LIGHT_MAP, Product.LIGHT_SAMPLES)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "no texel falls on a receiver in whose plane the light lies"
    }
    bias_sign = "none"
    may_leave_out = (Skip.MAPS,)

    class Params(MapParams):
        """Those of every map technique, and the light's points."""

        samples: int = setting(64, "points on the light", unit="maps per frame", source="Heckbert 1997", ge=1, le=10**5)
        sample_set: Literal["halton", "r2", "poisson_disc", "stratified", "random"] = setting(
            "halton", "point set on the light", unit="name", source="Scherzer 2009, sec. 4"
        )

    def render(self, frame: Frame) -> wp.array:
        p = self.params
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        error = frame.standard_error = frame.buffer("standard error", visibility.shape, wp.float32)
        if frame.nothing_casts(visibility):
            error.fill_(0.0 if p.samples > 1 else 1.0)
            return visibility
        samples = frame.light_samples(p.samples, p.sample_set)
        weights = samples.weights_host.astype(np.float32)
        total = np.add.accumulate(weights)[-1]  # in the kernels' order and precision, so that "all seen" is exactly 1
        maps = p.samples
        if maps > 1 and not frame.light.has_area and frame.leave_out(Skip.MAPS, count=maps - 1):
            maps, weights = 1, np.array([total])
        seen = frame.buffer("seen weight", visibility.shape, wp.float32)
        seen.zero_()
        for i in range(maps):
            light_map = frame.light_map(p.resolution, samples.host[i], slot=("sample", i), cull=p.cull)
            with frame.timed("compare depths"):
                inputs = [gbuffer, light_map.map, p.device_bias, float(weights[i])]
                frame.launch(ADD_COMPARISON, seen.shape, inputs, [seen])
        with frame.timed("average"):
            inputs = [gbuffer, seen, float(total), float(p.samples)]
            frame.launch(average, visibility.shape, inputs, [visibility, error])
        return visibility
