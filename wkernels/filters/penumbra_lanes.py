"""The filters of ``penumbra.py`` for a run of pixels at a time; see ``receiver_lanes.py`` for how that is written.

Every function does what the one of the same name there does, in the same order of operations.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.filters.penumbra import NEAREST_BLOCKER, LightFootprint, tap_rotation
from wkernels.light_maps.comparison_lanes import SpreadRun, compare_bilinear_taps, compare_nearest_taps
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, ReceiverRun


def flat_half_axes(footprint: LightFootprint) -> wp.array:
    """``footprint.half_axes`` as float (4 layers,), on the CPU; a view, which must not outlive the footprint."""
    axes = footprint.half_axes
    return wp.array(ptr=axes.ptr, dtype=float, shape=4 * axes.shape[0], device="cpu")


@wp.struct
class BlockerRun:
    """What each lane's blocker search finds; zeros where it finds nothing."""

    count: int  # lanes with a blocker
    hidden: Floats  # taps
    depth: Floats  # mean linear depth of the blockers
    moving: Ints  # taps that a moving caster hides; of use only in lanes with a receiver


@wp.func
def penumbra_ratio_lane(is_point: float, receiver_depth: float, blocker_depth: float):
    """``penumbra_ratio`` of one lane, 0 where there is no receiver."""
    behind = wp.max(receiver_depth - blocker_depth, 0.0)
    nearest = wp.max(blocker_depth, NEAREST_BLOCKER * receiver_depth)
    return wp.where(is_point > 0.0, behind / wp.where(nearest > 0.0, nearest, 1.0), behind)


@wp.func
def keep_without_receiver(receivers: ReceiverRun, lit: Floats):
    """``lit`` where a lane has a receiver, and where it has none the visibility that is known without a map."""
    layers = receivers.layer
    visible = receivers.visible
    for k in range(LANES):
        visible[k] = wp.where(layers[k] >= 0, lit[k], visible[k])
    return visible


@wp.func
def penumbra_filter_run(
    views: LaneViews,
    light_map: LightMap,
    receivers: ReceiverRun,
    spread: SpreadRun,
    taps: wp.array(dtype=wp.vec2),
    bilinear: int,
):
    """``penumbra_filter`` of each lane; lanes without a receiver hold nothing of use."""
    lit = Floats(0.0)
    if bilinear != 0:
        lit = compare_bilinear_taps(views, light_map, receivers, spread, taps)
    else:
        lit, _hidden, _moving = compare_nearest_taps(views, light_map, receivers, spread, taps)
    return lit / float(taps.shape[0])


@wp.func
def penumbra_spread_run(resolution: int, is_point: float, receivers: ReceiverRun, axes: SpreadRun, blocker: Floats):
    """``penumbra_spread`` of each lane for a caster of depth ``blocker``."""
    size = float(resolution)
    rise = receivers.rise
    xx = axes.xx
    xy = axes.xy
    yx = axes.yx
    yy = axes.yy
    for k in range(LANES):
        ratio = penumbra_ratio_lane(is_point, rise[k], blocker[k])
        across = wp.max(wp.abs(xx[k] * ratio), wp.abs(xy[k] * ratio))
        down = wp.max(wp.abs(yx[k] * ratio), wp.abs(yy[k] * ratio))
        limit = wp.min(1.0, size / wp.max(wp.max(across, down), 1.0))
        xx[k] = xx[k] * ratio * limit
        xy[k] = xy[k] * ratio * limit
        yx[k] = yx[k] * ratio * limit
        yy[k] = yy[k] * ratio * limit
    out = SpreadRun()
    out.xx = xx
    out.xy = xy
    out.yx = yx
    out.yy = yy
    return out


@wp.func
def texels_per_ratio_run(half_axes: wp.array(dtype=float), receivers: ReceiverRun, cosine: Floats, sine: Floats):
    """``texels_per_ratio`` of each lane, its taps turned by the lane's angle."""
    layers = receivers.layer
    density_x = receivers.density_x
    density_y = receivers.density_y
    xx = Floats(0.0)
    xy = Floats(0.0)
    yx = Floats(0.0)
    yy = Floats(0.0)
    for k in range(LANES):
        at = 4 * wp.max(layers[k], 0)
        a_xx = density_x[k] * half_axes[at]
        a_xy = density_x[k] * half_axes[at + 1]
        a_yx = -density_y[k] * half_axes[at + 2]
        a_yy = -density_y[k] * half_axes[at + 3]
        xx[k] = a_xx * cosine[k] + a_xy * sine[k]
        xy[k] = a_xy * cosine[k] - a_xx * sine[k]
        yx[k] = a_yx * cosine[k] + a_yy * sine[k]
        yy[k] = a_yy * cosine[k] - a_yx * sine[k]
    out = SpreadRun()
    out.xx = xx
    out.xy = xy
    out.yx = yx
    out.yy = yy
    return out


@wp.func
def pcss_visibility_run(
    views: LaneViews,
    light_map: LightMap,
    footprint: LightFootprint,
    half_axes: wp.array(dtype=float),
    receivers: ReceiverRun,
    blocker_taps: wp.array(dtype=wp.vec2),
    filter_taps: wp.array(dtype=wp.vec2),
    cosine: Floats,
    sine: Floats,
    bilinear: int,
):
    """``pcss_visibility`` of each lane; lanes without a receiver or a blocker keep their visibility.

    ``half_axes`` is ``flat_half_axes(footprint)``; cosine and sine are those of ``tap_rotation``.
    """
    axes = texels_per_ratio_run(half_axes, receivers, cosine, sine)
    search = search_spread_run(light_map, footprint, receivers, axes)
    blockers = search_blockers_run(views, light_map, receivers, search, blocker_taps)
    return filter_behind_blockers_run(
        views, light_map, footprint, receivers, axes, blockers, blockers.count, filter_taps, bilinear
    )


@wp.func
def search_spread_run(light_map: LightMap, footprint: LightFootprint, receivers: ReceiverRun, axes: SpreadRun):
    """The spread of the blocker search of each lane: the penumbra that the nearest caster in the map would cast."""
    layers = receivers.layer
    nearest_depth = footprint.nearest_depth
    nearest = Floats(0.0)
    for k in range(LANES):
        nearest[k] = nearest_depth[wp.max(layers[k], 0)]
    return penumbra_spread_run(light_map.resolution, footprint.is_point, receivers, axes, nearest)


@wp.func
def search_blockers_run(
    views: LaneViews,
    light_map: LightMap,
    receivers: ReceiverRun,
    search: SpreadRun,
    taps: wp.array(dtype=wp.vec2),
):
    """``mean_blocker_depth`` of each lane."""
    layers = receivers.layer
    lit, depth, moving = compare_nearest_taps(views, light_map, receivers, search, taps)
    hidden = Floats(0.0)
    count = int(0)
    all_taps = float(taps.shape[0])
    for k in range(LANES):
        hidden[k] = wp.where(layers[k] >= 0, all_taps - lit[k], 0.0)
        depth[k] = wp.where(hidden[k] > 0.0, depth[k], 0.0) / wp.max(hidden[k], 1.0)
        count += wp.where(hidden[k] > 0.0, 1, 0)
    out = BlockerRun()
    out.count = count
    out.hidden = hidden
    out.depth = depth
    out.moving = moving
    return out


@wp.func
def filter_behind_blockers_run(
    views: LaneViews,
    light_map: LightMap,
    footprint: LightFootprint,
    receivers: ReceiverRun,
    axes: SpreadRun,
    blockers: BlockerRun,
    count: int,
    taps: wp.array(dtype=wp.vec2),
    bilinear: int,
):
    """``penumbra_filter`` as wide as the mean blocker's penumbra, where there is one; the others' visibility.

    Without lanes that want it (``count`` = 0) none is filtered.
    """
    visible = receivers.visible
    if count > 0:
        hidden = blockers.hidden
        spread = penumbra_spread_run(light_map.resolution, footprint.is_point, receivers, axes, blockers.depth)
        lit = penumbra_filter_run(views, light_map, receivers, spread, taps, bilinear)
        for k in range(LANES):
            visible[k] = wp.where(hidden[k] > 0.0, lit[k], visible[k])
    return visible


@wp.func
def tap_rotation_run(x0: int, y: int, seed: int, rotate: int):
    """(cosine, sine) of ``tap_rotation`` of each lane."""
    cosine = Floats(1.0)
    sine = Floats(0.0)
    if rotate != 0:
        for k in range(LANES):
            rotation = tap_rotation(x0 + k, y, seed, rotate)
            cosine[k] = rotation[0, 0]
            sine[k] = rotation[1, 0]
    return cosine, sine
