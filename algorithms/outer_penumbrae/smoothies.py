"""Smoothies: strips of one width beside the silhouette, with depth and alpha, as seen by the light (Chan and Durand 2003).

1. A light map from the light's centre gives hard shadows; a second one the depth r of the nearest surface of all,
   caster or not, in each texel.
2. Each silhouette edge carries a strip of a width t that is the same everywhere in the light's view, and each vertex a
   fan between its strips (Schwaerzler 2009, section 4.11). In each texel that it covers it has the depth b of the
   silhouette and an alpha from 0 at the silhouette to 1 at its outer border, which the ratio of the distances makes a
   penumbra that is hard at contact:

       alpha' = clamp(alpha / (1 - b / r), 0, 1).

   The smoothie buffer keeps b and alpha' of the smoothie that is nearest to the light.
3. A pixel that is in the hard shadow is dark; one that is farther than b has the light alpha'; any other is lit.

The width of a penumbra is t (1 - b / r) in the light's view, where R (1 / b - 1 / r) would be right: that is the same
if t = R / b. So ``width`` is in light's radii as seen from the casters' mean distance (the mean of R / b over the
silhouette); casters that are nearer to the light have penumbrae too narrow, others too wide.

Deviations: strips and fans are found in closed form, on the outer side of their edge only; fans are round, whatever
their angle, so that strips are joined without a gap. The paper leaves t to the user. A light of another shape than a
ball counts as one of half its size. Directional lights are refused: b / r would depend on where depths begin.
Known artefacts: too dark: the umbra has the size of the hard shadow, however large the light. Where smoothies overlap
the nearest to the light wins, not the darkest, so that the edge of a low caster's shadow is lit within the penumbra of
a high one. The penumbra has the texels of the map, as hard edges have. Where several surfaces share a texel those
behind b have the light of the nearest.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from algorithms.outer_penumbrae._silhouette_maps import SilhouetteMaps, Skip, texel_of_receiver, texels_of_run
from algorithms.technique import ALL_LIGHTS, Frame, MapParams, Needs, setting
from wkernels.casters.outer_edges import OuterEdges, light_radius, nearest_outside
from wkernels.casters.pulls import pull_silhouettes
from wkernels.device.lanes import LANES, Floats, flat_floats, store_run
from wkernels.device.twin import Twin
from wkernels.light_maps.comparison_lanes import compare_nearest_run
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.binning import TileLists, tile_at
from wkernels.raster.gbuffer import GBuffer


@wp.kernel
def draw_smoothies(
    first: int,
    depth: wp.array2d(dtype=float),
    lists: TileLists,
    edges: OuterEdges,
    to_plane: wp.mat33,
    in_perspective: int,
    width: float,
    smoothie_out: wp.array2d(dtype=wp.vec2),
):
    """Depth and alpha' of the nearest smoothie in each texel; +inf and 1 where there is none."""
    row, x = wp.tid()
    y = first + row
    nearest = float(wp.inf)
    alpha = float(1.0)
    tile = tile_at(lists, y, x)
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    if begin < end and depth[y, x] < wp.inf:
        p = to_plane * wp.vec3(float(x) + 0.5, float(y) + 0.5, 1.0)
        for i in range(begin, end):
            edge = lists.shape[i]
            near = nearest_outside(edges.line[edge], edges.ramp[edge], p[0] / p[2], p[1] / p[2])
            b = -1.0 / near[1]
            if near[0] < width and b < depth[y, x] and b < nearest:
                nearest = b
                alpha = wp.min(near[0] / (width * (1.0 - b / depth[y, x])), 1.0)
    smoothie_out[y, x] = wp.vec2(nearest, alpha)


@wp.kernel
def draw_smoothies_lanes(
    first: int,
    depth: wp.array2d(dtype=float),
    lists: TileLists,
    edges: OuterEdges,
    to_plane: wp.mat33,
    in_perspective: int,
    width: float,
    smoothie_out: wp.array2d(dtype=wp.vec2),
):
    """``draw_smoothies`` of a run of texels, which lies in one tile."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    held = wp.min(LANES, smoothie_out.shape[1] - x0)
    tile = tile_at(lists, y, x0)
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    nearest = Floats(float(wp.inf))
    alpha = Floats(1.0)
    if begin < end:
        depths = Floats(0.0)
        for k in range(held):
            if depth[y, x0 + k] < wp.inf:
                depths[k] = depth[y, x0 + k]
        xs = Floats(0.0)
        ys = Floats(0.0)
        for k in range(LANES):
            p = to_plane * wp.vec3(float(x0 + k) + 0.5, float(y) + 0.5, 1.0)
            xs[k] = p[0] / p[2]
            ys[k] = p[1] / p[2]
        for i in range(begin, end):
            edge = lists.shape[i]
            line = edges.line[edge]
            ramp = edges.ramp[edge]
            from_x, from_y, way_x, way_y = line[0], line[1], line[2], line[3]
            length, key_0, change, lean = ramp[0], ramp[1], ramp[2], ramp[3]
            for k in range(LANES):
                dx = xs[k] - from_x
                dy = ys[k] - from_y
                along = dx * way_x + dy * way_y
                across = dx * way_y - dy * way_x
                foot = wp.clamp(along - across * lean, 0.0, length)
                distance = wp.sqrt((along - foot) * (along - foot) + across * across)
                b = -1.0 / (key_0 + change * foot)
                before = wp.where(b < depths[k], 1, 0) & wp.where(b < nearest[k], 1, 0)
                taken = before & wp.where(across >= 0.0, 1, 0) & wp.where(distance < width, 1, 0)
                light = wp.min(distance / (width * (1.0 - b / depths[k])), 1.0)
                nearest[k] = wp.where(taken != 0, b, nearest[k])
                alpha[k] = wp.where(taken != 0, light, alpha[k])
    for k in range(held):
        smoothie_out[y, x0 + k] = wp.vec2(nearest[k], alpha[k])


@wp.kernel
def look_up_smoothies(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    smoothies: wp.array(dtype=wp.vec2),
    visibility_out: wp.array2d(dtype=float),
):
    """Hard comparison of each pixel, and alpha' of the smoothie that is before it."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        visible = compare_nearest(light_map, receiver)
        texel = texel_of_receiver(light_map, receiver)
        if texel >= 0 and texel < smoothies.shape[0]:
            smoothie = smoothies[texel]
            if receiver.depth > smoothie[0]:
                visible *= smoothie[1]
    visibility_out[y, x] = visible


@wp.kernel
def look_up_smoothies_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    smoothies: wp.array(dtype=float),
    visibility_out: wp.array2d(dtype=float),
):
    """``look_up_smoothies`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        visible = compare_nearest_run(views, light_map, receivers)
        texels = texels_of_run(light_map, receivers)
        depths = receivers.depth
        if smoothies.shape[0] > 0:
            for k in range(LANES):
                at = 2 * wp.max(texels[k], 0)
                behind = wp.where(texels[k] >= 0, 1, 0) & wp.where(depths[k] > smoothies[at], 1, 0)
                visible[k] = visible[k] * wp.where(behind != 0, smoothies[at + 1], 1.0)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, bias: Bias, smoothies: wp.array) -> list:
    return [lane_views(gbuffer, light_map), light_map, bias, flat_floats(smoothies)]


DRAW = Twin(draw_smoothies, draw_smoothies_lanes, tolerance=1e-4, flips=1e-4)
LOOK_UP = Twin(look_up_smoothies, look_up_smoothies_lanes, inputs=_in_lanes, tolerance=1e-5, flips=1e-3)


class Smoothies(SilhouetteMaps):
    """Two maps, one comparison and one lookup a pixel."""

    name = "smoothies"
    paper = ("chan2003", "schwaerzler2009")
    needs = Needs(lights=ALL_LIGHTS - {"directional"}, area=True)

    class Params(MapParams):
        """The strips."""

        width: float = setting(
            1.0,
            "width of smoothies",
            unit="light's radii as seen from the silhouette's mean distance",
            ge=0.0,
            le=100.0,
        )

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        smoothies = wp.empty(0, dtype=wp.vec2, device=frame.device)
        if light_map.light.has_area or not frame.leave_out(Skip.NO_PENUMBRA):
            width = self.params.width * light_radius(light_map.light) * _mean_nearness(frame, light_map.light_ws)
            smoothies = self.pull_image(frame, light_map, "smoothie buffer", wp.vec2, DRAW, 0.0, width).texels
        with frame.timed("smoothie lookup"):
            inputs = [gbuffer, light_map.map, self.params.device_bias, smoothies]
            frame.launch(LOOK_UP, visibility_out.shape, inputs, [visibility_out])


def _mean_nearness(frame: Frame, light_ws: np.ndarray) -> float:
    """The mean of one over the distance of the silhouette's vertices from a point light; 0 where there is none."""

    def find(old: float | None) -> float:
        ends = frame.geometry.points_ws.numpy()[silhouettes.ends.ravel()]
        distance = np.linalg.norm(ends.astype(np.float64) - light_ws[:3], axis=1)
        return float((1.0 / np.maximum(distance, 1e-30)).mean()) if len(distance) else 0.0

    silhouettes = pull_silhouettes(frame, frame.geometry, light_ws)
    out: float = frame.product("width of smoothies", "width of smoothies", silhouettes, find)
    return out
