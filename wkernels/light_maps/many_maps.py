"""Maps of many points of a light side by side, so that one kernel can ask all of them.

The maps have one layout and lie in one array, a whole number of memory pages apart; each has views of its own, and may
have another number of layers. ``map_of`` gives one of them as the struct that everything in ``light_map`` takes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.errors import InputError
from wkernels.light_maps.drawing import Drawing
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.map_look import look_of
from wkernels.light_maps.storage import allocate_rows, lay_out, layer_images, row_stride
from wkernels.scene.views import HostView

MOST_TEXELS = 2**31 - 1  # an index is a 32-bit number


@wp.struct
class LightMaps:
    """Light depth maps on the device; what ``LightMap`` has once per layer is padded to the most layers there are."""

    depth: wp.array(dtype=float)  # (maps * stride,) as in ``LightMap``
    layer_begin: wp.array2d(
        dtype=int
    )  # (maps, layers) a texel is depth[layer_begin[map, layer] + row * pitch + column]
    pitch: int
    ws_to_ls: wp.array2d(dtype=wp.mat44)  # (maps, layers)
    right_ws: wp.array2d(dtype=wp.vec3)
    up_ws: wp.array2d(dtype=wp.vec3)
    split_far: wp.array2d(dtype=float)
    layers: wp.array(dtype=int)  # (maps,) in use
    resolution: int
    light_ws: wp.array(dtype=wp.vec4)  # (maps,) the light samples
    near: wp.array(dtype=float)
    selection: wp.array(dtype=int)
    eye_row: wp.array(dtype=wp.vec4)
    maps: int
    stride: int  # texels from one map to the next


@wp.func
def map_of(maps: LightMaps, i: int):
    """The ``i``-th map."""
    out = LightMap()
    out.depth = maps.depth
    out.layer_begin = maps.layer_begin[i]
    out.pitch = maps.pitch
    out.ws_to_ls = maps.ws_to_ls[i]
    out.right_ws = maps.right_ws[i]
    out.up_ws = maps.up_ws[i]
    out.split_far = maps.split_far[i]
    out.layers = maps.layers[i]
    out.resolution = maps.resolution
    out.light_ws = maps.light_ws[i]
    out.near = maps.near[i]
    out.selection = maps.selection[i]
    out.eye_row = maps.eye_row[i]
    return out


def draw_light_maps(
    drawing: Drawing,
    views: Sequence[Sequence[HostView]],
    light_ws: np.ndarray,
    old: LightMaps | None = None,
    draws: Sequence[bool] | None = None,
) -> tuple[LightMaps, int]:
    """Draws the maps of many points of a light, each the same bits as ``draw_light_map`` alone.

    Args:
        drawing: How.
        views: Of each map, one square view per layer; all of one resolution.
        light_ws: The light samples (maps, 4), rebased world.
        old: Earlier maps whose memory is taken over where it fits.
        draws: Whether anything is drawn into each; maps that no caster can be in are only cleared.

    Returns:
        The maps, and how many pairs of a block of casters and a layer were left out.

    Raises:
        InputError: More texels than one array holds.
    """
    device, count, layers = drawing.rasteriser.device, len(views), max(len(own) for own in views)
    layout = lay_out(drawing.options.storage, layers, views[0][0].width)
    stride = row_stride(layout)
    if count * stride > MOST_TEXELS:
        raise InputError(
            f"{count} maps of {layout.texels} texels are more than one array holds; take fewer or smaller ones."
        )
    fits = old is not None and old.depth.size == count * stride
    depth = old.depth if old is not None and fits else allocate_rows(layout, count, float, device).flatten()
    beside = 0
    for i, own in enumerate(views):
        images = layer_images(depth[i * stride : (i + 1) * stride], layout)[: len(own)]
        if draws is None or draws[i]:
            beside += drawing.draw(own, images)
        else:
            for image in images:
                image.fill_(float("inf"))
    looks = [look_of(own, sample) for own, sample in zip(views, light_ws, strict=True)]
    begin = np.arange(count)[:, None] * stride + np.array(layout.begin)

    def per_layer(name: str, dtype: type) -> wp.array:
        padded = np.zeros((count, layers, *getattr(looks[0], name).shape[1:]), dtype=np.float32)
        for row, look in zip(padded, looks, strict=True):
            row[: len(look.ws_to_ls)] = getattr(look, name)
        return wp.array(padded, dtype=dtype, device=device)

    def per_map(name: str, dtype: type) -> wp.array:
        return wp.array(np.array([getattr(look, name) for look in looks]), dtype=dtype, device=device)

    out = LightMaps()
    out.depth, out.maps, out.stride = depth, count, stride
    out.pitch, out.resolution = layout.pitch, layout.resolution
    out.layer_begin = wp.array(begin.astype(np.int32), dtype=int, device=device)
    out.ws_to_ls, out.split_far = per_layer("ws_to_ls", wp.mat44), per_layer("split_far", float)
    out.right_ws, out.up_ws = per_layer("right_ws", wp.vec3), per_layer("up_ws", wp.vec3)
    out.layers = wp.array([len(own) for own in views], dtype=int, device=device)
    out.light_ws, out.eye_row = per_map("light_ws", wp.vec4), per_map("eye_row", wp.vec4)
    out.near, out.selection = per_map("near", float), per_map("selection", int)
    return out, beside
