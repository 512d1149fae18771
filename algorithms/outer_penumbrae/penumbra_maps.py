"""Penumbra maps: cones and sheets behind the silhouette, drawn into a map beside the light map (Wyman and Hansen 2003).

1. A light map from the light's centre gives hard shadows; a second one the depth Z_P of the nearest surface of all,
   caster or not, in each of its texels.
2. Each silhouette vertex carries a cone that opens away from the light to the width of the outer penumbra, and each
   edge a sheet that touches the cones of both ends (Schwaerzler 2009, section 4.10). Where one of them, at depth Z_F,
   lies before the texel's surface, the texel's light is

       I = (Z_F - Z_v) / (Z_P - Z_v)

   (equation 4.7), Z_v being the depth of the vertex, interpolated along sheets: 0 at the silhouette, 1 where the cone
   meets the surface. The least of all is kept.
3. A pixel that is in the hard shadow is dark; any other that is farther than Z_v has its texel's light.

Of one edge and a flat surface I is the ramp of ``plateaus`` times k_P / k_F, the inverse depths of surface and cone:
less than the ramp in between, and the same at both ends.

Deviations: sheets and cones are not drawn as triangles; where a texel's ray meets them is found in closed form
(``casters.outer_edges``), on the outer side of their edge only. The map holds Z_v too: without it the caster's own
border, which shares its texels with what lies behind, would be dark. A light of another shape than a ball counts as one
of half its size; a directional light of angle a has cones of slope tan(a / 2).
Known artefacts: too dark: the umbra has the size of the hard shadow, however large the light. Silhouettes are those
from the centre, which a light that is large against a caster does not see alone. The penumbra has the texels of the
map, as hard edges have. Where several surfaces behind Z_v share a texel (an edge of the receiver, a leaf over the
ground) all of them have the light of the nearest.
"""

from __future__ import annotations

from typing import ClassVar

import warp as wp

from algorithms.outer_penumbrae._silhouette_maps import SilhouetteMaps
from algorithms.technique import Frame
from wkernels.casters.outer_edges import OuterEdges, light_radius, nearest_outside
from wkernels.device.lanes import LANES, Floats
from wkernels.device.twin import Twin
from wkernels.light_maps.host_map import HostMap
from wkernels.raster.binning import TileLists, tile_at
from wkernels.raster.gbuffer import GBuffer


@wp.kernel
def draw_penumbrae(
    first: int,
    depth: wp.array2d(dtype=float),
    lists: TileLists,
    edges: OuterEdges,
    to_plane: wp.mat33,
    in_perspective: int,
    radius: float,
    light_out: wp.array2d(dtype=wp.vec2),
):
    """Z_v and I, the least of equation 4.7 in each texel; +inf and 1 where there is no penumbra."""
    row, x = wp.tid()
    y = first + row
    light = float(1.0)
    own = float(0.0)
    tile = tile_at(lists, y, x)
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    if begin < end and depth[y, x] < wp.inf:
        p = to_plane * wp.vec3(float(x) + 0.5, float(y) + 0.5, 1.0)
        key = wp.where(in_perspective != 0, -1.0 / depth[y, x], depth[y, x])
        for i in range(begin, end):
            edge = lists.shape[i]
            near = nearest_outside(edges.line[edge], edges.ramp[edge], p[0] / p[2], p[1] / p[2])
            cone = near[1] + near[0] / radius
            if cone < key:
                share = (cone - near[1]) / (key - near[1]) * wp.where(in_perspective != 0, key / cone, 1.0)
                if share < light:
                    light = share
                    own = near[1]
    begins = wp.where(in_perspective != 0, -1.0 / own, own)
    light_out[y, x] = wp.vec2(wp.where(light < 1.0, begins, wp.inf), light)


@wp.kernel
def draw_penumbrae_lanes(
    first: int,
    depth: wp.array2d(dtype=float),
    lists: TileLists,
    edges: OuterEdges,
    to_plane: wp.mat33,
    in_perspective: int,
    radius: float,
    light_out: wp.array2d(dtype=wp.vec2),
):
    """``draw_penumbrae`` of a run of texels, which lies in one tile."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    tile = tile_at(lists, y, x0)
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    held = wp.min(LANES, light_out.shape[1] - x0)
    light = Floats(1.0)
    begins = Floats(float(wp.inf))
    if begin < end:
        keys = Floats(-float(wp.inf))
        for k in range(held):
            if depth[y, x0 + k] < wp.inf:
                keys[k] = wp.where(in_perspective != 0, -1.0 / depth[y, x0 + k], depth[y, x0 + k])
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
                own = key_0 + change * foot
                cone = own + distance / radius
                share = (cone - own) / (keys[k] - own) * wp.where(in_perspective != 0, keys[k] / cone, 1.0)
                covered = wp.where(across >= 0.0, 1, 0) & wp.where(cone < keys[k], 1, 0)
                taken = covered & wp.where(share < light[k], 1, 0)
                light[k] = wp.where(taken != 0, share, light[k])
                begins[k] = wp.where(taken != 0, wp.where(in_perspective != 0, -1.0 / own, own), begins[k])
    for k in range(held):
        light_out[y, x0 + k] = wp.vec2(begins[k], light[k])


DRAW = Twin(draw_penumbrae, draw_penumbrae_lanes, tolerance=1e-4, flips=1e-4)


class PenumbraMaps(SilhouetteMaps):
    """Two maps, one comparison and one lookup a pixel."""

    name = "penumbra_maps"
    paper = ("wyman2003", "schwaerzler2009")
    stability_limits: ClassVar[dict[str, str]] = {
        "light_grows": "the umbra keeps the hard shadow's size, where a light wider than its distance leaves none",
        "contact_light": "half of a light that a plate cuts is seen from everywhere; its dark half alone is shown",
    }

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        radius = light_radius(light_map.light)
        self.draw_and_look_up(frame, gbuffer, light_map, "penumbra map", DRAW, radius, 0.0, visibility_out)
