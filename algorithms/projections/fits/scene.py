"""Fit `scene`: light views that cover every receiver of the scene, wherever the eye is.

One orthographic view for a directional light, one perspective view for a point outside the receivers' box, else the six
faces of a cube (Williams 1978; Schwaerzler 2009, section 2.2.3: one map cannot cover an omnidirectional light). Texel
density is even over the scene, so the eye sees perspective aliasing nearby: m_x = f/z at best (Stingl 2011, equations
2.3 and 2.4). Nothing in it depends on the eye, which is why its shadows never swim.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Fit
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView


class Scene(Fit):
    """Covers the receivers' bounding box."""

    name = "scene"
    paper = ("williams1978", "stingl2011")
    title = "fitted to the whole scene"

    def views(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        return scene_views(light_ws, receivers, casters, resolution)
