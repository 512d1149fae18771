"""Percentage-closer filtering as Stingl 2011, section 3.6, has it: 64 Poisson taps, each a bilinear 2 x 2 comparison.

lit = mean over the taps of the bilinear mean of four (z <= SM + b) (Reeves, Salesin and Cook 1987). The taps fill a
disc of fixed size in texels; at 64 of 2 x 2 the steps of the map's texels all but disappear, which is what the thesis
wants of them. This is ``pcf`` with that kernel and nothing else to choose; it stands for itself because the sources
count it as a technique of its own.

Deviations: the taps are a relaxed set of best candidates in the unit disc, whose centroid is its centre, where the
thesis takes Poisson discs of Dunbar and Humphreys; comparisons are with the receiver's plane under each tap, where the
bias knows it.
Known artefacts: those of ``pcf``: a penumbra of constant width whatever the distance of the caster, and wide kernels
that darken the seam at a concave edge; 64 taps cost 16 times the comparisons of 16 nearest ones.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Frame, Limit, MapParams, MapTechnique, setting
from wkernels.filters.comparison_filter import FILTER_COMPARISONS
from wkernels.filters.penumbra import pull_taps
from wkernels.light_maps.host_map import HostMap
from wkernels.raster.gbuffer import GBuffer


class PcfPoisson(MapTechnique):
    """One map, 64 bilinear comparisons a pixel."""

    name = "pcf_poisson"
    family = "filtering"
    paper = ("stingl2011", "reeves1987pcf")
    bias_sign = "none"
    limits = (
        Limit(equals="pcf", other_params={"kernel": "poisson", "taps": 64, "bilinear": True}, tolerance=1e-6),
        Limit(equals="pcf", params={"taps": 16, "radius": 4.0}, other_params={"radius": 4.0}, tolerance=1e-6),
    )

    class Params(MapParams):
        """The disc."""

        taps: int = setting(
            64, "bilinear comparisons per pixel", unit="taps", source="Stingl 2011, sec. 3.6", ge=1, le=4096
        )
        radius: float = setting(2.0, "radius of the disc", unit="texels", ge=0.0, le=4096.0)

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        taps = pull_taps(frame, "poisson", self.params.taps)
        with frame.timed("filter comparisons"):
            inputs = [gbuffer, light_map.map, self.params.device_bias, taps, self.params.radius, 1]
            frame.launch(FILTER_COMPARISONS, visibility_out.shape, inputs, [visibility_out])
