"""Percentage-closer filtering: the mean of many depth comparisons around the receiver (Reeves, Salesin and Cook 1987).

lit = mean over the taps of (z <= SM + b): comparisons are averaged, never depths (Schwaerzler 2009, section 4.3;
Stingl 2011, section 3.6, whose kernel is 64 Poisson taps of 2 x 2 texels each). The kernel has a fixed size in
texels. ``box`` takes k x k taps over the square of half-side ``radius``; with k = 2 ``radius`` bilinear taps a
straight edge becomes a linear ramp exactly 2 ``radius`` texels wide. ``poisson`` takes the disc; its set of 16 is the
one of Schwaerzler 2009, appendix A, with the digits that its print damaged restored. Soft lights are reduced to their
centre.

Deviations: comparisons are with the receiver's plane under each tap, where the bias knows it, and not with one depth
for all; a constant bias would have to grow with the kernel.
Known artefacts: the penumbra is as wide at the contact as far away; bands, as n taps give n + 1 levels (less so with
bilinear taps); with biases that know no plane a wide kernel shadows its own surface; past a concave edge the
receiver's plane runs below the neighbouring surface, which darkens the seam; taps beyond the map, and beyond the 5 %
by which the faces of an omnidirectional map overlap, repeat the texel at its border.
"""

from __future__ import annotations

from typing import Literal

import warp as wp
from pydantic import ValidationInfo, field_validator

from algorithms.technique import Limit, MapParams, Technique, setting
from wkernels.device.lanes import LANES, Floats, runs_per_row, uses_lanes
from wkernels.filters.penumbra import check_tap_count, penumbra_filter, pull_taps
from wkernels.filters.penumbra_lanes import keep_without_receiver, penumbra_filter_run
from wkernels.frame.empty_maps import nothing_hides
from wkernels.frame.session import Session as Frame
from wkernels.light_maps.comparison_lanes import SpreadRun
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer


@wp.kernel
def filter_comparisons(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """The same kernel around every pixel's receiver."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        spread = wp.mat22(radius, 0.0, 0.0, radius)
        visible = penumbra_filter(light_map, receiver, spread, taps, bilinear)
    visibility_out[y, x] = visible


@wp.kernel
def filter_comparisons_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_comparisons`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        spread = SpreadRun()
        spread.xx = Floats(radius)
        spread.yy = Floats(radius)
        lit = penumbra_filter_run(views, light_map, receivers, spread, taps, bilinear)
        visible = keep_without_receiver(receivers, lit)
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        visibility_out[y, x0 + k] = visible[k]


class Pcf(Technique):
    """One map, one kernel of fixed size."""

    name = "pcf"
    family = "filtering"
    paper = ("reeves1987pcf", "schwaerzler2009", "stingl2011")
    bias_sign = "none"
    limits = (Limit(equals="shadow_map", params={"radius": 0.0, "bilinear": False}),)

    class Params(MapParams):
        """The kernel."""

        kernel: Literal["poisson", "box"] = setting(
            "poisson", "shape: poisson disc, or box of k x k taps", unit="name", source="Schwaerzler 2009, app. A"
        )
        taps: int = setting(
            16,
            "comparisons per pixel; a square number for box",
            unit="taps",
            source="Schwaerzler 2009, app. A",
            ge=1,
            le=4096,
        )
        radius: float = setting(2.0, "radius of the disc, half the side of the box", unit="texels", ge=0.0, le=4096.0)
        bilinear: bool = setting(
            True, "each tap is the bilinear mean of 2 x 2 comparisons", unit="yes/no", source="Stingl 2011, sec. 3.6"
        )

        @field_validator("taps")
        @classmethod
        def _fit_kernel(cls, taps: int, info: ValidationInfo) -> int:
            return check_tap_count(taps, info.data.get("kernel", "poisson"))

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        params = self.params
        light_map = frame.light_map(params.resolution, cull=params.cull)
        if nothing_hides(frame, gbuffer, light_map, visibility):
            return visibility
        taps = pull_taps(frame, params.kernel, params.taps)
        with frame.timed("filter comparisons"):
            inputs = [light_map, params.device_bias, taps, params.radius, int(params.bilinear)]
            if uses_lanes(frame.device):
                runs = (visibility.shape[0], runs_per_row(visibility.shape[1]))
                frame.launch(filter_comparisons_lanes, runs, [lane_views(gbuffer, light_map), *inputs], [visibility])
            else:
                frame.launch(filter_comparisons, visibility.shape, [gbuffer, *inputs], [visibility])
        return visibility
