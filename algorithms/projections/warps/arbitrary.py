"""Warp `arbitrary`: n' chosen by the user, for experiments (Stingl 2011, section 3.4).

The key ``warp_distance`` gives n' as a multiple of the extent that is covered, d, so that one value means the same
warp in every split: n' = d n / (f - n) is perspective shadow maps, and a large value no warp.

Known artefacts: too small a value starves the far end; the equations of the analysis hold for n' >= n only.
"""

from __future__ import annotations

from algorithms.projections.projection import Warp, WarpShape


class Arbitrary(Warp):
    """As strong as asked for."""

    name = "arbitrary"
    paper = ("stingl2011",)
    title = "warp of arbitrary strength"
    takes_distance = True

    def distance(self, shape: WarpShape) -> float:
        return (1.0 if shape.distance is None else shape.distance) * shape.extent
