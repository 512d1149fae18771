"""Plateaus: hard shadows on planes, with cones round the silhouette's vertices and patches between them (Haines 2001).

1. Hard shadows of the light's centre, by shadow volumes (Schwaerzler 2009, section 4.9).
2. On each plane that receives, each silhouette vertex at height h below a light at height H throws a disc of radius w
   = R h / (H - h), R being the light's radius, that is lit fully at its border and not at all in its middle. (Assarsson
   et al. 2003, section 2, tell it the other way round, which is the intensity of the shadow.) Between the discs of an
   edge's ends lies a Coons patch with the same ramp. With the point's distance d from the foot of its line on the
   edge, where the disc has the radius w, lit = d / w (``casters.outer_edges``).
3. The darkest of all counts, and the hard shadow is dark.

Deviations: the ramp is found in each pixel that shows the plane, not in a texture on it. Cones and patches count on the
outer side of their edge only; the inner one is in shadow, and there a cone of one edge would darken the light beyond
another. Discs are round under a slanted light too. A light of another shape than a ball counts as one of half its size;
a directional light of angle a has w = tan(a / 2) times the vertex's distance along the light. Receivers that are not
flat have the hard shadow alone.
Known artefacts: too dark: the umbra has the size of the hard shadow, however large the light (it should be narrower by
R h / (H - h) on each side), and is never lost. Silhouettes are those from the centre, so that a light that is large
against a caster sees other ones; a silhouette in the shadow of another caster has a penumbra too.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from algorithms.technique import Frame, Limit, Needs, Technique
from wkernels.casters.flattening import BELOW_LIGHT
from wkernels.casters.outer_edges import (
    LightPlane,
    OuterEdges,
    bin_edges,
    light_plane,
    light_radius,
    nearest_outside,
    to_light_plane,
)
from wkernels.casters.pulls import pull_silhouettes
from wkernels.casters.receiver_planes import extent_of, pull_planes, turned_to_light
from wkernels.casters.volume_counts import Uncounted, count_volumes
from wkernels.casters.volume_stencil import darken_in_volumes
from wkernels.device.lanes import LANES, Floats, Ints, Vectors, runs_of, store_run
from wkernels.device.twin import Twin
from wkernels.raster.binning import Binner, TileLists, tile_at
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product

FARTHEST = 1e30
"""How far above a receiver a caster under a directional light may be."""


class Skip(Omission):
    """What lights and planes save."""

    NO_RAMP = "plateaus", Because.NO_AREA
    UNSEEN = "plateaus", "no pixel shows the plane"
    FLAT_NONE = "plateaus", "no receiver is flat"


@wp.kernel
def darken_plateaus(
    first: int,
    gbuffer: GBuffer,
    plane_of_mesh: wp.array(dtype=int),
    number: int,
    plane: LightPlane,
    lists: TileLists,
    edges: OuterEdges,
    radius: float,
    visibility_out: wp.array2d(dtype=float),
):
    """The darkest ramp at each pixel that shows one plane; others keep what they have."""
    row, x = wp.tid()
    y = first + row
    lit = visibility_out[y, x]
    tile = tile_at(lists, y, x)
    mesh = gbuffer.mesh[y, x]
    if mesh >= 0 and lists.begin[tile] < lists.begin[tile + 1]:
        if plane_of_mesh[mesh] == number:
            p = to_light_plane(plane, gbuffer.position_ws[y, x])
            for i in range(lists.begin[tile], lists.begin[tile + 1]):
                edge = lists.shape[i]
                near = nearest_outside(edges.line[edge], edges.ramp[edge], p[0], p[1])
                width = radius * (p[2] - near[1])
                if near[0] < width:
                    lit = wp.min(lit, near[0] / width)
    visibility_out[y, x] = lit


@wp.kernel
def darken_plateaus_lanes(
    first: int,
    position_ws: wp.array(dtype=Vectors),  # a run from every component on
    mesh: wp.array(dtype=Ints),
    plane_of_mesh: wp.array(dtype=int),
    number: int,
    plane: LightPlane,
    lists: TileLists,
    edges: OuterEdges,
    radius: float,
    visibility_out: wp.array2d(dtype=float),
):
    """``darken_plateaus`` of a run of pixels, which lies in one tile."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    tile = tile_at(lists, y, x0)
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    if begin < end:
        pixel = y * visibility_out.shape[1] + x0
        meshes = mesh[pixel]
        positions = position_ws[3 * pixel]
        here = Ints(0)
        lit = Floats(1.0)
        count = int(0)
        for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
            lit[k] = visibility_out[y, x0 + k]
            if meshes[k] >= 0:
                if plane_of_mesh[meshes[k]] == number:
                    here[k] = 1
                    count += 1
        if count > 0:
            xs = Floats(0.0)
            ys = Floats(0.0)
            keys = Floats(0.0)
            for k in range(LANES):
                p = to_light_plane(plane, wp.vec3(positions[3 * k], positions[3 * k + 1], positions[3 * k + 2]))
                xs[k] = p[0]
                ys[k] = p[1]
                keys[k] = p[2]
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
                    width = radius * (keys[k] - (key_0 + change * foot))
                    inside = wp.where(across >= 0.0, here[k], 0) & wp.where(distance < width, 1, 0)
                    lit[k] = wp.min(lit[k], wp.where(inside != 0, distance / width, 1.0))
            store_run(lit, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, *others: object) -> list:
    return [runs_of(gbuffer.position_ws, Vectors, 3 * PADDING), runs_of(gbuffer.mesh, Ints, PADDING), *others]


DARKEN = Twin(darken_plateaus, darken_plateaus_lanes, inputs=_in_lanes, tolerance=1e-5)


class Plateaus(Technique):
    """Hard volumes, and ramps round the hard shadows on planes."""

    name = "plateaus"
    family = "outer_penumbrae"
    paper = ("haines2001", "schwaerzler2009", "assarsson2003")
    needs = Needs(area=True, planar_receiver=True, whole_casters=True)
    products = (Product.G_BUFFER, Product.CASTER_EDGES, Product.SILHOUETTES, Product.VOLUMES)
    bias_sign = "darker"
    may_leave_out = (Skip.NO_RAMP, Skip.UNSEEN, Skip.FLAT_NONE, Uncounted.BESIDE)
    limits = (
        Limit(equals="shadow_volume_zfail", light_scale=0.0),
        Limit(equals="ray_cast_point_shadow", light_scale=0.0, tolerance=1e-6, flips=0.002),
    )

    stability_limits: ClassVar[dict[str, str]] = {
        "light_grows": "the umbra keeps the hard shadow's size, where a light wider than its distance leaves none",
        "contact_light": "half of a light that a plate cuts is seen from everywhere; its dark half alone is shown",
    }

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        light_ws = frame.light.centre
        visibility.fill_(1.0)
        if frame.light.has_area or not frame.leave_out(Skip.NO_RAMP):
            self._add_ramps(frame, gbuffer, light_ws, visibility)
        counts = count_volumes(frame, frame.rasteriser, frame.geometry, gbuffer, frame.eye(), light_ws)
        darken_in_volumes(frame, gbuffer, counts, light_ws, visibility)
        return visibility

    def _add_ramps(self, frame: Frame, gbuffer: GBuffer, light_ws: np.ndarray, visibility_out: wp.array) -> None:
        geometry = frame.geometry
        planes = pull_planes(frame, frame.geometry, frame.index, gbuffer, Skip.UNSEEN, Skip.FLAT_NONE)
        plane_of_mesh = np.full(max(len(geometry.meshes), 1), -1, np.int32)
        for number, plane in planes:
            plane_of_mesh[plane.meshes] = number
        numbers = wp.array(plane_of_mesh, dtype=int, device=frame.device)
        silhouettes = pull_silhouettes(frame, geometry, light_ws)
        extent, radius = extent_of(geometry), light_radius(frame.light)
        binner = frame.product("memory for lists", "binner", (), lambda old: old or Binner(frame.device, frame.threads))
        for number, plane in planes:
            turned = turned_to_light(plane.plane, light_ws, extent)
            if turned is None or not len(silhouettes.edge):
                continue
            with frame.timed("plateaus"):
                across, depths, scale = _below(turned, light_ws)
                wide = radius * scale
                points = geometry.points_ws
                bins = bin_edges(frame, binner, points, silhouettes, across, depths, wide, gbuffer.view)
                inputs = [gbuffer, numbers, number, bins.plane, bins.lists, bins.edges, wide]
                frame.launch(DARKEN, visibility_out.shape, inputs, [visibility_out])


def _below(plane: np.ndarray, light_ws: np.ndarray) -> tuple[LightPlane, tuple[float, float], float]:
    """How a light sees what is above a receiver's plane.

    Args:
        plane: (4,), the unit normal on the light's side.
        light_ws: Light point (4,).

    Returns:
        Coordinates whose depth is measured across the receiver, the depths of what is between light and receiver, and
        by what the light's radius is multiplied there.
    """
    axis = -plane[:3]
    if light_ws[3] > 0.0:
        height = float(plane @ light_ws)
        return light_plane(light_ws, axis, float(plane[:3] @ light_ws[:3])), (BELOW_LIGHT * height, height), 1.0
    return light_plane(light_ws, axis, 0.0), (-FARTHEST, float(plane[3])), 1.0 / float(plane[:3] @ light_ws[:3])
