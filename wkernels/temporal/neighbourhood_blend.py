"""Sampled and smoothed shadows, blended by the error of the sampled ones; new pixels may keep the blend as a start.

Source: Schwaerzler 2009, sections 5.2.3 and 5.2.4, equations 5.9 to 5.14, and appendix A.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.device.lanes import LANES, Floats, first_of, flat_floats, flat_pairs, second_of
from wkernels.device.twin import Twin
from wkernels.filters.neighbourhood_filter import add_neighbours, add_neighbours_run
from wkernels.sampling.estimators import sampling_weight
from wkernels.temporal.shadow_buffer.record import TEXEL_TYPES, put


@wp.struct
class BlendSettings:
    """How psi is blended with its neighbourhood's mean."""

    depth_range: float  # largest difference of linear eye depth, share of the pixel's own
    least_error: float  # s_min
    largest_error: float  # s_max
    least_samples: float  # n below which the neighbourhood stands alone
    start_weight: float  # samples that a stored start counts as
    rejects_lit: int  # 1, as published: a neighbourhood that is wholly lit counts as none


@wp.func
def blend_psi(psi: float, blur: float, error: float, n: float, settings: BlendSettings) -> float:
    """Psi as it is shown, equation 5.14: the neighbourhood's mean ``blur`` alone while n is small."""
    weight = wp.where(
        n < settings.least_samples, 0.0, sampling_weight(error, settings.least_error, settings.largest_error)
    )
    return blur * (1.0 - weight) + psi * weight


@wp.func
def store_start(texels: wp.array2d(dtype=Any), y: int, x: int, psi: float, weight: float):
    """Makes ``psi`` the sum of so many tests; depth and blocker stay."""
    held = texels[y, x]
    if float(held[1]) > 0.0:
        put(texels, y, x, wp.vec4(psi * weight, weight, float(held[2]), float(held[3])))


@wp.kernel
def blend_neighbourhood(
    first: int,
    psi_depth: wp.array2d(dtype=wp.vec2),
    error: wp.array2d(dtype=float),
    half_width_px: wp.array2d(dtype=float),
    taps: wp.array(dtype=wp.vec2),
    settings: BlendSettings,
    texels: wp.array2d(dtype=Any),
    visibility_out: wp.array2d(dtype=float),
):
    """Visibility from psi and the mean of its neighbours, of which the pixel itself is none.

    Args:
        first: Tile offset.
        psi_depth: Hidden share of the light, 0 to 1, and linear eye depth, (H, W); (0, 0) where nothing receives.
        error: Its standard error.
        half_width_px: Radius of the neighbourhood in pixels, less than 1/2 for none; negative where what is shown is
            stored as the pixel's start.
        taps: Offsets in the unit disc, vec2 (n,).
        settings: What is done.
        texels: The shadow buffer's, (H, W); starts are written into it.
        visibility_out: 1 - psi, smoothed; 1 where nothing receives.
    """
    row, x = wp.tid()
    y = first + row
    shown = psi_depth[y, x][0]
    half_width = wp.abs(half_width_px[y, x])
    if half_width >= 0.5:
        sums = add_neighbours(x, y, psi_depth, half_width, taps, settings.depth_range, wp.vec2(0.0, 0.0))
        blur = sums[0] / wp.max(sums[1], 1.0)
        if sums[1] > 0.0 and (blur > 0.0 or settings.rejects_lit == 0):
            if half_width_px[y, x] < 0.0:
                # a new pixel's one test and its neighbourhood count the same (appendix A)
                shown = 0.5 * (blur + shown)
                store_start(texels, y, x, shown, settings.start_weight)
            else:
                shown = blend_psi(shown, blur, error[y, x], float(texels[y, x][1]), settings)
    visibility_out[y, x] = 1.0 - shown


BLEND_PLAIN = {
    texel: wp.overload(blend_neighbourhood, {"texels": wp.array2d(dtype=texel)}) for texel in TEXEL_TYPES.values()
}


@wp.kernel
def blend_neighbourhood_lanes(
    first: int,
    flat_psi_depth: wp.array(dtype=wp.int64),
    flat_error: wp.array(dtype=float),
    flat_half_width: wp.array(dtype=float),
    taps: wp.array(dtype=wp.vec2),
    settings: BlendSettings,
    flat_texels: wp.array(dtype=float),
    texels: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
):
    """``blend_neighbourhood`` of a run of pixels, for float32 texels; the images flat."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    width = visibility_out.shape[1]
    height = visibility_out.shape[0]
    begin = y * width
    shown = Floats(0.0)
    half = Floats(0.0)
    own = Floats(0.0)
    wide = int(0)
    starts = int(0)
    for k in range(LANES):
        at = begin + wp.min(x0 + k, width - 1)
        asked = flat_half_width[at]
        pair = flat_psi_depth[at]
        shown[k] = first_of(pair)
        own[k] = second_of(pair)
        half[k] = wp.abs(asked)
        wide += wp.where(half[k] >= 0.5, 1, 0)
        starts += wp.where(asked <= -0.5, 1, 0)
    if wide > 0:
        total, count = add_neighbours_run(flat_psi_depth, x0, y, width, height, half, own, taps, settings.depth_range)
        least_error = settings.least_error
        range_ = wp.max(settings.largest_error - least_error, 1.0e-20)
        largest_error = settings.largest_error
        least_samples = settings.least_samples
        rejects_lit = settings.rejects_lit
        taken = Floats(0.0)
        for k in range(LANES):
            at = begin + wp.min(x0 + k, width - 1)
            weight = wp.clamp((largest_error - flat_error[at]) / range_, 0.0, 1.0)
            weight = wp.where(flat_texels[4 * at + 1] < least_samples, 0.0, weight)
            weight = wp.where(flat_half_width[at] < 0.0, 0.5, weight)
            blur = total[k] / wp.max(count[k], 1.0)
            counts = wp.where(blur > 0.0, 1.0, wp.where(rejects_lit != 0, 0.0, 1.0))
            taken[k] = wp.where(count[k] > 0.0, counts, 0.0)
            blended = blur * (1.0 - weight) + shown[k] * weight
            shown[k] = wp.where(taken[k] > 0.0, blended, shown[k])
        if starts > 0:
            for k in range(wp.min(LANES, width - x0)):
                if flat_half_width[begin + x0 + k] <= -0.5 and taken[k] > 0.0:
                    store_start(texels, y, x0 + k, shown[k], settings.start_weight)
    for k in range(wp.min(LANES, width - x0)):
        visibility_out[y, x0 + k] = 1.0 - shown[k]


BLEND: dict[type, wp.Kernel | Twin] = {
    **BLEND_PLAIN,
    wp.vec4: Twin(
        BLEND_PLAIN[wp.vec4],
        blend_neighbourhood_lanes,
        inputs=lambda psi_depth, error, half_width, *others: [
            flat_pairs(psi_depth),
            flat_floats(error),
            flat_floats(half_width),
            *others,
        ],
        outputs=lambda texels, visibility: [flat_floats(texels), texels, visibility],
        tolerance=1e-5,
        flips=1e-3,
    ),
}
"""What blends, by texel type."""
