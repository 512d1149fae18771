"""Images of any texel type in the layout of a light map: filled from its depths, blurred, summed, read between texels.

A texel of such an image lies where the map's texel of the same layer, row and column does, whatever the storage, and
what a filter reads beyond the border of a layer is the nearest texel inside. ``texels`` names the types, ``blur`` and
``summed_area`` work on one layer, ``mips`` on all of them.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.device.twin import Twin
from wkernels.filters.blur import separable_blur
from wkernels.filters.summed_area import summed_area_table
from wkernels.filters.texels import DOUBLE, texel_type
from wkernels.light_maps.comparison_lanes import first_texels
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.receiver_lanes import ReceiverRun
from wkernels.light_maps.storage import MapLayout, allocate, layer_images
from wkernels.workspace.workspace import Workspace


@dataclass(frozen=True, eq=False, kw_only=True)
class MapImage:
    """Texels in the layout of a map. One that is filled anew is a new object, which stands for its content.

    Attributes:
        texels: (layout.texels,) of float, vec2, vec4 or vec8.
        layout: Of the map.
        slot: The map's, ``HostMap.slot``.
    """

    texels: wp.array
    layout: MapLayout
    slot: Hashable = None

    @property
    def layers(self) -> list[wp.array]:
        """Each layer as an image (R, R); views."""
        return layer_images(self.texels, self.layout)

    @property
    def texel(self) -> type:
        """The type of its texels."""
        return texel_type(self.texels)


def new_image(work: Workspace, layout: MapLayout, texel: type, old: MapImage | None, slot: Hashable = None) -> MapImage:
    """An image whose content is undefined, in the memory of an old one where it fits."""
    fits = old is not None and old.layout.texels == layout.texels and old.texel is texel
    texels = old.texels if old is not None and fits else allocate(layout, texel, work.device)
    return MapImage(texels=texels, layout=layout, slot=slot)


def fill_image(
    work: Workspace, kernel: wp.Kernel | Twin, light_map: HostMap, inputs: Sequence[Any], image: MapImage
) -> None:
    """Fills an image from a map's depths, layer by layer.

    Args:
        work: Where it runs.
        kernel: (first, depth (R, R), *inputs, image_out (R, R)), launched over (R, R).
        light_map: The map.
        inputs: What else the kernel takes.
        image: Of the same layout.
    """
    for depth, layer in zip(layer_images(light_map.map.depth, image.layout), image.layers, strict=True):
        work.launch(kernel, layer.shape, [depth, *inputs], [layer])


def blur_image(work: Workspace, image: MapImage, weights: np.ndarray, old: MapImage | None = None) -> MapImage:
    """Every layer blurred by the outer product of ``weights`` with itself; see ``separable_blur`` and ``new_image``."""
    out = new_image(work, image.layout, image.texel, old, image.slot)
    scratch = work.buffer("blurred rows", (image.layout.resolution, image.layout.resolution), image.texel)
    for layer, blurred in zip(image.layers, out.layers, strict=True):
        separable_blur(layer, weights, threads=work.threads, scratch=scratch, out=blurred)
    return out


def sum_image(work: Workspace, image: MapImage, old: wp.array | None = None) -> wp.array:
    """The summed-area table of every layer, (layers, R + 1, R + 1), float64; in the memory of ``old`` where it fits."""
    texel, side = DOUBLE[image.texel], image.layout.resolution + 1
    shape = (len(image.layout.begin), side, side)
    fits = old is not None and old.shape == shape and old.dtype is texel
    out: Any = old if fits else wp.empty(shape, dtype=texel, device=work.device)
    for i, layer in enumerate(image.layers):
        summed_area_table(layer, threads=work.threads, out=out[i])
    return out


def pull_blurred(work: Workspace, name: str, image: MapImage, weights: np.ndarray) -> MapImage:
    """``blur_image`` as a product under the pass ``name``."""
    inputs = (image, weights.tobytes())
    blurred: MapImage = work.product(
        name, (name, image.slot), inputs, lambda old: blur_image(work, image, weights, old)
    )
    return blurred


def pull_sums(work: Workspace, name: str, image: MapImage) -> wp.array:
    """``sum_image`` as a product under the pass ``name``."""
    return work.product(name, (name, image.slot), (image,), lambda old: sum_image(work, image, old))


@wp.func
def bilinear(texels: wp.array(dtype=Any), begin: int, pitch: int, side: int, x: float, y: float):
    """Bilinear lookup at a position in texels of a square within an array; beyond its border the nearest repeats."""
    left = wp.floor(x - 0.5)
    top = wp.floor(y - 0.5)
    x0 = wp.clamp(int(left), 0, side - 1)
    x1 = wp.clamp(int(left) + 1, 0, side - 1)
    row_0 = begin + wp.clamp(int(top), 0, side - 1) * pitch
    row_1 = begin + wp.clamp(int(top) + 1, 0, side - 1) * pitch
    fx = x - 0.5 - left
    fy = y - 0.5 - top
    upper = texels[row_0 + x0] * (1.0 - fx) + texels[row_0 + x1] * fx
    lower = texels[row_1 + x0] * (1.0 - fx) + texels[row_1 + x1] * fx
    return upper * (1.0 - fy) + lower * fy


@wp.func
def sample_bilinear(image: wp.array(dtype=Any), light_map: LightMap, layer: int, x: float, y: float):
    """Bilinear lookup at a position in texels of a layer, in an image in the layout of a map."""
    return bilinear(image, light_map.layer_begin[layer], light_map.pitch, light_map.resolution, x, y)


@wp.struct
class BilinearRun:
    """The four texels round each lane's receiver, and how far it lies between them."""

    a: Ints
    b: Ints
    c: Ints
    d: Ints
    fx: Floats
    fy: Floats


@wp.func
def texels_round_run(light_map: LightMap, receivers: ReceiverRun):
    """What ``sample_bilinear`` reads for each lane, by way of ``sample_component_run``."""
    begin = first_texels(light_map, receivers)
    pitch = light_map.pitch
    last = light_map.resolution - 1
    xs = receivers.x
    ys = receivers.y
    a = Ints(0)
    b = Ints(0)
    c = Ints(0)
    d = Ints(0)
    fx = Floats(0.0)
    fy = Floats(0.0)
    for k in range(LANES):
        left = wp.floor(xs[k] - 0.5)
        top = wp.floor(ys[k] - 0.5)
        x0 = wp.clamp(int(left), 0, last)
        x1 = wp.clamp(int(left) + 1, 0, last)
        y0 = begin[k] + wp.clamp(int(top), 0, last) * pitch
        y1 = begin[k] + wp.clamp(int(top) + 1, 0, last) * pitch
        a[k] = y0 + x0
        b[k] = y0 + x1
        c[k] = y1 + x0
        d[k] = y1 + x1
        fx[k] = xs[k] - 0.5 - left
        fy[k] = ys[k] - 0.5 - top
    out = BilinearRun()
    out.a = a
    out.b = b
    out.c = c
    out.d = d
    out.fx = fx
    out.fy = fy
    return out


@wp.func
def sample_component_run(image: wp.array(dtype=float), components: int, component: int, at: BilinearRun):
    """One component of ``sample_bilinear`` for each lane; ``image`` is flat, ``components`` floats a texel."""
    a = at.a
    b = at.b
    c = at.c
    d = at.d
    fx = at.fx
    fy = at.fy
    out = Floats(0.0)
    for k in range(LANES):
        upper = image[components * a[k] + component] * (1.0 - fx[k]) + image[components * b[k] + component] * fx[k]
        lower = image[components * c[k] + component] * (1.0 - fx[k]) + image[components * d[k] + component] * fx[k]
        out[k] = upper * (1.0 - fy[k]) + lower * fy[k]
    return out
