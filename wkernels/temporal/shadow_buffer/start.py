"""What a pixel without history begins with (Scherzer et al. 2009, section 3.3; Schwaerzler 2009, section 5.2.3)."""

from __future__ import annotations

import warp as wp

from wkernels.device.structs import filled
from wkernels.filters.penumbra import (
    LightFootprint,
    mean_blocker_depth,
    pcss_visibility,
    penumbra_spread,
    texels_per_ratio,
)
from wkernels.light_maps.light_map import LightMap, Receiver, receiver_depth_at, stored_depth

UNROTATED = wp.constant(wp.mat22(1.0, 0.0, 0.0, 1.0))

START_SAMPLE, START_PCSS, START_SEARCH = wp.constant(0), wp.constant(1), wp.constant(2)
"""A new pixel's start: its hard test alone; percentage-closer soft shadows of the frame's map; or its hard test and a
search for blockers, which tells how wide to smooth it."""


@wp.struct
class Start:
    """What a new pixel begins with."""

    method: int  # START_SAMPLE, START_PCSS or START_SEARCH
    weight: float  # for START_PCSS: samples that it counts as
    blocker_taps: wp.array(dtype=wp.vec2)
    filter_taps: wp.array(dtype=wp.vec2)  # for START_PCSS
    search_radius: float  # for START_SEARCH: texels
    stores_smoothed: int  # for START_SEARCH: asks, by a negative half width, for a start that is stored smoothed


def start_by(
    method: int,
    *,
    weight: float = 1.0,
    blocker_taps: wp.array | None = None,
    filter_taps: wp.array | None = None,
    search_radius: float = 0.0,
    stores_smoothed: bool = False,
) -> Start:
    """A start; what its method does not name needs no value."""
    return filled(
        Start,
        method=int(method),
        weight=weight,
        blocker_taps=blocker_taps,
        filter_taps=filter_taps,
        search_radius=search_radius,
        stores_smoothed=int(stores_smoothed),
    )


@wp.struct
class Started:
    """What a start finds in the frame's map."""

    tau: float  # hidden share of the light by START_PCSS; else the hard test
    blocker_rise: float  # of the mean blocker, 0 without
    moves: int  # 1: a moving caster hides some of the light


@wp.func
def meets_mover(light_map: LightMap, receiver: Receiver, spread: wp.mat22, taps: wp.array(dtype=wp.vec2)) -> int:
    """1 where a blocker search (``mean_blocker_depth``) finds a blocker that moves, else 0."""
    result = int(0)
    for i in range(taps.shape[0]):
        offset = spread * taps[i]
        column = int(wp.floor(receiver.x + offset[0]))
        row = int(wp.floor(receiver.y + offset[1]))
        stored = stored_depth(light_map, receiver.layer, column, row)
        if stored < 0.0 and receiver_depth_at(receiver, offset[0], offset[1]) > -stored:
            result = 1
    return result


@wp.func
def start_pixel(
    light_map: LightMap,
    footprint: LightFootprint,
    receiver: Receiver,
    position_ws: wp.vec3,
    tau: float,
    moves: int,
    tagged: int,
    start: Start,
) -> Started:
    """The search of a receiver on a layer, and with START_PCSS its filter.

    Args:
        light_map: The frame's. footprint: The light in it. receiver: On a layer. position_ws: Where it is.
        tau: Its hard test. moves: 1: a moving caster hides it. tagged: 1: the map tells. start: Not by START_SAMPLE.
    """
    result = Started()
    result.tau = tau
    result.moves = moves
    spread = start.search_radius * UNROTATED
    mean_depth = float(0.0)
    if start.method == START_PCSS:
        axes = texels_per_ratio(light_map, footprint, receiver.layer, position_ws)
        spread = penumbra_spread(light_map, footprint, receiver, axes, footprint.nearest_depth[receiver.layer])
        found = pcss_visibility(
            light_map, footprint, receiver, position_ws, start.blocker_taps, start.filter_taps, UNROTATED, 0
        )
        result.tau = 1.0 - found[0]
        mean_depth = found[1]
    else:
        mean_depth = mean_blocker_depth(light_map, receiver, spread, start.blocker_taps)[0]
    if mean_depth > 0.0:
        result.blocker_rise = wp.clamp(1.0 - mean_depth / receiver.plane_depth[2], 0.0, 1.0)
    if tagged != 0 and moves == 0:
        result.moves = meets_mover(light_map, receiver, spread, start.blocker_taps)
    return result
