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

import warp as wp

from algorithms.filtering._taps import TapParams, tap_count
from algorithms.technique import Frame, Limit, MapTechnique, setting
from wkernels.filters.comparison_filter import FILTER_COMPARISONS
from wkernels.filters.penumbra import pull_taps
from wkernels.light_maps.host_map import HostMap
from wkernels.raster.gbuffer import GBuffer


class Pcf(MapTechnique):
    """One map, one kernel of fixed size."""

    name = "pcf"
    family = "filtering"
    paper = ("reeves1987pcf", "schwaerzler2009", "stingl2011")
    bias_sign = "none"
    limits = (Limit(equals="shadow_map", params={"radius": 0.0, "bilinear": False}),)

    class Params(TapParams):
        """The kernel."""

        taps: int = tap_count(16, "comparisons per pixel", source="Schwaerzler 2009, app. A")
        radius: float = setting(2.0, "radius of the disc, half the side of the box", unit="texels", ge=0.0, le=4096.0)

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        p = self.params
        taps = pull_taps(frame, p.kernel, p.taps)
        with frame.timed("filter comparisons"):
            inputs = [gbuffer, light_map.map, p.device_bias, taps, p.radius, int(p.bilinear)]
            frame.launch(FILTER_COMPARISONS, visibility_out.shape, inputs, [visibility_out])
