"""``update`` for a run of pixels at a time; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, flat_floats, runs_of
from wkernels.device.twin import Twin
from wkernels.light_maps.light_map import Bias
from wkernels.light_maps.point_lanes import PointRun, points_of_run
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views
from wkernels.raster.gbuffer import PADDING
from wkernels.scene.views import View
from wkernels.temporal.map_pool.carried_history import CODES, FARTHEST, STEPS
from wkernels.temporal.map_pool.lanes import PoolViews, casting_run, pool_test_run, pool_views
from wkernels.temporal.map_pool.pool import MapPool
from wkernels.temporal.map_pool.update import (
    BORDER,
    PRIOR,
    PoolSteps,
    add_movers,
    hidden_variance,
    map_at,
    update_sums,
)
from wkernels.temporal.reach import MoverReach
from wkernels.temporal.reprojection_lanes import depths_on_planes, reproject_run


@wp.struct
class SumLanes:
    """``CarriedSums`` of each lane."""

    rho: Floats
    n: Floats
    offset_x: Floats
    offset_y: Floats


@wp.func
def fetch_lanes(previous: wp.array(dtype=float), view: View, points: PointRun, wanted: Ints, epsilon: float):
    """``fetch_sums`` of the lanes that are wanted (1); ``previous`` flat (4 H W,)."""
    seen = reproject_run(view, points, wanted)
    inside = seen.inside
    at_x = seen.x
    at_y = seen.y
    width = view.width
    height = view.height
    columns = Ints(0)
    lines = Ints(0)
    for k in range(LANES):
        here = inside[k]
        code = previous[4 * wp.where(here != 0, int(at_y[k]) * width + int(at_x[k]), 0) + 3]
        code_x = wp.floor(code / CODES)
        here_x = (code_x - 256.0) / STEPS
        here_y = (code - code_x * CODES - 256.0) / STEPS
        columns[k] = wp.clamp(int(wp.floor(wp.where(here != 0, at_x[k] - here_x, 0.0))), 0, width - 1)
        lines[k] = wp.clamp(int(wp.floor(wp.where(here != 0, at_y[k] - here_y, 0.0))), 0, height - 1)
    expected = depths_on_planes(view, points, columns, lines, 0, 0, seen.depth)
    rho = Floats(0.0)
    n = Floats(0.0)
    offset_x = Floats(0.0)
    offset_y = Floats(0.0)
    for k in range(LANES):
        at = 4 * (lines[k] * width + columns[k])
        held_rho = previous[at]
        held_n = previous[at + 1]
        held_depth = previous[at + 2]
        held_code = previous[at + 3]
        close = wp.abs(held_depth - expected[k]) < epsilon + 1.0e-6 * held_depth
        held_x = wp.floor(held_code / CODES)
        off_x = float(columns[k]) + 0.5 + (held_x - 256.0) / STEPS - at_x[k]
        off_y = float(lines[k]) + 0.5 + (held_code - held_x * CODES - 256.0) / STEPS - at_y[k]
        near = wp.where(wp.max(wp.abs(off_x), wp.abs(off_y)) < FARTHEST, inside[k], 0)
        taken = wp.where(close, wp.where(held_n > 0.0, wp.where(held_depth > 0.0, near, 0), 0), 0)
        rho[k] = wp.where(taken != 0, held_rho, 0.0)
        n[k] = wp.where(taken != 0, held_n, 0.0)
        offset_x[k] = wp.where(taken != 0, off_x, 0.0)
        offset_y[k] = wp.where(taken != 0, off_y, 0.0)
    out = SumLanes()
    out.rho = rho
    out.n = n
    out.offset_x = offset_x
    out.offset_y = offset_y
    return out


@wp.kernel
def update_sums_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    maps_of: PoolViews,
    pool: MapPool,
    steps: PoolSteps,
    previous_view: View,
    previous: wp.array(dtype=float),
    current_out: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
):
    """``update_sums`` of a run of pixels; ``previous`` flat (4 H W,)."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    begin = y * views.width + x0
    points = points_of_run(views, eye_depth, x0, y)
    casts = casting_run(views.flags[begin])
    depths = eye_depth[begin]
    receives = points.receives
    stays = receives - points.moves
    sums = SumLanes()
    if steps.has_history != 0:
        sums = fetch_lanes(previous, previous_view, points, stays, steps.depth_epsilon)
    rho = sums.rho
    n = sums.n
    wanted = Ints(0)
    most = int(0)
    for k in range(LANES):
        want = wp.where(n[k] > 0.0, steps.tests, steps.new_tests)
        wanted[k] = receives[k] * wp.min(want, steps.filled)
    most = wp.max(wanted)
    more_rho = Floats(0.0)
    more_n = Floats(0.0)
    for i in range(most):
        m = map_at(i, steps)
        found = pool_test_run(pool, maps_of, m, steps.bias, points, casts)
        weight = pool.weight[m]
        holds = found.holds
        tau = found.tau
        for k in range(LANES):
            share = wp.where(i < wanted[k], weight * holds[k], 0.0)
            more_rho[k] = more_rho[k] + share * tau[k]
            more_n[k] = more_n[k] + share
    offset_x = sums.offset_x
    offset_y = sums.offset_y
    visible = Floats(1.0)
    error = Floats(0.0)
    limit = steps.limit
    clip = steps.clip
    even = steps.even
    for k in range(LANES):
        middle = (more_rho[k] + PRIOR) / (more_n[k] + 2.0 * PRIOR)
        reach = clip * wp.sqrt(middle * (1.0 - middle) / (more_n[k] + 2.0 * PRIOR))
        clipped = wp.clamp(rho[k], wp.max(middle - reach, 0.0) * n[k], wp.min(middle + reach, 1.0) * n[k])
        rho[k] = wp.where(clip > 0.0, wp.where(more_n[k] > 0.0, clipped, rho[k]), rho[k])
        kept = wp.max(limit - more_n[k], 0.0) / wp.max(n[k], 1.0e-6)
        scale = wp.where(n[k] + more_n[k] > limit, kept, 1.0)
        rho[k] = scale * rho[k] + more_rho[k]
        n[k] = scale * n[k] + more_n[k]
        over_n = 1.0 / wp.where(n[k] > 0.0, n[k], 1.0)
        shrink = 1.0 - more_n[k] * over_n
        offset_x[k] = offset_x[k] * shrink
        offset_y[k] = offset_y[k] * shrink
        visible[k] = wp.where(receives[k] != 0, 1.0 - wp.clamp(rho[k] * over_n, 0.0, 1.0), 1.0)
        total = n[k] + 2.0 * PRIOR
        p = wp.clamp((rho[k] + PRIOR) / total, 0.0, 1.0)
        mixed = p * (1.0 - p)
        spread = wp.where(even != 0, BORDER * wp.sqrt(mixed) / (total * wp.sqrt(total)), mixed / (total + 1.0))
        error[k] = float(receives[k]) * wp.sqrt(spread)
        o_x = wp.clamp(wp.floor(offset_x[k] * STEPS + 0.5), -256.0, 255.0)
        o_y = wp.clamp(wp.floor(offset_y[k] * STEPS + 0.5), -256.0, 255.0)
        offset_x[k] = (o_x + 256.0) * CODES + (o_y + 256.0)
        n[k] = n[k] * float(stays[k])
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        current_out[y, x0 + k] = wp.vec4(rho[k], n[k], depths[k], offset_x[k])
        visibility_out[y, x0 + k] = visible[k]
        error_out[y, x0 + k] = error[k]


UPDATE_SUMS = Twin(
    update_sums,
    update_sums_lanes,
    inputs=lambda gbuffer, pool, steps, view, previous: [
        lane_views(gbuffer),
        runs_of(gbuffer.depth, Floats, PADDING),
        pool_views(pool),
        pool,
        steps,
        view,
        flat_floats(previous),
    ],
    tolerance=1e-4,
    flips=0.01,
)


@wp.func
def reached_lanes(reach: MoverReach, points: PointRun):
    """``may_reach`` of the lanes that receive, as 0 and 1."""
    px = points.x
    py = points.y
    pz = points.z
    receives = points.receives
    l_x, l_y, l_z, l_w = reach.light_ws[0], reach.light_ws[1], reach.light_ws[2], reach.light_ws[3]
    c_x, c_y, c_z = reach.centre_ws[0], reach.centre_ws[1], reach.centre_ws[2]
    radius = reach.radius
    spread = reach.spread
    out = Ints(0)
    for k in range(LANES):
        w_x = l_x - px[k] * l_w
        w_y = l_y - py[k] * l_w
        w_z = l_z - pz[k] * l_w
        length = wp.max(wp.sqrt(w_x * w_x + w_y * w_y + w_z * w_z), 1.0e-20)
        b_x = c_x - px[k]
        b_y = c_y - py[k]
        b_z = c_z - pz[k]
        along = wp.max((b_x * w_x + b_y * w_y + b_z * w_z) / length, 0.0)
        share = along / length
        a_x = b_x - w_x * share
        a_y = b_y - w_y * share
        a_z = b_z - w_z * share
        near = spread * wp.min((along + radius + spread) / length, 1.0)
        widest = wp.where(l_w == 0.0, spread * 2.0 * (along + radius), near)
        aside = wp.sqrt(a_x * a_x + a_y * a_y + a_z * a_z)
        out[k] = wp.where(aside <= 1.001 * (radius + widest), receives[k], 0)
    return out


@wp.kernel
def add_movers_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    maps_of: PoolViews,
    movers_of: PoolViews,
    pool: MapPool,
    movers: MapPool,
    maps: int,
    bias: Bias,
    reach: MoverReach,
    even: int,
    visibility: wp.array2d(dtype=float),
    error: wp.array2d(dtype=float),
):
    """``add_movers`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    points = points_of_run(views, eye_depth, x0, y)
    casts = casting_run(views.flags[y * views.width + x0])
    within = reached_lanes(reach, points)
    if wp.max(within) == 0:
        return
    points.receives = within
    hidden = Floats(0.0)
    total = float(0.0)
    touched = int(0)
    for m in range(maps):
        weight = pool.weight[m]
        total += weight
        found = pool_test_run(movers, movers_of, m, bias, points, Ints(0))
        tau = found.tau
        met = int(0)
        for k in range(LANES):
            met += int(tau[k])
        if met > 0:
            touched += 1
            still = pool_test_run(pool, maps_of, m, bias, points, casts)
            open_ = still.tau
            for k in range(LANES):
                hidden[k] = hidden[k] + weight * tau[k] * (1.0 - open_[k])
    if touched > 0:
        for k in range(wp.min(LANES, visibility.shape[1] - x0)):
            if hidden[k] > 0.0:
                visibility[y, x0 + k] = wp.max(visibility[y, x0 + k] - hidden[k] / total, 0.0)
                more = hidden_variance(hidden[k], total, even)
                error[y, x0 + k] = wp.sqrt(error[y, x0 + k] * error[y, x0 + k] + more)


ADD_MOVERS = Twin(
    add_movers,
    add_movers_lanes,
    inputs=lambda gbuffer, pool, movers, *others: [
        lane_views(gbuffer),
        runs_of(gbuffer.depth, Floats, PADDING),
        pool_views(pool),
        pool_views(movers),
        pool,
        movers,
        *others,
    ],
    tolerance=1e-4,
    flips=0.01,
)
