"""Warp `none`: texels of equal size, m_x = f/z (Stingl 2011, equations 2.7 and 2.8)."""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Warp, WarpShape


class NoWarp(Warp):
    """A uniform map."""

    name = "none"
    paper = ("stingl2011",)
    title = "uniform"

    def distance(self, shape: WarpShape) -> float:
        return float(np.inf)
