"""Warp `psm`: the strength of perspective shadow maps (Stamminger and Drettakis 2002), n' = z_0 d / (z_1 - z_0).

Under overhead light that is n' = n, and the map is the paper's own: m_x is constant and m_z grows with depth to (f -
n) / (2 n tan theta) at the far plane (Stingl 2011, equations 2.5 and 2.6).

Deviations: the warp stays within the map's plane, so depth stays linear and the light never turns inside out; for
other light directions the paper's projection is not of this family, and this is Lloyd's end eta = 1 of it. The eye is
not moved back: casters behind it are covered because a body and not the frustum is fitted (Kozlov's remedy is not
needed).

Known artefacts: the far end is starved unless the near plane is as far away as it can be.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Warp, WarpShape


class Psm(Warp):
    """The strongest warp that leaves m_x no greater near than far."""

    name = "psm"
    paper = ("stamminger2002psm", "stingl2011")
    title = "PSM warp"

    def distance(self, shape: WarpShape) -> float:
        rise = shape.z_1 - shape.z_0
        return shape.z_0 * shape.extent / rise if rise > 0.0 else float(np.inf)
