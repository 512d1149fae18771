"""Passes 1 to 3 of the lane rasteriser as one call: the triangles of a mesh, listed per band of rows of a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.lane_bands import PIECE
from wkernels.raster.lane_culling import LANES, append_clipped, cull_lanes, list_bands, project_lanes
from wkernels.raster.lanes import BAND_BYTES, CHUNKS, LaneRasteriser
from wkernels.raster.triangles import CLIP_TRIANGLES, CLIP_VERTICES, clip_triangles
from wkernels.views import View


@dataclass
class BandLists:
    """What pass 4 reads, valid until the rasteriser's next call.

    Attributes:
        corners: int32, three vertices per triangle, those of clipped pieces behind the mesh's.
        column, row: int32, vertices in 1/256 pixel.
        key: float32, their depth keys.
        begin: int32 (bands + 1,), where each band's part of ``listed`` begins.
        listed: int32, triangles.
        bands, band_rows, pitch: Bands, rows in each, floats from one row of scratch to the next.
    """

    corners: wp.array
    column: wp.array
    row: wp.array
    key: wp.array
    begin: wp.array
    listed: wp.array
    bands: int
    band_rows: int
    pitch: int


class LaneLists(LaneRasteriser):
    """The passes that every use of the lane rasteriser shares."""

    def list(self, points_ws: wp.array, indices: wp.array, view: View, perspective: int, cull: int) -> BandLists:
        """Projects, culls, clips and lists all triangles; arguments as for ``LaneRasteriser.draw``."""
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
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [corners, column, row, 0, triangles, 0, CHUNKS, *shape]
            scratch.launch(cull_lanes, CHUNKS, inputs, [survivor, span, clipped, found, counts])
        crossing = [
            clipped.numpy()[b : b + n] for b, n in zip(chunk_begin, found.numpy()[1, :CHUNKS], strict=False) if n
        ]
        slots = sum(len(part) for part in crossing)
        if slots:
            which = wp.array(np.concatenate(crossing), dtype=int, device="cpu")
            clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
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
        begin = scratch.array("band begin", (bands + 1,), int)
        begin.numpy()[: bands + 1] = starts[:: CHUNKS + 1]
        counts.numpy().ravel()[:] = starts[:-1]
        listed = scratch.array("band list", (int(starts[-1]),), int)
        begins = wp.array(chunk_begin, dtype=int, device="cpu")
        scratch.launch(list_bands, CHUNKS + 1, [survivor, span, begins, found, counts], [listed])
        return BandLists(corners, column, row, key, begin, listed, bands, band_rows, pitch)
