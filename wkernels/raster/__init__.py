"""Triangle rasteriser: nearest linear depth and triangle per pixel.

Coverage is exact and the same on every path: vertices are snapped to 1/256 pixel, edge functions are integers, and the
top-left rule gives a pixel centre on a shared edge to exactly one triangle. Triangles that cross the near plane or
leave the guard band are clipped first (Sutherland-Hodgman in homogeneous coordinates). Of equal depths the lower
triangle index wins (on the lane path pieces of clipped triangles come last). Results do not depend on the number of
threads.

- ``lanes``: the CPU's path, bands of rows with the inner loops written so that LLVM turns them into SIMD;
- ``tiles``: the plain CPU path, the others' twin, for targets narrower than 8 pixels and matrices that no light has;
- ``stripes``: CUDA;
- ``counting``, ``lane_counting``: how often pixels are covered, on the same three; ``homogeneous``: by triangles that
  reach to infinity;
- ``triangles``, ``clipping``: projection, clipping, coverage and depth functions that they share;
- ``cut_triangles``: those that are cut out by a texture are drawn plainly, over the others;
- ``binning``: convex shapes in lists per tile of pixels, for kernels that are not about depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np
import warp as wp

from wkernels.device.launch import wake_workers
from wkernels.errors import InputError
from wkernels.raster.blocks import MAX_VIEWS, TriangleBlocks
from wkernels.raster.counting import COUNT_ALL, COUNT_FARTHER, COUNT_NEARER, Counted, count_plainly
from wkernels.raster.cut_triangles import CutTriangles
from wkernels.raster.homogeneous import project_homogeneous
from wkernels.raster.lane_counting import LaneCounter
from wkernels.raster.lane_target import PIECE, DepthKey
from wkernels.raster.lanes import MAX_TRIANGLES, LaneRasteriser, depth_key
from wkernels.raster.plain_splits import clip_flagged, draw_splits_plainly
from wkernels.raster.scratch import Scratch
from wkernels.raster.stripes import draw_stripes
from wkernels.raster.tiles import draw_tiles
from wkernels.raster.triangles import (
    CULL_BACK,
    CULL_FRONT,
    CULL_NONE,
    NO_TRIANGLE,
    ScreenTriangles,
    flag_clipped,
    project_vertices,
    to_homogeneous_pixels,
)
from wkernels.scene.cutouts import Cutouts
from wkernels.scene.views import View

__all__ = [
    "COUNT_ALL",
    "COUNT_FARTHER",
    "COUNT_NEARER",
    "CULL_BACK",
    "CULL_FRONT",
    "CULL_NONE",
    "Rasteriser",
    "TriangleBlocks",
    "to_homogeneous_pixels",
]


WORTH_LEAVING_OUT = 0.2
"""Share of the blocks below which single passes take them all: with 5 % left out they were 8 % slower."""


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
        self._cut = CutTriangles()
        self._counter = LaneCounter(Scratch(device, threads))  # either holds the corners of its own triangles

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        depth_out: wp.array,
        triangle_out: wp.array | None = None,
        cull: int = CULL_NONE,
        *,
        cutouts: Cutouts | None = None,
    ) -> None:
        """Clears the targets and draws all triangles.

        Args:
            points_ws: vec3, shape (V,).
            indices: int32, shape (3 T,). An array that is given again must hold the same.
            view: Target size and projection; 1 to 8192 pixels per side.
            depth_out: float32 (H, W), a part of a larger image too: linear depth of the nearest surface, +inf where
                there is none.
            triangle_out: int32 (H, W): its triangle, -1 where there is none.
            cull: CULL_NONE, CULL_BACK or CULL_FRONT, as seen from the view (counter-clockwise is front).
            cutouts: Of the vertices: where triangles are not there, asked at pixel centres.
        """
        wake_workers(self.device, self.threads)
        cuts = cutouts is not None and self._cut.any(indices, cutouts)
        if (key := self._lane_key(indices, view, depth_out, triangle_out)) is None:
            triangles, total = self._project(points_ws, indices, view, cull, cutouts if cuts else None)
            self._draw_plainly(triangles, total, depth_out, triangle_out)
            return
        whole, cut = self._cut.split(indices, cutouts) if cutouts is not None and cuts else (indices, None)
        self._lanes.draw(points_ws, whole, view, key, depth_out, triangle_out, cull)
        if cut is not None:
            triangles, total = self._project(points_ws, cut, view, cull, cutouts)
            triangles.over = 1
            self._draw_plainly(triangles, total, depth_out, triangle_out)

    def peel(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        depth_out: Sequence[wp.array],
        triangle_out: Sequence[wp.array] | None = None,
        cull: int = CULL_NONE,
        drawn: Callable[[int], None] = lambda peel: None,
        *,
        cutouts: Cutouts | None = None,
    ) -> None:
        """Draws the nearest surfaces of each pixel, one after the other (depth peeling: Everitt 2001).

        The first are those of ``draw``, bit for bit; each further one is the nearest of what lies farther than the one
        before. Surfaces at one depth, to the last bit, are one.

        Args:
            points_ws: vec3, shape (V,).
            indices: int32, shape (3 T,).
            view: As for ``draw``.
            depth_out: float32 (H, W) each, nearest first, of the same strides; +inf where there is none left.
            triangle_out: int32, likewise, or None.
            cull: CULL_NONE, CULL_BACK or CULL_FRONT, as seen from the view.
            drawn: Called with the number of each when its images are complete; one of ``triangle_out`` may then be
                the next one's too.
            cutouts: As for ``draw``. Where some triangle is cut out the first are those of ``draw`` to rounding.
        """
        wake_workers(self.device, self.threads)
        owners = triangle_out or [None] * len(depth_out)
        cut = cutouts if cutouts is not None and self._cut.any(indices, cutouts) else None
        if cut is None and (key := self._lane_key(indices, view, depth_out[0], owners[0])) is not None:
            draw = self._lanes.peeler(points_ws, indices, view, key, depth_out[0], cull)
        else:
            triangles, total = self._project(points_ws, indices, view, cull, cut)
            draw = partial(self._peel_plainly, triangles, total)
        left = True
        for peel, (depth, owner) in enumerate(zip(depth_out, owners, strict=True)):
            if left:
                draw(depth, owner)
                left = peel + 1 == len(depth_out) or bool(depth.numpy().min() < np.inf)
            else:
                depth.fill_(float("inf"))
                if owner is not None:
                    owner.fill_(int(NO_TRIANGLE))
            drawn(peel)

    def draw_many(
        self,
        points_ws: wp.array,
        indices: wp.array,
        views: Sequence[View],
        depth_out: wp.array | Sequence[wp.array],
        triangle_out: wp.array | Sequence[wp.array] | None = None,
        cull: int = CULL_NONE,
        *,
        blocks: TriangleBlocks | None = None,
        drawing: str = "passes",
        everything: bool = False,
        drawn: Callable[[int], None] = lambda layer: None,
        cutouts: Cutouts | None = None,
    ) -> int:
        """Draws the same triangles into many views, the same bits as ``draw`` into each.

        Args:
            points_ws: vec3, shape (V,).
            indices: int32, shape (3 T,).
            views: One per layer, all of the same size.
            depth_out: float32, (layers, H, W) or one (H, W) each, as for ``draw``.
            triangle_out: int32, likewise, or None.
            cull: CULL_NONE, CULL_BACK or CULL_FRONT, as seen from each view.
            blocks: Those of the triangles, up to date: what lies beside a view is then left out there.
            drawing: ``passes``: one view after the other; ``cloned``: a work item per chunk of blocks, which loops over
                the views from the first to the last that need a block; ``instanced``: one per chunk and view. The last
                two need ``blocks``; what follows the culling is done view by view there too.
            everything: Whether nothing is left out all the same.
            drawn: Called with a layer's number when it is complete.
            cutouts: As for ``draw``. Where some triangle is cut out, views are drawn one after the other, whole.

        Returns:
            How many pairs of a block and a view were left out.
        """
        layers = range(len(views))
        owners = [None if triangle_out is None else triangle_out[layer] for layer in layers]
        cuts = cutouts is not None and self._cut.any(indices, cutouts)
        if blocks is None or cuts or len(indices) < 3 or not views:
            for layer in layers:
                self.draw(points_ws, indices, views[layer], depth_out[layer], owners[layer], cull, cutouts=cutouts)
                drawn(layer)
            return 0
        wake_workers(self.device, self.threads)
        beside = 0
        for first in range(0, len(views), MAX_VIEWS):
            part = views[first : first + MAX_VIEWS]
            seen = blocks.seen_by(part, ranges=drawing != "passes", everything=everything)
            if drawing == "passes" and seen.beside < WORTH_LEAVING_OUT * seen.pairs:
                for layer in range(first, first + len(part)):
                    self.draw(points_ws, indices, views[layer], depth_out[layer], owners[layer], cull)
                    drawn(layer)
                continue
            beside += seen.beside

            def targets(i: int, first: int = first) -> tuple[wp.array, wp.array | None]:
                return depth_out[first + i], owners[first + i]

            def complete(i: int, first: int = first) -> None:
                drawn(first + i)

            keys = [self._lane_key(indices, part[i], *targets(i)) for i in range(len(part))]
            if any(key is None for key in keys):
                draw_splits_plainly(self._scratch, points_ws, indices, part, seen, drawing, cull, targets, complete)
            else:
                lanes = [key for key in keys if key is not None]
                self._lanes.draw_splits(points_ws, indices, part, lanes, seen, drawing, cull, targets, complete)
        return beside

    def count(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        depth: wp.array | None,
        count_out: wp.array,
        test: int = COUNT_NEARER,
        front: int = 1,
        back: int = -1,
        slack: float = 0.0,
    ) -> None:
        """Counts the faces that cover each pixel before or behind what is seen there (Crow 1977, Heidmann 1991).

        Coverage is that of ``draw``. Faces may reach to infinity, and nothing is cut at the far plane (Everitt and
        Kilgard 2002); they are clipped at the near plane, so that COUNT_NEARER says nothing true of volumes that hold
        the eye or are cut there. COUNT_FARTHER does, for closed volumes.

        Where faces lie on what is seen, as a volume's caps do, test against depths that ``draw`` gave, as snapped
        vertices tilt a face: a G-buffer's exact ones differ by the depth's change over 1/256 pixel.

        Args:
            points_ws: vec3, shape (V,), or vec4: (x, y, z, 1), or (x, y, z, 0) for what lies infinitely far away along
                (x, y, z). A triangle with any other w below 0, or a vertex that is no number or all 0, is none.
            indices: int32, shape (3 T,).
            view: Target size and projection; 1 to 8192 pixels per side.
            depth: float32 (H, W): linear depth of what is seen, +inf, behind all faces, where that is nothing; None for
                COUNT_ALL.
            count_out: int32 (H, W): the sum of what all counted faces add; within 2^24 at any time.
            test: COUNT_NEARER (the face's depth < (1 - ``slack``) ``depth``), COUNT_FARTHER (all others), COUNT_ALL.
            front: What a face that is counter-clockwise seen from the view adds.
            back: What any other adds. (1, -1) before what is seen counts volumes entered and not left, as does (-1, 1)
                behind it; (1, 0) and (0, 1) count either kind alone.
            slack: Share of the depth by which a face on what is seen may come out before it and yet count as behind.

        Raises:
            InputError: No depth to test against.
        """
        if depth is None:
            if test != COUNT_ALL:
                raise InputError("rasteriser: a depth test needs the depth that is seen; COUNT_ALL takes none")
            depth = self._scratch.array("no depth", (1, 8), float)
        counted = Counted()
        counted.depth, counted.test, counted.front, counted.back = depth, test, front, back
        counted.limit = 1.0 - slack
        cull = CULL_FRONT if front == 0 else CULL_BACK if back == 0 else CULL_NONE
        key = self._lane_key(indices, view, count_out)
        if key is not None and not key.warped and depth.is_contiguous and count_out.is_contiguous:
            self._counter.count(points_ws, indices, view, key, counted, count_out, cull)
            return
        triangles, total = self._project(points_ws, indices, view, cull)
        count_plainly(self._scratch, triangles, total, counted, count_out)

    def _draw_plainly(
        self, triangles: ScreenTriangles, total: int, depth_out: wp.array, triangle_out: wp.array | None
    ) -> None:
        with_triangles = int(triangle_out is not None)
        if triangle_out is None:
            triangle_out = self._scratch.array("no triangles", (1, 1), int)
        draw = draw_tiles if wp.get_device(self.device).is_cpu else draw_stripes
        draw(self._scratch, triangles, total, with_triangles, depth_out, triangle_out)

    def _peel_plainly(
        self, triangles: ScreenTriangles, total: int, depth_out: wp.array, triangle_out: wp.array | None
    ) -> None:
        self._draw_plainly(triangles, total, depth_out, triangle_out)
        triangles.peels, triangles.nearer = 1, depth_out

    def _lane_key(
        self, indices: wp.array, view: View, out: wp.array, triangle_out: wp.array | None = None
    ) -> DepthKey | None:
        """``depth_key(view)`` where lanes are used, else None."""
        if triangle_out is not None and triangle_out.strides != out.strides:
            return None
        fits = len(indices) // 3 < MAX_TRIANGLES and view.width >= PIECE and out.strides[1] == 4
        lanes = self.path == "lanes" and wp.get_device(self.device).is_cpu and fits
        return depth_key(view) if lanes else None

    def _project(
        self, points_ws: wp.array, indices: wp.array, view: View, cull: int, cutouts: Cutouts | None = None
    ) -> tuple[ScreenTriangles, int]:
        scratch, count = self._scratch, len(indices) // 3
        out = ScreenTriangles()
        out.screen = scratch.array("screen", (len(points_ws),), wp.vec4)
        out.indices, out.count = indices, count
        out.width, out.height, out.far, out.cull = view.width, view.height, view.far, cull
        if cutouts is not None:
            out.cutouts, out.view, out.points_ws = cutouts, view, points_ws
        project = project_homogeneous if points_ws.dtype is wp.vec4 else project_vertices
        scratch.launch(project, len(points_ws), [points_ws, view], [out.screen])
        flags = scratch.array("flags", (count,), wp.uint8)
        scratch.launch(flag_clipped, count, [out.screen, indices], [flags])
        clipped = np.flatnonzero(flags.numpy()[:count])  # scratch holds at least one
        return out, clip_flagged(scratch, points_ws, view, clipped, out)
