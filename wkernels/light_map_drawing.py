"""Drawing a light depth map: the casters' nearest depth, layer by layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.geometry import MOVES, Geometry
from wkernels.launch import launch
from wkernels.light_map import BY_DEPTH, BY_MARGIN, FIRST_INSIDE, LightMap
from wkernels.raster import Rasteriser
from wkernels.views import HostView, ProjectiveView


@wp.kernel
def tag_moving(
    first: int,
    triangle: wp.array2d(dtype=int),
    triangle_mesh: wp.array(dtype=int),
    mesh_flags: wp.array(dtype=int),
    layer: int,
    depth_out: wp.array3d(dtype=float),
):
    """Negates the depth of texels whose caster moves (Scherzer et al. 2009, section 3.4)."""
    row, x = wp.tid()
    y = first + row
    t = triangle[y, x]
    if t >= 0:
        if (mesh_flags[triangle_mesh[t]] & MOVES) != 0:
            depth_out[layer, y, x] = -depth_out[layer, y, x]


def draw_light_map(
    old: LightMap | None,
    geometry: Geometry,
    views: Sequence[HostView],
    light_ws: np.ndarray,
    rasteriser: Rasteriser,
    cull: int,
    triangle: wp.array | None,
) -> LightMap:
    """Draws a map; a new struct each time, so that the struct itself stands for its content.

    Args:
        old: An earlier map of the same resolution whose memory is taken over, if it has as many layers.
        geometry: What casts.
        views: One square view per layer.
        light_ws: The light sample (4,), rebased world.
        rasteriser: Draws the layers.
        cull: Faces that are left out, as seen from the light.
        triangle: int32 (R, R) scratch to tag moving casters with, or None to leave them untagged.
    """
    device, layers, resolution = rasteriser.device, len(views), views[0].width

    def axes(name: str) -> wp.array:
        values = np.stack([getattr(view, name) for view in views]).astype(np.float32)
        return wp.array(values, dtype=wp.vec3, device=device)

    out = LightMap()
    if old is not None and old.layers == layers:
        out.depth = old.depth
    else:
        out.depth = wp.empty((layers, resolution, resolution), dtype=float, device=device)
    matrices = np.stack([view.ws_to_ss for view in views]).astype(np.float32)
    out.ws_to_ls = wp.array(matrices, dtype=wp.mat44, device=device)
    out.right_ws, out.up_ws = axes("right_ws"), axes("up_ws")
    out.layers, out.resolution = layers, resolution
    out.light_ws, out.near = wp.vec4(*light_ws), views[0].near
    _choose_layers(out, views, device)
    for layer, view in enumerate(views):
        rasteriser.draw(geometry.points_ws, geometry.caster_indices, view.to_device(), out.depth[layer], triangle, cull)
        if triangle is not None:
            inputs = [triangle, geometry.triangle_mesh, geometry.mesh_flags, layer]
            launch(tag_moving, triangle.shape, inputs, [out.depth], device=device, threads=rasteriser.threads)
    return out


def _choose_layers(out: LightMap, views: Sequence[HostView], device: str) -> None:
    choices = [view.choice for view in views if isinstance(view, ProjectiveView) and view.choice is not None]
    out.selection = int(BY_MARGIN)
    if len(views) == 1 or len(choices) < len(views):
        out.split_far = wp.zeros(1, dtype=float, device=device)
        return
    out.selection = int(BY_DEPTH if choices[0].rule == "depth" else FIRST_INSIDE)
    out.eye_row = wp.vec4(*choices[0].eye_row)
    out.split_far = wp.array([choice.far for choice in choices], dtype=float, device=device)


def views_stamp(views: Sequence[HostView]) -> tuple[bytes, tuple]:
    """What a map's content depends on of its views, comparable."""
    choices = tuple(view.choice for view in views if isinstance(view, ProjectiveView))
    return np.stack([view.ws_to_ss for view in views]).tobytes(), choices
