"""Mips of a map image: its means over squares of 2, 4, 8, ... texels, and lookups between them (Williams 1983)."""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.device.lanes import LANES, Floats, Pairs, runs_of, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.filters.levels import MapLevels, pitch_of, side_of, sides_of
from wkernels.filters.map_images import bilinear
from wkernels.filters.texels import DOUBLE, components, texel_type


@wp.func
def second_share(levels: MapLevels, level: int, i: int):
    """Share of texel ``i`` of a level that the second of its two texels below covers, on one axis; 1/2 inside."""
    half = 1 << (level - 1)
    left = wp.min(levels.resolution - 2 * i * half, half)
    right = wp.clamp(levels.resolution - (2 * i + 1) * half, 0, half)
    return float(right) / float(left + right)


@wp.kernel
def halve(first: int, finer: wp.array[Any], levels: MapLevels, level: int, means_out: wp.array[Any]):
    """One texel of a level, from ``finer``: the image for level 1, else ``means_out`` itself."""
    row, layer, x = wp.tid()
    y = first + row
    last = side_of(levels, level - 1) - 1
    pitch = pitch_of(levels, level - 1)
    begin = levels.begin[level - 1, layer]
    upper_row = begin + 2 * y * pitch
    lower_row = begin + wp.min(2 * y + 1, last) * pitch
    left = 2 * x
    right = wp.min(2 * x + 1, last)
    across = second_share(levels, level, x)
    down = second_share(levels, level, y)
    first_column = finer[upper_row + left] * (1.0 - down) + finer[lower_row + left] * down
    second_column = finer[upper_row + right] * (1.0 - down) + finer[lower_row + right] * down
    at = levels.begin[level, layer] + y * side_of(levels, level) + x
    means_out[at] = first_column * (1.0 - across) + second_column * across


@wp.kernel
def halve_lanes(
    first: int,
    finer: wp.array(dtype=Pairs),  # 32 floats from every float on
    levels: MapLevels,
    level: int,
    components: int,  # of a texel: 1, 2 or 4; of vec8 the plain kernel is as fast
    means_out: wp.array(dtype=Floats),
):
    """``halve`` of a run of floats, where every square is whole; a row's last run begins within the one before."""
    row, layer, run = wp.tid()
    y = first + row
    side = side_of(levels, level)
    start = wp.min(run * LANES, side * components - LANES)
    pitch = pitch_of(levels, level - 1) * components
    begin = levels.begin[level - 1, layer] * components + 2 * (y * pitch + start)
    columns = finer[begin] * 0.5 + finer[begin + pitch] * 0.5
    means = Floats(0.0)
    if components == 1:
        for k in range(LANES):
            means[k] = columns[2 * k] * 0.5 + columns[2 * k + 1] * 0.5
    elif components == 2:
        for k in range(LANES):
            means[k] = columns[2 * k - k % 2] * 0.5 + columns[2 * k - k % 2 + 2] * 0.5
    else:
        for k in range(LANES):
            means[k] = columns[2 * k - k % 4] * 0.5 + columns[2 * k - k % 4 + 4] * 0.5
    means_out[(levels.begin[level, layer] + y * side) * components + start] = means


_HALVE = {t: wp.overload(halve, [int, wp.array(dtype=t), MapLevels, int, wp.array(dtype=t)]) for t in DOUBLE}


def find_mips(
    image: wp.array, levels: MapLevels, *, threads: int | None = None, out: wp.array | None = None
) -> wp.array:
    """The means of an image over the squares that the texels of all levels from 1 on stand for.

    A square at the border of a layer counts with the part of it that lies inside, so that the last level is the mean of
    the layer, for every resolution.

    Args:
        image: (texels,) of float, vec2, vec4 or vec8 in the layout that ``levels`` was made for.
        levels: ``lay_out_levels``.
        threads: CPU threads; see ``wkernels.device.launch``. The result does not depend on it.
        out: Earlier mips whose memory is taken over where it fits.

    Returns:
        (levels.texels,) of the image's type; at least one texel.
    """
    texel, device = texel_type(image), str(image.device)
    size = max(levels.texels, 1)
    if out is None or out.size != size or texel_type(out) is not texel:
        out = wp.empty(size, dtype=image.dtype, device=device)
    count = components(texel)
    for level, side in enumerate(sides_of(levels)[1:], 1):
        finer = image if level == 1 else out
        whole = levels.resolution % (1 << level) == 0
        if uses_lanes(device) and whole and count <= 4 and side * count >= LANES:
            grid = (side, levels.layers, runs_per_row(side * count))
            inputs = [runs_of(finer, Pairs), levels, level, count]
            launch(halve_lanes, grid, inputs, [runs_of(out, Floats)], device=device, threads=threads)
        else:
            grid, inputs = (side, levels.layers, side), [finer, levels, level]
            launch(_HALVE[texel], grid, inputs, [out], device=device, threads=threads)
    return out


@wp.func
def sample_level(texels: wp.array(dtype=Any), levels: MapLevels, level: int, layer: int, x: float, y: float):
    """Bilinear lookup in one level at a position in texels of level 0; of the image for level 0, else of its mips."""
    scale = 1.0 / float(1 << level)
    begin = levels.begin[level, layer]
    return bilinear(texels, begin, pitch_of(levels, level), side_of(levels, level), x * scale, y * scale)


@wp.func
def sample_trilinear(
    image: wp.array(dtype=Any),
    mips: wp.array(dtype=Any),
    levels: MapLevels,
    layer: int,
    x: float,
    y: float,
    level: float,
):
    """Linear between the bilinear lookups in the two levels next to ``level``, which is clamped to those there are.

    Args:
        image: Level 0.
        mips: The others, ``find_mips``.
        levels: Where they lie.
        layer: Of the map.
        x: Texels of level 0.
        y: Likewise, from the top.
        level: ``level_of_width``.
    """
    at = wp.clamp(level, 0.0, float(levels.levels - 1))
    below = wp.min(int(at), wp.max(levels.levels - 2, 0))
    share = at - float(below)
    fine = image.dtype(0.0)
    if below == 0:
        fine = sample_level(image, levels, 0, layer, x, y)
    else:
        fine = sample_level(mips, levels, below, layer, x, y)
    if share > 0.0:
        fine = fine * (1.0 - share) + sample_level(mips, levels, below + 1, layer, x, y) * share
    return fine


@wp.func
def level_of_width(texels: float):
    """The level whose texels are so wide, fractions included; 0 for a texel or less."""
    return wp.log2(wp.max(texels, 1.0))
