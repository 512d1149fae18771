"""Variance shadow maps: a filtered map of depth and squared depth bounds the lit share (Donnelly and Lauritzen 2006).

The map stores z and z^2, is filtered like any image, and gives mean and variance of the depths under the filter: mu =
M1, s^2 = M2 - M1^2 (Schwaerzler 2009, equations 4.1 and 4.2). Chebyshev's inequality bounds the share of them at or
beyond the receiver's depth t: lit = 1 where t <= mu, else s^2 / (s^2 + (t - mu)^2) (equation 4.3; the condition is
missing there, and the share is the lit one, not the one that fails). Two planes under the filter, one of them the
receiver's, give the exact share. ``width: fixed`` filters with a Gaussian; soft lights are reduced to their centre.
``width: pcss`` predicts the penumbra by a blocker search (Fernando 2005; Schwaerzler 2009, section 4.3.1) and takes
the mean moments over it from a summed-area table (Lauritzen 2007). ``bleeding`` cuts off the tail of the bound: (p -
a) / (1 - a), at least 0.

Deviations: depths are normalised to [-1/2, 1/2] over the range of each layer of the map, or float32 would lose M2 -
M1^2 and a split of 10 m would have the ``min_variance`` of a scene of 3 km; tables are float64. Texels without a caster
hold the range's far end. The slope term M2 += (zx^2 + zy^2)/4 (``slope_variance``) takes the smaller one-sided
difference of the map on each axis, which is the caster's own slope and not the step at its silhouette.
Known artefacts: light bleeding where casters overlap: two hiding depths a < b in equal parts leave 1 / (1 + (1 + 2 (c
- b)/(b - a))^2) of the light at depth c; lit contacts, where caster and receiver are closer than
sqrt(``min_variance``) of the layer's range; the box of ``pcss`` turns with the map, not with the light; filters end at
the map's border, and at that of a face of an omnidirectional map.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp
from pydantic import field_validator

from algorithms.technique import Frame, MapParams, MapTechnique, setting
from wkernels.filters.blur import gaussian_weights
from wkernels.filters.map_images import pull_blurred, pull_sums
from wkernels.filters.moments import LOOK_UP_MOMENTS, Chebyshev, lit_share, normalised, pull_moments
from wkernels.filters.penumbra import (
    LightFootprint,
    mean_blocker_depth,
    penumbra_box,
    penumbra_spread,
    pull_footprint,
    pull_taps,
    texels_per_ratio,
)
from wkernels.filters.summed_area import box_mean
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Because, Omission


class Skip(Omission):
    """What filters that change nothing save."""

    TAPS_ALIKE = "taps of the search", Because.NO_AREA
    NO_BLUR = "blur of moments", "its kernel has one tap"


@wp.kernel
def look_up_penumbra(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    chebyshev: Chebyshev,
    footprint: LightFootprint,
    blocker_taps: wp.array(dtype=wp.vec2),
    tables: wp.array3d(dtype=wp.vec2d),
    visibility_out: wp.array2d(dtype=float),
):
    """Blocker search, then the mean moments over the box that has the penumbra's second moments."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        axes = texels_per_ratio(light_map, footprint, receiver.layer, gbuffer.position_ws[y, x])
        nearest = footprint.nearest_depth[receiver.layer]
        search = penumbra_spread(light_map, footprint, receiver, axes, nearest)
        blocker = mean_blocker_depth(light_map, receiver, search, blocker_taps)
        if blocker[1] > 0.0:
            half = penumbra_box(penumbra_spread(light_map, footprint, receiver, axes, blocker[0]))
            at = wp.vec2(receiver.x, receiver.y)
            low = at - half
            high = at + half
            mean = box_mean(tables[receiver.layer], low[0], low[1], high[0], high[1])
            visible = lit_share(chebyshev, mean, normalised(chebyshev.ranges[receiver.layer], receiver.depth))
    visibility_out[y, x] = visible


class Vsm(MapTechnique):
    """One map of moments, one filtered lookup per pixel."""

    name = "vsm"
    family = "filtering"
    paper = ("donnelly2006vsm", "lauritzen2007savsm", "fernando2005pcss", "schwaerzler2009")
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "no texel falls on a receiver in whose plane the light lies"
    }
    bias_sign = "lighter"
    may_leave_out = (Skip.TAPS_ALIKE, Skip.NO_BLUR)

    class Params(MapParams):
        """Filter and bound."""

        width: Literal["fixed", "pcss"] = setting(
            "fixed",
            "filter of fixed size, or as wide as the penumbra",
            unit="name",
            source="Schwaerzler 2009, sec. 4.3.1",
        )
        taps: int = setting(5, "taps of the Gaussian along each axis, odd (width fixed)", unit="texels", ge=1, le=255)
        blocker_taps: int = setting(
            16, "taps of the blocker search (width pcss)", unit="taps", source="Scherzer 2009, sec. 4", ge=1, le=4096
        )
        min_variance: float = setting(
            1e-5,
            "least variance of depth, which is 0 to 1 over what a layer of the map can hold: the meshes' boxes in its "
            "window",
            unit="layer depth range^2",
            source="Lauritzen 2007",
            gt=0.0,
            le=1.0,
        )
        bleeding: float = setting(
            0.0,
            "share of the bound that is cut off against light bleeding",
            unit="1",
            source="Lauritzen 2007",
            ge=0.0,
            le=0.99,
        )
        slope_variance: bool = setting(
            False, "adds the variance of depth within each texel", unit="yes/no", source="Lauritzen 2007"
        )

        @field_validator("taps")
        @classmethod
        def _have_a_centre(cls, taps: int) -> int:
            if taps % 2 == 0:
                raise ValueError(f"a filter has an odd number of taps, so {taps} is not possible: take {taps + 1}")
            return taps

    def leaves_out(self) -> tuple[Omission, ...]:
        return self.may_leave_out if self.params.taps == 1 else (Skip.TAPS_ALIKE,)

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        p = self.params
        bound = {"min_variance": p.min_variance, "bleeding": p.bleeding, "slope_variance": p.slope_variance}
        moments = pull_moments(frame, light_map, frame.geometry, **bound)
        common = [gbuffer, light_map.map, p.device_bias, moments.chebyshev]
        if p.width == "fixed":
            image = moments.image
            if p.taps > 1 or not frame.leave_out(Skip.NO_BLUR):
                image = pull_blurred(frame, "blur of moments", image, gaussian_weights(p.taps // 2))
            with frame.timed("moment lookup"):
                frame.launch(LOOK_UP_MOMENTS, visibility_out.shape, [*common, image.texels], [visibility_out])
            return
        tables = pull_sums(frame, "summed-area tables", moments.image)
        footprint = pull_footprint(frame, light_map)
        count = p.blocker_taps
        if count > 1 and not light_map.light.has_area and frame.leave_out(Skip.TAPS_ALIKE, count=count - 1):
            count = 1
        taps = pull_taps(frame, "poisson", count)
        with frame.timed("penumbra lookup"):
            inputs = [*common, footprint, taps, tables]
            frame.launch(look_up_penumbra, visibility_out.shape, inputs, [visibility_out])
