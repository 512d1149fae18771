"""One light seen by penumbra wedges: silhouettes, hard counts and edges in, visibility of the eye's pixels out."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.casters.pulls import pull_edges, pull_silhouettes
from wkernels.casters.silhouettes import Silhouettes
from wkernels.casters.volume_counts import count_volumes
from wkernels.casters.volume_stencil import darken_in_volumes
from wkernels.raster import Rasteriser
from wkernels.raster.binning import Binner, TileLists
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light
from wkernels.scene.views import HostView
from wkernels.wedges.bodies import WedgeRule, Wedges, bin_wedges, pull_wedges
from wkernels.wedges.light_shapes import HostShape, LightShape, shape_of
from wkernels.wedges.shading import Faces, settle
from wkernels.wedges.shading_lanes import SHADE
from wkernels.workspace.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Stage:
    """What all passes of a frame share.

    Attributes:
        work: Memory, products, stopwatch.
        rasteriser: Counts volumes.
        geometry: The casters.
        gbuffer: What the eye sees.
        eye: The view that it was drawn through.
        mesh_id: The casters' ``wp.Mesh``.
        reach: Length of a way that leaves the scene.
        rule: Around what wedges are.
        culls: Whether wedges before or behind all that a tile shows are left out of its list.
    """

    work: Workspace
    rasteriser: Rasteriser
    geometry: Geometry
    gbuffer: GBuffer
    eye: HostView
    mesh_id: wp.uint64
    reach: float
    rule: WedgeRule
    culls: bool


@dataclass(frozen=True, eq=False)
class Prepared:
    """A light's wedges over a stage.

    Attributes:
        stage: The stage.
        slot: Which of several lights this is.
        shape: The light.
        light: The same for kernels.
        silhouettes: From its centre.
        wedges: Of these.
        faces: What hides its centre.
    """

    stage: Stage
    slot: Hashable
    shape: HostShape
    light: LightShape
    silhouettes: Silhouettes
    wedges: Wedges
    faces: Faces

    def count(self) -> wp.array:
        """Hard counts, int32 (H, W), valid until the next call."""
        stage = self.stage
        return count_volumes(
            stage.work,
            stage.rasteriser,
            stage.geometry,
            stage.gbuffer,
            stage.eye,
            self.shape.light_ws,
            slot=self.slot,
        )

    def lists(self, wedges: Wedges) -> TileLists:
        """Some of its wedges in lists per tile, valid until the next call."""
        stage = self.stage
        work = stage.work
        binner: Binner = work.product(
            "memory for lists", "wedge binner", (), lambda old: old or Binner(work.device, work.threads)
        )
        with work.timed("lists of wedges"):
            seen = stage.gbuffer.depth if stage.culls else None
            return bin_wedges(binner, wedges, stage.gbuffer.view, seen)


def prepare(stage: Stage, light: Light, slot: Hashable = 0) -> Prepared | None:
    """Silhouettes and wedges of a light, found once for light and casters; None if it has no area.

    Args:
        stage: Where.
        light: Sphere, disc, sun or rectangle, rebased world.
        slot: Which of several lights this is.
    """
    work, geometry = stage.work, stage.geometry
    box = geometry.bounds(casters=True)
    shape = shape_of(light, 0.5 * (box.low + box.high))
    if shape is None:
        return None
    silhouettes = pull_silhouettes(work, geometry, shape.light_ws, slot=slot)
    wedges = pull_wedges(work, geometry.points_ws, silhouettes, shape, stage.rule, slot)
    adjacency = pull_edges(work, geometry)
    faces = Faces()
    faces.mesh_id, faces.points_ws, faces.reach = stage.mesh_id, geometry.points_ws, stage.reach

    def upload(old: tuple[wp.array, wp.array] | None) -> tuple[wp.array, wp.array]:
        indices = wp.array(np.ascontiguousarray(adjacency.faces.ravel()), dtype=int, device=work.device)
        return indices, wp.array(silhouettes.turns, dtype=wp.int8, device=work.device)

    faces.indices, faces.turns = work.product("faces for recounts", ("faces", slot), silhouettes, upload)
    return Prepared(stage, slot, shape, shape.to_device(stage.reach), silhouettes, wedges, faces)


def see_by_wedges(prepared: Prepared, visibility_out: wp.array) -> None:
    """Visibility of a light, float32 (H, W): hard counts and all its edges together."""
    stage, work = prepared.stage, prepared.stage.work
    counts = prepared.count()
    lists = prepared.lists(prepared.wedges)
    edges = prepared.wedges.edges
    with work.timed("penumbra wedges"):
        inputs = [stage.gbuffer, prepared.light, edges, lists, counts]
        work.launch(SHADE, visibility_out.shape, inputs, [visibility_out])
    settle_untrusted(prepared, prepared.wedges, lists, prepared.faces, visibility_out)


def settle_untrusted(
    prepared: Prepared, wedges: Wedges, lists: TileLists, faces: Faces, visibility_out: wp.array
) -> None:
    """Settles the receivers that are ``UNTRUSTED``."""
    stage = prepared.stage
    light_ws = wp.vec4d(*prepared.shape.light_ws)
    with stage.work.timed("recounts"):
        inputs = [stage.gbuffer, prepared.light, light_ws, wedges.edges, lists, faces]
        stage.work.launch(settle, visibility_out.shape, inputs, [visibility_out])


def see_hard(stage: Stage, light: Light, visibility_out: wp.array) -> None:
    """Visibility of a light's centre, float32 (H, W), by its volumes alone."""
    work, light_ws = stage.work, light.centre
    counts = count_volumes(work, stage.rasteriser, stage.geometry, stage.gbuffer, stage.eye, light_ws)
    visibility_out.fill_(1.0)
    darken_in_volumes(work, stage.gbuffer, counts, light_ws, visibility_out)
