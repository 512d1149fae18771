"""Images of any texel type in the layout of a light map: filled from its depths, blurred, summed, read between texels.

A texel of such an image lies where the map's texel of the same layer, row and column does, whatever the storage, and
what a filter reads beyond the border of a layer is the nearest texel inside. ``texels`` names the types, ``blur`` and
``summed_area`` work on one layer, ``mips`` on all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, runs_of, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.filters.blur import separable_blur
from wkernels.filters.summed_area import summed_area_table
from wkernels.filters.texels import DOUBLE, components, texel_type
from wkernels.light_maps.comparison_lanes import first_texels
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.receiver_lanes import ReceiverRun
from wkernels.light_maps.storage import MapLayout, allocate, layer_images


def image_like(old: wp.array | None, layout: MapLayout, texel: type, device: str) -> wp.array:
    """An image in the layout of a map: ``old`` where it fits, else new memory; its content is undefined."""
    fits = old is not None and old.size == layout.texels and texel_type(old) is texel
    return old if fits else allocate(layout, texel, device)


def fill_layers(
    kernel: wp.Kernel,
    lanes: wp.Kernel | None,
    depth: wp.array,
    layout: MapLayout,
    inputs: Sequence[Any],
    out: wp.array,
    *,
    threads: int | None = None,
) -> wp.array:
    """Fills an image from a map's depths, layer by layer.

    Args:
        kernel: (first, depth (R, R), *inputs, image_out (R, R)), launched over (R, R).
        lanes: Its lane kernel, if there is one: (first, depth as runs, *inputs, begin, pitch, R, image_out as runs),
            launched over (R, runs_per_row(R)); begin and pitch are those of the layer, in texels, and a row's last run
            begins within the one before.
        depth: float32 (texels,), of the map.
        layout: Of the map, and of the image.
        inputs: What else the kernels take.
        out: (texels,).

    Returns:
        ``out``.
    """
    device, side = str(out.device), layout.resolution
    if lanes is not None and uses_lanes(device) and side >= LANES:
        runs = wp.types.vector(length=int(LANES) * components(texel_type(out)), dtype=wp.float32)
        depths, images, grid = runs_of(depth, Floats), runs_of(out, runs), (side, runs_per_row(side))
        for begin in layout.begin:
            places = [*inputs, begin, layout.pitch, side]
            launch(lanes, grid, [depths, *places], [images], device=device, threads=threads)
        return out
    for layer, image in zip(layer_images(depth, layout), layer_images(out, layout), strict=True):
        launch(kernel, image.shape, [layer, *inputs], [image], device=device, threads=threads)
    return out


def blur_layers(
    image: wp.array,
    layout: MapLayout,
    weights: np.ndarray,
    *,
    threads: int | None = None,
    scratch: wp.array | None = None,
    out: wp.array | None = None,
) -> wp.array:
    """Every layer of an image blurred; arguments as for ``separable_blur``, images (texels,), scratch (R, R)."""
    out = image_like(out, layout, texel_type(image), str(image.device))
    for layer, blurred in zip(layer_images(image, layout), layer_images(out, layout), strict=True):
        separable_blur(layer, weights, threads=threads, scratch=scratch, out=blurred)
    return out


def sum_layers(
    image: wp.array, layout: MapLayout, *, threads: int | None = None, out: wp.array | None = None
) -> wp.array:
    """The summed-area table of every layer, (layers, R + 1, R + 1) in float64; memory of ``out`` where it fits."""
    texel, side = DOUBLE[texel_type(image)], layout.resolution + 1
    shape = (len(layout.begin), side, side)
    if out is None or out.shape != shape or out.dtype is not texel:
        out = wp.empty(shape, dtype=texel, device=image.device)
    for layer, table in zip(layer_images(image, layout), out, strict=True):
        summed_area_table(layer, threads=threads, out=table)
    return out


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
