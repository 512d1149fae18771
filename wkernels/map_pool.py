"""A pool of light depth maps, one for each of many points of a light, that outlive their frame.

Casters that stand still under a light that stands still look the same from every point of the light for ever: their
maps are drawn once, a few a frame, and then only read. Each map carries its own matrices, so that a pool may hold
maps that were drawn for different eyes; a map says nothing of points that it does not hold.

A map is one to ``slots`` layers; a point reads the first layer that holds it. What a test needs of a layer is kept as
a row of ``CONSTANTS`` floats, with cross products of the matrix's rows, by which the slope of any plane follows under
any projection (``plane_slopes``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.lanes import LANES, Floats, runs_of, uses_lanes
from wkernels.launch import launch
from wkernels.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, ROUNDING, Bias, to_light
from wkernels.raster import Rasteriser
from wkernels.views import HostView

TILE = 4
"""Texels along a side of a tile. Neighbouring pixels fall on a line across a map: of 4 x 4 texels, which fill a cache
line, it meets a quarter of the lines that it meets of 16 x 1, and many maps are read at once."""
TexelTile = wp.types.vector(length=TILE * TILE, dtype=wp.float32)

CONSTANTS = 40
"""Floats a layer: rows x, y, depth, w of its matrix (0 to 15); z*y, z*w, x*z, x*y, x*w, w*y as cross products of the
rows' first three entries (16 to 33); growth of x and of w along the map's right, of y and of w along its up (34 to 37);
the length of x*y (38)."""

EDGE_ON = wp.constant(1.0e-5)  # a plane seen at a smaller sine of the angle has no slope worth a bias


@wp.struct
class MapPool:
    """Maps on the device; map m has the layers m * slots to m * slots + layers[m] - 1."""

    depth: wp.array2d(dtype=TexelTile)  # (maps * slots, tiles^2) linear depth from the light's point, +inf: empty
    constants: wp.array2d(dtype=float)  # (maps * slots, CONSTANTS)
    light_ws: wp.array(dtype=wp.vec4)  # (maps,) the point of the light
    weight: wp.array(dtype=float)  # (maps,) its relative radiance
    layers: wp.array(dtype=int)  # (maps,) layers in use
    slots: int
    resolution: int
    tiles: int  # along a side


@wp.struct
class PoolTest:
    """What one map of a pool says of a point."""

    holds: int  # 1: the map holds the point, or the point is turned away from the light's point
    tau: float  # 1 hidden, 0 lit
    rise: float  # 1 - z_b / z_r of what hides it; 0 for none


def allocate_pool(maps: int, slots: int, resolution: int, device: str) -> MapPool:
    """A pool of ``maps`` empty maps. The memory, 4 ``maps`` ``slots`` ``resolution``^2 bytes, is not touched yet."""
    out = MapPool()
    tiles = -(-resolution // TILE)
    out.depth = wp.empty((maps * slots, tiles * tiles), dtype=TexelTile, device=device)
    out.constants = wp.zeros((maps * slots, CONSTANTS), dtype=float, device=device)
    out.light_ws = wp.zeros(maps, dtype=wp.vec4, device=device)
    out.weight = wp.zeros(maps, dtype=float, device=device)
    out.layers = wp.zeros(maps, dtype=int, device=device)
    out.slots, out.resolution, out.tiles = slots, resolution, tiles
    return out


def layer_constants(view: HostView) -> np.ndarray:
    """float32 (CONSTANTS,) of one view."""
    rows = view.ws_to_ss
    x, y, z, w = rows[:, :3]
    out = np.zeros(CONSTANTS, dtype=np.float32)
    out[:16] = rows.ravel()
    pairs = ((z, y), (z, w), (x, z), (x, y), (x, w), (w, y))
    out[16:34] = np.concatenate([(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
                                 for a, b in pairs])  # fmt: skip
    out[34:38] = x @ view.right_ws, w @ view.right_ws, y @ view.up_ws, w @ view.up_ws
    out[38] = np.linalg.norm(out[25:28])
    return out


def draw_into_pool(
    pool: MapPool,
    at: int,
    views: Sequence[HostView],
    light_ws: np.ndarray,
    weight: float,
    casters: tuple[wp.array, wp.array],
    rasteriser: Rasteriser,
    cull: int,
    drawn: wp.array,
) -> None:
    """Draws one map of a pool, over what was there.

    Args:
        pool: The pool. at: Index of the map. views: Its layers, at most ``pool.slots``, square, of the pool's
            resolution. light_ws: The light's point (4,), rebased world. weight: Its relative radiance.
        casters: Vertices and indices, as of ``Geometry.casters``.
        rasteriser: Draws the layers. cull: Faces that are left out, as seen from the light.
        drawn: Scratch, float32 (R, R), which holds the last layer's depths afterwards.
    """
    first = at * pool.slots
    device = str(pool.depth.device)
    depths = wp.zeros(1, dtype=float, device=device)
    for i, view in enumerate(views):
        rasteriser.draw(*casters, view.to_device(), drawn, None, cull)
        store_layers(drawn, 1, depths, first + i, pool, rasteriser.threads)
    rows = np.stack([layer_constants(view) for view in views])

    def put(out: wp.array, values: np.ndarray, begin: int, dtype: type) -> None:
        wp.copy(out, wp.array(values, dtype=dtype, device=device), dest_offset=begin, count=len(values))

    put(pool.constants.flatten(), rows.ravel(), first * CONSTANTS, float)
    put(pool.light_ws, np.asarray(light_ws, np.float32).reshape(1, 4), at, wp.vec4)
    put(pool.weight, np.array([weight], np.float32), at, float)
    put(pool.layers, np.array([len(views)], np.int32), at, int)


@wp.func
def texel_depth(pool: MapPool, layer: int, row: int, column: int) -> float:
    """Depth in a texel of a layer."""
    return pool.depth[layer, (row >> 2) * pool.tiles + (column >> 2)][((row & 3) << 2) + (column & 3)]


@wp.kernel
def store_tiles(
    first: int,
    drawn: wp.array2d(dtype=float),
    columns: int,
    nearest: wp.array(dtype=float),
    layer: int,
    pool: MapPool,
):
    """Copies squares of an image into layers of a pool, a tile a cell of a grid (tiles, tiles, squares).

    Args:
        first: Tile offset. drawn: Squares of the pool's resolution, row by row. columns: How many in a row.
        nearest: 0 for a square that holds depths; else the depth z0 of the keys 1 - z0 / z that it holds.
        layer: Of the first square; the others follow. pool: Written to.
    """
    row, column, square = wp.tid()
    line = first + row
    least = nearest[square]
    left = (square % columns) * pool.resolution
    top = (square // columns) * pool.resolution
    tile = TexelTile()
    for i in range(TILE):
        for j in range(TILE):
            y = TILE * line + i
            x = TILE * column + j
            depth = float(wp.inf)
            if y < pool.resolution and x < pool.resolution:
                depth = drawn[top + y, left + x]
                if least > 0.0 and depth < 1.0:
                    depth = least / (1.0 - depth)
            tile[i * TILE + j] = depth
    pool.depth[layer + square, line * pool.tiles + column] = tile


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


def store_layers(
    drawn: wp.array, columns: int, nearest: wp.array, layer: int, pool: MapPool, threads: int | None
) -> None:
    """Copies as many squares of an image as ``nearest`` has entries into a pool; arguments as for ``store_tiles``."""
    device, squares = str(drawn.device), len(nearest)
    if uses_lanes(device) and pool.resolution % int(LANES) == 0:
        inputs = [runs_of(drawn, Floats), drawn.shape[1], columns, nearest, layer, pool.tiles]
        grid = (pool.tiles, pool.resolution // int(LANES), squares)
        launch(store_tiles_lanes, grid, inputs, [runs_of(pool.depth, Floats)], device=device, threads=threads)
    else:
        inputs = [drawn, columns, nearest, layer, pool]
        launch(store_tiles, (pool.tiles, pool.tiles, squares), inputs, device=device, threads=threads)


@wp.func
def row_of(pool: MapPool, layer: int, at: int):
    """Three constants of a layer as a vector."""
    return wp.vec3(pool.constants[layer, at], pool.constants[layer, at + 1], pool.constants[layer, at + 2])


@wp.func
def plane_slopes(pool: MapPool, layer: int, normal_ws: wp.vec3, x: float, y: float, w: float):
    """How depth changes per texel on the plane through a point, along x and along y; 0 where it is seen edge-on.

    A step d that keeps to the plane and moves the point along one map axis only solves three linear equations; by
    Cramer's rule the depth's change is a ratio of scalar triple products, those of the normal with cross products of
    the matrix's rows. It is exact under any projection.

    Args:
        pool: The pool. layer: Its layer. normal_ws: The plane's unit normal. x, y: The point in [-1, 1]. w: Its w.
    """
    z_w = wp.dot(normal_ws, row_of(pool, layer, 19))
    across = wp.dot(normal_ws, row_of(pool, layer, 16)) - y * z_w
    down = wp.dot(normal_ws, row_of(pool, layer, 22)) + x * z_w
    area = wp.dot(normal_ws, row_of(pool, layer, 25))
    area = area - y * wp.dot(normal_ws, row_of(pool, layer, 28)) - x * wp.dot(normal_ws, row_of(pool, layer, 31))
    result = wp.vec2()
    if wp.abs(area) > EDGE_ON * pool.constants[layer, 38]:
        step = 2.0 * w / (float(pool.resolution) * area)
        result = wp.vec2(wp.abs(across * step), wp.abs(down * step))
    return result


@wp.func
def map_test(pool: MapPool, m: int, bias: Bias, casts: int, position_ws: wp.vec3, normal_ws: wp.vec3) -> PoolTest:
    """The hard shadow test of a point in one map, with the bias of ``locate_receiver``.

    Args:
        pool: The pool. m: The map. bias: What keeps a surface from shadowing itself. casts: 1 where the point's own
            surface hides what is behind it. position_ws, normal_ws: The point and its unit normal.
    """
    result = PoolTest()
    light_ws = pool.light_ws[m]
    if casts != 0 and wp.dot(normal_ws, to_light(light_ws, position_ws)) <= 0.0:
        result.holds = 1
        result.tau = 1.0
        return result
    for i in range(pool.layers[m]):
        layer = m * pool.slots + i
        x = wp.dot(row_of(pool, layer, 0), position_ws) + pool.constants[layer, 3]
        y = wp.dot(row_of(pool, layer, 4), position_ws) + pool.constants[layer, 7]
        z = wp.dot(row_of(pool, layer, 8), position_ws) + pool.constants[layer, 11]
        w = wp.dot(row_of(pool, layer, 12), position_ws) + pool.constants[layer, 15]
        if result.holds == 0 and w > 0.0 and wp.max(wp.abs(x), wp.abs(y)) <= w:
            result.holds = 1
            size = float(pool.resolution)
            lift = float(0.0)
            if bias.kind == BIAS_CONSTANT or bias.kind == BIAS_NORMAL:
                across = wp.abs(pool.constants[layer, 34] - pool.constants[layer, 35] * x / w)
                down = wp.abs(pool.constants[layer, 36] - pool.constants[layer, 37] * y / w)
                lift = bias.constant / wp.max(0.5 * size / w * wp.min(across, down), 1.0e-30)
            if bias.kind == BIAS_NORMAL:
                x += lift * wp.dot(row_of(pool, layer, 0), normal_ws)
                y += lift * wp.dot(row_of(pool, layer, 4), normal_ws)
                z += lift * wp.dot(row_of(pool, layer, 8), normal_ws)
                w += lift * wp.dot(row_of(pool, layer, 12), normal_ws)
            depth = z
            if bias.kind != BIAS_NONE:
                depth -= ROUNDING * z
            if bias.kind == BIAS_CONSTANT:
                depth -= lift
            if bias.kind == BIAS_SLOPE:
                slopes = plane_slopes(pool, layer, normal_ws, x / w, y / w, w)
                depth -= bias.slope * 0.5 * (slopes[0] + slopes[1])
            column = wp.clamp(int((0.5 + 0.5 * x / w) * size), 0, pool.resolution - 1)
            row = wp.clamp(int((0.5 - 0.5 * y / w) * size), 0, pool.resolution - 1)
            stored = texel_depth(pool, layer, row, column)
            if depth > stored:
                result.tau = 1.0
                result.rise = wp.clamp(1.0 - stored / z, 0.0, 1.0)
    return result
