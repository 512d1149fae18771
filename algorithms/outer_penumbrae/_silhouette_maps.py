"""What both techniques share that draw penumbrae beside silhouettes into an image in the light map's layout."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from algorithms.technique import ALL_LIGHTS, Frame, Limit, MapTechnique, Needs
from wkernels.casters.outer_edges import bin_edges, pixel_to_plane, plane_of_view
from wkernels.casters.pulls import pull_silhouettes
from wkernels.device.lanes import LANES, Ints
from wkernels.device.twin import Twin
from wkernels.filters.map_images import MapImage, new_image
from wkernels.light_maps.comparison_lanes import first_texels
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import LightMap, Receiver, to_texel
from wkernels.light_maps.receiver_lanes import ReceiverRun
from wkernels.light_maps.storage import layer_images
from wkernels.light_maps.surfaces import pull_surfaces
from wkernels.raster.binning import Binner
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product

FARTHEST = 1e30
"""How far before a map's receivers a caster under a directional light may be."""
NEAREST = 1e-6
"""Of a map's depth: what is closer to a point light is none of its silhouette."""


class Skip(Omission):
    """What a light without an area saves."""

    NO_PENUMBRA = "penumbrae beside silhouettes", Because.NO_AREA


@wp.func
def texel_of_receiver(light_map: LightMap, receiver: Receiver):
    """The texel that a receiver falls into; -1 beside the map."""
    column = int(wp.floor(receiver.x))
    row = int(wp.floor(receiver.y))
    last = light_map.resolution - 1
    texel = int(-1)
    if column >= 0 and row >= 0 and column <= last and row <= last:
        texel = to_texel(light_map, receiver.layer, column, row)
    return texel


@wp.func
def texels_of_run(light_map: LightMap, receivers: ReceiverRun):
    """``texel_of_receiver`` of each lane; -1 for lanes without a receiver too."""
    begin = first_texels(light_map, receivers)
    pitch = light_map.pitch
    last = light_map.resolution - 1
    xs = receivers.x
    ys = receivers.y
    layers = receivers.layer
    out = Ints(0)
    for k in range(LANES):
        column = int(wp.floor(xs[k]))
        row = int(wp.floor(ys[k]))
        inside_x = wp.clamp(column, 0, last)
        inside_y = wp.clamp(row, 0, last)
        beside = wp.where(inside_x != column, 1, 0) | wp.where(inside_y != row, 1, 0) | wp.where(layers[k] < 0, 1, 0)
        out[k] = wp.where(beside != 0, -1, begin[k] + inside_y * pitch + inside_x)
    return out


class SilhouetteMaps(MapTechnique):
    """A light map, and an image beside it of what silhouettes do to each texel's surface."""

    family = "outer_penumbrae"
    needs = Needs(lights=ALL_LIGHTS, area=True)
    products = (Product.G_BUFFER, Product.LIGHT_MAP, Product.CASTER_EDGES, Product.SILHOUETTES)
    bias_sign = "darker"
    may_leave_out = (Skip.NO_PENUMBRA,)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="shadow_map", light_scale=0.0),)

    def pull_image(
        self,
        frame: Frame,
        light_map: HostMap,
        name: str,
        texel: type,
        kernel: wp.Kernel | Twin,
        radius: float,
        width: float = 0.0,
    ) -> MapImage:
        """The image, kept for as long as the light map, the silhouettes and all surfaces stay.

        Args:
            frame: Keeps it.
            light_map: Whose layout it has.
            name: Of the pass.
            texel: Type of its texels.
            kernel: (first, depth (R, R), lists, edges, pixel_to_plane, in_perspective, size, image_out (R, R)); size is
                the width where it is the same everywhere, else the radius.
            radius: ``light_radius``.
            width: Of what edges cover, in the light's plane, where that is the same everywhere.
        """
        geometry = frame.geometry
        silhouettes = pull_silhouettes(frame, geometry, light_map.light_ws)
        surfaces = pull_surfaces(frame, frame.rasteriser, geometry, light_map)
        binner = frame.product("memory for lists", "binner", (), lambda old: old or Binner(frame.device, frame.threads))

        def build(old: MapImage | None) -> MapImage:
            image = new_image(frame, light_map.layout, texel, old, light_map.slot)
            depths = layer_images(surfaces, light_map.layout)
            for view, depth, layer in zip(light_map.views, depths, image.layers, strict=True):
                plane = plane_of_view(light_map.light_ws, view)
                ends = self._depths(frame, light_map, view.ws_to_ss[2])
                bins = bin_edges(
                    frame, binner, geometry.points_ws, silhouettes, plane, ends, radius, view.to_device(), width
                )
                to_plane = wp.mat33(*pixel_to_plane(light_map.light_ws, view, plane).astype(np.float32).ravel())
                in_perspective = int(light_map.light_ws[3] > 0.0)
                inputs = [depth, bins.lists, bins.edges, to_plane, in_perspective, width or radius]
                frame.launch(kernel, layer.shape, inputs, [layer])
            return image

        inputs = (light_map.map, silhouettes, geometry.version, radius, width)
        out: MapImage = frame.product(name, (name, light_map.slot), inputs, build)
        return out

    def _depths(self, frame: Frame, light_map: HostMap, depth_row: Sequence[Any] | np.ndarray) -> tuple[float, float]:
        """Least and greatest linear depth of silhouettes that matter in a layer."""
        box = frame.geometry.bounds(receivers=True, noticed=True)
        row = np.asarray(depth_row)
        farthest = 0.0 if box.empty else float((box.corners @ row[:3]).max() + row[3])
        if light_map.light_ws[3] == 0.0:
            return -FARTHEST, farthest
        return NEAREST * max(farthest, 1e-30), farthest
