"""Drawing a light depth map: the casters' nearest depth, layer by layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.depth_clamp import clamp_casters
from wkernels.geometry import MOVES, Geometry
from wkernels.lanes import LANES, Floats, Ints, runs_of, uses_lanes
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


@wp.kernel
def tag_moving_lanes(
    first: int,
    triangle: wp.array(dtype=Ints),
    moving: wp.array(dtype=wp.vec2i),
    pixels: int,
    depth_out: wp.array(dtype=Floats),
):
    """``tag_moving`` of a run of texels of one layer; ``moving`` are ranges of triangles, begin and end."""
    run = first + wp.tid()
    at = wp.min(run * LANES, pixels - LANES)
    own = run * LANES - at  # the last run begins within the one before, whose texels are done
    triangles = triangle[at]
    depth = depth_out[at]
    for i in range(moving.shape[0]):
        begin = moving[i][0]
        end = moving[i][1]
        for k in range(LANES):
            inside = wp.where(triangles[k] >= begin, wp.where(triangles[k] < end, 1, 0), 0)
            depth[k] = wp.where(inside != 0, wp.where(k >= own, -depth[k], depth[k]), depth[k])
    depth_out[at] = depth


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
    out.light_ws, out.near = wp.vec4(*light_ws), max(views[0].near, _clamps(views)[0])
    _choose_layers(out, views, device)
    device_views = [view.to_device() for view in views]
    if triangle is None:
        rasteriser.draw_many(geometry.points_ws, geometry.caster_indices, device_views, out.depth, cull=cull)
    else:
        for layer, view in enumerate(device_views):
            rasteriser.draw(geometry.points_ws, geometry.caster_indices, view, out.depth[layer], triangle, cull)
            _tag_moving(out.depth, layer, geometry, triangle, rasteriser)
    for layer, near in enumerate(_clamps(views)):
        if near > 0.0:
            clamp_casters(out.depth[layer], near, rasteriser.threads)
    return out


def _tag_moving(depth: wp.array, layer: int, geometry: Geometry, triangle: wp.array, rasteriser: Rasteriser) -> None:
    device, threads = rasteriser.device, rasteriser.threads
    pixels = triangle.size
    if not uses_lanes(device) or pixels < LANES:
        inputs = [triangle, geometry.triangle_mesh, geometry.mesh_flags, layer]
        launch(tag_moving, triangle.shape, inputs, [depth], device=device, threads=threads)
        return
    runs = -(-pixels // int(LANES))
    inputs = [runs_of(triangle, Ints), geometry.moving_triangles, pixels]
    if pixels % int(LANES):
        # the last two runs overlap: one thread does them one after the other
        threads = 1
    launch(tag_moving_lanes, runs, inputs, [runs_of(depth[layer], Floats)], device=device, threads=threads)


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
    return np.stack([view.ws_to_ss for view in views]).tobytes(), (choices, _clamps(views))


def _clamps(views: Sequence[HostView]) -> tuple[float, ...]:
    return tuple(view.clamped_before if isinstance(view, ProjectiveView) else 0.0 for view in views)
