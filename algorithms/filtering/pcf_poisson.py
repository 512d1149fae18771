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

import numpy as np
import warp as wp

from algorithms.technique import Limit, MapParams, Technique, setting
from wkernels.filters.penumbra import tap_set
from wkernels.filters.searched_filter import filter_after_search, searched_filter
from wkernels.frame.empty_maps import nothing_hides
from wkernels.frame.session import Session as Frame

NO_SEARCH = np.zeros((0, 2))


class PcfPoisson(Technique):
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

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        params = self.params
        light_map = frame.light_map(params.resolution, cull=params.cull)
        if nothing_hides(frame, gbuffer, light_map, visibility):
            return visibility
        taps = tap_set("poisson", params.taps)
        searched = searched_filter(frame, NO_SEARCH, taps, params.radius, True, (params.taps, params.radius))
        with frame.timed("filter comparisons"):
            filter_after_search(frame, gbuffer, light_map, params.device_bias, searched, visibility)
        return visibility
