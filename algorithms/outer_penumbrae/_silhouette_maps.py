"""What both techniques share that draw penumbrae beside silhouettes into an image in the light map's layout."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from algorithms.technique import ALL_LIGHTS, Frame, Limit, MapTechnique, Needs
from wkernels.casters.outer_edges import bin_edges, pixel_to_plane, plane_of_view
from wkernels.casters.pulls import pull_loops, pull_silhouettes
from wkernels.device.lanes import LANES, flat_floats, store_run
from wkernels.device.twin import Twin
from wkernels.filters.map_images import MapImage, new_image
from wkernels.light_maps.comparison_lanes import compare_nearest_run, first_texels
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest, to_texel
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.light_maps.storage import layer_images
from wkernels.light_maps.surfaces import pull_surfaces
from wkernels.raster.binning import Binner
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product

FARTHEST = 1e30
"""How far before a map's receivers a caster under a directional light may be."""
NEAREST = 1e-6
"""Of a map's depth: what is closer to a point light is none of its silhouette."""


class Skip(Omission):
    """What a light without an area saves."""

    NO_PENUMBRA = "penumbrae beside silhouettes", Because.NO_AREA


@wp.kernel
def look_up_penumbra(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    penumbra: wp.array(dtype=wp.vec2),
    visibility_out: wp.array2d(dtype=float),
):
    """Hard comparison of each pixel, and its texel's light if it is farther than the silhouette that takes it away."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        visible = compare_nearest(light_map, receiver)
        column = int(wp.floor(receiver.x))
        row_ls = int(wp.floor(receiver.y))
        last = light_map.resolution - 1
        if penumbra.shape[0] > 0 and column >= 0 and row_ls >= 0 and column <= last and row_ls <= last:
            beside = penumbra[to_texel(light_map, receiver.layer, column, row_ls)]
            if receiver.depth > beside[0]:
                visible *= beside[1]
    visibility_out[y, x] = visible


@wp.kernel
def look_up_penumbra_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    penumbra: wp.array(dtype=float),  # flat
    visibility_out: wp.array2d(dtype=float),
):
    """``look_up_penumbra`` of a run of pixels."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = receivers.visible
    if receivers.count > 0:
        visible = compare_nearest_run(views, light_map, receivers)
        if penumbra.shape[0] > 0:
            begin = first_texels(light_map, receivers)
            pitch = light_map.pitch
            last = light_map.resolution - 1
            xs = receivers.x
            ys = receivers.y
            layers = receivers.layer
            depths = receivers.depth
            for k in range(LANES):
                column = int(wp.floor(xs[k]))
                row_ls = int(wp.floor(ys[k]))
                inside_x = wp.clamp(column, 0, last)
                inside_y = wp.clamp(row_ls, 0, last)
                beside = wp.where(inside_x != column, 1, 0) | wp.where(inside_y != row_ls, 1, 0)
                at = 2 * (begin[k] + inside_y * pitch + inside_x)
                behind = wp.where(layers[k] >= 0, 1 - beside, 0) & wp.where(depths[k] > penumbra[at], 1, 0)
                visible[k] = visible[k] * wp.where(behind != 0, penumbra[at + 1], 1.0)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, bias: Bias, penumbra: wp.array) -> list:
    return [lane_views(gbuffer, light_map), light_map, bias, flat_floats(penumbra)]


LOOK_UP = Twin(look_up_penumbra, look_up_penumbra_lanes, inputs=_in_lanes, tolerance=1e-5, flips=1e-3)


class SilhouetteMaps(MapTechnique):
    """A light map, and an image beside it of what silhouettes do to each texel's surface.

    Attributes:
        in_loops: Whether edges need to know the ones before and after them.
    """

    in_loops: ClassVar[bool] = False
    family = "outer_penumbrae"
    needs = Needs(lights=ALL_LIGHTS, area=True, whole_casters=True)
    products: ClassVar[tuple[Product, ...]] = (
        Product.G_BUFFER,
        Product.LIGHT_MAP,
        Product.CASTER_EDGES,
        Product.SILHOUETTES,
    )
    bias_sign = "darker"
    may_leave_out = (Skip.NO_PENUMBRA,)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="shadow_map", light_scale=0.0),)

    def draw_and_look_up(
        self,
        frame: Frame,
        gbuffer: GBuffer,
        light_map: HostMap,
        name: str,
        kernel: Twin,
        radius: float,
        width: float,
        visibility_out: wp.array,
    ) -> None:
        """Fills ``visibility_out`` from the light map and the image, which is not drawn where the light has no area.

        Args:
            frame: Keeps the image.
            gbuffer: The receivers.
            light_map: Whose layout the image has.
            name: Of the pass that draws it.
            kernel: Of ``_pull_image``.
            radius: ``light_radius``, for edges whose cones count; or
            width: Of what edges cover, in the light's plane, where that is the same everywhere.
            visibility_out: float32 (H, W).
        """
        penumbra = wp.empty(0, dtype=wp.vec2, device=frame.device)
        if light_map.light.has_area or not frame.leave_out(Skip.NO_PENUMBRA):
            penumbra = self._pull_image(frame, light_map, name, kernel, radius, width).texels
        with frame.timed("penumbra lookup"):
            inputs = [gbuffer, light_map.map, self.params.device_bias, penumbra]
            frame.launch(LOOK_UP, visibility_out.shape, inputs, [visibility_out])

    def _pull_image(
        self, frame: Frame, light_map: HostMap, name: str, kernel: Twin, radius: float, width: float
    ) -> MapImage:
        """Kept for as long as the light map, the silhouettes and all surfaces stay.

        A texel is the depth of a silhouette, +inf where there is none, and what it leaves of the light behind.
        ``kernel`` takes (depth (R, R), lists, edges, pixel to plane, in perspective, radius or width) and fills the
        image (R, R) of a layer.
        """
        geometry = frame.geometry
        silhouettes = pull_silhouettes(frame, geometry, light_map.light_ws)
        loops = pull_loops(frame, silhouettes) if self.in_loops else None
        surfaces = pull_surfaces(frame, frame.rasteriser, geometry, light_map)
        binner = frame.product("memory for lists", "binner", (), lambda old: old or Binner(frame.device, frame.threads))

        def build(old: MapImage | None) -> MapImage:
            points = geometry.points_ws
            image = new_image(frame, light_map.layout, wp.vec2, old, light_map.slot)
            depths = layer_images(surfaces, light_map.layout)
            for view, depth, layer in zip(light_map.views, depths, image.layers, strict=True):
                plane = plane_of_view(light_map.light_ws, view)
                ends = _depths(frame, light_map, view.ws_to_ss[2])
                seen = view.to_device()
                bins = bin_edges(
                    frame, binner, points, silhouettes, plane, ends, radius, seen, width=width, loops=loops
                )
                to_plane = wp.mat33(*pixel_to_plane(light_map.light_ws, view, plane).astype(np.float32).ravel())
                in_perspective = int(light_map.light_ws[3] > 0.0)
                inputs = [depth, bins.lists, bins.edges, to_plane, in_perspective, width or radius]
                frame.launch(kernel, layer.shape, inputs, [layer])
            return image

        inputs = (light_map.map, silhouettes, geometry.version, radius, width)
        out: MapImage = frame.product(name, (name, light_map.slot), inputs, build)
        return out


def _depths(frame: Frame, light_map: HostMap, depth_row: np.ndarray) -> tuple[float, float]:
    """Least and greatest linear depth of silhouettes that matter in a layer."""
    box = frame.geometry.bounds(receivers=True, noticed=True)
    farthest = 0.0 if box.empty else float((box.corners @ depth_row[:3]).max() + depth_row[3])
    if light_map.light_ws[3] == 0.0:
        return -FARTHEST, farthest
    return NEAREST * max(farthest, 1e-30), farthest
