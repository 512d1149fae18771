"""Where the layers of a light map lie in memory (Stingl 2011, section 3.3.5 and Fig 3.16).

A texel of a map is ``depth[layer_begin[layer] + row * pitch + column]``. Whatever the storage, a layer is a square of
its own and filters end at its border, so that pictures do not depend on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import warp as wp

from wkernels.errors import InputError

PLACES: dict[str, int | None] = {
    "separate": None,
    "array": None,
    "cube6": 6,
    "atlas4": 4,
    "atlas9": 9,
    "atlas16": 16,
}
"""The storages and how many layers they have room for; None: as many as a map has.

``separate``: each layer begins on a memory page of its own; ``array``: one after the other; ``cube6``: likewise, always
six faces; ``atlas4``, ``atlas9``, ``atlas16``: one square texture of 2 x 2, 3 x 3 or 4 x 4 tiles, in rows.
"""
DRAWINGS = ("passes", "cloned", "instanced")
PAGE = 1024
"""Texels of a memory page of 4096 bytes."""
MAX_TILE = 2048
"""Texels per side of a tile of an atlas, which thus has at most 8192."""


@dataclass(frozen=True)
class MapOptions:
    """How a projection wants its maps stored and drawn; neither changes a texel's value.

    A projection (``frame.light_side.LightViews``) may have one as its attribute ``map_options``.

    Attributes:
        storage: A key of ``PLACES``.
        drawing: One of ``DRAWINGS``.
    """

    storage: str = "separate"
    drawing: str = "passes"


PLAIN_MAP = MapOptions()


@dataclass(frozen=True)
class MapLayout:
    """Places of a map's layers in its texels.

    Attributes:
        begin: First texel of each layer.
        pitch: Texels from one row of a layer to the next.
        texels: Texels of the whole map, unused places included: what it takes of memory.
        resolution: Texels per side of a layer.
    """

    begin: tuple[int, ...]
    pitch: int
    texels: int
    resolution: int


@lru_cache(maxsize=64)
def lay_out(storage: str, layers: int, resolution: int) -> MapLayout:
    """The layout of a map.

    Args:
        storage: A key of ``PLACES``. Layers that it has no room for (the six faces of an omnidirectional light where an
            atlas of four was meant for splits) are stored as ``array``.
        layers: At least 1.
        resolution: Texels per side of each layer.

    Raises:
        InputError: An atlas of tiles larger than ``MAX_TILE``.
    """
    places = PLACES[storage]
    if places is not None and layers > places:
        storage, places = "array", None
    if storage.startswith("atlas"):
        across = int(np.sqrt(places or 0))
        if resolution > MAX_TILE:
            raise InputError(
                f"'{storage}' takes splits of at most {MAX_TILE} texels per side, so that an atlas stays within "
                f"{4 * MAX_TILE}; the resolution is {resolution}.",
                key="projection.storage",
            )
        pitch = across * resolution
        begin = tuple((i // across * pitch + i % across) * resolution for i in range(layers))
        return MapLayout(begin, pitch, pitch * pitch, resolution)
    size = resolution * resolution
    if storage == "separate":
        size = -(-size // PAGE) * PAGE
    return MapLayout(tuple(i * size for i in range(layers)), resolution, (places or layers) * size, resolution)


@lru_cache(maxsize=64)
def begins_on_device(layout: MapLayout, device: str) -> wp.array:
    """``layout.begin`` for kernels, int32 (layers,); made once, as an array costs as much as many a small launch."""
    return wp.array(np.array(layout.begin, dtype=np.int32), dtype=int, device=device)


def allocate(layout: MapLayout, dtype: type, device: str) -> wp.array:
    """Memory (texels,) of a map, from a page's begin on; its content is undefined."""
    size = wp.types.type_size_in_bytes(dtype)
    held = wp.empty(layout.texels + 4 * PAGE // size, dtype=dtype, device=device)
    skip = -(held.ptr // size) % (4 * PAGE // size)
    return held[skip : skip + layout.texels]


def row_stride(layout: MapLayout) -> int:
    """Texels from one map to the next where maps of one layout lie side by side: whole pages."""
    return -(-layout.texels // PAGE) * PAGE


def allocate_rows(layout: MapLayout, rows: int, dtype: type, device: str) -> wp.array:
    """Memory of so many maps or images of one layout, its content undefined.

    Returns:
        (rows, row_stride(layout)); a row has the texels of ``layout`` at its begin.
    """
    stride = row_stride(layout)
    return allocate(replace(layout, texels=rows * stride), dtype, device).reshape((rows, stride))


def layer_images(texels: wp.array, layout: MapLayout) -> list[wp.array]:
    """The layers of a map as images (R, R); views, which must not outlive it.

    Args:
        texels: (texels,) of any type, as ``allocate`` makes it.
        layout: Of the map.
    """
    size, r = wp.types.type_size_in_bytes(texels.dtype), layout.resolution
    return [
        wp.array(
            ptr=texels.ptr + size * begin,
            dtype=texels.dtype,
            shape=(r, r),
            strides=(size * layout.pitch, size),
            device=texels.device,
        )
        for begin in layout.begin
    ]


def layers_on_host(texels: wp.array, layout: MapLayout) -> np.ndarray:
    """The layers of a map as (layers, R, R) or, of vectors, (layers, R, R, n); a copy."""
    flat = texels.numpy()
    rows = np.arange(layout.resolution)
    at = np.array(layout.begin)[:, None, None] + rows[:, None] * layout.pitch + rows
    return flat[at]
