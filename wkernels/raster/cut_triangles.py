"""Which triangles are cut out by a texture: the lanes draw the others, and the plain kernels these, over them.

Both sets keep the numbers of all triangles: one that a set leaves out has no area there, and is skipped for that.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.scene.cutouts import Cutouts, cut_triangles

HELD = 8
"""Index arrays whose sets are kept: a geometry has three."""


class CutTriangles:
    """Keeps the sets of the index arrays that it was asked of last; an array that is given again must hold the same."""

    def __init__(self) -> None:
        self._sets: dict[int, tuple[wp.array, bool, tuple[wp.array, wp.array] | None]] = {}

    def any(self, indices: wp.array, cutouts: Cutouts) -> bool:
        """Whether some triangle is cut out."""
        return cutouts.count > 0 and self._held(indices, cutouts)[1]

    def split(self, indices: wp.array, cutouts: Cutouts) -> tuple[wp.array, wp.array]:
        """The triangles that are whole, and those that are cut out, int32 (3 T,) each."""
        sets = self._held(indices, cutouts)[2]
        assert sets is not None, "asked only where some triangle is cut out"
        return sets

    def _held(self, indices: wp.array, cutouts: Cutouts) -> tuple[wp.array, bool, tuple[wp.array, wp.array] | None]:
        held = self._sets.get(id(indices))
        if held is None or held[0] is not indices:
            cut = cut_triangles(indices, cutouts)
            sets = None
            if cut.any():
                corners = indices.numpy().reshape(-1, 3)
                points = np.repeat(corners[:, :1], 3, axis=1)
                pair = np.where(cut[:, None], points, corners), np.where(cut[:, None], corners, points)
                whole, only = (wp.array(part.ravel(), dtype=int, device=indices.device) for part in pair)
                sets = whole, only
            while len(self._sets) >= HELD:
                self._sets.pop(next(iter(self._sets)))
            held = self._sets[id(indices)] = (indices, bool(cut.any()), sets)
        return held
