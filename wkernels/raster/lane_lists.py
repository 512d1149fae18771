"""Passes 1 to 3 of the lane rasteriser as one call: the triangles of a mesh, listed per band of rows of a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.blocks import BlockViews
from wkernels.raster.clipping import CLIP_TRIANGLES, CLIP_VERTICES, clip_homogeneous, clip_triangles
from wkernels.raster.homogeneous import pack_homogeneous
from wkernels.raster.lane_bands import BAND_LANES
from wkernels.raster.lane_bands import Ints as BandInts
from wkernels.raster.lane_culling import (
    MESH_LANES,
    Floats,
    Ints,
    Longs,
    Points,
    append_clipped,
    cull_lanes,
    list_bands,
    project_lanes,
)
from wkernels.raster.scratch import Scratch
from wkernels.raster.split_culling import (
    CullShape,
    Splits,
    cull_cloned,
    cull_instanced,
    project_cloned,
    project_instanced,
)
from wkernels.scene.views import View

CHUNKS = 32
CLIP_RUNS = 64  # room for the clipped triangles' vertices behind those of each of many views
BAND_BYTES = 2**18  # a band's depths stay in the second-level cache


@dataclass
class BandLists:
    """What pass 4 reads, valid until the next call.

    Attributes:
        corners: int32, all first corners, then all second ones, then all third ones, ``corner_pitch`` apart; those of
            pieces of clipped triangles behind the mesh's.
        vertex: int64, snapped columns and rows, ``lane_culling.pack``.
        key: float32, their depth keys.
        clip_triangle: int32, the mesh's triangle of each piece, ``first_clipped`` and on.
        begin: int32 (bands + 1,), where each band's part of ``listed`` begins.
        listed: Triangles, a run from every entry on.
        bands, band_rows: Bands, and rows in each.
    """

    corners: wp.array
    corner_pitch: int
    vertex: wp.array
    key: wp.array
    clip_triangle: wp.array
    first_clipped: int
    begin: wp.array
    listed: wp.array
    bands: int
    band_rows: int


@dataclass
class Culled:
    """What passes 1 and 2 leave of the triangles for one view; of the outputs of ``cull_lanes``, and the vertices."""

    vertex: wp.array
    key: wp.array
    survivor: wp.array
    span: wp.array
    clipped: wp.array
    found: wp.array
    counts: wp.array


class LaneLists:
    """The passes that every use of the lane rasteriser shares.

    Args:
        scratch: Memory, device and threads.
    """

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch
        self._corners_of: wp.array | None = None  # whose corners are held
        self._corner_pitch = 0  # in runs

    def list(self, points_ws: wp.array, indices: wp.array, view: View, perspective: int, cull: int) -> BandLists:
        """Projects, culls, clips and lists all triangles; arguments as for ``LaneRasteriser.draw``."""
        scratch = self._scratch
        vertices, triangles = len(points_ws), len(indices) // 3
        shape, bands = _shape_of(view, cull)
        self._hold_corners(indices, _runs(triangles) * MESH_LANES)
        room = _runs(vertices) * MESH_LANES
        vertex, key = scratch.array("vertex", (room,), wp.int64), scratch.array("key", (room,), float)
        inputs: list[Any]
        if points_ws.dtype is wp.vec4:
            scratch.launch(pack_homogeneous, vertices, [points_ws, view, perspective], [vertex, key])
        elif vertices:
            inputs = [*self._point_runs(points_ws), view, perspective]
            scratch.launch(project_lanes, _runs(vertices), inputs, [_in_runs(vertex, Longs), _in_runs(key, Floats)])
        survivor, span, clipped = (scratch.array(name, (triangles,), int) for name in ("survivor", "span", "clipped"))
        found = scratch.array("found", (2, CHUNKS + 1), int)
        counts = scratch.array("counts", (bands, CHUNKS + 1), int)
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [self._corner_runs, self._corner_pitch, vertex, 0, triangles, 0, CHUNKS, *_parts(shape)]
            scratch.launch(cull_lanes, CHUNKS, inputs, [survivor, span, clipped, found, counts])
        culled = Culled(vertex, key, survivor, span, clipped, found, counts)
        return self.finish(points_ws, indices, view, perspective, cull, culled)

    def cull_splits(
        self,
        points_ws: wp.array,
        indices: wp.array,
        splits: Splits,
        view: View,
        cull: int,
        seen: BlockViews,
        cloned: bool,
    ) -> Sequence[Culled]:
        """Projects and culls the triangles for many views at once; ``finish`` does the rest for one after the other.

        Args:
            points_ws, indices, cull: As for ``LaneRasteriser.draw``; there is at least one triangle.
            splits: The views; what it says of room is filled in here.
            view: Any of them, as they are all of one size.
            seen: What they need.
            cloned: One work item per block, else one per block and view.
        """
        scratch, views = self._scratch, splits.count
        vertices, triangles = len(points_ws), len(indices) // 3
        shape, bands = _shape_of(view, cull)
        self._hold_corners(indices, _runs(triangles) * MESH_LANES)
        runs = _runs(vertices)
        splits.vertex_runs, splits.triangles = runs + CLIP_RUNS, triangles
        splits.bands, splits.chunks = bands, CHUNKS
        room = splits.vertex_runs * MESH_LANES
        vertex = scratch.array("split vertex", (views * room,), wp.int64)
        key = scratch.array("split key", (views * room,), float)
        survivor, span, clipped = (
            scratch.array(name, (views * triangles,), int) for name in ("split survivor", "split span", "split clipped")
        )
        found = scratch.array("split found", (2 * views, CHUNKS + 1), int)
        counts = scratch.array("split counts", (views * bands, CHUNKS + 1), int)
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        inputs = [*self._point_runs(points_ws), splits, seen.run]
        outputs = [_in_runs(vertex, Longs), _in_runs(key, Floats)]
        project, cull_all = (project_cloned, cull_cloned) if cloned else (project_instanced, cull_instanced)
        scratch.launch(project, runs if cloned else (runs, views), inputs, outputs)
        inputs = [self._corner_runs, self._corner_pitch, vertex, triangles, shape, splits, seen.block]
        outputs = [survivor, span, clipped, found, counts]
        scratch.launch(cull_all, CHUNKS if cloned else (CHUNKS, views), inputs, outputs)
        out = []
        for i in range(views):
            own, part = slice(i * triangles, (i + 1) * triangles), slice(i * room, (i + 1) * room)
            where = found[2 * i : 2 * i + 2], counts[i * bands : (i + 1) * bands]
            out.append(Culled(vertex[part], key[part], survivor[own], span[own], clipped[own], *where))
        return out

    def finish(
        self, points_ws: wp.array, indices: wp.array, view: View, perspective: int, cull: int, culled: Culled
    ) -> BandLists:
        """Clips and lists what is left of the triangles in one view."""
        scratch = self._scratch
        vertices, triangles = len(points_ws), len(indices) // 3
        # where those of clipped ones go
        clip_vertex, clip_begin = _runs(vertices) * MESH_LANES, _runs(triangles) * MESH_LANES
        shape, bands = _shape_of(view, cull)
        vertex, key, survivor, span = culled.vertex, culled.key, culled.survivor, culled.span
        found, counts = culled.found, culled.counts
        chunk_begin = _chunk_begin(triangles, clip_begin)
        crossing = [
            culled.clipped.numpy()[b : b + n] for b, n in zip(chunk_begin, found.numpy()[1, :CHUNKS], strict=False) if n
        ]
        slots = sum(len(part) for part in crossing)
        clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
        if slots:
            which = wp.array(np.concatenate(crossing), dtype=int, device="cpu")
            clip_screen = scratch.array("clip screen", (slots * CLIP_VERTICES,), wp.vec4)
            clip_corners = scratch.array("clip corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
            inputs: list[Any] = [points_ws, indices, which, view]
            clip = clip_homogeneous if points_ws.dtype is wp.vec4 else clip_triangles
            scratch.launch(clip, slots, inputs, [clip_screen, clip_corners, clip_triangle])
            total = clip_begin + slots * CLIP_TRIANGLES
            self._hold_corners(indices, total)
            room = clip_vertex + slots * CLIP_VERTICES
            vertex = self._with_room("vertex", vertex, room, clip_vertex)
            key = self._with_room("key", key, room, clip_vertex)
            survivor = self._with_room("survivor", survivor, total, triangles)
            span = self._with_room("span", span, total, triangles)
            inputs = [clip_screen, clip_corners, clip_vertex, clip_begin, perspective]
            outputs = [vertex, key, self._corners, self._corner_pitch * MESH_LANES]
            scratch.launch(append_clipped, slots, inputs, outputs)
            inputs = [self._corner_runs, self._corner_pitch, vertex, clip_begin, total, CHUNKS, 1, *_parts(shape)]
            scratch.launch(cull_lanes, 1, inputs, [survivor, span, culled.clipped, found, counts])

        starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
        band_begin = scratch.array("band begin", (bands + 1,), int)
        band_begin.numpy()[: bands + 1] = starts[:: CHUNKS + 1]
        counts.numpy().ravel()[:] = starts[:-1]
        listed = int(starts[-1])
        band_list = scratch.array("band list", (listed + BAND_LANES,), int)
        band_list.numpy()[listed:] = 0  # lanes behind the end set up some triangle, which is not drawn
        list_runs = wp.array(ptr=band_list.ptr, dtype=BandInts, shape=listed + 1, strides=(4,), device="cpu")
        begins = wp.array(chunk_begin, dtype=int, device="cpu")
        scratch.launch(list_bands, CHUNKS + 1, [survivor, span, begins, found, counts], [band_list])
        pitch, rows = self._corner_pitch * int(MESH_LANES), 1 << shape.band_shift
        return BandLists(
            self._corners, pitch, vertex, key, clip_triangle, clip_begin, band_begin, list_runs, bands, rows
        )

    def _point_runs(self, points_ws: wp.array) -> tuple[wp.array, wp.array]:
        """Points in whole runs, and a run of what is left of them."""
        whole = len(points_ws) // MESH_LANES
        runs = wp.array(ptr=points_ws.ptr, dtype=Points, shape=whole, device="cpu")
        rest = self._scratch.array("last points", (1, 1), Points)
        left = points_ws.numpy()[whole * MESH_LANES :].ravel()
        rest.numpy().ravel()[: left.size] = left
        return runs, rest

    def _with_room(self, name: str, held: wp.array, count: int, keep: int) -> wp.array:
        """``held`` if it has room for ``count``, else an array that begins with its first ``keep`` elements."""
        if len(held) >= count:
            return held
        new = self._scratch.array(name, (count,), held.dtype)
        if new.ptr != held.ptr:
            wp.copy(new, held, count=keep)
        return new

    def _hold_corners(self, indices: wp.array, count: int) -> None:
        """All first corners, then all second ones, then all third ones, each with room for ``count`` in whole runs."""
        if self._corners_of is indices and self._corner_pitch * MESH_LANES >= count:
            return
        self._corner_pitch = _runs(count + count // 8)
        self._corners = self._scratch.array("corners", (3 * self._corner_pitch * MESH_LANES,), int)
        self._corner_runs = wp.array(ptr=self._corners.ptr, dtype=Ints, shape=3 * self._corner_pitch, device="cpu")
        held = self._corners.numpy()[: 3 * self._corner_pitch * MESH_LANES].reshape(3, -1)
        triangles = len(indices) // 3
        held[:, :triangles] = indices.numpy()[: 3 * triangles].reshape(-1, 3).T
        held[:, triangles:] = 0
        self._corners_of = indices


def _shape_of(view: View, cull: int) -> tuple[CullShape, int]:
    """What triangles are culled for in a view, and its bands."""
    shape = CullShape()
    shape.width, shape.height, shape.cull = view.width, view.height, cull
    shape.band_shift = int(np.log2(min(64, max(8, BAND_BYTES // (4 * view.width)), max(1, -(-view.height // 4)))))
    return shape, -(-view.height // (1 << shape.band_shift))


def _parts(shape: CullShape) -> list[int]:
    """What ``cull_lanes`` takes of it."""
    return [shape.width, shape.height, shape.band_shift, shape.cull]


def _in_runs(values: wp.array, dtype: type) -> wp.array:
    return wp.array(ptr=values.ptr, dtype=dtype, shape=len(values) // int(MESH_LANES), device="cpu")


def _runs(count: int) -> int:
    return -(-count // MESH_LANES)


def _chunk_begin(triangles: int, clip_begin: int) -> np.ndarray:
    """First triangle of each chunk, as ``lane_culling.chunk_start`` has it, and of the clipped ones."""
    starts = [min(_runs(triangles) * k // CHUNKS * MESH_LANES, triangles) for k in range(CHUNKS)]
    return np.array([*starts, clip_begin], dtype=np.int32)
