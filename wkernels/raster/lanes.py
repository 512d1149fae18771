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
that nearer is less in both; ``depth_key`` says what it is for warped ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.lane_bands import LANES as BAND_LANES
from wkernels.raster.lane_bands import PIECE, DepthKey, IntPiece, Piece, Target, draw_band
from wkernels.raster.lane_bands import Ints as BandInts
from wkernels.raster.lane_culling import (
    LANES,
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

MAX_TRIANGLES = 2**24  # the triangle of a pixel is kept in a float, next to its depth
CHUNKS = 32
BAND_BYTES = 2**18  # a band's depths stay in the second-level cache

_STEPS = Piece(*range(PIECE))


def depth_key(view: View) -> DepthKey | None:
    """How a view's depths follow from keys that are affine on the screen; None where the view has no such key.

    All rays through pixels meet in the light (or are parallel to it), which is where x, y and w of the view's matrix
    vanish. For a light at a finite place the linear depth vanishes there too, -1/w grows along each ray, and depth / w
    is affine on the screen; for a direction depth / w grows, and 1 / w is affine. Without a warp these factors are 1.
    """
    rows = np.array(view.ws_to_ss, dtype=np.float32).reshape(4, 4).astype(np.float64)
    out = DepthKey()
    out.constant = 1.0
    if np.array_equal(rows[3], (0.0, 0.0, 0.0, 1.0)) or np.array_equal(rows[3], rows[2]):
        out.perspective = int(rows[3, 3] != 1.0 or rows[3, :3].any())
        return out
    scale = np.linalg.norm(rows, axis=1, keepdims=True)
    if not (np.isfinite(rows).all() and scale.all()):
        return None
    plane, (x, y, depth, w) = rows / scale, (0, 1, 2, 3)
    light = np.linalg.svd(plane[[x, y, w]])[2][-1]
    out.perspective = int(abs(plane[depth] @ light) < 1e-4)
    target = rows[depth] if out.perspective else np.array([0.0, 0.0, 0.0, 1.0])
    basis = rows[[w, x, y]].T
    factors, *_ = np.linalg.lstsq(basis, target, rcond=None)
    if np.linalg.norm(basis @ factors - target) > 1e-4 * np.linalg.norm(target):
        return None
    # from [-1, 1] to the centres of pixels
    in_x, in_y = 2.0 * factors[1] / view.width, -2.0 * factors[2] / view.height
    out.warped, out.per_column, out.per_row = 1, in_x, in_y
    out.constant = factors[0] - factors[1] + factors[2] + 0.5 * (in_x + in_y)
    return out


class LaneRasteriser:
    """Draws perspective, orthographic and warped views on the CPU.

    Args:
        scratch: Memory, device and threads.
    """

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch
        self._corners_of: wp.array | None = None  # whose corners are held
        self._corner_pitch = 0  # in runs

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        key: DepthKey,
        depth_out: wp.array,
        triangle_out: wp.array | None,
        cull: int,
    ) -> None:
        """``Rasteriser.draw`` for fewer than MAX_TRIANGLES triangles; ``key`` is ``depth_key(view)``."""
        scratch = self._scratch
        vertices, triangles = len(points_ws), len(indices) // 3
        clip_vertex, clip_begin = _runs(vertices) * LANES, _runs(triangles) * LANES  # where those of clipped ones go
        band_shift = int(np.log2(min(64, max(8, BAND_BYTES // (4 * view.width)), max(1, -(-view.height // 4)))))
        band_rows = 1 << band_shift
        bands = -(-view.height // band_rows)

        self._hold_corners(indices, clip_begin)
        self._hold_vertices(clip_vertex)
        if vertices:
            inputs: list[Any] = [*self._point_runs(points_ws), view, key.perspective]
            scratch.launch(project_lanes, _runs(vertices), inputs, [self._vertex_runs, self._key_runs])

        survivor, span, clipped = (scratch.array(name, (triangles,), int) for name in ("survivor", "span", "clipped"))
        found = scratch.array("found", (2, CHUNKS + 1), int)
        counts = scratch.array("counts", (bands, CHUNKS + 1), int)
        shape = [view.width, view.height, band_shift, cull]
        outputs = [survivor, span, clipped, found, counts]
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [self._corner_runs, self._corner_pitch, self._vertex, 0, triangles, 0, CHUNKS, *shape]
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
            inputs = [clip_screen, clip_corners, clip_vertex, clip_begin, key.perspective]
            outputs = [self._vertex, self._key, self._corners, self._corner_pitch * LANES]
            scratch.launch(append_clipped, slots, inputs, outputs)
            inputs = [self._corner_runs, self._corner_pitch, self._vertex, clip_begin, total, CHUNKS, 1, *shape]
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

        inputs = [self._corners, self._corner_pitch * LANES, self._vertex, self._key, clip_triangle, clip_begin]
        inputs += [band_begin, list_runs, band_rows, view.far, key, cull, _STEPS]
        scratch.launch(draw_band, bands, inputs, [_target(view, depth_out, triangle_out)], tile=1)

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


def _target(view: View, depth_out: wp.array, triangle_out: wp.array | None) -> Target:
    out = Target()
    pixels = view.width * view.height
    out.key, out.key_piece = _flat(depth_out.ptr, pixels, float), _pieces(depth_out.ptr, pixels, Piece)
    if triangle_out is not None:
        address = triangle_out.ptr
        out.triangle, out.triangle_piece = _flat(address, pixels, float), _pieces(address, pixels, Piece)
        out.triangle_out, out.triangle_out_piece = _flat(address, pixels, int), _pieces(address, pixels, IntPiece)
    out.with_triangles, out.width, out.height = int(triangle_out is not None), view.width, view.height
    return out


def _flat(address: int, count: int, dtype: type) -> wp.array:
    return wp.array(ptr=address, dtype=dtype, shape=count, device="cpu")


def _pieces(address: int, count: int, dtype: type) -> wp.array:
    """So many numbers as overlapping pieces, one from every number on that has 7 more behind it."""
    return wp.array(ptr=address, dtype=dtype, shape=count - PIECE + 1, strides=(4,), device="cpu")


def _runs(count: int) -> int:
    return -(-count // LANES)


def _chunk_begin(triangles: int, clip_begin: int) -> np.ndarray:
    """First triangle of each chunk, as ``lane_culling.chunk_start`` has it, and of the clipped ones."""
    starts = [min(_runs(triangles) * k // CHUNKS * LANES, triangles) for k in range(CHUNKS)]
    return np.array([*starts, clip_begin], dtype=np.int32)
