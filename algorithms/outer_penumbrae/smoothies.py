"""Smoothies: strips of one width beside the silhouette that the light sees, in depth and alpha (Chan and Durand 2003).

1. A light map from the light's centre gives hard shadows; a second one the depth r of the nearest surface of all,
   caster or not, in each texel.
2. Each silhouette edge carries a strip of a width t that is the same everywhere in the light's view, and each corner a
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
their angle, so that strips are joined without a gap. Where alpha' would be 1 or more a smoothie is not kept, as the lit
rest of its strip would hide others. The paper leaves t to the user. A light of another shape than a
ball counts as one of half its size. Directional lights are refused: b / r would depend on where depths begin.
Known artefacts: too dark: the umbra has the size of the hard shadow, however large the light. Where smoothies overlap
the nearest to the light wins, not the darkest, so that the edge of a low caster's shadow is lit within the penumbra of
a high one. The penumbra has the texels of the map, as hard edges have. Where several surfaces share a texel those
behind b have the light of the nearest.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from algorithms.outer_penumbrae._silhouette_maps import SilhouetteMaps
from algorithms.technique import ALL_LIGHTS, Frame, MapParams, Needs, setting
from wkernels.casters.outer_edges import OuterEdges, light_radius, nearest_outside
from wkernels.casters.pulls import pull_silhouettes
from wkernels.device.lanes import LANES, Floats
from wkernels.device.twin import Twin
from wkernels.light_maps.host_map import HostMap
from wkernels.raster.binning import TileLists, tile_at
from wkernels.raster.gbuffer import GBuffer


@wp.func
def in_strip_or_fan(line: wp.vec4, before: wp.vec4, after: wp.vec4, length: float, x: float, y: float):
    """Whether a point beside an edge is in its strip, or beyond an end and not beside the edge that goes on there."""
    dx = x - line[0]
    dy = y - line[1]
    along = dx * line[2] + dy * line[3]
    back = dx * before[2] + dy * before[3]  # of the point from the begin, along the edge before
    on = (dx - line[2] * length) * after[2] + (dy - line[3] * length) * after[3]
    return (along >= 0.0 or back >= 0.0) and (along <= length or on <= 0.0)


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
            line = edges.line[edge]
            before = edges.line[edges.beside[edge][0]]
            after = edges.line[edges.beside[edge][1]]
            near = nearest_outside(line, edges.ramp[edge], p[0] / p[2], p[1] / p[2])
            b = -1.0 / near[1]
            covered = in_strip_or_fan(line, before, after, edges.ramp[edge][0], p[0] / p[2], p[1] / p[2])
            if covered and near[0] < width and b < depth[y, x] and b < nearest:
                light = near[0] / (width * (1.0 - b / depth[y, x]))
                if light < 1.0:
                    nearest = b
                    alpha = light
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
            beside = edges.beside[edge]
            before = edges.line[beside[0]]
            after = edges.line[beside[1]]
            before_x, before_y, after_x, after_y = before[2], before[3], after[2], after[3]
            for k in range(LANES):
                dx = xs[k] - from_x
                dy = ys[k] - from_y
                along = dx * way_x + dy * way_y
                across = dx * way_y - dy * way_x
                foot = wp.clamp(along - across * lean, 0.0, length)
                distance = wp.sqrt((along - foot) * (along - foot) + across * across)
                b = -1.0 / (key_0 + change * foot)
                back = dx * before_x + dy * before_y
                on = (dx - way_x * length) * after_x + (dy - way_y * length) * after_y
                begun = wp.where(along >= 0.0, 1, 0) | wp.where(back >= 0.0, 1, 0)
                covered = begun & (wp.where(along <= length, 1, 0) | wp.where(on <= 0.0, 1, 0))
                nearer = wp.where(b < depths[k], 1, 0) & wp.where(b < nearest[k], 1, 0)
                light = distance / (width * (1.0 - b / depths[k]))
                here = wp.where(across >= 0.0, 1, 0) & wp.where(distance < width, 1, 0) & wp.where(light < 1.0, 1, 0)
                taken = covered & nearer & here
                nearest[k] = wp.where(taken != 0, b, nearest[k])
                alpha[k] = wp.where(taken != 0, light, alpha[k])
    for k in range(held):
        smoothie_out[y, x0 + k] = wp.vec2(nearest[k], alpha[k])


DRAW = Twin(draw_smoothies, draw_smoothies_lanes, tolerance=1e-4, flips=1e-4)


class Smoothies(SilhouetteMaps):
    """Two maps, one comparison and one lookup a pixel."""

    name = "smoothies"
    paper = ("chan2003", "schwaerzler2009")
    in_loops = True
    needs = Needs(lights=ALL_LIGHTS - {"directional"}, area=True, whole_casters=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_grows": "the umbra keeps the hard shadow's size, where a light wider than its distance leaves none",
    }

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
        width = self.params.width * light_radius(light_map.light) * _mean_nearness(frame, light_map.light_ws)
        self.draw_and_look_up(frame, gbuffer, light_map, "smoothie buffer", DRAW, 0.0, width, visibility_out)


def _mean_nearness(frame: Frame, light_ws: np.ndarray) -> float:
    """The mean of one over the distance of the silhouette's vertices from a point light; 0 where there is none."""

    def find(old: float | None) -> float:
        ends = frame.geometry.points_ws.numpy()[silhouettes.ends.ravel()]
        distance = np.linalg.norm(ends.astype(np.float64) - light_ws[:3], axis=1)
        return float((1.0 / np.maximum(distance, 1e-30)).mean()) if len(distance) else 0.0

    silhouettes = pull_silhouettes(frame, frame.geometry, light_ws)
    out: float = frame.product("width of smoothies", "width of smoothies", silhouettes, find)
    return out
