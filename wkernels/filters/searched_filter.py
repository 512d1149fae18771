"""A filter of fixed size after a cheap search for blockers, which settles most pixels by itself.

Where none of the search's taps is hidden the receiver is lit, where all of them are it is dark, and the filter is left
out in both cases (Fernando 2005; Stingl 2011, section 3.6, who leaves it out where none is). What the search misses is
lost; ``rim_taps`` looks where an edge that enters the filter must come through.
"""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, store_run
from wkernels.device.twin import Twin
from wkernels.errors import InputError
from wkernels.filters.penumbra import mean_blocker_depth, penumbra_filter
from wkernels.filters.penumbra_lanes import keep_without_receiver, penumbra_filter_run
from wkernels.light_maps.comparison_lanes import SpreadRun, compare_nearest_taps
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, in_lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Omission
from wkernels.workspace.workspace import Workspace


class Searched(Omission):
    """What the search saves."""

    SETTLED = "filter of pixels", "the search settles them"


@wp.struct
class SearchedFilter:
    """A search and the filter that follows it; both sets of taps are vec2 (n,), radii in texels."""

    search_taps: wp.array(dtype=wp.vec2)
    search_radius: float
    taps: wp.array(dtype=wp.vec2)
    radius: float
    bilinear: int  # as in ``penumbra_filter``
    leave_out: int  # 1: no filter where the search has settled the pixel; 0: its outcome is thrown away there


def rim_taps(count: int) -> np.ndarray:
    """The centre of the unit disc and ``count`` - 1 points evenly on its rim.

    A straight edge that passes between the rim's points cuts off at most a segment of the disc: of n points the share
    (a - sin a) / 2 pi with a = 2 pi / n.

    Args:
        count: At least 1.

    Returns:
        float64 (count, 2).

    Raises:
        InputError: The count is less than 1.
    """
    if count < 1:
        raise InputError(f"a search needs at least 1 tap, not {count}")
    # turned by a golden share, so that no point lies on an axis of the map, where edges tend to run
    angle = 2.0 * np.pi * (np.arange(count - 1) + 0.381966) / max(count - 1, 1)
    return np.concatenate([np.zeros((1, 2)), np.stack([np.cos(angle), np.sin(angle)], axis=1)])


def searched_filter(
    work: Workspace, search_taps: np.ndarray, taps: np.ndarray, radius: float, bilinear: bool, slot: Hashable
) -> SearchedFilter:
    """The parameters of ``filter_after_search``, as a product of the frame.

    The search reaches as far as the filter does: to its outermost tap, and with bilinear taps half a texel farther.

    Args:
        work: Of the frame.
        search_taps: (m, 2), in the unit disc.
        taps: (n, 2), of ``tap_set``.
        radius: Of the filter, texels.
        bilinear: Whether each of its taps is the mean of 2 x 2 comparisons.
        slot: Everything that the arguments above depend on.
    """

    def build(old: SearchedFilter | None) -> SearchedFilter:
        out = SearchedFilter()
        out.search_taps, out.taps = (
            wp.array(set_.astype(np.float32).reshape(-1, 2), dtype=wp.vec2, device=work.device)
            for set_ in (search_taps, taps)
        )
        out.radius, out.bilinear = radius, int(bilinear)
        out.search_radius = radius * float(np.linalg.norm(taps, axis=1).max()) + 0.5 * bilinear
        return out

    made: SearchedFilter = work.product("filter taps", ("searched filter", slot), (), build)
    return made


@wp.kernel
def filter_undecided(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    searched: SearchedFilter,
    left_out_out: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """Search and filter of each pixel; ``left_out_out``: 1 where the filter was not run."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    left_out = int(0)
    if receiver.layer >= 0:
        count = float(searched.search_taps.shape[0])
        search = wp.mat22(searched.search_radius, 0.0, 0.0, searched.search_radius)
        blockers = mean_blocker_depth(light_map, receiver, search, searched.search_taps)[1]
        settled = wp.where(blockers == 0.0 or blockers == count, 1, 0)
        visible = wp.where(blockers == 0.0, 1.0, 0.0)
        left_out = settled * searched.leave_out
        if left_out == 0:
            spread = wp.mat22(searched.radius, 0.0, 0.0, searched.radius)
            filtered = penumbra_filter(light_map, receiver, spread, searched.taps, searched.bilinear)
            visible = wp.where(settled != 0, visible, filtered)
    left_out_out[y, x] = left_out
    visibility_out[y, x] = visible


@wp.kernel
def filter_undecided_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    searched: SearchedFilter,
    left_out_out: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_undecided`` of a run of pixels; the filter is left out where the search settles them all.

    A settled pixel keeps the search's answer even where its neighbours make the run filter, so that images do not
    depend on how pixels are grouped.
    """
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    left_out = int(0)
    if receivers.count > 0:
        layers = receivers.layer
        spread = SpreadRun()
        open = Floats(1.0)
        found = Floats(0.0)
        spread.xx = Floats(searched.search_radius)
        spread.yy = Floats(searched.search_radius)
        lit_taps, _hidden, _moving = compare_nearest_taps(views, light_map, receivers, spread, searched.search_taps)
        count = float(searched.search_taps.shape[0])
        undecided = int(0)
        for k in range(LANES):
            mixed = wp.where(lit_taps[k] > 0.0, wp.where(lit_taps[k] < count, 1, 0), 0)
            open[k] = float(mixed)
            found[k] = wp.where(lit_taps[k] > 0.0, 1.0, 0.0)
            undecided += wp.where(layers[k] >= 0, mixed, 0)
        lit = found
        if undecided > 0 or searched.leave_out == 0:
            spread.xx = Floats(searched.radius)
            spread.yy = Floats(searched.radius)
            filtered = penumbra_filter_run(views, light_map, receivers, spread, searched.taps, searched.bilinear)
            for k in range(LANES):
                lit[k] = wp.where(open[k] > 0.0, filtered[k], found[k])
        else:
            for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
                left_out += wp.where(layers[k] >= 0, 1, 0)
        visible = keep_without_receiver(receivers, lit)
    left_out_out[y, column] = left_out
    store_run(visible, x0, y, visibility_out)


FILTER_UNDECIDED = Twin(
    filter_undecided,
    filter_undecided_lanes,
    inputs=in_lane_views,
    tolerance=1e-5,
    flips=1e-3,
    compared=lambda left_out, visibility: [visibility],
)


def filter_after_search(
    work: Workspace,
    gbuffer: GBuffer,
    light_map: HostMap,
    bias: Bias,
    searched: SearchedFilter,
    visibility_out: wp.array,
) -> None:
    """Fills ``visibility_out``; records how many pixels were not filtered (of a run on the CPU: none or all).

    Args:
        work: Of the frame.
        gbuffer: The receivers, (H, W).
        light_map: The map.
        bias: Of its comparisons.
        searched: Of ``searched_filter``; its ``leave_out`` is set here.
        visibility_out: float32 (H, W), in [0, 1].
    """
    searched.leave_out = int(work.may_leave_out(Searched.SETTLED))
    # a run counts in the first columns; those behind them stay 0
    left_out = work.buffer("unfiltered pixels", visibility_out.shape, wp.int32)
    inputs = [gbuffer, light_map.map, bias, searched]
    work.launch(FILTER_UNDECIDED, visibility_out.shape, inputs, [left_out, visibility_out])
    if searched.leave_out:
        work.count_later(Searched.SETTLED, lambda: int(left_out.numpy().sum()))
