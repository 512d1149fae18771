"""One light seen by penumbra wedges: silhouettes, hard counts and edges in, visibility of the eye's pixels out."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from wkernels.casters.pulls import pull_edges, pull_silhouettes
from wkernels.casters.silhouettes import Silhouettes
from wkernels.casters.volume_counts import count_volumes
from wkernels.casters.volume_stencil import darken_in_volumes
from wkernels.casters.wedges.bodies import WedgeRule, Wedges, bin_wedges, pull_wedges
from wkernels.casters.wedges.cells import shade_cells
from wkernels.casters.wedges.light_shapes import HostShape, LightShape, shape_of
from wkernels.casters.wedges.near_lists import NearLists, keep_all, keep_near
from wkernels.casters.wedges.shading import Faces, hide_behind_own_plane, settle
from wkernels.casters.wedges.shading_lanes import SHADE
from wkernels.casters.wedges.stored import PLAIN, StorageRule, shade_stored
from wkernels.casters.wedges.textures import LightTexture, shade_textured
from wkernels.raster import Rasteriser
from wkernels.raster.binning import Binner
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light
from wkernels.scene.views import HostView
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

    def count(self, chosen: np.ndarray | None = None) -> wp.array:
        """Hard counts of all casters or of those chosen, bool (C,); int32 (H, W), valid until the next call."""
        stage = self.stage
        return count_volumes(
            stage.work,
            stage.rasteriser,
            stage.geometry,
            stage.gbuffer,
            stage.eye,
            self.shape.light_ws,
            slot=self.slot,
            chosen=chosen,
        )

    def lists(self, wedges: Wedges) -> NearLists:
        """Some of its wedges in lists per tile, valid until the next call."""
        stage = self.stage
        work = stage.work
        binner: Binner = work.product(
            "memory for lists", "wedge binner", (), lambda old: old or Binner(work.device, work.threads)
        )
        with work.timed("lists of wedges"):
            seen = stage.gbuffer.depth if stage.culls else None
            out = NearLists()
            out.lists = bin_wedges(binner, wedges, stage.gbuffer.view, seen)
            tiles = len(out.lists.begin) - 1
            out.end = work.buffer("ends of lists", (tiles,), wp.int32)
            if stage.culls:
                points_ws = stage.geometry.points_ws
                inputs = [stage.gbuffer, self.light, points_ws, wedges.edges, stage.reach]
                work.launch(keep_near, tiles, inputs, [out])
            else:
                work.launch(keep_all, tiles, [], [out])
            return out


def prepare(stage: Stage, light: Light, slot: Hashable = 0) -> Prepared | None:
    """Silhouettes and wedges of a light, found once for light and casters; None if it has no area.

    Args:
        stage: Where.
        light: Sphere, disc, sun or rectangle, rebased world.
        slot: Which of several lights this is.
    """
    work, geometry = stage.work, stage.geometry
    box = geometry.bounds(casters=True)
    shape = shape_of(light, np.zeros(3) if box.empty else 0.5 * (box.low + box.high))
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


def see_by_wedges(prepared: Prepared, visibility_out: wp.array, storage: StorageRule = PLAIN) -> None:
    """Visibility of a light, float32 (H, W): hard counts and all its edges together."""
    _shade(prepared, prepared.wedges, prepared.count(), prepared.faces, storage, visibility_out)


def _shade(
    prepared: Prepared, wedges: Wedges, counts: wp.array, faces: Faces, rule: StorageRule, visibility_out: wp.array
) -> None:
    stage, work = prepared.stage, prepared.stage.work
    lists = prepared.lists(wedges)
    inputs = [stage.gbuffer, prepared.light, wedges.edges, lists, counts]
    with work.timed("penumbrae"):
        if rule.is_plain:
            work.launch(SHADE, visibility_out.shape, inputs, [visibility_out])
        else:
            shape = prepared.shape.shape
            storage = work.product(
                "coverage tables", ("coverage tables", shape, rule), (), lambda old: rule.to_device(shape, work.device)
            )
            work.launch(shade_stored, visibility_out.shape, [*inputs, storage], [visibility_out])
    with work.timed("recounts"):
        inputs = [stage.gbuffer, prepared.light, wp.vec4d(*prepared.shape.light_ws), wedges.edges, lists, faces]
        work.launch(settle, visibility_out.shape, inputs, [visibility_out])


def see_casters_apart(prepared: Prepared, visibility_out: wp.array, storage: StorageRule = PLAIN) -> None:
    """Visibility of a light, float32 (H, W): of every caster on its own, merged one after the other by ``merge_cover``.

    A caster is a connected component, in the order of their numbers: its holes are loops too, and take from its own.
    """
    stage, work, wedges = prepared.stage, prepared.stage.work, prepared.wedges
    turns, of_face = prepared.silhouettes.turns, pull_edges(work, stage.geometry).component
    casters, first = np.unique(wedges.component, return_index=True)
    if len(casters) < 2:
        see_by_wedges(prepared, visibility_out, storage)
        return
    light = prepared.shape.to_device(stage.reach)
    light.own_plane = 0  # it would count once for each caster
    prepared = replace(prepared, light=light)
    part = work.buffer("visibility past one caster", visibility_out.shape, wp.float32)
    visibility_out.fill_(1.0)
    for caster, begin, end in zip(casters, first, [*first[1:], len(wedges.component)], strict=True):
        chosen = np.zeros(len(pull_edges(work, stage.geometry).component_closed), bool)
        chosen[caster] = True
        counts = prepared.count(chosen)
        faces = Faces()
        faces.mesh_id, faces.points_ws, faces.reach = stage.mesh_id, stage.geometry.points_ws, stage.reach
        faces.indices = prepared.faces.indices
        faces.turns = wp.array(np.where(of_face == caster, turns, 0).astype(np.int8), dtype=wp.int8, device=work.device)
        _shade(prepared, wedges.of(slice(int(begin), int(end))), counts, faces, storage, part)
        with work.timed("merging"):
            work.launch(merge_cover, part.shape, [part], [visibility_out])
    light = prepared.shape.to_device(stage.reach)
    work.launch(hide_behind_own_plane, part.shape, [stage.gbuffer, light], [visibility_out])


@wp.kernel
def merge_cover(first: int, part: wp.array2d(dtype=float), visibility_out: wp.array2d(dtype=float)):
    """What two casters cover together, who knows where: the greater and half of the lesser (Assarsson 2003, eq. 1)."""
    row, x = wp.tid()
    y = first + row
    a = 1.0 - visibility_out[y, x]
    b = 1.0 - part[y, x]
    visibility_out[y, x] = wp.max(0.0, 1.0 - (wp.max(a, b) + 0.5 * wp.min(a, b)))


@wp.kernel
def add_part(
    first: int, part: wp.array2d(dtype=float), share: float, begins: int, visibility_out: wp.array2d(dtype=float)
):
    """Adds a share of one image to another, or begins it."""
    row, x = wp.tid()
    y = first + row
    before = float(0.0)
    if begins == 0:
        before = visibility_out[y, x]
    visibility_out[y, x] = before + share * part[y, x]


def see_textured(prepared: Prepared, texture: LightTexture, visibility_out: wp.array) -> None:
    """Visibility of a light with a texture, float32 (H, W)."""
    stage, work = prepared.stage, prepared.stage.work
    counts, lists = prepared.count(), prepared.lists(prepared.wedges)
    with work.timed("penumbrae"):
        inputs = [*_exact_inputs(prepared, lists), texture, counts]
        work.launch(shade_textured, visibility_out.shape, [stage.gbuffer, *inputs], [visibility_out])


def see_cells(prepared: Prepared, visibility_out: wp.array) -> None:
    """Visibility of a light, float32 (H, W), as the share of its cells that nothing hides."""
    stage, work = prepared.stage, prepared.stage.work
    counts, lists = prepared.count(), prepared.lists(prepared.wedges)
    with work.timed("penumbrae"):
        inputs = [*_exact_inputs(prepared, lists), counts]
        work.launch(shade_cells, visibility_out.shape, [stage.gbuffer, *inputs], [visibility_out])


def _exact_inputs(prepared: Prepared, lists: NearLists) -> list:
    return [prepared.light, wp.vec4d(*prepared.shape.light_ws), prepared.wedges.edges, lists, prepared.faces]


def see_hard(stage: Stage, light: Light, visibility_out: wp.array) -> None:
    """Visibility of a light's centre, float32 (H, W), by its volumes alone."""
    work, light_ws = stage.work, light.centre
    counts = count_volumes(work, stage.rasteriser, stage.geometry, stage.gbuffer, stage.eye, light_ws)
    visibility_out.fill_(1.0)
    darken_in_volumes(work, stage.gbuffer, counts, light_ws, visibility_out)
