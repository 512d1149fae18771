"""Drawing the maps of a pool (``pool``): layer by layer into an image, and from there into tiles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, runs_of
from wkernels.device.launch import launch
from wkernels.device.twin import Twin
from wkernels.light_maps.depth_clamp import clamp_casters
from wkernels.light_maps.map_look import clamps_of
from wkernels.raster import Rasteriser, TriangleBlocks
from wkernels.scene.geometry import CasterBuffers
from wkernels.scene.views import HostView
from wkernels.temporal.map_pool.pool import CONSTANTS, TILE, MapPool, TexelTile, layer_constants


@wp.kernel
def store_tiles(
    first: int,
    drawn: wp.array2d(dtype=float),
    columns: int,
    nearest: wp.array(dtype=float),
    layer: int,
    resolution: int,
    tiles: int,
    depth_out: wp.array2d(dtype=TexelTile),
):
    """Copies squares of an image into layers of a pool, a tile a cell of a grid (tiles, tiles, squares).

    Args:
        first: Tile offset. drawn: Squares of the pool's resolution, row by row. columns: How many in a row.
        nearest: 0 for a square that holds depths; else the depth z0 of the keys 1 - z0 / z that it holds.
        layer: Of the first square; the others follow. resolution: Texels along a square. tiles: Likewise.
        depth_out: The pool's.
    """
    row, column, square = wp.tid()
    line = first + row
    least = nearest[square]
    left = (square % columns) * resolution
    top = (square // columns) * resolution
    tile = TexelTile()
    for i in range(TILE):
        for j in range(TILE):
            y = TILE * line + i
            x = TILE * column + j
            depth = float(wp.inf)
            if y < resolution and x < resolution:
                depth = drawn[top + y, left + x]
                if least > 0.0 and depth < 1.0:
                    depth = least / (1.0 - depth)
            tile[i * TILE + j] = depth
    depth_out[layer + square, line * tiles + column] = tile


@wp.kernel
def store_tiles_lanes(
    first: int,
    drawn: wp.array(dtype=Floats),
    pitch: int,
    columns: int,
    nearest: wp.array(dtype=float),
    layer: int,
    tiles: int,
    depth_out: wp.array(dtype=Floats),
):
    """``store_tiles``, four tiles side by side a cell, where squares are a multiple of 16 wide; both images in runs."""
    row, column, square = wp.tid()
    line = first + row
    least = nearest[square]
    left = (square % columns) * tiles * TILE
    top = (square // columns) * tiles * TILE
    begin = (top + TILE * line) * pitch + left + LANES * column
    a = drawn[begin]
    b = drawn[begin + pitch]
    c = drawn[begin + 2 * pitch]
    d = drawn[begin + 3 * pitch]
    for k in range(LANES):
        a[k] = wp.where(least > 0.0, wp.where(a[k] < 1.0, least / (1.0 - a[k]), a[k]), a[k])
        b[k] = wp.where(least > 0.0, wp.where(b[k] < 1.0, least / (1.0 - b[k]), b[k]), b[k])
        c[k] = wp.where(least > 0.0, wp.where(c[k] < 1.0, least / (1.0 - c[k]), c[k]), c[k])
        d[k] = wp.where(least > 0.0, wp.where(d[k] < 1.0, least / (1.0 - d[k]), d[k]), d[k])
    at = ((layer + square) * tiles + line) * tiles * TILE * TILE + LANES * TILE * column
    for tile in range(4):
        out = Floats(
            a[4 * tile], a[4 * tile + 1], a[4 * tile + 2], a[4 * tile + 3],
            b[4 * tile], b[4 * tile + 1], b[4 * tile + 2], b[4 * tile + 3],
            c[4 * tile], c[4 * tile + 1], c[4 * tile + 2], c[4 * tile + 3],
            d[4 * tile], d[4 * tile + 1], d[4 * tile + 2], d[4 * tile + 3],
        )  # fmt: skip
        depth_out[at + LANES * tile] = out


STORE_TILES = Twin(
    store_tiles,
    store_tiles_lanes,
    inputs=lambda drawn, columns, nearest, layer, resolution, tiles: [
        runs_of(drawn, Floats),
        drawn.shape[1],
        columns,
        nearest,
        layer,
        tiles,
    ],
    outputs=lambda depth: [runs_of(depth, Floats)],
    grid=lambda grid: (grid[0], grid[1] * TILE // int(LANES), grid[2]),
    fits=lambda drawn, columns, nearest, layer, resolution, *_: resolution % int(LANES) == 0,
    tolerance=1e-6,
)


def store_layers(
    drawn: wp.array, columns: int, nearest: wp.array, layer: int, pool: MapPool, threads: int | None
) -> None:
    """Copies as many squares of an image as ``nearest`` has entries into a pool; arguments as for ``store_tiles``."""
    inputs = [drawn, columns, nearest, layer, pool.resolution, pool.tiles]
    grid = (pool.tiles, pool.tiles, len(nearest))
    launch(STORE_TILES, grid, inputs, [pool.depth], device=str(drawn.device), threads=threads)


class PoolPainter:
    """Draws the same casters into maps of pools.

    Args:
        casters: Of ``Geometry.caster_buffers``.
        resolution: Texels per side of the maps.
        device: Warp device.
        threads: CPU threads; None for all.
        culls: Whether casters beside a layer's view are left out, for which they must stand still.
    """

    def __init__(self, casters: CasterBuffers, resolution: int, device: str, threads: int | None, culls: bool) -> None:
        self._points, self._indices, self._cutouts = casters
        self._rasteriser = Rasteriser(device, threads)
        self._image = wp.empty((resolution, resolution), dtype=float, device=device)
        self._depths = wp.zeros(1, dtype=float, device=device)
        self._culls = culls
        self._blocks: TriangleBlocks | None = None

    def draw(
        self,
        pool: MapPool,
        at: int,
        views: Sequence[HostView],
        light_ws: np.ndarray,
        weight: float,
        cull: int,
        layers: range | None = None,
    ) -> int:
        """Draws one map of a pool, or some of its layers, over what was there.

        Args:
            pool: The pool. at: Index of the map. views: Its layers, at most ``pool.slots``, square, of the painter's
                resolution. light_ws: The light's point (4,), rebased world. weight: Its relative radiance.
            cull: Faces that are left out, as seen from the light. layers: Which are drawn; all unless given.

        Returns:
            How many pairs of a block of casters and a layer were left out, as the one lies beside the other.
        """
        first, device = at * pool.slots, str(pool.depth.device)
        chosen = list(range(len(views)) if layers is None else layers)
        clamps = clamps_of(views)

        def finish(i: int) -> None:
            if clamps[chosen[i]] > 0.0:
                clamp_casters(self._image, clamps[chosen[i]], self._rasteriser.threads)
            store_layers(self._image, 1, self._depths, first + chosen[i], pool, self._rasteriser.threads)

        blocks = None
        if len(chosen) > 1 and self._culls and len(self._indices) >= 3:
            if self._blocks is None:
                self._blocks = TriangleBlocks(self._points, self._indices, device, self._rasteriser.threads)
            blocks = self._blocks
        shown = [views[layer].to_device() for layer in chosen]
        images = [self._image] * len(chosen)
        beside = self._rasteriser.draw_many(
            self._points,
            self._indices,
            shown,
            images,
            None,
            cull,
            blocks=blocks,
            drawn=finish,
            cutouts=self._cutouts,
        )

        def put(out: wp.array, values: np.ndarray, begin: int, dtype: type) -> None:
            wp.copy(out, wp.array(values, dtype=dtype, device=device), dest_offset=begin, count=len(values))

        rows = np.stack([layer_constants(view) for view in views])
        put(pool.constants.flatten(), rows.ravel(), first * CONSTANTS, float)
        put(pool.light_ws, np.asarray(light_ws, np.float32).reshape(1, 4), at, wp.vec4)
        put(pool.weight, np.array([weight], np.float32), at, float)
        put(pool.layers, np.array([len(views)], np.int32), at, int)
        return beside
