"""Passes 1 to 3 of the lane rasteriser as one call: the triangles of a mesh, listed per band of rows of a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.lane_bands import LANES as BAND_LANES
from wkernels.raster.lane_bands import Ints as BandInts
from wkernels.raster.lane_culling import (
    LANES,
    CullShape,
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
from wkernels.raster.triangles import CLIP_TRIANGLES, CLIP_VERTICES, clip_triangles
from wkernels.views import View

CHUNKS = 32
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
        clip_vertex, clip_begin = _runs(vertices) * LANES, _runs(triangles) * LANES  # where those of clipped ones go
        band_shift = int(np.log2(min(64, max(8, BAND_BYTES // (4 * view.width)), max(1, -(-view.height // 4)))))
        band_rows = 1 << band_shift
        bands = -(-view.height // band_rows)

        self._hold_corners(indices, clip_begin)
        self._hold_vertices(clip_vertex)
        if vertices:
            inputs: list[Any] = [*self._point_runs(points_ws), view, perspective]
            scratch.launch(project_lanes, _runs(vertices), inputs, [self._vertex_runs, self._key_runs])

        survivor, span, clipped = (scratch.array(name, (triangles,), int) for name in ("survivor", "span", "clipped"))
        found = scratch.array("found", (2, CHUNKS + 1), int)
        counts = scratch.array("counts", (bands, CHUNKS + 1), int)
        shape = CullShape()
        shape.width, shape.height, shape.band_shift, shape.cull = view.width, view.height, band_shift, cull
        outputs = [survivor, span, clipped, found, counts]
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [self._corner_runs, self._corner_pitch, self._vertex, 0, triangles, 0, CHUNKS, shape]
            scratch.launch(cull_lanes, CHUNKS, inputs, outputs)
        chunk_begin = _chunk_begin(triangles, clip_begin)
        crossing = [
            clipped.numpy()[b : b + n] for b, n in zip(chunk_begin, found.numpy()[1, :CHUNKS], strict=False) if n
        ]
        slots = sum(len(part) for part in crossing)
        clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
        if slots:
            which = wp.array(np.concatenate(crossing), dtype=int, device="cpu")
            clip_screen = scratch.array("clip screen", (slots * CLIP_VERTICES,), wp.vec4)
            clip_corners = scratch.array("clip corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
            inputs = [points_ws, indices, which, view]
            scratch.launch(clip_triangles, slots, inputs, [clip_screen, clip_corners, clip_triangle])
            total = clip_begin + slots * CLIP_TRIANGLES
            self._hold_corners(indices, total)
            self._hold_vertices(clip_vertex + slots * CLIP_VERTICES, keep=clip_vertex)
            survivor, span = (self._grown(name, total, triangles) for name in ("survivor", "span"))
            inputs = [clip_screen, clip_corners, clip_vertex, clip_begin, perspective]
            outputs = [self._vertex, self._key, self._corners, self._corner_pitch * LANES]
            scratch.launch(append_clipped, slots, inputs, outputs)
            inputs = [self._corner_runs, self._corner_pitch, self._vertex, clip_begin, total, CHUNKS, 1, shape]
            scratch.launch(cull_lanes, 1, inputs, [survivor, span, clipped, found, counts])

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
        corners, pitch = self._corners, self._corner_pitch * int(LANES)
        return BandLists(
            corners, pitch, self._vertex, self._key, clip_triangle, clip_begin, band_begin, list_runs, bands, band_rows
        )

    def _point_runs(self, points_ws: wp.array) -> tuple[wp.array, wp.array]:
        """Points in whole runs, and a run of what is left of them."""
        whole = len(points_ws) // LANES
        runs = wp.array(ptr=points_ws.ptr, dtype=Points, shape=whole, device="cpu")
        rest = self._scratch.array("last points", (1, 1), Points)
        left = points_ws.numpy()[whole * LANES :].ravel()
        rest.numpy().ravel()[: left.size] = left
        return runs, rest

    def _hold_vertices(self, count: int, keep: int = 0) -> None:
        """Room for the vertices' coordinates and keys, in whole runs; the first ``keep`` stay as they are."""
        count = _runs(count) * LANES
        self._vertex, self._key = self._grown("vertex", count, keep, wp.int64), self._grown("key", count, keep, float)
        self._vertex_runs = wp.array(ptr=self._vertex.ptr, dtype=Longs, shape=_runs(count), device="cpu")
        self._key_runs = wp.array(ptr=self._key.ptr, dtype=Floats, shape=_runs(count), device="cpu")

    def _grown(self, name: str, count: int, keep: int, dtype: type = int) -> wp.array:
        """A scratch array of at least ``count``; its first ``keep`` elements survive if it has to grow."""
        old = self._scratch.array(name, (keep,), dtype) if keep else None
        new = self._scratch.array(name, (count,), dtype)
        if old is not None and old.ptr != new.ptr:
            wp.copy(new, old, count=keep)
        return new

    def _hold_corners(self, indices: wp.array, count: int) -> None:
        """All first corners, then all second ones, then all third ones, each with room for ``count`` in whole runs."""
        if self._corners_of is indices and self._corner_pitch * LANES >= count:
            return
        self._corner_pitch = _runs(count + count // 8)
        self._corners = self._scratch.array("corners", (3 * self._corner_pitch * LANES,), int)
        self._corner_runs = wp.array(ptr=self._corners.ptr, dtype=Ints, shape=3 * self._corner_pitch, device="cpu")
        held = self._corners.numpy()[: 3 * self._corner_pitch * LANES].reshape(3, -1)
        triangles = len(indices) // 3
        held[:, :triangles] = indices.numpy()[: 3 * triangles].reshape(-1, 3).T
        held[:, triangles:] = 0
        self._corners_of = indices


def _runs(count: int) -> int:
    return -(-count // LANES)


def _chunk_begin(triangles: int, clip_begin: int) -> np.ndarray:
    """First triangle of each chunk, as ``lane_culling.chunk_start`` has it, and of the clipped ones."""
    starts = [min(_runs(triangles) * k // CHUNKS * LANES, triangles) for k in range(CHUNKS)]
    return np.array([*starts, clip_begin], dtype=np.int32)
