"""Smoothing in screen space: the mean over neighbours that see about the same depth, as wide as a penumbra looks.

Source: Scherzer et al. 2009, section 3.3; Schwaerzler 2009, section 5.2.3.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, first_of, flat_floats, flat_pairs, second_of
from wkernels.device.twin import Twin
from wkernels.errors import InputError
from wkernels.sampling.disc_sets import poisson_disc_taps
from wkernels.scene.views import View
from wkernels.workspace.workspace import Workspace


def opposite_taps(count: int) -> np.ndarray:
    """Taps in pairs at opposite offsets: half of them a Poisson disc, the other half its mirror image.

    A range of depths cuts the neighbourhood on slanted ground down to a band. Of opposite taps both survive or
    neither, so that the mean stays where it is; a set that is not symmetric, such as the published one, shifts the
    edges of shadows.

    Args:
        count: Taps, an even number from 2 on.

    Returns:
        float64 (count, 2).

    Raises:
        InputError: The number is odd or too small.
    """
    if count < 2 or count % 2:
        raise InputError(f"a filter of opposite taps needs an even number of them, not {count}")
    half = poisson_disc_taps(count // 2)
    return np.concatenate([half, -half])


def pull_opposite_taps(work: Workspace, count: int) -> wp.array:
    """``opposite_taps`` as a product of the frame, vec2 (count,)."""

    def build(old: wp.array | None) -> wp.array:
        return old or wp.array(opposite_taps(count).astype(np.float32), dtype=wp.vec2, device=work.device)

    taps: wp.array = work.product("filter taps", ("opposite taps", count), (), build)
    return taps


@wp.func
def pixels_per_length(view: View, depth: float) -> float:
    """How many pixels a unit length across the view covers at a depth."""
    return 1.0 / wp.max(wp.length(view.base_dx_ws + depth * view.along_dx_ws), 1.0e-30)


@wp.func
def add_neighbours(
    x: int,
    y: int,
    psi_depth: wp.array2d(dtype=wp.vec2),
    half_width_px: float,
    taps: wp.array(dtype=wp.vec2),
    depth_range: float,
    sums: wp.vec2,
) -> wp.vec2:
    """(Sum of psi, number) with the pixels added whose taps fall on a receiver at about the depth of pixel (x, y)."""
    total = sums[0]
    count = sums[1]
    depth = psi_depth[y, x][1]
    for i in range(taps.shape[0]):
        column = int(wp.round(float(x) + half_width_px * taps[i][0]))
        line = int(wp.round(float(y) + half_width_px * taps[i][1]))
        if column >= 0 and line >= 0 and column < psi_depth.shape[1] and line < psi_depth.shape[0]:
            held = psi_depth[line, column]
            if held[1] > 0.0 and wp.abs(held[1] - depth) < depth_range * depth:
                total += held[0]
                count += 1.0
    return wp.vec2(total, count)


@wp.kernel
def filter_neighbourhood(
    first: int,
    psi_depth: wp.array2d(dtype=wp.vec2),
    half_width_px: wp.array2d(dtype=float),
    taps: wp.array(dtype=wp.vec2),
    depth_range: float,
    visibility_out: wp.array2d(dtype=float),
):
    """Visibility from psi, smoothed over the pixels that ask for it (Scherzer et al. 2009, section 3.3).

    The mean of the pixel and of the taps that fall on a receiver of a similar depth.

    Args:
        first: Tile offset.
        psi_depth: Hidden share of the light, 0 to 1, and linear eye depth, (H, W); (0, 0) where nothing receives.
        half_width_px: Half the filter's width in pixels; less than 1/2 for none.
        taps: Offsets in the unit disc, vec2 (n,), ``pull_opposite_taps``.
        depth_range: Largest difference of linear eye depth, share of the pixel's own.
        visibility_out: 1 - psi, smoothed; 1 where nothing receives.
    """
    row, x = wp.tid()
    y = first + row
    total = psi_depth[y, x][0]
    half_width = half_width_px[y, x]
    if half_width >= 0.5:
        sums = add_neighbours(x, y, psi_depth, half_width, taps, depth_range, wp.vec2(total, 1.0))
        total = sums[0] / sums[1]
    visibility_out[y, x] = 1.0 - total


@wp.func
def add_neighbours_run(
    psi_depth: wp.array(dtype=wp.int64),
    x0: int,
    y: int,
    width: int,
    height: int,
    half_width_px: Floats,
    own_depth: Floats,
    taps: wp.array(dtype=wp.vec2),
    depth_range: float,
):
    """``add_neighbours`` of each lane, from nothing: (sum of psi, number); none in lanes that ask for none."""
    total = Floats(0.0)
    count = Floats(0.0)
    begin = y * width
    for i in range(taps.shape[0]):
        tap_x = taps[i][0]
        tap_y = taps[i][1]
        for k in range(LANES):
            reach = wp.where(half_width_px[k] >= 0.5, half_width_px[k], 0.0)
            column = int(wp.round(float(x0 + k) + reach * tap_x))
            line = int(wp.round(float(y) + reach * tap_y))
            in_row = wp.where(column >= 0, wp.where(column < width, 1, 0), 0)
            inside = wp.where(line >= 0, wp.where(line < height, in_row, 0), 0)
            pair = psi_depth[wp.where(inside != 0, line * width + column, begin)]
            receives = wp.where(second_of(pair) > 0.0, inside, 0)
            close = wp.where(wp.abs(second_of(pair) - own_depth[k]) < depth_range * own_depth[k], receives, 0)
            share = wp.where(half_width_px[k] >= 0.5, float(close), 0.0)
            total[k] = total[k] + share * first_of(pair)
            count[k] = count[k] + share
    return total, count


@wp.kernel
def filter_neighbourhood_lanes(
    first: int,
    psi_depth: wp.array(dtype=wp.int64),
    half_width_px: wp.array(dtype=float),
    taps: wp.array(dtype=wp.vec2),
    depth_range: float,
    visibility_out: wp.array2d(dtype=float),
):
    """``filter_neighbourhood`` of a run of pixels; the images flat (H W,), ``flat_pairs`` and ``flat_floats``."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    width = visibility_out.shape[1]
    height = visibility_out.shape[0]
    begin = y * width
    total = Floats(0.0)
    half = Floats(0.0)
    own = Floats(0.0)
    wide = int(0)
    for k in range(LANES):
        at = begin + wp.min(x0 + k, width - 1)
        pair = psi_depth[at]
        total[k] = first_of(pair)
        own[k] = second_of(pair)
        half[k] = half_width_px[at]
        wide += wp.where(half[k] >= 0.5, 1, 0)
    if wide > 0:
        near, count = add_neighbours_run(psi_depth, x0, y, width, height, half, own, taps, depth_range)
        for k in range(LANES):
            total[k] = (total[k] + near[k]) / (1.0 + count[k])
    for k in range(wp.min(LANES, width - x0)):
        visibility_out[y, x0 + k] = 1.0 - total[k]


FILTER_NEIGHBOURHOOD = Twin(
    filter_neighbourhood,
    filter_neighbourhood_lanes,
    inputs=lambda psi_depth, half, *others: [flat_pairs(psi_depth), flat_floats(half), *others],
    tolerance=1e-5,
    flips=1e-3,
)


def filter_image(
    work: Workspace,
    psi_depth: wp.array,
    half_width_px: wp.array,
    taps: int,
    depth_range: float,
    visibility_out: wp.array,
) -> None:
    """Launches ``filter_neighbourhood``, see there, with so many opposite taps."""
    inputs = [psi_depth, half_width_px, pull_opposite_taps(work, taps), depth_range]
    work.launch(FILTER_NEIGHBOURHOOD, visibility_out.shape, inputs, [visibility_out])
