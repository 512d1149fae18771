"""Warp `lispsm_nrepar`: LiSPSM with Lloyd's strength, which gives way as light and view become parallel (Lloyd 2007).

Equations 3.3 and 3.4 of Stingl 2011: the angle gamma between light and view sets eta from -1 (no warp) to 0 (n_opt);
n' = d / (alpha - 1) (1 + sqrt(alpha) - eta (alpha - 1)) / (eta + 1) with alpha = f/n, where d is the projected width
W_lz.

Deviations: d is measured on what is covered, so equation 3.5, whose W'_s1 is printed wrong, is not used. Angles above
90 degrees are folded. The case eta > 0 of equation 3.4 is kept for completeness; equation 3.3 never gives it.

Known artefacts: assumes a directional or narrow light.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Warp, WarpShape

ETA_B, ETA_C = -0.2, 0.0  # eta at theta, and from theta + 0.3 (90 degrees - theta) on


class LispsmNrepar(Warp):
    """No worse than uniform in x, whatever the light's direction."""

    name = "lispsm_nrepar"
    paper = ("lloyd2007", "lloyd2008", "stingl2011")
    title = "LiSPSM warp (n_repar)"

    def distance(self, shape: WarpShape) -> float:
        eta, alpha = strength(shape.gamma, shape.half_fov), shape.far / shape.near
        if eta <= -1.0 or shape.extent <= 0.0:
            return float(np.inf)
        root = float(np.sqrt(alpha))
        if alpha <= 1.0 + 1e-12:  # 0/0; its limit at eta = 0
            return 2.0 * shape.near / (eta + 1.0)
        factor = (1.0 + root - eta * (alpha - 1.0)) / (eta + 1.0) if eta < 0.0 else (1.0 + root) / (eta * root + 1.0)
        return shape.extent / (alpha - 1.0) * factor


def strength(gamma: float, theta: float) -> float:
    """eta of equation 3.3; both angles in radians, gamma from 0 to pi/2."""
    gamma_a, gamma_b, gamma_c = theta / 3.0, theta, theta + 0.3 * (0.5 * np.pi - theta)
    if gamma <= gamma_a:
        return -1.0
    if gamma <= gamma_b:
        return -1.0 + (ETA_B + 1.0) * (gamma - gamma_a) / (gamma_b - gamma_a)
    if gamma <= gamma_c:
        return ETA_B + (ETA_C - ETA_B) * float(np.sin(0.5 * np.pi * (gamma - gamma_b) / (gamma_c - gamma_b)))
    return ETA_C
