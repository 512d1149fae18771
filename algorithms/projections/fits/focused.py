"""Fit `focused`: light views that cover only what the eye sees (Stingl 2011, section 3.1; Brabec et al. 2002).

The covered body is H, the eye's frustum within the receivers' box; its depth range replaces the eye's, so that splits
do not lie in empty space (section 3.3.1). The thesis fits to B, which holds H and all light rays to it within the
scene: in the map B has the extent of H, and only its depth range is larger (``focusing.light_body``), so that
H suffices.

Deviations: linear depth over the whole scene's range, so that no near plane need be moved, and casters before B need no
clamping. Brabec's other variant, a near plane at what is seen with the casters before it clamped to it, is the key
``depth: tight``. Stingl calls that unsafe under a warp, which bends the depth that is clamped; here warps leave depth
linear, and the clamp moves stored depths and no vertices, so that the shadows are the same to the bit. What is lost is
the clamped casters' distance: soft shadows take them for nearer than they are.

Known artefacts: shadow edges swim as the eye moves. A point light within the covered body gets six uniform faces.
"""

from __future__ import annotations

import numpy as np

from algorithms.projections.projection import Fit
from wkernels.projections.clipping import ConvexBody
from wkernels.projections.focusing import fitted_view, light_space, seen_body
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView


class Focused(Fit):
    """Covers the receivers in the eye's view."""

    name = "focused"
    paper = ("stingl2011", "brabec2002", "stamminger2002psm")
    title = "focused on what the eye sees"
    follows_eye = True

    def views(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        body = self.body(receivers, eye)
        scene = Bounds()
        scene.add(np.concatenate([receivers.corners, casters.corners]))
        space = None if body.is_empty else light_space(light_ws, body.vertices, scene, eye)
        if space is None:
            return scene_views(light_ws, receivers, casters, resolution)
        return [fitted_view(space, body.vertices, resolution)]

    def body(self, receivers: Bounds, eye: HostView) -> ConvexBody:
        return seen_body(receivers, eye)
