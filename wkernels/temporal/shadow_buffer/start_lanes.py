"""``start`` of a run of pixels, 16 at a time; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.filters.penumbra import LightFootprint
from wkernels.filters.penumbra_lanes import (
    filter_behind_blockers_run,
    search_blockers_run,
    search_spread_run,
    texels_per_ratio_run,
)
from wkernels.light_maps.comparison_lanes import SpreadRun
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, ReceiverRun
from wkernels.temporal.shadow_buffer.start import START_PCSS, Start


@wp.struct
class StartRun:
    """``Started`` of each lane; of use only in lanes with a receiver."""

    tau: Floats  # hidden share of the light by START_PCSS; else not of use
    blocker_rise: Floats  # of the mean blocker, 0 without
    moves: Ints  # taps that a moving caster hides


@wp.func
def start_run(
    views: LaneViews,
    light_map: LightMap,
    footprint: LightFootprint,
    half_axes: wp.array(dtype=float),
    receivers: ReceiverRun,
    starts: Ints,
    start: Start,
):
    """The blocker search of each lane, and with START_PCSS its filter, for the sake of those that start (1)."""
    plane = receivers.rise
    axes = SpreadRun()
    search = SpreadRun()
    if start.method == START_PCSS:
        axes = texels_per_ratio_run(half_axes, receivers, Floats(1.0), Floats(0.0))
        search = search_spread_run(light_map, footprint, receivers, axes)
    else:
        search.xx = Floats(start.search_radius)
        search.yy = Floats(start.search_radius)
    blockers = search_blockers_run(views, light_map, receivers, search, start.blocker_taps)
    hidden = blockers.hidden
    mean_depth = blockers.depth
    rise = Floats(0.0)
    filtered = int(0)
    for k in range(LANES):
        found = wp.where(hidden[k] > 0.0, 1, 0)
        filtered += found * starts[k]
        own = wp.where(found != 0, plane[k], 1.0)
        rise[k] = wp.where(found != 0, wp.clamp(1.0 - mean_depth[k] / own, 0.0, 1.0), 0.0)
    out = StartRun()
    out.blocker_rise = rise
    out.moves = blockers.moving
    if start.method == START_PCSS:
        out.tau = Floats(1.0) - filter_behind_blockers_run(
            views, light_map, footprint, receivers, axes, blockers, filtered, start.filter_taps, 0
        )
    return out
