"""Mips of a map image: its means over squares of 2, 4, 8, ... texels, and lookups between them (Williams 1983)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from wkernels.device.lanes import LANES, Floats, Pairs, in_floats, runs_of
from wkernels.device.twin import Twin
from wkernels.filters.levels import MapLevels, lay_out_levels, pitch_of, side_of, sides_of
from wkernels.filters.map_images import MapImage, bilinear
from wkernels.filters.texels import DOUBLE, components, texel_type
from wkernels.workspace.workspace import Workspace


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
    components: int,  # of a texel: 1, 2 or 4
    means_out: wp.array(dtype=Floats),
):
    """``halve`` of a run of texels, where every square is whole; a row's last run begins within the one before."""
    row, layer, run = wp.tid()
    y = first + row
    side = side_of(levels, level)
    start = wp.min(run * LANES, side - LANES) * components
    pitch = pitch_of(levels, level - 1) * components
    finer_row = levels.begin[level - 1, layer] * components + 2 * y * pitch
    own_row = (levels.begin[level, layer] + y * side) * components
    for part in range(components):
        at = start + part * LANES
        columns = finer[finer_row + 2 * at] * 0.5 + finer[finer_row + 2 * at + pitch] * 0.5
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
        means_out[own_row + at] = means


def _in_lanes(finer: wp.array, levels: MapLevels, level: int) -> list:
    return [runs_of(finer, Pairs), levels, level, components(texel_type(finer))]


def _fits_lanes(finer: wp.array, levels: MapLevels, level: int, means: wp.array) -> bool:
    """Whether every square is whole and a row holds a run; vec8 gains nothing."""
    whole = levels.resolution % (1 << level) == 0 and levels.resolution >> level >= LANES
    return whole and components(texel_type(finer)) <= 4


for _texel in DOUBLE:
    wp.overload(halve, [int, wp.array(dtype=_texel), MapLevels, int, wp.array(dtype=_texel)])
HALVE = Twin(halve, halve_lanes, inputs=_in_lanes, outputs=in_floats, fits=_fits_lanes)
"""(image or mips, levels, level) -> mips, of which one level is written."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Mips:
    """The levels of an image from 1 on.

    Attributes:
        texels: (levels.texels,) of the image's type, or one if there are none.
        levels: Where they lie.
    """

    texels: wp.array
    levels: MapLevels


def find_mips(work: Workspace, image: MapImage, old: Mips | None = None) -> Mips:
    """The means of an image over the squares that the texels of all levels from 1 on stand for.

    A square at the border of a layer counts with the part of it that lies inside, so that the last level is the mean of
    the layer, for every resolution.

    Args:
        work: Where it runs.
        image: Of float, vec2, vec4 or vec8.
        old: Earlier mips, whose memory is taken over where it fits.
    """
    levels = lay_out_levels(image.layout, work.device)
    size = max(levels.texels, 1)
    fits = old is not None and old.texels.size == size and old.texels.dtype is image.texels.dtype
    texels = old.texels if old is not None and fits else wp.zeros(size, dtype=image.texels.dtype, device=work.device)
    for level, side in enumerate(sides_of(levels)[1:], 1):
        inputs = [image.texels if level == 1 else texels, levels, level]
        work.launch(HALVE, (side, levels.layers, side), inputs, [texels])
    return Mips(texels=texels, levels=levels)


def pull_mips(work: Workspace, name: str, image: MapImage) -> Mips:
    """``find_mips`` as a product under the pass ``name``."""
    mips: Mips = work.product(name, (name, image.slot), (image,), lambda old: find_mips(work, image, old))
    return mips


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
