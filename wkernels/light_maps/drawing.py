"""Drawing a light depth map: the casters' nearest depth, layer by layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, runs_of
from wkernels.device.launch import launch
from wkernels.device.twin import Twin
from wkernels.light_maps.depth_clamp import clamp_casters
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.map_look import clamps_of, look_of
from wkernels.light_maps.storage import PLAIN_MAP, MapOptions, allocate, lay_out, layer_images
from wkernels.raster import Rasteriser, TriangleBlocks
from wkernels.scene.geometry import MOVES, Geometry
from wkernels.scene.views import HostView


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


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """How casters are drawn into maps.

    Attributes:
        geometry: What casts.
        rasteriser: Draws it.
        cull: Faces that are left out, as seen from the light.
        caster_set: Which casters, a key of ``Geometry.caster_sets``; blocks are of ``all``, others are drawn in passes.
        options: How maps are stored and drawn; drawn in any other way than in passes only with ``blocks``.
        blocks: Of the casters; what lies beside a layer's view is not drawn there.
        everything: Whether all of it is drawn all the same.
        triangle: int32 (R, pitch) scratch to tag moving casters with, or None to leave them untagged.
    """

    geometry: Geometry
    rasteriser: Rasteriser
    cull: int
    caster_set: str = "all"
    options: MapOptions = PLAIN_MAP
    blocks: CasterBlocks | None = None
    everything: bool = False
    triangle: wp.array | None = None

    def draw(self, views: Sequence[HostView], images: Sequence[wp.array]) -> int:
        """Draws the layers of a map.

        Args:
            views: One per layer.
            images: float32 (R, R) each.

        Returns:
            How many pairs of a block of casters and a layer were left out.
        """
        geometry, rasteriser = self.geometry, self.rasteriser
        owner = None if self.triangle is None else self.triangle[:, : views[0].width]
        clamps = clamps_of(views)

        def finish(layer: int) -> None:
            if owner is not None:
                inputs = [owner, geometry.triangle_mesh, geometry.mesh_flags, geometry.moving_triangles]
                shape, device, threads = images[layer].shape, rasteriser.device, rasteriser.threads
                launch(TAG_MOVING, shape, inputs, [images[layer]], device=device, threads=threads)
            if clamps[layer] > 0.0:
                clamp_casters(images[layer], clamps[layer], rasteriser.threads)

        # a single view mostly sees most of the casters: finding out which it does not costs more than drawing them
        drawing = self.options.drawing if self.caster_set == "all" else "passes"
        sorts_out = drawing != "passes" or (len(views) > 1 and not self.everything)
        return rasteriser.draw_many(
            geometry.points_ws,
            geometry.caster_sets[self.caster_set],
            [view.to_device() for view in views],
            images,
            None if owner is None else [owner] * len(views),
            self.cull,
            blocks=self.blocks.pull() if self.blocks and sorts_out and self.caster_set == "all" else None,
            drawing=drawing,
            everything=self.everything,
            drawn=finish,
            cutouts=geometry.cutouts,
        )


def draw_light_map(
    drawing: Drawing, views: Sequence[HostView], light_ws: np.ndarray, old: LightMap | None = None, draws: bool = True
) -> tuple[LightMap, int]:
    """Draws a map; a new struct each time, so that the struct itself stands for its content.

    Args:
        drawing: How.
        views: One square view per layer.
        light_ws: The light sample (4,), rebased world.
        old: An earlier map of the same resolution and storage whose memory is taken over, if it has as many layers.
        draws: Whether anything is drawn; a map that no caster can be in is only cleared.

    Returns:
        The map, and how many pairs of a block of casters and a layer were left out.
    """
    layout = lay_out(drawing.options.storage, len(views), views[0].width)
    device = drawing.rasteriser.device
    fits = old is not None and old.layers == len(views)
    depth = old.depth if old is not None and fits else allocate(layout, float, device)
    out = look_of(views, light_ws).on_device(layout, depth)
    images = layer_images(depth, layout)
    if draws:
        return out, drawing.draw(views, images)
    for image in images:
        image.fill_(float("inf"))
    return out, 0


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
            self._blocks.update(geometry.movable_triangles)
        self._version = geometry.version
        return self._blocks
