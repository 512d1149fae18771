"""Where the levels of a pyramid over a light map lie, whatever its texels are: means (``mips``), ranges (``pyramid``).

Level 0 is the map itself, or an image in its layout. Level l has ceil(R / 2^l) texels per side, each of which stands
for the square of 2^l texels of the map below it, or for what of that square lies in the map. The levels from 1 on lie
in one array of their own: level after level, in each layer after layer, in each row after row, whatever the storage.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.light_maps.storage import MapLayout


@wp.struct
class MapLevels:
    """The levels of all layers of a map."""

    begin: wp.array2d(dtype=int)  # (levels, layers) first texel; level 0 in the map, the others in their own array
    pitch: int  # of level 0; rows of other levels lie side by side
    levels: int  # the last one is a single texel
    layers: int
    resolution: int  # of level 0
    texels: int  # of all levels from 1 on


def lay_out_levels(layout: MapLayout, device: str) -> MapLevels:
    """The levels over a map with this layout, down to 1 x 1."""
    side, layers = layout.resolution, len(layout.begin)
    begin, texels = [np.array(layout.begin)], 0
    while side > 1:
        side = (side + 1) // 2
        begin.append(texels + np.arange(layers) * side * side)
        texels += layers * side * side
    out = MapLevels()
    out.begin = wp.array(np.stack(begin).astype(np.int32), dtype=int, device=device)
    out.pitch, out.levels, out.layers = layout.pitch, len(begin), layers
    out.resolution, out.texels = layout.resolution, texels
    return out


@wp.func
def side_of(levels: MapLevels, level: int):
    """Texels per side of a level."""
    return (levels.resolution + (1 << level) - 1) >> level


@wp.func
def pitch_of(levels: MapLevels, level: int):
    """Texels from one row of a level to the next."""
    return wp.where(level == 0, levels.pitch, side_of(levels, level))


def sides_of(levels: MapLevels) -> list[int]:
    """Texels per side of each level."""
    return [-(-levels.resolution >> level) for level in range(levels.levels)]
