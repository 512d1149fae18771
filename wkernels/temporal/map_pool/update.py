"""One frame's step of a pixel's sums: tests against the maps of a pool, as many as the pixel still needs.

The plain kernels; ``update_lanes`` has the CPU's. Estimates after Scherzer et al. 2009, equations 1 to 5.
"""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.light_map import Bias
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, MOVES, RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.map_pool.carried_history import CarriedSums, encode_offset, fetch_sums
from wkernels.temporal.map_pool.pool import MapPool, map_test
from wkernels.temporal.reach import MoverReach, may_reach

PRIOR = wp.constant(0.5)  # tests of either outcome that the standard error takes for granted (Jeffreys' prior)
BORDER = wp.constant(0.7)  # of ``hidden_variance``; measured, docs/tc_adaptive.md


@wp.struct
class PoolSteps:
    """How many tests a pixel gets, and which."""

    bias: Bias
    head: int  # one past the map that is tested first; the others follow backwards, round the pool
    filled: int  # maps of the pool that are drawn
    tests: int  # of a pixel with history
    new_tests: int  # of one without
    limit: float  # largest n; sums are scaled down to stay there
    even: int  # 1: points of the light are spread evenly, as for ``hidden_variance``
    clip: float  # standard errors of this frame's tests that history may differ by; 0: any
    has_history: int
    depth_epsilon: float  # scene units


@wp.func
def map_at(step: int, steps: PoolSteps) -> int:
    """Index of the map of a step, 0 being the first."""
    m = steps.head - 1 - step
    return wp.where(m < 0, m + steps.filled, m)


@wp.func
def clipped_sum(rho: float, n: float, new_rho: float, new_n: float, clip: float) -> float:
    """History's rho, as far from this frame's tests as ``clip`` of their standard errors allow.

    What moved into a pixel from a place nearby is not wholly its own; what the pixel's own tests exclude is dropped.
    """
    middle = (new_rho + PRIOR) / (new_n + 2.0 * PRIOR)
    reach = clip * wp.sqrt(middle * (1.0 - middle) / (new_n + 2.0 * PRIOR))
    clipped = wp.clamp(rho, wp.max(middle - reach, 0.0) * n, wp.min(middle + reach, 1.0) * n)
    return wp.where(clip > 0.0, wp.where(new_n > 0.0, clipped, rho), rho)


@wp.func
def hidden_variance(rho: float, n: float, even: int) -> float:
    """Variance of psi = rho / n; not 0 where all tests agree so far.

    Of independent points of the light it is that of the Beta distribution of a proportion. Of ``even`` (1) ones, each
    of which stands for its own part of the light, only those err through whose part the border of what is hidden
    passes: about sqrt(n) of n, so that it falls with n^-3/2. ``BORDER`` is for the length of that border.
    """
    total = n + 2.0 * PRIOR
    p = wp.clamp((rho + PRIOR) / total, 0.0, 1.0)
    mixed = p * (1.0 - p)
    return wp.where(even != 0, BORDER * wp.sqrt(mixed) / (total * wp.sqrt(total)), mixed / (total + 1.0))


@wp.kernel
def update_sums(
    first: int,
    gbuffer: GBuffer,
    pool: MapPool,
    steps: PoolSteps,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
):
    """Finds each pixel's sums again and adds this frame's tests of what stands still.

    Args:
        first: Tile offset. gbuffer: Receivers, (H, W). pool: Maps of the casters that stand still. steps: Which tests.
        previous_view: The eye's view that ``previous`` was written for. previous: Of the last frame, as for
            ``fetch_sums``, meaningless without history. current_out: This frame's.
        visibility_out: 1 - psi; 1 where nothing receives or no map holds the point. error_out: Its standard error.
    """
    row, x = wp.tid()
    y = first + row
    flags = gbuffer.flags[y, x]
    sums = CarriedSums()
    visible = float(1.0)
    variance = float(0.0)
    if (flags & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        normal_ws = gbuffer.normal_ws[y, x]
        if steps.has_history != 0 and (flags & MOVES) == 0:
            sums = fetch_sums(previous, previous_view, position_ws, normal_ws, steps.depth_epsilon)
        rho = float(0.0)
        n = float(0.0)
        wanted = wp.where(sums.n > 0.0, steps.tests, steps.new_tests)
        for i in range(wp.min(wanted, steps.filled)):
            m = map_at(i, steps)
            found = map_test(pool, m, steps.bias, flags & CASTS, position_ws, normal_ws)
            weight = pool.weight[m] * float(found.holds)
            rho += weight * found.tau
            n += weight
        sums.rho = clipped_sum(sums.rho, sums.n, rho, n, steps.clip)
        scale = wp.where(sums.n + n > steps.limit, wp.max(steps.limit - n, 0.0) / wp.max(sums.n, 1.0e-6), 1.0)
        sums.rho = scale * sums.rho + rho
        sums.n = scale * sums.n + n
        if sums.n > 0.0:
            sums.offset = sums.offset * (1.0 - n / sums.n)
            visible = 1.0 - wp.clamp(sums.rho / sums.n, 0.0, 1.0)
        variance = hidden_variance(sums.rho, sums.n, steps.even)
    kept = wp.where((flags & MOVES) != 0, 0.0, sums.n)
    current_out[y, x] = wp.vec4(sums.rho, kept, gbuffer.depth[y, x], encode_offset(sums.offset))
    visibility_out[y, x] = visible
    error_out[y, x] = wp.sqrt(variance)


@wp.kernel
def add_movers(
    first: int,
    gbuffer: GBuffer,
    pool: MapPool,
    movers: MapPool,
    maps: int,
    bias: Bias,
    reach: MoverReach,
    even: int,
    visibility: wp.array2d(dtype=float),
    error: wp.array2d(dtype=float),
):
    """Takes away what moving casters hide of the light, and what nothing that stands still hides already.

    Args:
        first: Tile offset. gbuffer: Receivers, (H, W). pool: Maps of the casters that stand still. movers: Maps of
            those that move, from the points of the light of the first ``maps`` maps of ``pool``. maps: How many.
        bias: As for ``map_test``. reach: Where movers may cast. even: As for ``hidden_variance``.
        visibility: (H, W) of what stands still alone; changed. error: Its standard error; grows.
    """
    row, x = wp.tid()
    y = first + row
    flags = gbuffer.flags[y, x]
    if (flags & RECEIVES) != 0 and may_reach(reach, gbuffer.position_ws[y, x]):
        position_ws = gbuffer.position_ws[y, x]
        normal_ws = gbuffer.normal_ws[y, x]
        hidden = float(0.0)
        total = float(0.0)
        for m in range(maps):
            total += pool.weight[m]
            found = map_test(movers, m, bias, 0, position_ws, normal_ws)
            if found.tau > 0.0:
                still = map_test(pool, m, bias, flags & CASTS, position_ws, normal_ws)
                hidden += pool.weight[m] * (1.0 - still.tau)
        if hidden > 0.0:
            visibility[y, x] = wp.max(visibility[y, x] - hidden / total, 0.0)
            error[y, x] = wp.sqrt(error[y, x] * error[y, x] + hidden_variance(hidden, total, even))
