"""Stabiliser `exact` (flicker_exact): texels of constant size at constant places (Stingl 2011, section 3.5).

The map covers the bounding sphere of the split's frustum instead of what lies in it, so that its size does not change
as the eye moves or turns, and its centre is moved to a whole number of texels. The sphere of a frustum with depths n
and f and k^2 = tan^2 theta_x + tan^2 theta_y has its centre at depth min(f, (n + f)/2 (1 + k^2)).

Known artefacts: much of the map is wasted. Not with warps, whose texels move with the eye.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Stabiliser
from wkernels.projections.focusing import LightSpace
from wkernels.projections.stabilising import frustum_sphere, snapped_window
from wkernels.scene.views import HostView


class Exact(Stabiliser):
    """Neither scale nor offset of the texels depends on the eye."""

    name = "exact"
    paper = ("zhang2009split", "stingl2011")
    adjusts = False

    def window(self, space: LightSpace, body: np.ndarray, eye: HostView, resolution: int) -> np.ndarray:
        centre, radius = frustum_sphere(eye)
        middle = space.project(centre[None])[0, :2]
        return snapped_window(middle, np.full(2, radius), resolution)
