"""Separable blur of images: a row pass, then a column pass. Texels beyond the border repeat the nearest one inside."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, row_runs, runs_per_row
from wkernels.device.launch import launch
from wkernels.device.twin import Twin
from wkernels.filters.texels import DOUBLE, check_image, components, texel_type


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
    total = image.dtype(0.0)
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
    total = image.dtype(0.0)
    for i in range(weights.shape[0]):
        total += weights[i] * image[wp.clamp(y + i - radius, 0, last), x]
    blurred_out[y, x] = total


@wp.kernel
def blur_rows_lanes(
    first: int,
    image: wp.array2d(dtype=float),
    image_runs: wp.array2d(dtype=Floats),  # its rows, a run from every float on
    components: int,
    weights: wp.array(dtype=float),
    blurred_out: wp.array2d(dtype=Floats),
):
    """``blur_rows`` of a run of floats; the last run of a row begins within the one before."""
    row, run = wp.tid()
    y = first + row
    row_floats = image.shape[1]
    start = wp.min(run * LANES, row_floats - LANES)
    radius = weights.shape[0] / 2
    reach = radius * components
    total = Floats(0.0)
    if start >= reach and start + LANES + reach <= row_floats:
        for i in range(weights.shape[0]):
            weight = weights[i]
            values = image_runs[y, start + (i - radius) * components]
            for k in range(LANES):
                total[k] = total[k] + weight * values[k]
    else:
        last = row_floats / components - 1
        for i in range(weights.shape[0]):
            weight = weights[i]
            for k in range(LANES):
                texel = (start + k) / components
                component = start + k - texel * components
                nearest = wp.clamp(texel + i - radius, 0, last)
                total[k] = total[k] + weight * image[y, nearest * components + component]
    blurred_out[y, start] = total


@wp.kernel
def blur_columns_lanes(
    first: int,
    image_runs: wp.array2d(dtype=Floats),
    weights: wp.array(dtype=float),
    blurred_out: wp.array2d(dtype=Floats),
):
    """``blur_columns`` of a run of floats."""
    row, run = wp.tid()
    y = first + row
    start = wp.min(run * LANES, image_runs.shape[1] - 1)
    radius = weights.shape[0] / 2
    last = image_runs.shape[0] - 1
    total = Floats(0.0)
    for i in range(weights.shape[0]):
        weight = weights[i]
        values = image_runs[wp.clamp(y + i - radius, 0, last), start]
        for k in range(LANES):
            total[k] = total[k] + weight * values[k]
    blurred_out[y, start] = total


def _floats_of(image: wp.array) -> wp.array:
    """The components of an image as (H, W n)."""
    shape, strides = (image.shape[0], image.shape[1] * (image.strides[1] // 4)), (image.strides[0], 4)
    return wp.array(ptr=image.ptr, dtype=float, shape=shape, strides=strides, device="cpu")


def _rows_in_lanes(image: wp.array, weights: wp.array) -> list:
    return [_floats_of(image), row_runs(image, Floats), components(texel_type(image)), weights]


def _columns_in_lanes(image: wp.array, weights: wp.array) -> list:
    return [row_runs(image, Floats), weights]


def _out_in_lanes(image: wp.array) -> list:
    return [row_runs(image, Floats)]


def _fits_lanes(image: wp.array, weights: wp.array, out: wp.array) -> bool:
    """Whether a row holds a run, and texels lie side by side."""
    texel = 4 * components(texel_type(image))
    return image.strides[1] == out.strides[1] == texel and image.shape[1] * texel >= 4 * LANES


def _runs_of_texels(count: int, grid: tuple[int, ...]) -> tuple[int, int]:
    """The lanes' grid for texels of so many floats."""
    return grid[0], runs_per_row(grid[1] * count)


def _twins(plain: wp.Kernel, lanes: wp.Kernel, inputs: Callable[..., list]) -> dict[type, Twin]:
    """By type of the texels: (image, weights) -> image blurred along one axis."""
    return {
        t: Twin(
            wp.overload(plain, [int, wp.array2d(dtype=t), wp.array(dtype=float), wp.array2d(dtype=t)]),
            lanes,
            inputs=inputs,
            outputs=_out_in_lanes,
            grid=partial(_runs_of_texels, components(t)),
            fits=_fits_lanes,
            tolerance=1e-6,
        )
        for t in DOUBLE
    }


BLUR_ROWS = _twins(blur_rows, blur_rows_lanes, _rows_in_lanes)
BLUR_COLUMNS = _twins(blur_columns, blur_columns_lanes, _columns_in_lanes)


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
        image: (H, W) of float, vec2, vec4 or vec8; a part of a larger one too.
        weights: An odd number of taps; ``box_weights`` or ``gaussian_weights``. Used as float32.
        threads: CPU threads; see ``wkernels.device.launch``. The result does not depend on it.
        scratch: Holds the row pass; like ``image`` and not the same array. A new one if not given.
        out: Like ``image``, and may be the same array. A new one if not given.

    Returns:
        ``out``.

    Raises:
        TypeError: The image has another type.
        ValueError: The number of weights is even.
    """
    texel = check_image(image, "a blur")
    if len(weights) % 2 == 0:
        raise ValueError(f"a blur needs an odd number of weights, not {len(weights)}")
    device = str(image.device)
    scratch = wp.empty_like(image) if scratch is None else scratch
    out = wp.empty_like(image) if out is None else out
    taps = wp.array(np.asarray(weights, np.float32), dtype=float, device=device)
    launch(BLUR_ROWS[texel], image.shape, [image, taps], [scratch], device=device, threads=threads)
    launch(BLUR_COLUMNS[texel], image.shape, [scratch, taps], [out], device=device, threads=threads)
    return out
