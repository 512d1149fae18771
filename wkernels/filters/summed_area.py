"""Summed-area tables: the mean of an image over any box from its corners (Crow 1984; Lauritzen 2007 for moments).

Entry (y, x) of a table is the sum over all texels above row y and left of column x, so that a table has one row and
one column more than its image, and its first row and column are 0. Sums are float64: in float32 a 1024^2 table of
values near 1 is wrong by 1.6e-2 on a single texel. With u = 2^-53, an H x W image and a box of A
texels, a box mean differs from the exact one by at most ``8 (H + W) u sum|v| / A`` and the final rounding to float32.

Texels must be finite: one infinity would reach every box below and to the right of it.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.device.launch import launch
from wkernels.filters.texels import DOUBLE, check_image

NARROWEST_BOX = wp.constant(1.0 / 1024.0)
"""Texels. A narrower box counts as a point: the difference of its corners would be mostly rounding error."""

_COLUMNS_PER_THREAD = 16  # on the CPU: whole cache lines; one column at a time would load each line over and over
_TEXELS_PER_TILE = 16384  # enough that a small table is not worth a second thread


@wp.func
def double(texel: float):
    """A texel in float64."""
    return wp.float64(texel)


@wp.func  # type: ignore[no-redef]
def double(texel: Any):
    """A texel in float64."""
    return wp.vector(texel, dtype=wp.float64)


@wp.func
def single(texel: wp.float64):
    """A texel in float32."""
    return wp.float32(texel)


@wp.func  # type: ignore[no-redef]
def single(texel: Any):
    """A texel in float32."""
    return wp.vector(texel, dtype=wp.float32)


@wp.func
def _sum_above_left(sat: wp.array2d[Any], x: float, y: float):
    """Integral of the image, constant over each texel, from (0, 0) to (x, y): bilinear in the table, hence exact."""
    col = wp.min(int(x), sat.shape[1] - 2)
    row = wp.min(int(y), sat.shape[0] - 2)
    s = wp.float64(x) - wp.float64(col)
    t = wp.float64(y) - wp.float64(row)
    above = sat[row, col] + s * (sat[row, col + 1] - sat[row, col])
    below = sat[row + 1, col] + s * (sat[row + 1, col + 1] - sat[row + 1, col])
    return above + t * (below - above)


@wp.func
def _clip_interval(start: float, end: float, size: int) -> wp.vec2:
    """The part of an interval within [0, size]; the texel at its middle if it is empty, outside or too narrow."""
    lo = wp.clamp(start, 0.0, float(size))
    hi = wp.clamp(end, 0.0, float(size))
    if hi - lo < NARROWEST_BOX:
        lo = wp.floor(wp.clamp(0.5 * (start + end), 0.0, float(size - 1)))
        hi = lo + 1.0
    return wp.vec2(lo, hi)


@wp.func
def box_mean(sat: wp.array2d[Any], x0: float, y0: float, x1: float, y1: float):
    """Mean of the image over the box [x0, x1] x [y0, y1], clipped to the map.

    Args:
        sat: A table of ``summed_area_table``, (H + 1, W + 1).
        x0: Left border in texels; texel (column i, row j) covers [i, i + 1] x [j, j + 1].
        y0: Upper border.
        x1: Right border. Texels that a border cuts count by the share inside.
        y1: Lower border. A box outside the map, or narrower than ``NARROWEST_BOX``, takes the nearest texel on that
            axis.

    Returns:
        A texel, as the image has them.
    """
    x = _clip_interval(x0, x1, sat.shape[1] - 1)
    y = _clip_interval(y0, y1, sat.shape[0] - 1)
    right = _sum_above_left(sat, x[1], y[1]) - _sum_above_left(sat, x[1], y[0])
    left = _sum_above_left(sat, x[0], y[1]) - _sum_above_left(sat, x[0], y[0])
    area = (wp.float64(x[1]) - wp.float64(x[0])) * (wp.float64(y[1]) - wp.float64(y[0]))
    return single((right - left) / area)


@wp.kernel
def sum_rows(first: int, image: wp.array2d[Any], sat_out: wp.array2d[Any]):
    """Running sums along one row of the image, into the row below of the table."""
    y = first + wp.tid()
    total = sat_out.dtype(0.0)
    sat_out[y + 1, 0] = total
    for x in range(image.shape[1]):
        total += double(image[y, x])
        sat_out[y + 1, x + 1] = total


@wp.kernel
def sum_columns(first: int, columns: int, sat_out: wp.array2d[Any]):
    """Running sums down ``columns`` neighbouring columns, in place."""
    begin = (first + wp.tid()) * columns
    end = wp.min(begin + columns, sat_out.shape[1])
    for x in range(begin, end):
        sat_out[0, x] = sat_out.dtype(0.0)
    for y in range(1, sat_out.shape[0]):
        for x in range(begin, end):
            sat_out[y, x] += sat_out[y - 1, x]


_SUM_ROWS = {t: wp.overload(sum_rows, [int, wp.array2d(dtype=t), wp.array2d(dtype=d)]) for t, d in DOUBLE.items()}
_SUM_COLUMNS = {t: wp.overload(sum_columns, [int, int, wp.array2d(dtype=d)]) for t, d in DOUBLE.items()}


def summed_area_table(image: wp.array, *, threads: int | None = None, out: wp.array | None = None) -> wp.array:
    """The summed-area table of ``image``, on the device of the image.

    Every row and column is summed in order by one thread, so the bits do not depend on the number of threads.

    Args:
        image: (H, W) of float, vec2, vec4 or vec8, finite.
        threads: CPU threads; see ``wkernels.device.launch``.
        out: A table of the right shape and type to be overwritten; a new one if not given.

    Returns:
        (H + 1, W + 1) of the texel's type in float64, ``texels.DOUBLE``.

    Raises:
        TypeError: The image has another type, or ``out`` does not fit it.
    """
    texel = check_image(image, "a summed-area table")
    height, width = image.shape
    dtype, device = DOUBLE[texel], str(image.device)
    if out is None:
        out = wp.empty((height + 1, width + 1), dtype=dtype, device=device)
    elif out.dtype is not dtype or out.shape != (height + 1, width + 1):
        raise TypeError(f"the table of a {height} x {width} image does not fit into {out.shape} of {out.dtype}")
    columns = _COLUMNS_PER_THREAD if image.device.is_cpu else 1
    tile = max(1, _TEXELS_PER_TILE // max(width, 1))
    launch(_SUM_ROWS[texel], height, [image], [out], device=device, threads=threads, tile=tile)
    blocks = -(-(width + 1) // columns)
    tile = max(1, _TEXELS_PER_TILE // (columns * (height + 1)))
    launch(_SUM_COLUMNS[texel], blocks, [columns], [out], device=device, threads=threads, tile=tile)
    return out
