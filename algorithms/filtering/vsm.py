"""Variance shadow maps: a filtered map of depth and squared depth bounds the lit share (Donnelly and Lauritzen 2006).

The map stores z and z^2, is filtered like any image, and gives mean and variance of the depths under the filter: mu =
M1, s^2 = M2 - M1^2 (Schwaerzler 2009, equations 4.1 and 4.2). Chebyshev's inequality bounds the share of them at or
beyond the receiver's depth t: lit = 1 where t <= mu, else s^2 / (s^2 + (t - mu)^2) (equation 4.3; the condition is
missing there, and the share is the lit one, not the one that fails). Two planes under the filter, one of them the
receiver's, give the exact share. ``width: fixed`` filters with a Gaussian; soft lights are reduced to their centre.
``width: pcss`` predicts the penumbra by a blocker search (Fernando 2005; Schwaerzler 2009, section 4.3.1) and takes
the mean moments over it from a summed-area table (Lauritzen 2007). ``bleeding`` cuts off the tail of the bound: (p -
a) / (1 - a), at least 0.

Deviations: depths are normalised to [-1/2, 1/2] over the scene's range, or float32 would lose M2 - M1^2, and tables
are float64. Texels without a caster hold the range's far end. The slope term M2 += (zx^2 + zy^2)/4
(``slope_variance``) takes the smaller one-sided difference of the map on each axis, which is the caster's own slope
and not the step at its silhouette.
Known artefacts: light bleeding where casters overlap: two hiding depths a < b in equal parts leave 1 / (1 + (1 + 2 (c
- b)/(b - a))^2) of the light at depth c; lit contacts, where caster and receiver are closer than
sqrt(``min_variance``) of the range; the box of ``pcss`` turns with the map, not with the light; filters end at the
map's border, and at that of a face of an omnidirectional map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import warp as wp
from pydantic import field_validator

from algorithms.technique import MapParams, Technique, setting
from wkernels.device.lanes import LANES, Floats, Pairs, flat_floats, runs_of, runs_per_row, store_run, uses_lanes
from wkernels.filters.blur import gaussian_weights, separable_blur
from wkernels.filters.moments import (
    Chebyshev,
    depth_range,
    find_moments,
    find_moments_lanes,
    lit_share,
    lit_share_run,
    normalised,
    sample_bilinear,
)
from wkernels.filters.penumbra import (
    LightFootprint,
    mean_blocker_depth,
    penumbra_spread,
    pull_footprint,
    pull_taps,
    texels_per_ratio,
)
from wkernels.filters.summed_area import box_mean, summed_area_table
from wkernels.frame.empty_maps import nothing_hides
from wkernels.frame.session import Session as Frame
from wkernels.light_maps.light_map import Bias, LightMap, layout_of
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.light_maps.storage import MapLayout, allocate, layer_images
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What lights and filters save."""

    TAPS_ALIKE = "taps of the search", Because.NO_AREA
    NO_BLUR = "blur of moments", "its kernel has one tap"


@wp.kernel
def look_up_blurred(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=wp.vec2),
    visibility_out: wp.array2d(dtype=float),
):
    """One bilinear lookup of filtered moments per pixel."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        mean = sample_bilinear(moments, light_map, receiver.layer, receiver.x, receiver.y)
        visible = lit_share(chebyshev, mean, normalised(chebyshev, receiver.depth))
    visibility_out[y, x] = visible


@wp.kernel
def look_up_blurred_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=float),
    visibility_out: wp.array2d(dtype=float),
):
    """``look_up_blurred`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        visible = lit_share_run(chebyshev, moments, receivers, light_map)
    store_run(visible, x0, y, visibility_out)


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
            spread = penumbra_spread(light_map, footprint, receiver, axes, blocker[0])
            # one texel at least: less would be an unfiltered map
            half_x = wp.max(wp.length(wp.vec2(spread[0, 0], spread[0, 1])), 0.5)
            half_y = wp.max(wp.length(wp.vec2(spread[1, 0], spread[1, 1])), 0.5)
            mean = box_mean(
                tables[receiver.layer],
                receiver.x - half_x,
                receiver.y - half_y,
                receiver.x + half_x,
                receiver.y + half_y,
            )
            visible = lit_share(chebyshev, mean, normalised(chebyshev, receiver.depth))
    visibility_out[y, x] = visible


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of one light map, unfiltered.

    Attributes:
        chebyshev: The depth range they are normalised to, and the technique's constants.
        image: vec2 (texels,), in the layout of the map: mean and mean square of normalised depth.
        layout: That layout.
    """

    chebyshev: Chebyshev
    image: wp.array
    layout: MapLayout


class Vsm(Technique):
    """One map of moments, one filtered lookup per pixel."""

    name = "vsm"
    family = "filtering"
    paper = ("donnelly2006vsm", "lauritzen2007savsm", "fernando2005pcss", "schwaerzler2009")
    products = (Product.G_BUFFER, Product.LIGHT_MAP)
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
        taps: int = setting(
            5,
            "taps of the Gaussian along each axis, odd (width fixed)",
            unit="texels",
            ge=1,
            le=255,
        )
        blocker_taps: int = setting(
            16, "taps of the blocker search (width pcss)", unit="taps", source="Scherzer 2009, sec. 4", ge=1, le=4096
        )
        min_variance: float = setting(
            1e-5,
            "least variance, of depth over the scene's depth range",
            unit="1",
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

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        params = self.params
        light_map = frame.light_map(params.resolution, cull=params.cull)
        if nothing_hides(frame, gbuffer, light_map, visibility):
            return visibility
        moments = self._moments(frame, light_map.map)
        common = [light_map.map, params.device_bias, moments.chebyshev]
        if params.width == "fixed":
            image = self._blurred(frame, moments)
            with frame.timed("moment lookup"):
                if uses_lanes(frame.device):
                    inputs = [lane_views(gbuffer, light_map.map), *common, flat_floats(image)]
                    runs = (visibility.shape[0], runs_per_row(visibility.shape[1]))
                    frame.launch(look_up_blurred_lanes, runs, inputs, [visibility])
                else:
                    frame.launch(look_up_blurred, visibility.shape, [gbuffer, *common, image], [visibility])
            return visibility
        tables = self._tables(frame, moments)
        footprint = pull_footprint(frame, light_map)
        count, hard = params.blocker_taps, not frame.light.has_area
        if count > 1 and hard and frame.leave_out(Skip.TAPS_ALIKE, count=count - 1):
            count = 1
        taps = pull_taps(frame, "poisson", count)
        with frame.timed("penumbra lookup"):
            frame.launch(look_up_penumbra, visibility.shape, [gbuffer, *common, footprint, taps, tables], [visibility])
        return visibility

    def _moments(self, frame: Frame, light_map: LightMap) -> Moments:
        def build(old: Moments | None) -> Moments:
            box = frame.geometry.bounds(casters=True, receivers=True)
            near, far = depth_range(light_map.ws_to_ls.numpy(), box.corners)
            chebyshev = Chebyshev()
            chebyshev.near, chebyshev.per_length = near, 1.0 / (far - near)
            chebyshev.min_variance, chebyshev.bleeding = self.params.min_variance, self.params.bleeding
            layout, side = layout_of(light_map), light_map.resolution
            image = _reuse(old.image if old else None, layout, frame.device)
            layers = zip(layer_images(light_map.depth, layout), layer_images(image, layout), strict=True)
            for begin, (depth, out) in zip(layout.begin, layers, strict=True):
                if uses_lanes(frame.device) and side >= LANES and not self.params.slope_variance:
                    inputs = [runs_of(light_map.depth, Floats), chebyshev, begin, layout.pitch, side]
                    frame.launch(find_moments_lanes, (side, runs_per_row(side)), inputs, [runs_of(image, Pairs)])
                else:
                    frame.launch(find_moments, out.shape, [depth, chebyshev, int(self.params.slope_variance)], [out])
            return Moments(chebyshev, image, layout)

        # a map that is drawn anew is a new struct, so that the struct itself stands for everything the map depends on
        moments: Moments = frame.product("moments", "moments", (light_map,), build)
        return moments

    def _blurred(self, frame: Frame, moments: Moments) -> wp.array:
        if self.params.taps == 1 and frame.leave_out(Skip.NO_BLUR):
            return moments.image

        def build(old: wp.array | None) -> wp.array:
            out, layout = _reuse(old, moments.layout, frame.device), moments.layout
            scratch = frame.buffer("blurred rows", (layout.resolution, layout.resolution), wp.vec2)
            weights = gaussian_weights(self.params.taps // 2)
            for image, blurred in zip(layer_images(moments.image, layout), layer_images(out, layout), strict=True):
                separable_blur(image, weights, threads=frame.threads, scratch=scratch, out=blurred)
            return out

        blurred: wp.array = frame.product("blur of moments", "blurred moments", (moments,), build)
        return blurred

    def _tables(self, frame: Frame, moments: Moments) -> wp.array:
        def build(old: wp.array | None) -> wp.array:
            images = layer_images(moments.image, moments.layout)
            shape = (len(images), moments.layout.resolution + 1, moments.layout.resolution + 1)
            kept = old if old is not None and old.shape == shape else None
            out = kept or wp.empty(shape, dtype=wp.vec2d, device=frame.device)
            for layer, image in enumerate(images):
                summed_area_table(image, threads=frame.threads, out=out[layer])
            return out

        tables: wp.array = frame.product("summed-area tables", "summed-area tables", (moments,), build)
        return tables


def _reuse(old: wp.array | None, layout: MapLayout, device: str) -> wp.array:
    return old if old is not None and old.size == layout.texels else allocate(layout, wp.vec2, device)
