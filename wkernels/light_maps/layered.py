"""Layered light maps: the nearest depths of each texel, not the first alone, and how many there would be.

A *peel* of a map is one of them: peel 0 is the ordinary map, each further one holds what lies next behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.light_maps.depth_clamp import clamp_casters
from wkernels.light_maps.drawing import Drawing
from wkernels.light_maps.light_map import LightMap, to_texel
from wkernels.light_maps.map_look import clamps_of, look_of
from wkernels.light_maps.storage import allocate_rows, lay_out, layer_images, row_stride
from wkernels.raster import COUNT_ALL, CULL_BACK, CULL_FRONT
from wkernels.scene.views import HostView

NO_FACE, FRONT_FACE, BACK_FACE = wp.constant(wp.uint8(0)), wp.constant(wp.uint8(1)), wp.constant(wp.uint8(2))


@wp.struct
class LayeredMap:
    """A light map with the nearest depths of each texel."""

    map: LightMap  # its depths are those of peel 0
    peels: int
    depth: wp.array2d(dtype=float)  # (peels, stride) each row as ``map.depth``, nearest first; +inf: no more
    face: wp.array2d(dtype=wp.uint8)  # (peels, stride) NO_FACE, FRONT_FACE or BACK_FACE towards the light; or (1, 1)


@wp.func
def peel_depth(layered: LayeredMap, peel: int, layer: int, column: int, row: int):
    """Depth of a peel in a texel, +inf outside the layer."""
    resolution = layered.map.resolution
    result = float(wp.inf)
    if column >= 0 and row >= 0 and column < resolution and row < resolution:
        result = layered.depth[peel, to_texel(layered.map, layer, column, row)]
    return result


@wp.kernel
def tag_faces(
    first: int,
    triangle: wp.array2d(dtype=int),
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    light_ws: wp.vec4,
    face_out: wp.array2d(dtype=wp.uint8),
):
    """Which side each texel's triangle turns to the light; counter-clockwise is the front."""
    row, x = wp.tid()
    y = first + row
    t = triangle[y, x]
    face = NO_FACE
    if t >= 0:
        a = points_ws[indices[3 * t]]
        b = points_ws[indices[3 * t + 1]]
        c = points_ws[indices[3 * t + 2]]
        to_light = wp.vec3(light_ws[0], light_ws[1], light_ws[2]) - a * light_ws[3]
        face = BACK_FACE
        if wp.dot(wp.cross(b - a, c - a), to_light) > 0.0:
            face = FRONT_FACE
    face_out[y, x] = face


def draw_layered_map(
    drawing: Drawing,
    views: Sequence[HostView],
    light_ws: np.ndarray,
    peels: int,
    *,
    faces: bool = False,
    old: LayeredMap | None = None,
) -> LayeredMap:
    """Draws a map with the nearest depths of each texel; a new struct each time.

    Surfaces at one depth, to the last bit, are one. Casters that a view moves up to its near plane all lie on it.

    Args:
        drawing: How; casters are drawn in passes, untagged.
        views: One square view per layer.
        light_ws: The light sample (4,), rebased world.
        peels: How many, at least 1.
        faces: Whether it is noted which side they turn to the light.
        old: An earlier map whose memory is taken over where it fits.
    """
    geometry, rasteriser = drawing.geometry, drawing.rasteriser
    device, indices, clamps = rasteriser.device, geometry.caster_sets[drawing.caster_set], clamps_of(views)
    layout = lay_out(drawing.options.storage, len(views), views[0].width)
    shape = (peels, row_stride(layout))
    out = LayeredMap()
    out.peels = peels
    fits = old is not None and old.depth.shape == shape
    out.depth = old.depth if old and fits else allocate_rows(layout, peels, float, device)
    if faces:
        fits = old is not None and old.face.shape == shape
        out.face = old.face if old and fits else allocate_rows(layout, peels, wp.uint8, device)
        triangle = wp.empty((views[0].width, layout.pitch), dtype=int, device=device)[:, : views[0].width]
    else:
        out.face = wp.empty((1, 1), dtype=wp.uint8, device=device)
    out.map = look_of(views, light_ws).on_device(layout, out.depth[0][: layout.texels])
    depths = [layer_images(out.depth[peel], layout) for peel in range(peels)]
    for layer, view in enumerate(views):

        def finish(peel: int, layer: int = layer) -> None:
            depth = depths[peel][layer]
            if faces:
                inputs = [triangle, geometry.points_ws, indices, out.map.light_ws]
                face = layer_images(out.face[peel], layout)[layer]
                launch(tag_faces, face.shape, inputs, [face], device=device, threads=rasteriser.threads)
            if clamps[layer] > 0.0:
                clamp_casters(depth, clamps[layer], rasteriser.threads)

        images = [own[layer] for own in depths]
        owners = [triangle] * peels if faces else None
        points, cutouts = geometry.points_ws, geometry.cutouts
        rasteriser.peel(points, indices, view.to_device(), images, owners, drawing.cull, finish, cutouts=cutouts)
    return out


class LostPeels(NamedTuple):
    """What a layered map does not hold.

    Attributes:
        texels: Texels with more surfaces than there are peels.
        surfaces: How many surfaces these have more.
        most: The most surfaces of any texel.
    """

    texels: int
    surfaces: int
    most: int


def count_lost(drawing: Drawing, views: Sequence[HostView], peels: int) -> LostPeels:
    """Counts the surfaces that a layered map of these views has no room for.

    Surfaces at one depth count one by one here, and so do those beyond the far plane, and whole cards whose leaves
    alone are there.

    Args:
        drawing: As for ``draw_layered_map``.
        views: Likewise.
        peels: Of the map.
    """
    geometry, rasteriser, side = drawing.geometry, drawing.rasteriser, views[0].width
    count = wp.empty((side, side), dtype=int, device=rasteriser.device)
    texels, surfaces, most = 0, 0, 0
    for view in views:
        rasteriser.count(
            geometry.points_ws,
            geometry.caster_sets[drawing.caster_set],
            view.to_device(),
            None,
            count,
            COUNT_ALL,
            front=int(drawing.cull != CULL_FRONT),
            back=int(drawing.cull != CULL_BACK),
        )
        found = count.numpy()
        beyond = found[found > peels] - peels
        texels, surfaces, most = texels + beyond.size, surfaces + int(beyond.sum()), max(most, int(found.max()))
    return LostPeels(texels, surfaces, most)
