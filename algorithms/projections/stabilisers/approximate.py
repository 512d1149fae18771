"""Stabiliser `approximate` (flicker_approx): texel sizes in 64 levels at whole texels (Stingl 2011, section 3.5).

What is covered is fitted as without a stabiliser, but its extent is rounded up to a 64th of the diameter of the
split's bounding sphere, and its centre is moved to a whole number of texels (Zhang 2009, whose number of levels was
found by trial).

Known artefacts: shadow edges jump when the level changes. Not with warps.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Stabiliser
from wkernels.projections.focusing import LightSpace
from wkernels.projections.stabilising import frustum_sphere, snapped_window
from wkernels.scene.views import HostView

LEVELS = 64


class Approximate(Stabiliser):
    """The texels' size seldom changes and their offset never does in between."""

    name = "approximate"
    paper = ("zhang2009split", "stingl2011")
    adjusts = True

    def window(self, space: LightSpace, body: np.ndarray, eye: HostView, resolution: int) -> np.ndarray:
        mapped = space.project(body)[:, :2]
        step = 2.0 * frustum_sphere(eye)[1] / LEVELS
        half = 0.5 * step * np.maximum(np.ceil(np.ptp(mapped, axis=0) / step), 1.0)
        return snapped_window(0.5 * (mapped.min(axis=0) + mapped.max(axis=0)), half, resolution)
