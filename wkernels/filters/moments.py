"""Moments of depth, and what share of the depths under a filter they say can be lit (Donnelly and Lauritzen 2006)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Pairs, flat_floats, row_runs, store_run
from wkernels.device.twin import Twin
from wkernels.filters.depth_ranges import depth_range
from wkernels.filters.map_images import (
    MapImage,
    new_image,
    sample_bilinear,
    sample_component_run,
    texels_round_run,
)
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.light_maps.receiver_lanes import LaneViews, ReceiverRun, in_lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.light_maps.storage import layer_images
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.workspace.workspace import Workspace


@wp.struct
class Chebyshev:
    """How moments become visibility."""

    ranges: wp.array(dtype=wp.vec2)  # (layers,) of ``normalised``
    min_variance: float  # of normalised depth
    bleeding: float  # share of the bound that is cut off


@wp.func
def normalised(range_of_layer: wp.vec2, depth: float):
    """Linear depth to [-1/2, 1/2] over a layer's range; empty texels (+inf) and what lies beyond it to 1/2.

    The range is the depth that is -1/2, scene units, and 1 / (far - near), per scene unit.
    """
    return wp.min((depth - range_of_layer[0]) * range_of_layer[1], 1.0) - 0.5


@wp.func
def lit_share(chebyshev: Chebyshev, moments: wp.vec2, depth: float):
    """Upper bound of the share of depths, with these moments, at or beyond ``depth`` (all normalised), in [0, 1]."""
    behind = depth - moments[0]
    bound = float(1.0)
    if behind > 0.0:
        variance = wp.max(moments[1] - moments[0] * moments[0], chebyshev.min_variance)
        bound = variance / (variance + behind * behind)
    return wp.max(bound - chebyshev.bleeding, 0.0) / (1.0 - chebyshev.bleeding)


@wp.func
def smaller_step(before: float, here: float, after: float):
    """The smaller of the two one-sided differences."""
    return wp.min(wp.abs(here - before), wp.abs(after - here))


@wp.kernel
def find_moments(
    first: int,
    depth: wp.array2d(dtype=float),  # of one layer
    range_of_layer: wp.vec2,
    slope_variance: int,
    moments_out: wp.array2d(dtype=wp.vec2),
):
    """Depth and squared depth of each texel of a layer."""
    row, x = wp.tid()
    y = first + row
    last = depth.shape[1] - 1
    z = normalised(range_of_layer, depth[y, x])
    square = z * z
    if slope_variance != 0:
        left = normalised(range_of_layer, depth[y, wp.max(x - 1, 0)])
        right = normalised(range_of_layer, depth[y, wp.min(x + 1, last)])
        above = normalised(range_of_layer, depth[wp.max(y - 1, 0), x])
        below = normalised(range_of_layer, depth[wp.min(y + 1, last), x])
        dx = smaller_step(left, z, right)
        dy = smaller_step(above, z, below)
        square += 0.25 * (dx * dx + dy * dy)
    moments_out[y, x] = wp.vec2(z, square)


@wp.kernel
def find_moments_lanes(
    first: int,
    depth: wp.array2d(dtype=Floats),  # the rows of a layer, a run from every texel on
    range_of_layer: wp.vec2,
    slope_variance: int,  # 0
    moments_out: wp.array2d(dtype=Pairs),
):
    """``find_moments`` of a run of texels, without the slope term; a row's last run begins within the one before."""
    row, run = wp.tid()
    y = first + row
    start = wp.min(run * LANES, depth.shape[1] - 1)
    near = range_of_layer[0]
    per_length = range_of_layer[1]
    depths = depth[y, start]
    out = Pairs()
    for k in range(LANES):
        z = wp.min((depths[k] - near) * per_length, 1.0) - 0.5
        out[2 * k] = z
        out[2 * k + 1] = z * z
    moments_out[y, 2 * start] = out


def _layer_in_lanes(depth: wp.array, range_of_layer: wp.vec2, slope_variance: int) -> list:
    return [row_runs(depth, Floats), range_of_layer, slope_variance]


def _out_in_pairs(image: wp.array) -> list:
    return [row_runs(image, Pairs)]


def _fits_lanes(depth: wp.array, range_of_layer: wp.vec2, slope_variance: int, image: wp.array) -> bool:
    return bool(depth.shape[1] >= LANES) and not slope_variance


FIND_MOMENTS = Twin(
    find_moments, find_moments_lanes, inputs=_layer_in_lanes, outputs=_out_in_pairs, fits=_fits_lanes, tolerance=1e-6
)
"""(depth of a layer, range of depth, slope_variance) -> moments of each of its texels."""


@wp.func
def lit_share_run(chebyshev: Chebyshev, moments: wp.array(dtype=float), receivers: ReceiverRun, light_map: LightMap):
    """``lit_share`` of each lane with a receiver from ``sample_bilinear`` at its place, the others' visibility.

    ``moments`` are those of all layers, flat, in the layout of the map.
    """
    at = texels_round_run(light_map, receivers)
    means = sample_component_run(moments, 2, 0, at)
    squares = sample_component_run(moments, 2, 1, at)
    layers = receivers.layer
    visible = receivers.visible
    own = receivers.depth
    near = Floats(0.0)
    per_length = Floats(0.0)
    for k in range(LANES):
        range_of_layer = chebyshev.ranges[wp.max(layers[k], 0)]
        near[k] = range_of_layer[0]
        per_length[k] = range_of_layer[1]
    least = chebyshev.min_variance
    bleeding = chebyshev.bleeding
    for k in range(LANES):
        depth = wp.min((own[k] - near[k]) * per_length[k], 1.0) - 0.5
        behind = depth - means[k]
        variance = wp.max(squares[k] - means[k] * means[k], least)
        bound = wp.where(behind > 0.0, variance / (variance + behind * behind), 1.0)
        lit = wp.max(bound - bleeding, 0.0) / (1.0 - bleeding)
        visible[k] = wp.where(layers[k] >= 0, lit, visible[k])
    return visible


@wp.kernel
def look_up_moments(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=wp.vec2),  # in the layout of the map
    visibility_out: wp.array2d(dtype=float),
):
    """One bilinear lookup of filtered moments per pixel."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        mean = sample_bilinear(moments, light_map, receiver.layer, receiver.x, receiver.y)
        visible = lit_share(chebyshev, mean, normalised(chebyshev.ranges[receiver.layer], receiver.depth))
    visibility_out[y, x] = visible


@wp.kernel
def look_up_moments_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=float),
    visibility_out: wp.array2d(dtype=float),
):
    """``look_up_moments`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        visible = lit_share_run(chebyshev, moments, receivers, light_map)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, bias: Bias, chebyshev: Chebyshev, moments: wp.array) -> list:
    return in_lane_views(gbuffer, light_map, bias, chebyshev, flat_floats(moments))


LOOK_UP_MOMENTS = Twin(look_up_moments, look_up_moments_lanes, inputs=_in_lanes, tolerance=1e-4, flips=1e-3)
"""(gbuffer, light_map, bias, chebyshev, moments) -> visibility of every pixel."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Moments:
    """Moments of one light map.

    Attributes:
        chebyshev: The ranges of depth they are normalised to, by layer, and the constants of the bound.
        image: vec2, mean and mean square of normalised depth.
    """

    chebyshev: Chebyshev
    image: MapImage


def pull_moments(
    work: Workspace,
    light_map: HostMap,
    geometry: Geometry,
    *,
    min_variance: float,
    bleeding: float,
    slope_variance: bool = False,
) -> Moments:
    """Unfiltered moments of a map as a product.

    Args:
        work: Where they are kept; of one technique label, whose constants stay.
        light_map: The map.
        geometry: Spans the depth range of each layer.
        min_variance: As in ``Chebyshev``.
        bleeding: Likewise.
        slope_variance: Whether the variance of depth within each texel is added (Lauritzen 2007).
    """

    def build(old: Moments | None) -> Moments:
        ranges = np.zeros((light_map.map.layers, 2), np.float32)
        for i, rows in enumerate(light_map.map.ws_to_ls.numpy()):
            near, far = depth_range(rows, geometry.mesh_boxes)
            ranges[i] = near, 1.0 / (far - near)
        chebyshev = Chebyshev()
        chebyshev.ranges = wp.array(ranges, dtype=wp.vec2, device=work.device)
        chebyshev.min_variance, chebyshev.bleeding = min_variance, bleeding
        image = new_image(work, light_map.layout, wp.vec2, old.image if old else None, light_map.slot)
        depths = layer_images(light_map.map.depth, image.layout)
        for own, depth, layer in zip(ranges, depths, image.layers, strict=True):
            work.launch(FIND_MOMENTS, layer.shape, [depth, wp.vec2(*own), int(slope_variance)], [layer])
        return Moments(chebyshev=chebyshev, image=image)

    moments: Moments = work.product("moments", ("moments", light_map.slot), (light_map.map,), build)
    return moments
