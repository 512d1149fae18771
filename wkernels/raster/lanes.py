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

from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from wkernels.raster.blocks import BlockViews
from wkernels.raster.lane_bands import draw_band
from wkernels.raster.lane_lists import BandLists, LaneLists
from wkernels.raster.lane_target import PIECE, DepthKey, IntPiece, Piece, Target
from wkernels.raster.split_culling import Splits
from wkernels.scene.views import View

MAX_TRIANGLES = 2**24  # the triangle of a pixel is kept in a float, next to its depth

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
    terms = plane[depth] * light  # they cancel where depth vanishes, whatever the scene's unit
    out.perspective = int(abs(terms.sum()) < 1e-4 * np.abs(terms).sum())
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


class LaneRasteriser(LaneLists):
    """Draws perspective, orthographic and warped views on the CPU."""

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
        lists = self.list(points_ws, indices, view, key.perspective, cull)
        self._draw(lists, view, key, _target(view, depth_out, triangle_out), cull)

    def peeler(
        self, points_ws: wp.array, indices: wp.array, view: View, key: DepthKey, like: wp.array, cull: int
    ) -> Callable[[wp.array, wp.array | None], None]:
        """``Rasteriser.peel``: draws one depth and triangle image after the other, all with the strides of ``like``.

        Triangles are culled and listed once for all of them, so that nothing else may be drawn in between.
        """
        lists = self.list(points_ws, indices, view, key.perspective, cull)
        nearer = self._scratch.array("nearer keys", (_pixels_of(view, like),), float)
        peels = 1

        def draw(depth_out: wp.array, triangle_out: wp.array | None) -> None:
            nonlocal peels
            target = _target(view, depth_out, triangle_out)
            target.peels, peels = peels, 2
            target.nearer, target.nearer_piece = nearer, pieces(nearer.ptr, len(nearer), Piece)
            self._draw(lists, view, key, target, cull)

        return draw

    def draw_splits(
        self,
        points_ws: wp.array,
        indices: wp.array,
        views: Sequence[View],
        keys: Sequence[DepthKey],
        seen: BlockViews,
        drawing: str,
        cull: int,
        targets: Callable[[int], tuple[wp.array, wp.array | None]],
        drawn: Callable[[int], None],
    ) -> None:
        """Many views of one size, ``Rasteriser.draw_many``: all at once up to pass 2, then one after the other.

        Args:
            points_ws, indices, cull: As for ``draw``, with at least one triangle.
            views: At most ``blocks.MAX_VIEWS``.
            keys: ``depth_key`` of each.
            seen: What they need, ``TriangleBlocks.seen_by``.
            drawing: ``passes`` (not at once at all), ``cloned`` or ``instanced``.
            targets: Depth and triangle images of a view.
            drawn: Called after each view.
        """
        splits = Splits()
        splits.views = wp.array(list(views), dtype=View, device="cpu")
        splits.perspective = wp.array([key.perspective for key in keys], dtype=int, device="cpu")
        together = 1 if drawing == "passes" else len(views)
        for first in range(0, len(views), together):
            splits.first, splits.count = first, together
            culled = self.cull_splits(points_ws, indices, splits, views[0], cull, seen, drawing == "cloned")
            for i, own in enumerate(culled, first):
                lists = self.finish(points_ws, indices, views[i], keys[i].perspective, cull, own)
                self._draw(lists, views[i], keys[i], _target(views[i], *targets(i)), cull)
                drawn(i)

    def _draw(self, lists: BandLists, view: View, key: DepthKey, target: Target, cull: int) -> None:
        inputs = [lists.corners, lists.corner_pitch, lists.vertex, lists.key, lists.clip_triangle, lists.first_clipped]
        inputs += [lists.begin, lists.listed, lists.band_rows, view.far, key, cull, _STEPS]
        self._scratch.launch(draw_band, lists.bands, inputs, [target], tile=1)


def _pixels_of(view: View, image: wp.array) -> int:
    """From the first pixel of an image to its last."""
    return image.strides[0] // 4 * (view.height - 1) + view.width


def _target(view: View, depth_out: wp.array, triangle_out: wp.array | None) -> Target:
    out = Target()
    pitch = depth_out.strides[0] // 4
    pixels = _pixels_of(view, depth_out)
    out.key, out.key_piece = _flat(depth_out.ptr, pixels, float), pieces(depth_out.ptr, pixels, Piece)
    if triangle_out is not None:
        address = triangle_out.ptr
        out.triangle, out.triangle_piece = _flat(address, pixels, float), pieces(address, pixels, Piece)
        out.triangle_out, out.triangle_out_piece = _flat(address, pixels, int), pieces(address, pixels, IntPiece)
    out.with_triangles, out.width, out.height, out.pitch = int(triangle_out is not None), view.width, view.height, pitch
    return out


def _flat(address: int, count: int, dtype: type) -> wp.array:
    return wp.array(ptr=address, dtype=dtype, shape=count, device="cpu")


def pieces(address: int, count: int, dtype: type) -> wp.array:
    """So many numbers as overlapping pieces, one from every number on that has 7 more behind it."""
    return wp.array(ptr=address, dtype=dtype, shape=count - PIECE + 1, strides=(4,), device="cpu")
