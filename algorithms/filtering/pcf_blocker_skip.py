"""Percentage-closer filtering with a blocker search first, which leaves the filter out where nothing is at stake.

1. Search: a few nearest comparisons over the region that the filter covers. None hidden: lit (Fernando 2005; Stingl
   2011, section 3.6). All hidden: dark, which the sources do not use but which is as true.
2. Everywhere else the filter of section 3.6: the mean of 64 Poisson taps of 2 x 2 comparisons.

The thesis reports up to 15 % more frames a second; docs/parts.md has what is saved here, and what the search misses.
On the CPU the filter is left out for runs of 64 pixels. Misses are lit rather than dark.

Deviations: ``rim`` puts the search's taps at the centre and on the rim of the filter's disc, through which every edge
enters, instead of all over the disc as the filter's are (``disc``).
Known artefacts: what the search misses is dropped: thin casters, and the first percents of a ramp. Known too are those
of ``pcf``, above all the constant width of its penumbrae.
"""

from __future__ import annotations

from typing import Literal

import warp as wp

from algorithms.technique import Frame, Limit, MapParams, MapTechnique, setting
from wkernels.filters.penumbra import tap_set
from wkernels.filters.searched_filter import Searched, filter_after_search, rim_taps, searched_filter
from wkernels.light_maps.host_map import HostMap
from wkernels.raster.gbuffer import GBuffer


class PcfBlockerSkip(MapTechnique):
    """One map, a search a pixel, and a filter where the search finds an edge."""

    name = "pcf_blocker_skip"
    family = "filtering"
    paper = ("stingl2011", "fernando2005pcss")
    bias_sign = "none"
    may_leave_out = (Searched.SETTLED,)
    limits = (
        Limit(equals="shadow_map", params={"radius": 0.0, "bilinear": False}),
        Limit(
            equals="pcf_poisson",
            params={"search": "disc", "search_taps": 1024, "taps": 64},
            other_params={"taps": 64},
            tolerance=0.01,
            flips=0.001,
        ),
    )

    class Params(MapParams):
        """The search and the filter."""

        search: Literal["rim", "disc"] = setting(
            "rim", "where the search looks: centre and rim of the filter's disc, or all over it", unit="name"
        )
        search_taps: int = setting(9, "nearest comparisons of the search", unit="taps", ge=1, le=4096)
        taps: int = setting(64, "comparisons of the filter", unit="taps", source="Stingl 2011, sec. 3.6", ge=1, le=4096)
        radius: float = setting(2.0, "radius of the filter's disc", unit="texels", ge=0.0, le=4096.0)
        bilinear: bool = setting(
            True, "each tap is the bilinear mean of 2 x 2 comparisons", unit="yes/no", source="Stingl 2011, sec. 3.6"
        )

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        p = self.params
        search = rim_taps(p.search_taps) if p.search == "rim" else tap_set("poisson", p.search_taps)
        slot = (p.search, p.search_taps, p.taps, p.radius, p.bilinear)
        searched = searched_filter(frame, search, tap_set("poisson", p.taps), p.radius, p.bilinear, slot)
        with frame.timed("search and filter"):
            filter_after_search(frame, gbuffer, light_map, p.device_bias, searched, visibility_out)
