"""Percentage-closer filtering of every pixel with one kernel, fixed in texels."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, store_run
from wkernels.device.twin import Twin
from wkernels.filters.penumbra import penumbra_filter
from wkernels.filters.penumbra_lanes import keep_without_receiver, penumbra_filter_run
from wkernels.light_maps.comparison_lanes import SpreadRun
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, in_lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer


@wp.kernel
def filter_comparisons(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """The same kernel around every pixel's receiver."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        spread = wp.mat22(radius, 0.0, 0.0, radius)
        visible = penumbra_filter(light_map, receiver, spread, taps, bilinear)
    visibility_out[y, x] = visible


@wp.kernel
def filter_comparisons_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_comparisons`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        spread = SpreadRun()
        spread.xx = Floats(radius)
        spread.yy = Floats(radius)
        lit = penumbra_filter_run(views, light_map, receivers, spread, taps, bilinear)
        visible = keep_without_receiver(receivers, lit)
    store_run(visible, x0, y, visibility_out)


FILTER_COMPARISONS = Twin(
    filter_comparisons, filter_comparisons_lanes, inputs=in_lane_views, tolerance=1e-5, flips=1e-3
)
"""(gbuffer, light_map, bias, taps, radius [texels], bilinear) -> visibility of every pixel."""
