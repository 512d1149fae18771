"""PCF whose kernel has one size in the world in all splits (Reeves, Salesin and Cook 1987; Stingl 2011, section 3.6.1).

A kernel of fixed size in texels is as wide in the world as the split's texels are, so that shadows change their
softness abruptly where one split ends and the next begins (Fig 3.22). Equation 3.9 scales it by each split's focusing,
s_i = r_l l_sc (2 / (max_x - min_x), 2 / (max_y - min_y)), where r_l is the diameter of a fictional light and max - min
the split's extent in light space: r_l times texels per length, as long as nothing but the focusing scales the map.

``scale: layer`` is the equation: one size in texels for all of a split, measured in the middle of its map. Under a warp
texels grow away from the eye, and the kernel with them: within a split it is too narrow before the middle and too wide
behind it, by the ratio of the texels there, and it jumps again at the border. ``scale: receiver`` measures texels per
length where the receiver lies, which is the same without a warp, and keeps its size with one and under point lights;
it is the default.

Deviations: l_sc, which shrinks the kernel to an atlas's tile, has no place here, as kernels are in texels of a layer
whatever the storage; with the factor 2 the equation is in normalised coordinates, not in texture coordinates. Under a
point light, ``layer`` holds at the distance of the middle of the receivers. The thesis has 64 taps.
Known artefacts: those of ``pcf``; a split whose texels are wider than the kernel has the softness of one texel.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp

from algorithms.filtering._taps import TapParams, tap_count
from algorithms.technique import Frame, Limit, MapTechnique, setting
from wkernels.device.lanes import LANES, Floats, flat_floats, store_run
from wkernels.device.twin import Twin
from wkernels.filters.penumbra import penumbra_filter, pull_taps
from wkernels.filters.penumbra_lanes import keep_without_receiver, penumbra_filter_run
from wkernels.light_maps.comparison_lanes import SpreadRun
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.layer_density import pull_layer_densities
from wkernels.light_maps.light_map import Bias, LightMap, texels_per_length
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer


@wp.func
def kernel_radius(density: float, radius: float, resolution: int):
    """Radius in texels, at most the side of the map."""
    return wp.min(radius * density, float(resolution))


@wp.kernel
def filter_in_world(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    densities: wp.array(dtype=wp.vec2),
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    by_receiver: int,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """A kernel of ``radius`` scene units around every pixel's receiver."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        density = densities[receiver.layer]
        if by_receiver != 0:
            density = texels_per_length(light_map, receiver.layer, gbuffer.position_ws[y, x])
        across = kernel_radius(density[0], radius, light_map.resolution)
        down = kernel_radius(density[1], radius, light_map.resolution)
        visible = penumbra_filter(light_map, receiver, wp.mat22(across, 0.0, 0.0, down), taps, bilinear)
    visibility_out[y, x] = visible


@wp.kernel
def filter_in_world_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    densities: wp.array(dtype=float),  # flat (2 layers,)
    taps: wp.array(dtype=wp.vec2),
    radius: float,
    by_receiver: int,
    bilinear: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_in_world`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        layers = receivers.layer
        density_x = receivers.density_x
        density_y = receivers.density_y
        across = Floats(0.0)
        down = Floats(0.0)
        for k in range(LANES):
            layer = wp.max(layers[k], 0)
            here_x = wp.where(by_receiver != 0, density_x[k], densities[2 * layer])
            here_y = wp.where(by_receiver != 0, density_y[k], densities[2 * layer + 1])
            across[k] = kernel_radius(here_x, radius, light_map.resolution)
            down[k] = kernel_radius(here_y, radius, light_map.resolution)
        spread = SpreadRun()
        spread.xx = across
        spread.yy = down
        lit = penumbra_filter_run(views, light_map, receivers, spread, taps, bilinear)
        visible = keep_without_receiver(receivers, lit)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, bias: Bias, densities: wp.array, *others: object) -> list:
    return [lane_views(gbuffer, light_map), light_map, bias, flat_floats(densities), *others]


FILTER = Twin(filter_in_world, filter_in_world_lanes, inputs=_in_lanes, tolerance=1e-5, flips=1e-3)


class PcfSplitKernel(MapTechnique):
    """One kernel of fixed size in the world."""

    name = "pcf_split_kernel"
    family = "filtering"
    paper = ("stingl2011", "reeves1987pcf")
    stability_limits: ClassVar[dict[str, str]] = {
        "unit_length": "the kernel's diameter is a length of the world: a scene in other units needs another"
    }
    bias_sign = "none"
    limits = (Limit(equals="shadow_map", params={"diameter": 0.0, "bilinear": False}),)

    class Params(TapParams):
        """The kernel."""

        diameter: float = setting(
            0.2, "r_l, width of the softened edge", unit="scene units", source="Stingl 2011, eq. 3.9", ge=0.0, le=1e6
        )
        scale: Literal["layer", "receiver"] = setting(
            "receiver",
            "where texels per length are measured: once for each split, or at each receiver",
            unit="name",
            source="Stingl 2011, eq. 3.9",
        )
        taps: int = tap_count(64, "comparisons per pixel", source="Stingl 2011, sec. 3.6")

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        p = self.params
        taps = pull_taps(frame, p.kernel, p.taps)
        densities = pull_layer_densities(frame, light_map, frame.middle_of_receivers)
        with frame.timed("filter comparisons"):
            kernel = [taps, 0.5 * p.diameter, int(p.scale == "receiver"), int(p.bilinear)]
            inputs = [gbuffer, light_map.map, p.device_bias, densities, *kernel]
            frame.launch(FILTER, visibility_out.shape, inputs, [visibility_out])
