"""Convex shapes in lists per tile of pixels: for kernels whose pixels ask which wedges, quads or cones they may lie in.

A shape is the convex hull of up to 16 points, a polygon or a body, in any order. A tile lists each shape whose picture
comes near one of its pixels' centres, in ascending order. Nobody writes into another's part of a list: there are no
atomics, and the lists are the same for any number of threads. A kernel loops over ``k`` from ``lists.begin[tile]`` to
``lists.begin[tile + 1]``, with ``tile_at``; where the tile is a multiple of 16 a run of lanes lies within one.

A picture is bounded row by row of tiles, by how far the hull's left and right borders reach while they pass the centres
of the row's pixels: what is convex comes near every tile in between.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.errors import InputError
from wkernels.raster.outlines import CORNERS, MAX_POINTS, Shapes, find_border, find_outline, reach
from wkernels.raster.scratch import Scratch
from wkernels.scene.views import View

CHUNKS = 64
ZERO, ONE, HALF = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0)), wp.constant(wp.float64(0.5))


@wp.struct
class TileLists:
    """Which shapes come near the pixels of each tile."""

    begin: wp.array(dtype=int)  # (tiles + 1,): where each tile's part of ``shape`` begins
    shape: wp.array(dtype=int)  # ascending within a tile
    tile: int  # pixels per side
    tiles_x: int


@wp.func
def tile_at(lists: TileLists, y: int, x: int):
    """The tile of a pixel."""
    return (y / lists.tile) * lists.tiles_x + x / lists.tile


@wp.func
def tiles_between(low: wp.float64, high: wp.float64, tile: int, pixels: int):
    """First and last tile with a pixel centre between two coordinates; where there is none the last is the lesser."""
    size = wp.float64(tile)
    last = wp.float64((pixels - 1) / tile)
    a = wp.clamp(wp.ceil((low + HALF) / size) - ONE, ZERO, last)
    b = wp.clamp(wp.floor((high - HALF) / size), -ONE, last)
    if low > wp.float64(pixels) - HALF or high < HALF:
        b = -ONE
    return wp.vec2i(int(a), int(b))


@wp.struct
class Spans:
    """Which tiles shapes come near, and how they are shared out."""

    rows: wp.array(dtype=wp.vec2i)  # (shapes,): first and last row of tiles
    span: wp.array2d(dtype=int)  # (shapes, rows of tiles): first column, and last column + 1 << 16; own rows only
    depths: wp.array(dtype=wp.vec2)  # (shapes,): nearest and farthest
    seen: wp.array(dtype=wp.vec2)  # (tiles,): nearest and farthest of what is seen, or none
    count: int
    chunks: int
    tile: int
    tiles_x: int


@wp.func
def chunk_begin(spans: Spans, chunk: int):
    """The first shape of a chunk."""
    return int(wp.int64(spans.count) * wp.int64(chunk) / wp.int64(spans.chunks))


@wp.func
def is_listed(spans: Spans, s: int, tile: int):
    """Whether a shape's depths meet those of a tile."""
    listed = spans.seen.shape[0] == 0
    if not listed:
        listed = spans.depths[s][0] <= spans.seen[tile][1] and spans.depths[s][1] >= spans.seen[tile][0]
    return listed


@wp.kernel
def count_shapes(
    first: int,
    shapes: Shapes,
    margin: wp.float64,
    corners: wp.array(dtype=wp.vec2d),  # room for each chunk's outline, and its left and right border
    spans_out: Spans,
    counts_out: wp.array2d(dtype=int),  # (chunks, tiles)
):
    """Which tiles the shapes of one chunk come near, and how many of them each tile gets."""
    chunk = first + wp.tid()
    tile = spans_out.tile
    width = shapes.view.width
    height = shapes.view.height
    outline_at = 3 * CORNERS * chunk
    left_at = outline_at + CORNERS
    right_at = left_at + CORNERS
    for t in range(counts_out.shape[1]):
        counts_out[chunk, t] = 0
    for s in range(chunk_begin(spans_out, chunk), chunk_begin(spans_out, chunk + 1)):
        outline = find_outline(shapes, s, corners, outline_at)
        rows = wp.vec2i(0, -1)
        if outline.count > 0:
            top = corners[outline_at][1] - margin
            bottom = corners[outline_at + outline.count - 1][1] + margin
            rows = tiles_between(top, bottom, tile, height)
        # what reads the lists rounds too
        spans_out.depths[s] = wp.vec2(outline.nearest * 0.99999, outline.farthest * 1.00001)
        spans_out.rows[s] = rows
        if rows[1] >= rows[0]:
            left = find_border(corners, outline_at, outline.count, -ONE, left_at)
            right = find_border(corners, outline_at, outline.count, ONE, right_at)
            for row in range(rows[0], rows[1] + 1):
                above = wp.float64(row * tile) + HALF - margin
                below = wp.float64(wp.min((row + 1) * tile, height)) - HALF + margin
                low = -reach(corners, left_at, left, -ONE, above, below) - margin
                high = reach(corners, right_at, right, ONE, above, below) + margin
                columns = tiles_between(low, high, tile, width)
                spans_out.span[s, row] = columns[0] | ((columns[1] + 1) << 16)
                for column in range(columns[0], columns[1] + 1):
                    t = row * spans_out.tiles_x + column
                    if is_listed(spans_out, s, t):
                        counts_out[chunk, t] += 1


@wp.kernel
def list_shapes(
    first: int,
    spans: Spans,
    next_slot: wp.array2d(dtype=int),  # (chunks, tiles), advanced
    shape_out: wp.array(dtype=int),
):
    """Writes the shapes of one chunk into the tiles' lists."""
    chunk = first + wp.tid()
    for s in range(chunk_begin(spans, chunk), chunk_begin(spans, chunk + 1)):
        for row in range(spans.rows[s][0], spans.rows[s][1] + 1):
            span = spans.span[s, row]
            for column in range(span & 65535, span >> 16):
                tile = row * spans.tiles_x + column
                if is_listed(spans, s, tile):
                    slot = next_slot[chunk, tile]
                    next_slot[chunk, tile] = slot + 1
                    shape_out[slot] = s


@wp.kernel
def find_tile_depths(
    first: int, depth: wp.array2d(dtype=float), tile: int, tiles_x: int, seen_out: wp.array(dtype=wp.vec2)
):
    """Least and greatest finite depth in a tile; (inf, -inf) where nothing is seen."""
    t = first + wp.tid()
    top = (t / tiles_x) * tile
    left = (t % tiles_x) * tile
    nearest = float(wp.inf)
    farthest = -float(wp.inf)
    for y in range(top, wp.min(top + tile, depth.shape[0])):
        for x in range(left, wp.min(left + tile, depth.shape[1])):
            if depth[y, x] < wp.inf:
                nearest = wp.min(nearest, depth[y, x])
                farthest = wp.max(farthest, depth[y, x])
    seen_out[t] = wp.vec2(nearest, farthest)


class Binner:
    """Bins shapes; keeps its memory between calls.

    Args:
        device: Warp device.
        threads: CPU threads; None for all.
    """

    def __init__(self, device: str = "cpu", threads: int | None = None) -> None:
        self.device, self.threads = device, threads
        self._scratch = Scratch(device, threads)

    def bin(
        self,
        points: wp.array,
        begin: wp.array,
        view: View,
        tile: int = 16,
        *,
        seen: wp.array | None = None,
        depth_range: wp.array | None = None,
        margin: float = 1.0 / 32.0,
    ) -> TileLists:
        """Lists the shapes that come near each tile's pixels: all that cover a pixel's centre, and few others.

        Args:
            points: vec4 (N,), homogeneous, (x, y, z, 1) in the rebased world or (x, y, z, 0) infinitely far away, and
                what lies before the near plane is cut off; or vec2 (N,), pixels. A shape with a point that is none of
                these covers nothing.
            begin: int32 (shapes + 1,), where each shape's points begin.
            view: Size of the image, and of homogeneous points the projection.
            tile: Pixels per side.
            seen: float32 (H, W), linear depth of what is seen, +inf where that is nothing: leaves out shapes that lie
                before or behind all of a tile. Only for kernels whose shapes hold the points that they change.
            depth_range: vec2 (shapes,), least and greatest depth of each. Else homogeneous points tell, and for pixels
                any depth will do.
            margin: Pixels by which a shape is taken to be larger, as those who read the lists round differently.

        Returns:
            The lists, valid until the next call.

        Raises:
            InputError: A shape of more than 16 points, or more entries than a list can have.
        """
        scratch, count = self._scratch, max(0, len(begin) - 1)
        if count and int(np.diff(begin.numpy()).max()) > MAX_POINTS:
            raise InputError(f"binning: a shape has more than {MAX_POINTS} points; cut it into several")
        tiles_x, tiles_y = -(-view.width // tile), -(-view.height // tile)
        tiles, chunks = tiles_x * tiles_y, CHUNKS if wp.get_device(self.device).is_cpu else 8 * CHUNKS
        shapes = Shapes()
        shapes.begin, shapes.view, shapes.on_screen = begin, view, int(points.dtype is wp.vec2)
        if shapes.on_screen:
            shapes.points_ss = points
        else:
            shapes.points_ws = points
        if depth_range is not None:
            shapes.depth_range = depth_range
        spans = Spans()
        spans.rows, spans.depths = scratch.array("rows", (count,), wp.vec2i), scratch.array("depths", (count,), wp.vec2)
        spans.span = scratch.array("span", (count, tiles_y), int)
        spans.count, spans.chunks, spans.tile, spans.tiles_x = count, chunks, tile, tiles_x
        if seen is not None:
            spans.seen = scratch.array("seen", (tiles,), wp.vec2)
            scratch.launch(find_tile_depths, tiles, [seen, tile, tiles_x], [spans.seen])
        counts = scratch.array("counts", (chunks, tiles), int)
        corners = scratch.array("corners", (3 * int(CORNERS) * chunks,), wp.vec2d)
        scratch.launch(count_shapes, chunks, [shapes, wp.float64(margin), corners], [spans, counts], tile=1)
        starts = np.concatenate([[0], np.cumsum(counts.numpy().T.ravel(), dtype=np.int64)])
        if starts[-1] >= 2**31:
            raise InputError(f"binning: {starts[-1]} entries are too many; take larger tiles")
        out = TileLists()
        out.tile, out.tiles_x = tile, tiles_x
        out.begin, out.shape = (
            scratch.array(n, (k,), int) for n, k in (("begin", tiles + 1), ("list", int(starts[-1])))
        )
        wp.copy(out.begin, wp.array(starts[::chunks].astype(np.int32), dtype=int, device="cpu"))
        own = np.ascontiguousarray(starts[:-1].reshape(tiles, chunks).T, dtype=np.int32)
        wp.copy(counts, wp.array(own, dtype=int, device="cpu"))
        scratch.launch(list_shapes, chunks, [spans, counts], [out.shape], tile=1)
        return out
