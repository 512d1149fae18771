"""Which layer of a light map every pixel reads, as an image."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.light_maps.light_map import LightMap, to_layer
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES


@wp.kernel
def find_layers(first: int, gbuffer: GBuffer, light_map: LightMap, layer_out: wp.array2d(dtype=int)):
    """The layer of each pixel's receiver; -1 where no layer holds it or nothing receives."""
    row, x = wp.tid()
    y = first + row
    layer = int(-1)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        layer = to_layer(light_map, gbuffer.position_ws[y, x])
    layer_out[y, x] = layer


def chosen_layers(gbuffer: GBuffer, light_map: LightMap, device: str, threads: int | None = None) -> np.ndarray:
    """int32 (H, W): the layer of ``light_map`` that the receiver in each pixel of ``gbuffer`` reads, or -1."""
    out = wp.empty(gbuffer.depth.shape, dtype=wp.int32, device=device)
    launch(find_layers, out.shape, [gbuffer, light_map], [out], device=device, threads=threads)
    layers: np.ndarray = out.numpy().copy()
    return layers
