"""The texel types of map images: what filters, sums and pyramids are compiled for."""

from __future__ import annotations

import warp as wp

vec8 = wp.types.vector(length=8, dtype=wp.float32)
vec8d = wp.types.vector(length=8, dtype=wp.float64)

DOUBLE: dict[type, type] = {float: wp.float64, wp.vec2: wp.vec2d, wp.vec4: wp.vec4d, vec8: vec8d}
"""The texel types, and what each is summed in."""


def texel_type(image: wp.array) -> type:
    """The type of an image's texels as a key of ``DOUBLE``; that of another image as it is."""
    return float if image.dtype is wp.float32 else image.dtype


def components(texel: type) -> int:
    """Numbers in a texel."""
    return int(getattr(texel, "_length_", 1))


def check_image(image: wp.array, use: str) -> type:
    """The texel type of a 2-D image that ``use`` (a blur, ...) can be applied to.

    Raises:
        TypeError: The image has another type or number of axes.
    """
    texel = texel_type(image)
    if texel not in DOUBLE or image.ndim != 2:
        raise TypeError(f"{use} needs a 2-D array of float, vec2, vec4 or vec8, not {texel.__name__}")
    return texel
