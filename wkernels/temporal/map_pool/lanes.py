"""``pool.map_test`` for a run of pixels at a time; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, flat_floats
from wkernels.light_maps.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, ROUNDING, Bias
from wkernels.light_maps.point_lanes import PointRun
from wkernels.scene.geometry import CASTS
from wkernels.temporal.map_pool.pool import CONSTANTS, EDGE_ON, TILE, MapPool


@wp.struct
class PoolViews:
    """Flat views of a pool."""

    depth: wp.array(dtype=float)
    constants: wp.array(dtype=float)


@wp.struct
class TestLanes:
    """``PoolTest`` of each lane."""

    holds: Floats
    tau: Floats


def pool_views(pool: MapPool) -> PoolViews:
    """Views of a pool, on the CPU."""
    out = PoolViews()
    out.depth, out.constants = flat_floats(pool.depth), flat_floats(pool.constants)
    return out


@wp.func
def casting_run(flags: Ints):
    """1 in lanes whose surface casts, else 0."""
    casts = Ints(0)
    for k in range(LANES):
        casts[k] = wp.where((flags[k] & CASTS) != 0, 1, 0)
    return casts


@wp.func
def pool_test_run(pool: MapPool, views: PoolViews, m: int, bias: Bias, points: PointRun, casts: Ints):
    """``map_test`` of each lane that receives, ``casts`` of each."""
    px = points.x
    py = points.y
    pz = points.z
    nx = points.normal_x
    ny = points.normal_y
    nz = points.normal_z
    receives = points.receives
    light = pool.light_ws[m]
    l_x, l_y, l_z, l_w = light[0], light[1], light[2], light[3]
    depth = views.depth
    resolution = pool.resolution
    tiles = pool.tiles
    size = float(resolution)
    rounding = wp.where(bias.kind == BIAS_NONE, 1.0, 1.0 - ROUNDING)
    per_slope = wp.where(bias.kind == BIAS_SLOPE, bias.slope / size, 0.0)
    holds = Floats(0.0)
    tau = Floats(0.0)
    if wp.max(casts) > 0:
        for k in range(LANES):
            facing = nx[k] * (l_x - px[k] * l_w) + ny[k] * (l_y - py[k] * l_w) + nz[k] * (l_z - pz[k] * l_w)
            turned = wp.where(facing <= 0.0, casts[k] * receives[k], 0)
            holds[k] = float(turned)
            tau[k] = float(turned)
    for i in range(pool.layers[m]):
        layer = m * pool.slots + i
        c = views.constants
        at = layer * CONSTANTS
        m00, m01, m02, m03 = c[at], c[at + 1], c[at + 2], c[at + 3]
        m10, m11, m12, m13 = c[at + 4], c[at + 5], c[at + 6], c[at + 7]
        m20, m21, m22, m23 = c[at + 8], c[at + 9], c[at + 10], c[at + 11]
        m30, m31, m32, m33 = c[at + 12], c[at + 13], c[at + 14], c[at + 15]
        zy_x, zy_y, zy_z = c[at + 16], c[at + 17], c[at + 18]
        zw_x, zw_y, zw_z = c[at + 19], c[at + 20], c[at + 21]
        xz_x, xz_y, xz_z = c[at + 22], c[at + 23], c[at + 24]
        xy_x, xy_y, xy_z = c[at + 25], c[at + 26], c[at + 27]
        xw_x, xw_y, xw_z = c[at + 28], c[at + 29], c[at + 30]
        wy_x, wy_y, wy_z = c[at + 31], c[at + 32], c[at + 33]
        right_x, right_w, up_y, up_w = c[at + 34], c[at + 35], c[at + 36], c[at + 37]
        least = EDGE_ON * c[at + 38]
        begin = layer * tiles * tiles * (TILE * TILE)
        xs = Floats(0.0)
        ys = Floats(0.0)
        zs = Floats(0.0)
        ws = Floats(0.0)
        inside = Ints(0)
        found = int(0)
        for k in range(LANES):
            x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
            y = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
            w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
            here = wp.where(holds[k] > 0.0, 0, wp.where(w > 0.0, receives[k], 0))
            here = wp.where(wp.max(wp.abs(x), wp.abs(y)) <= w, here, 0)
            inside[k] = here
            found += here
            xs[k] = x
            ys[k] = y
            zs[k] = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
            ws[k] = wp.where(here != 0, w, 1.0)
        if found > 0:
            lift = Floats(0.0)
            if bias.kind == BIAS_CONSTANT:
                for k in range(LANES):
                    across = wp.abs(right_x - right_w * xs[k] / ws[k])
                    down = wp.abs(up_y - up_w * ys[k] / ws[k])
                    lift[k] = bias.constant / wp.max(0.5 * size / ws[k] * wp.min(across, down), 1.0e-30)
            if bias.kind == BIAS_NORMAL:
                for k in range(LANES):
                    across = wp.abs(right_x - right_w * xs[k] / ws[k])
                    down = wp.abs(up_y - up_w * ys[k] / ws[k])
                    raised = bias.constant / wp.max(0.5 * size / ws[k] * wp.min(across, down), 1.0e-30)
                    xs[k] = xs[k] + raised * (m00 * nx[k] + m01 * ny[k] + m02 * nz[k])
                    ys[k] = ys[k] + raised * (m10 * nx[k] + m11 * ny[k] + m12 * nz[k])
                    zs[k] = zs[k] + raised * (m20 * nx[k] + m21 * ny[k] + m22 * nz[k])
                    moved = ws[k] + raised * (m30 * nx[k] + m31 * ny[k] + m32 * nz[k])
                    ws[k] = wp.where(inside[k] != 0, moved, 1.0)
            for k in range(LANES):
                over_w = 1.0 / ws[k]
                x = xs[k] * over_w
                y = ys[k] * over_w
                z_w = zw_x * nx[k] + zw_y * ny[k] + zw_z * nz[k]
                across = zy_x * nx[k] + zy_y * ny[k] + zy_z * nz[k] - y * z_w
                down = xz_x * nx[k] + xz_y * ny[k] + xz_z * nz[k] + x * z_w
                area_x = wy_x * nx[k] + wy_y * ny[k] + wy_z * nz[k]
                area_y = xw_x * nx[k] + xw_y * ny[k] + xw_z * nz[k]
                area = xy_x * nx[k] + xy_y * ny[k] + xy_z * nz[k] - y * area_y - x * area_x
                sloped = wp.abs(area) > least
                step = ws[k] / wp.where(sloped, wp.abs(area), 1.0)
                rise = wp.where(sloped, per_slope * step * (wp.abs(across) + wp.abs(down)), 0.0)
                own = rounding * zs[k] - lift[k] - rise
                column = wp.clamp(int((0.5 + 0.5 * x) * size), 0, resolution - 1)
                line = wp.clamp(int((0.5 - 0.5 * y) * size), 0, resolution - 1)
                tile = (line >> 2) * tiles + (column >> 2)
                texel = (tile << 4) + ((line & 3) << 2) + (column & 3)
                stored = depth[begin + wp.where(inside[k] != 0, texel, 0)]
                tau[k] = wp.where(inside[k] != 0, wp.where(own > stored, 1.0, 0.0), tau[k])
                holds[k] = wp.where(inside[k] != 0, 1.0, holds[k])
    out = TestLanes()
    out.holds = holds
    out.tau = tau
    return out
