"""Depths of all that a light sees, casters or not, in the layout of a light map."""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.storage import allocate, layer_images
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.workspace.workspace import Workspace


def pull_surfaces(work: Workspace, rasteriser: Rasteriser, geometry: Geometry, light_map: HostMap) -> wp.array:
    """Linear depth of the nearest surface in each texel, float32 (layout.texels,), +inf where there is none.

    Args:
        work: Keeps them for as long as map and meshes stay.
        rasteriser: Draws.
        geometry: All meshes.
        light_map: Whose views; they are cut at its near plane, which is before all casters.
    """
    layout = light_map.layout

    def build(old: wp.array | None) -> wp.array:
        out = old if old is not None and old.size == layout.texels else allocate(layout, float, work.device)
        for view, image in zip(light_map.views, layer_images(out, layout), strict=True):
            points, cutouts = geometry.points_ws, geometry.cutouts
            rasteriser.draw(points, geometry.indices, view.to_device(), image, cutouts=cutouts)
        return out

    inputs = (light_map.map, geometry.version)
    return work.product("surfaces seen from the light", ("surfaces", light_map.slot), inputs, build)
