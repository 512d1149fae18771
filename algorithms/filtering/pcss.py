"""Percentage-closer soft shadows: a filter as wide as the penumbra that a blocker search predicts (Fernando 2005).

1. Blocker search: mean depth z_b of the map's texels that hide the receiver, at taps over the region that the light
   covers as seen from the receiver, R_s = L (z_r - near) / z_r on the near plane. No blocker: lit, and no filter
   (Stingl 2011, section 3.6).
2. Penumbra width, with light, blocker and receiver parallel: w = L (z_r - z_b) / z_b (Schwaerzler 2009, equation 5.6;
   Scherzer et al. 2009, equation 6). A directional light of angle a, whose L / z_b is 2 tan(a/2): w = 2 tan(a/2) (z_r
   - z_b).
3. Percentage-closer filter of that width on the plane of the receiver: w near / (z_r near plane's size) in map
   coordinates.

Deviations: ``near`` of the search is the depth of the nearest caster in the map, not the near plane, which lies at
the light and would spread the taps over the whole map. Filters have the shape of the light on the map's axes, so that
a rectangle, a line or a tilted disc gives its own widths; of a polygon only its second moments count. Comparisons are
with the receiver's plane under each tap, where the bias knows it. Widths are limited to the map's side where blocker
or light come close to the receiver.
Known artefacts: bands in wide penumbrae with 16 taps, noise instead with ``rotate``; where casters overlap their
depths are averaged, and so are their penumbrae; a sparse search misses thin casters and the outer penumbra, which is
then lit; a caster close to the light widens the search of every receiver; past a concave edge the receiver's plane
runs below the neighbouring surface, which then counts as a blocker; a receiver faces the light or not as the light's
centre lies above its horizon or below, so that without any caster it is too light by the share of the light that is
below, or too dark by the share that is above, up to a half either way; taps beyond the map, and beyond the 5 % by which
the faces of an omnidirectional map overlap, repeat the texel at its border. ``poisson`` fills a disc, which suits
discs, spheres and the sun; for rectangles and lines ``box`` is exact.
"""

from __future__ import annotations

from typing import ClassVar

import warp as wp

from algorithms.filtering._taps import TapParams, tap_count
from algorithms.technique import Frame, Limit, MapTechnique, Needs, setting
from wkernels.device.lanes import LANES, store_run
from wkernels.device.twin import Twin
from wkernels.filters.penumbra import LightFootprint, pcss_visibility, pull_footprint, pull_taps, tap_rotation
from wkernels.filters.penumbra_lanes import flat_half_axes, pcss_visibility_run, tap_rotation_run
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Because, Omission


class Skip(Omission):
    """What a light without an area saves."""

    TAPS = "taps of search and filter", Because.NO_AREA


@wp.kernel
def filter_penumbra(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    bias: Bias,
    blocker_taps: wp.array(dtype=wp.vec2),
    filter_taps: wp.array(dtype=wp.vec2),
    rotate: int,
    bilinear: int,
    seed: int,
    visibility_out: wp.array2d(dtype=float),
):
    """Blocker search, penumbra width and filter of each pixel."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        rotation = tap_rotation(x, y, seed, rotate)
        found = pcss_visibility(
            light_map, footprint, receiver, gbuffer.position_ws[y, x], blocker_taps, filter_taps, rotation, bilinear
        )
        visible = found[0]
    visibility_out[y, x] = visible


@wp.kernel
def filter_penumbra_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    footprint: LightFootprint,
    half_axes: wp.array(dtype=float),
    bias: Bias,
    blocker_taps: wp.array(dtype=wp.vec2),
    filter_taps: wp.array(dtype=wp.vec2),
    rotate: int,
    bilinear: int,
    seed: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_penumbra`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        cosine, sine = tap_rotation_run(x0, y, seed, rotate)
        visible = pcss_visibility_run(
            views, light_map, footprint, half_axes, receivers, blocker_taps, filter_taps, cosine, sine, bilinear
        )
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, footprint: LightFootprint, *others: object) -> list:
    return [lane_views(gbuffer, light_map), light_map, footprint, flat_half_axes(footprint), *others]


FILTER = Twin(filter_penumbra, filter_penumbra_lanes, inputs=_in_lanes, tolerance=1e-5, flips=1e-3)


class Pcss(MapTechnique):
    """One map, a search and a filter per pixel."""

    name = "pcss"
    family = "filtering"
    paper = ("fernando2005pcss", "schwaerzler2009", "scherzer2009tc", "stingl2011")
    needs = Needs(area=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_grows": "one map sees one side of a caster, and a light much wider than its distance shines past both"
    }
    bias_sign = "none"
    may_leave_out = (Skip.TAPS,)
    limits = (Limit(equals="shadow_map", light_scale=0.0),)

    class Params(TapParams):
        """The two tap sets."""

        blocker_taps: int = tap_count(16, "taps of the blocker search", source="Scherzer 2009, sec. 4")
        filter_taps: int = tap_count(16, "taps of the filter", source="Scherzer 2009, sec. 4")
        bilinear: bool = setting(
            False, "each filter tap is the bilinear mean of 2 x 2", unit="yes/no", source="Scherzer 2009, sec. 4"
        )
        rotate: bool = setting(False, "turn the taps by a random angle in each pixel", unit="yes/no")

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        p = self.params
        maps = [gbuffer, light_map.map, pull_footprint(frame, light_map)]
        counts = [p.blocker_taps, p.filter_taps]
        # without an area all taps fall on one spot; means of bilinear comparisons are not the same when rounded
        more = 0 if frame.light.has_area or p.bilinear else sum(counts) - 2
        if more and frame.leave_out(Skip.TAPS, count=more):
            counts = [1, 1]
        taps = [pull_taps(frame, p.kernel, count) for count in counts]
        options = [p.device_bias, *taps, int(p.rotate), int(p.bilinear), frame.seed]
        with frame.timed("penumbra filter"):
            frame.launch(FILTER, visibility_out.shape, [*maps, *options], [visibility_out])
