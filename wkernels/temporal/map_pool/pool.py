"""A pool of light depth maps, one for each of many points of a light, that outlive their frame.

Casters that stand still under a light that stands still look the same from every point of the light for ever: their
maps are drawn once, a few a frame, and then only read. Each map carries its own matrices, so that a pool may hold
maps that were drawn for different eyes; a map says nothing of points that it does not hold.

A map is one to ``slots`` layers; a point reads the first layer that holds it. What a test needs of a layer is kept as
a row of ``CONSTANTS`` floats, with cross products of the matrix's rows, by which the slope of any plane follows under
any projection (``plane_slopes``).
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.light_maps.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, ROUNDING, Bias
from wkernels.raster.gbuffer import to_light
from wkernels.scene.views import HostView

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


@wp.func
def texel_depth(pool: MapPool, layer: int, row: int, column: int) -> float:
    """Depth in a texel of a layer."""
    return pool.depth[layer, (row >> 2) * pool.tiles + (column >> 2)][((row & 3) << 2) + (column & 3)]


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
    return result
