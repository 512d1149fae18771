"""Warp `lispsm_nopt`: light space perspective shadow maps (Wimmer, Scherzer and Purgathofer 2004; general form 2006).

n' = d / (z_1 - z_0) (z_0 + sqrt(z_p z_f)) makes m_z equal at the depths z_p and z_f: the ends z_0 and z_1, which gives
equation 3.2 of Stingl 2011, n' = d / (sqrt(z_1 / z_0) - 1), or the pseudo planes (equation 4.2).

Deviations: printed, equation 4.2 multiplies only its first term by d / (z_1 - z_0), which agrees with equation 3.2 for
overhead light alone. The form here has no difference of nearly equal roots.

Known artefacts: where the angle between light and view is less than half the field of view, m_x exceeds the uniform
map's; ``lispsm_nrepar`` does not.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Warp, WarpShape


class LispsmNopt(Warp):
    """Equal errors in z at both ends."""

    name = "lispsm_nopt"
    paper = ("wimmer2004lispsm", "wimmer2006lispsm", "stingl2011")
    title = "LiSPSM warp (n_opt)"

    def distance(self, shape: WarpShape) -> float:
        rise = shape.z_1 - shape.z_0
        if rise <= 0.0:
            return float(np.inf)
        z_p, z_f = shape.z_0 + shape.pseudo_near * rise, shape.z_1 - shape.pseudo_far * rise
        return float(shape.extent / rise * (shape.z_0 + np.sqrt(z_p * z_f)))
