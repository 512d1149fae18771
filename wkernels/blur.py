"""Separable blur of images: a row pass, then a column pass. Texels beyond the border repeat the nearest one inside."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.launch import launch


def box_weights(radius: int) -> np.ndarray:
    """Equal weights of 2 ``radius`` + 1 taps, float64, sum 1; ``radius`` >= 0 in texels."""
    return np.full(2 * radius + 1, 1.0 / (2 * radius + 1))


def gaussian_weights(radius: int, sigma: float | None = None) -> np.ndarray:
    """Gaussian weights of 2 ``radius`` + 1 taps.

    Args:
        radius: Texels on each side, >= 0.
        sigma: Standard deviation in texels, > 0; half the radius if not given, so that the kernel ends at two of it.

    Returns:
        float64 (2 radius + 1,), symmetric, sum 1.
    """
    if radius == 0:
        return np.ones(1)
    offset = np.arange(-radius, radius + 1) / (0.5 * radius if sigma is None else sigma)
    weights = np.exp(-0.5 * offset * offset)
    return weights / weights.sum()


@wp.kernel
def blur_rows(first: int, image: wp.array2d[Any], weights: wp.array[float], blurred_out: wp.array2d[Any]):
    """Weighted mean along the row of each texel."""
    row, x = wp.tid()
    y = first + row
    radius = weights.shape[0] / 2
    last = image.shape[1] - 1
    total = image.dtype()
    for i in range(weights.shape[0]):
        total += weights[i] * image[y, wp.clamp(x + i - radius, 0, last)]
    blurred_out[y, x] = total


@wp.kernel
def blur_columns(first: int, image: wp.array2d[Any], weights: wp.array[float], blurred_out: wp.array2d[Any]):
    """Weighted mean along the column of each texel."""
    row, x = wp.tid()
    y = first + row
    radius = weights.shape[0] / 2
    last = image.shape[0] - 1
    total = image.dtype()
    for i in range(weights.shape[0]):
        total += weights[i] * image[wp.clamp(y + i - radius, 0, last), x]
    blurred_out[y, x] = total


_TYPES = (wp.vec2, wp.vec4)
_BLUR_ROWS, _BLUR_COLUMNS = (
    {t: wp.overload(kernel, [int, wp.array2d(dtype=t), wp.array(dtype=float), wp.array2d(dtype=t)]) for t in _TYPES}
    for kernel in (blur_rows, blur_columns)
)


def separable_blur(
    image: wp.array,
    weights: np.ndarray,
    *,
    threads: int | None = None,
    scratch: wp.array | None = None,
    out: wp.array | None = None,
) -> wp.array:
    """``image`` blurred by the outer product of ``weights`` with itself, on the device of the image.

    Args:
        image: (H, W) of vec2 or vec4.
        weights: An odd number of taps; ``box_weights`` or ``gaussian_weights``. Used as float32.
        threads: CPU threads; see ``wkernels.launch``. The result does not depend on it.
        scratch: Holds the row pass; like ``image`` and not the same array. A new one if not given.
        out: Like ``image``, and may be the same array. A new one if not given.

    Returns:
        ``out``.

    Raises:
        TypeError: The image has another type.
        ValueError: The number of weights is even.
    """
    if image.dtype not in _TYPES or image.ndim != 2:
        raise TypeError(f"a blur needs a 2-D array of vec2 or vec4, not {image.dtype.__name__}")
    if len(weights) % 2 == 0:
        raise ValueError(f"a blur needs an odd number of weights, not {len(weights)}")
    device = str(image.device)
    scratch = wp.empty_like(image) if scratch is None else scratch
    out = wp.empty_like(image) if out is None else out
    taps = wp.array(np.asarray(weights, np.float32), dtype=float, device=device)
    launch(_BLUR_ROWS[image.dtype], image.shape, [image, taps], [scratch], device=device, threads=threads)
    launch(_BLUR_COLUMNS[image.dtype], image.shape, [scratch, taps], [out], device=device, threads=threads)
    return out
