"""Triangle rasteriser: nearest linear depth and triangle per pixel.

Coverage is exact and the same on every path: vertices are snapped to 1/256 pixel, edge functions are integers, and the
top-left rule gives a pixel centre on a shared edge to exactly one triangle. Triangles that cross the near plane or
leave the guard band are clipped first (Sutherland-Hodgman in homogeneous coordinates). Of equal depths the lower
triangle index wins (on the lane path pieces of clipped triangles come last). Results do not depend on the number of
threads.

- ``lanes``: the CPU's path, bands of rows with the inner loops written so that LLVM turns them into SIMD;
- ``tiles``: the plain CPU path, the others' twin, for targets narrower than 8 pixels and matrices that no light has;
- ``stripes``: CUDA;
- ``triangles``: projection, clipping, coverage and depth functions that they share.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from wkernels.launch import wake_workers
from wkernels.raster.lane_bands import PIECE
from wkernels.raster.lanes import MAX_TRIANGLES, LaneRasteriser, depth_key
from wkernels.raster.scratch import Scratch
from wkernels.raster.stripes import draw_stripes
from wkernels.raster.tiles import draw_tiles
from wkernels.raster.triangles import (
    CLIP_TRIANGLES,
    CLIP_VERTICES,
    CULL_BACK,
    CULL_FRONT,
    CULL_NONE,
    ScreenTriangles,
    clip_triangles,
    flag_clipped,
    project_vertices,
    to_homogeneous_pixels,
)
from wkernels.views import View

__all__ = ["CULL_BACK", "CULL_FRONT", "CULL_NONE", "Rasteriser", "to_homogeneous_pixels"]


class Rasteriser:
    """Draws triangles into depth maps; keeps its scratch memory between calls.

    Args:
        device: Warp device.
        threads: CPU threads; None for all.
        path: On the CPU, ``lanes`` where the projection allows it, or always the plain ``tiles``.
    """

    def __init__(
        self, device: str = "cpu", threads: int | None = None, path: Literal["lanes", "tiles"] = "lanes"
    ) -> None:
        self.device, self.threads, self.path = device, threads, path
        self._scratch = Scratch(device, threads)
        self._lanes = LaneRasteriser(self._scratch)

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        depth_out: wp.array,
        triangle_out: wp.array | None = None,
        cull: int = CULL_NONE,
    ) -> None:
        """Clears the targets and draws all triangles.

        Args:
            points_ws: vec3, shape (V,).
            indices: int32, shape (3 T,).
            view: Target size and projection; 1 to 8192 pixels per side.
            depth_out: float32 (H, W): linear depth of the nearest surface, +inf where there is none.
            triangle_out: int32 (H, W): its triangle, -1 where there is none.
            cull: CULL_NONE, CULL_BACK or CULL_FRONT, as seen from the view (counter-clockwise is front).
        """
        wake_workers(self.device, self.threads)
        on_cpu = wp.get_device(self.device).is_cpu
        count = len(indices) // 3
        if on_cpu and self.path == "lanes" and count < MAX_TRIANGLES and view.width >= PIECE:
            whole = depth_out.is_contiguous and (triangle_out is None or triangle_out.is_contiguous)
            if whole and (key := depth_key(view)) is not None:
                self._lanes.draw(points_ws, indices, view, key, depth_out, triangle_out, cull)
                return
        triangles, total = self._project(points_ws, indices, view, cull)
        with_triangles = int(triangle_out is not None)
        if triangle_out is None:
            triangle_out = self._scratch.array("no triangles", (1, 1), int)
        draw = draw_tiles if on_cpu else draw_stripes
        draw(self._scratch, triangles, total, with_triangles, depth_out, triangle_out)

    def _project(self, points_ws: wp.array, indices: wp.array, view: View, cull: int) -> tuple[ScreenTriangles, int]:
        scratch, count = self._scratch, len(indices) // 3
        out = ScreenTriangles()
        out.screen = scratch.array("screen", (len(points_ws),), wp.vec4)
        out.indices, out.count = indices, count
        out.width, out.height, out.far, out.cull = view.width, view.height, view.far, cull
        scratch.launch(project_vertices, len(points_ws), [points_ws, view], [out.screen])
        flags = scratch.array("flags", (count,), wp.uint8)
        scratch.launch(flag_clipped, count, [out.screen, indices], [flags])
        clipped = np.flatnonzero(flags.numpy()[:count]).astype(np.int32)  # scratch holds at least one
        slots = len(clipped)
        out.clip_screen = scratch.array("clip screen", (slots * CLIP_VERTICES,), wp.vec4)
        out.clip_corners = scratch.array("clip corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
        out.clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
        if slots:
            which = wp.array(clipped, dtype=int, device=self.device)
            clip_outputs = [out.clip_screen, out.clip_corners, out.clip_triangle]
            scratch.launch(clip_triangles, slots, [points_ws, indices, which, view], clip_outputs)
        return out, count + slots * CLIP_TRIANGLES
