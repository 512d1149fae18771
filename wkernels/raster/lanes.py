"""The CPU rasteriser: four passes whose inner loops LLVM turns into SIMD.

1. ``project_lanes``: vertices to snapped screen coordinates and a depth key that is affine on the screen.
2. ``cull_lanes``: boxes, orientation and area of 128 triangles at a time; survivors are counted per band of rows.
3. ``list_bands``: survivors into the bands' lists, in triangle order.
4. ``draw_band``: 64 triangles at a time are set up, then each is drawn in pieces of 8 pixels of a row.

A loop becomes SIMD where it has a constant trip count, fixed-size local vectors for storage, and flat scalar arrays;
that is why coordinates are kept apart, and why ``where`` stands for ``if``. Coverage is that of ``triangles.edge``:
edge functions of triangles up to 128 pixels wide fit 32 bits, and as all pixel centres share their value modulo one
pixel, what is left after dividing by 256 fits the 24 bits of a float exactly. Wider triangles get the exact span of
each row from 64-bit divisions. The key is the depth itself for orthographic views and -1/depth for perspective ones, so
that nearer is less in both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.lane_bands import PIECE, Piece, Target, draw_band
from wkernels.raster.lane_culling import LANES, append_clipped, cull_lanes, list_bands, project_lanes
from wkernels.raster.scratch import Scratch
from wkernels.raster.triangles import CLIP_TRIANGLES, CLIP_VERTICES, clip_triangles
from wkernels.views import View

MAX_TRIANGLES = 2**24  # the triangle of a pixel is kept in a float, next to its depth
CHUNKS = 32
BAND_BYTES = 2**18  # a band's depths stay in the second-level cache
PERSPECTIVE, ORTHOGRAPHIC = 1, 0

_STEPS = Piece(*range(PIECE))


def projection_kind(view: View) -> int | None:
    """PERSPECTIVE, ORTHOGRAPHIC, or None for a view whose depth key is not affine on the screen (a warped one)."""
    rows = np.array(view.ws_to_ss, dtype=np.float32).reshape(4, 4)
    if np.array_equal(rows[3], (0.0, 0.0, 0.0, 1.0)):
        return ORTHOGRAPHIC
    return PERSPECTIVE if np.array_equal(rows[3], rows[2]) else None


class LaneRasteriser:
    """Draws perspective and orthographic views on the CPU.

    Args:
        scratch: Memory, device and threads.
    """

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch
        self._corners_of: wp.array | None = None  # whose copy the first part of the scratch "corners" is

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        perspective: int,
        depth_out: wp.array,
        triangle_out: wp.array | None,
        cull: int,
    ) -> None:
        """``Rasteriser.draw`` for fewer than MAX_TRIANGLES triangles; ``perspective`` is ``projection_kind(view)``."""
        scratch = self._scratch
        vertices, triangles = len(points_ws), len(indices) // 3
        pitch = -(-(view.width + PIECE) // PIECE) * PIECE  # a piece may begin at the last pixel of a row
        band_rows = min(64, max(8, BAND_BYTES // (4 * pitch)), max(1, -(-view.height // 4)))
        bands = -(-view.height // band_rows)

        corners = self._corners(indices, 3 * triangles)
        column, row, key = self._vertices(vertices)
        flat = wp.array(ptr=points_ws.ptr, dtype=float, shape=3 * vertices, device="cpu") if vertices else points_ws
        inputs: list[Any] = [flat, vertices, view, perspective]
        scratch.launch(project_lanes, -(-vertices // LANES), inputs, [column, row, key])

        survivor, span, clipped = (scratch.array(name, (triangles,), int) for name in ("survivor", "span", "clipped"))
        found = scratch.array("found", (2, CHUNKS + 1), int)
        counts = scratch.array("counts", (bands, CHUNKS + 1), int)
        chunk_begin = np.array([triangles * k // CHUNKS for k in range(CHUNKS + 1)], dtype=np.int32)
        shape = [view.width, view.height, band_rows, cull]
        outputs = [survivor, span, clipped, found, counts]
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [corners, column, row, 0, triangles, 0, CHUNKS, *shape]
            scratch.launch(cull_lanes, CHUNKS, inputs, outputs)
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
            total = triangles + slots * CLIP_TRIANGLES
            corners = self._corners(indices, 3 * total)
            column, row, key = self._vertices(vertices + slots * CLIP_VERTICES, keep=vertices)
            survivor, span = (self._grown(name, total, triangles) for name in ("survivor", "span"))
            inputs = [clip_screen, clip_corners, vertices, triangles, perspective]
            scratch.launch(append_clipped, slots, inputs, [column, row, key, corners])
            inputs = [corners, column, row, triangles, total, CHUNKS, 1, *shape]
            scratch.launch(cull_lanes, 1, inputs, [survivor, span, clipped, found, counts])

        starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
        band_begin = scratch.array("band begin", (bands + 1,), int)
        band_begin.numpy()[: bands + 1] = starts[:: CHUNKS + 1]
        counts.numpy().ravel()[:] = starts[:-1]
        band_list = scratch.array("band list", (int(starts[-1]),), int)
        begins = wp.array(chunk_begin, dtype=int, device="cpu")
        scratch.launch(list_bands, CHUNKS + 1, [survivor, span, begins, found, counts], [band_list])

        target = self._target(pitch, bands * band_rows, view.width, triangle_out is not None)
        if triangle_out is None:
            triangle_out = scratch.array("no triangles", (1, 1), int)
        pixels = view.width * view.height
        inputs = [corners, column, row, key, clip_triangle, triangles, band_begin, band_list, band_rows, view.height]
        inputs += [view.far, perspective, cull, _STEPS, target, _pieces(depth_out.ptr, pixels)]
        scratch.launch(draw_band, bands, inputs, [depth_out, triangle_out], tile=1)

    def _vertices(self, count: int, keep: int = 0) -> list[wp.array]:
        names = (("column", int), ("row", int), ("key", float))
        return [self._grown(name, count, keep, dtype) for name, dtype in names]

    def _grown(self, name: str, count: int, keep: int, dtype: type = int) -> wp.array:
        """A scratch array of at least ``count``; its first ``keep`` elements survive if it has to grow."""
        old = self._scratch.array(name, (keep,), dtype) if keep else None
        new = self._scratch.array(name, (count,), dtype)
        if old is not None and old.ptr != new.ptr:
            wp.copy(new, old, count=keep)
        return new

    def _corners(self, indices: wp.array, count: int) -> wp.array:
        """The mesh's indices with room for the corners of clipped triangles behind them."""
        before = self._scratch.array("corners", (len(indices),), int)
        out = self._scratch.array("corners", (count,), int)
        if self._corners_of is not indices or before.ptr != out.ptr:
            if len(indices):
                wp.copy(out, indices)
            self._corners_of = indices
        return out

    def _target(self, pitch: int, rows: int, width: int, with_triangles: bool) -> Target:
        size = pitch * rows + 2 * PIECE
        out = Target()
        out.key = self._scratch.array("target key", (size,), float)
        out.triangle = self._scratch.array("target triangle", (size if with_triangles else 1,), float)
        out.key_piece = _pieces(out.key.ptr, size)
        out.triangle_piece = _pieces(out.triangle.ptr, size if with_triangles else PIECE)
        out.with_triangles, out.pitch, out.width = int(with_triangles), pitch, width
        return out


def _pieces(address: int, floats: int) -> wp.array:
    """Memory of so many floats as overlapping pieces, one from every float on that has 7 more behind it."""
    return wp.array(ptr=address, dtype=Piece, shape=max(1, floats - PIECE + 1), strides=(4,), device="cpu")
