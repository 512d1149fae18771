"""Drawing a light depth map: the casters' nearest depth, layer by layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, runs_of
from wkernels.device.launch import launch
from wkernels.device.twin import Twin
from wkernels.light_maps.depth_clamp import clamp_casters
from wkernels.light_maps.light_map import BY_DEPTH, BY_MARGIN, FIRST_INSIDE, LightMap
from wkernels.light_maps.storage import PLAIN_MAP, MapOptions, allocate, lay_out, layer_images
from wkernels.raster import Rasteriser, TriangleBlocks
from wkernels.scene.geometry import MOVES, Geometry
from wkernels.scene.views import HostView, ProjectiveView


@wp.kernel
def tag_moving(
    first: int,
    triangle: wp.array2d(dtype=int),
    triangle_mesh: wp.array(dtype=int),
    mesh_flags: wp.array(dtype=int),
    moving: wp.array(dtype=wp.vec2i),  # of use in lanes
    depth_out: wp.array2d(dtype=float),
):
    """Negates the depth of texels whose caster moves (Scherzer et al. 2009, section 3.4)."""
    row, x = wp.tid()
    y = first + row
    t = triangle[y, x]
    if t >= 0:
        if (mesh_flags[triangle_mesh[t]] & MOVES) != 0:
            depth_out[y, x] = -depth_out[y, x]


@wp.kernel
def tag_moving_lanes(
    first: int,
    triangle: wp.array(dtype=Ints),
    moving: wp.array(dtype=wp.vec2i),
    width: int,
    pitch: int,  # of both images
    depth_out: wp.array(dtype=Floats),
):
    """``tag_moving`` of a run of texels of one layer; ``moving`` are ranges of triangles, begin and end."""
    row, run = wp.tid()
    start = wp.min(run * LANES, width - LANES)
    own = run * LANES - start  # a row's last run begins within the one before, whose texels are done
    at = (first + row) * pitch + start
    triangles = triangle[at]
    depth = depth_out[at]
    for i in range(moving.shape[0]):
        begin = moving[i][0]
        end = moving[i][1]
        for k in range(LANES):
            inside = wp.where(triangles[k] >= begin, wp.where(triangles[k] < end, 1, 0), 0)
            depth[k] = wp.where(inside != 0, wp.where(k >= own, -depth[k], depth[k]), depth[k])
    depth_out[at] = depth


TAG_MOVING = Twin(
    tag_moving,
    tag_moving_lanes,
    inputs=lambda triangle, mesh, flags, moving: [
        runs_of(triangle, Ints),
        moving,
        triangle.shape[1],
        triangle.strides[0] // 4,
    ],
    outputs=lambda depth: [runs_of(depth, Floats)],
    fits=lambda triangle, *others: triangle.shape[1] >= LANES,
)


def draw_light_map(
    old: LightMap | None,
    geometry: Geometry,
    views: Sequence[HostView],
    light_ws: np.ndarray,
    rasteriser: Rasteriser,
    cull: int,
    triangle: wp.array | None,
    options: MapOptions = PLAIN_MAP,
    blocks: CasterBlocks | None = None,
    everything: bool = False,
    draws: bool = True,
    casters: str = "all",
) -> tuple[LightMap, int]:
    """Draws a map; a new struct each time, so that the struct itself stands for its content.

    Args:
        old: An earlier map of the same resolution and storage whose memory is taken over, if it has as many layers.
        geometry: What casts.
        views: One square view per layer.
        light_ws: The light sample (4,), rebased world.
        rasteriser: Draws the layers.
        cull: Faces that are left out, as seen from the light.
        triangle: int32 (R, pitch) scratch to tag moving casters with, or None to leave them untagged.
        options: How it is stored and drawn; drawn in any other way than in passes only with ``blocks``.
        blocks: Of the casters; what lies beside a layer's view is not drawn there.
        everything: Whether all of it is drawn all the same.
        draws: Whether anything is drawn; a map that no caster can be in is only cleared.
        casters: Which of them, a key of ``Geometry.caster_sets``; blocks are of ``all``, others are drawn in passes.

    Returns:
        The map, and how many pairs of a block of casters and a layer were left out.
    """
    device, layers, resolution = rasteriser.device, len(views), views[0].width

    def axes(name: str) -> wp.array:
        values = np.stack([getattr(view, name) for view in views]).astype(np.float32)
        return wp.array(values, dtype=wp.vec3, device=device)

    layout = lay_out(options.storage, layers, resolution)
    out = LightMap()
    if old is not None and old.layers == layers:
        out.depth, out.layer_begin = old.depth, old.layer_begin
    else:
        out.depth = allocate(layout, float, device)
        out.layer_begin = wp.array(np.array(layout.begin, dtype=np.int32), dtype=int, device=device)
    out.pitch = layout.pitch
    matrices = np.stack([view.ws_to_ss for view in views]).astype(np.float32)
    out.ws_to_ls = wp.array(matrices, dtype=wp.mat44, device=device)
    out.right_ws, out.up_ws = axes("right_ws"), axes("up_ws")
    out.layers, out.resolution = layers, resolution
    out.light_ws, out.near = wp.vec4(*light_ws), max(views[0].near, clamps_of(views)[0])
    _choose_layers(out, views, device)
    if not draws:
        for image in layer_images(out.depth, layout):
            image.fill_(float("inf"))
        return out, 0
    device_views = [view.to_device() for view in views]
    images = layer_images(out.depth, layout)
    owner = None if triangle is None else triangle[:, :resolution]
    clamps = clamps_of(views)

    def finish(layer: int) -> None:
        if owner is not None:
            inputs = [owner, geometry.triangle_mesh, geometry.mesh_flags, geometry.moving_triangles]
            shape, threads = images[layer].shape, rasteriser.threads
            launch(TAG_MOVING, shape, inputs, [images[layer]], device=device, threads=threads)
        if clamps[layer] > 0.0:
            clamp_casters(images[layer], clamps[layer], rasteriser.threads)

    needed = None
    # a single view mostly sees most of the casters: finding out which it does not costs more than drawing them
    drawing = options.drawing if casters == "all" else "passes"
    if casters == "all" and blocks is not None and (options.drawing != "passes" or (layers > 1 and not everything)):
        needed = blocks.pull()
    beside = rasteriser.draw_many(
        geometry.points_ws,
        geometry.caster_sets[casters],
        device_views,
        images,
        None if owner is None else [owner] * layers,
        cull,
        blocks=needed,
        drawing=drawing,
        everything=everything,
        drawn=finish,
    )
    return out, beside


def _choose_layers(out: LightMap, views: Sequence[HostView], device: str) -> None:
    choices = [view.choice for view in views if isinstance(view, ProjectiveView) and view.choice is not None]
    out.selection = int(BY_MARGIN)
    if len(views) == 1 or len(choices) < len(views):
        out.split_far = wp.zeros(1, dtype=float, device=device)
        return
    out.selection = int(BY_DEPTH if choices[0].rule == "depth" else FIRST_INSIDE)
    out.eye_row = wp.vec4(*choices[0].eye_row)
    out.split_far = wp.array([choice.far for choice in choices], dtype=float, device=device)


class CasterBlocks:
    """The blocks of a geometry's casters, made when they are first asked for and kept up to date.

    Args:
        geometry: What casts.
        device: Warp device, the geometry's.
        threads: CPU threads; None for all.
    """

    def __init__(self, geometry: Geometry, device: str, threads: int | None) -> None:
        self._geometry, self._device, self._threads = geometry, device, threads
        self._blocks: TriangleBlocks | None = None
        self._version = 0

    def pull(self) -> TriangleBlocks | None:
        """The blocks at the geometry's present frame; None where nothing casts."""
        geometry = self._geometry
        if geometry.caster_triangles == 0:
            return None
        if self._blocks is None:
            self._blocks = TriangleBlocks(geometry.points_ws, geometry.caster_indices, self._device, self._threads)
        elif self._version != geometry.version:
            self._blocks.update([(int(begin), int(end)) for begin, end in geometry.moving_triangles.numpy()])
        self._version = geometry.version
        return self._blocks


def views_stamp(views: Sequence[HostView]) -> tuple[bytes, tuple]:
    """What a map's content depends on of its views, comparable."""
    choices = tuple(view.choice for view in views if isinstance(view, ProjectiveView))
    return np.stack([view.ws_to_ss for view in views]).tobytes(), (choices, clamps_of(views))


def clamps_of(views: Sequence[HostView]) -> tuple[float, ...]:
    """For each view the linear depth that nearer casters are moved to; 0 where they keep their own."""
    return tuple(view.clamped_before if isinstance(view, ProjectiveView) else 0.0 for view in views)
