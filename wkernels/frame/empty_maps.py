"""Light depth maps that no caster lies in the view of: nothing is drawn into them, nothing compared with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.light_maps.host_map import HostMap
from wkernels.projections.clipping import frustum_planes
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES, Bounds
from wkernels.scene.views import HostView
from wkernels.workspace.left_out import Omission
from wkernels.workspace.workspace import Workspace


class EmptyMaps(Omission):
    """What a map without casters saves."""

    UNDRAWN = "drawing of the light depth map", "no caster lies in the light's view"
    UNCOMPARED = "comparisons with the light depth map", "no caster lies in the light's view"


SLACK = 1e-5  # share of a box's distance: some hundred float32 roundings


@wp.kernel
def light_front(first: int, gbuffer: GBuffer, light_ws: wp.vec4, visibility_out: wp.array2d(dtype=float)):
    """What an empty map says: 0 where a receiver's own surface hides the light, else 1."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        if is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
    visibility_out[y, x] = visible


def may_see(views: Sequence[HostView], casters: Bounds) -> bool:
    """Whether any box of ``casters`` may reach into any of the views; far planes do not count."""
    boxes = casters.corners
    for view in views:
        planes = frustum_planes(view.ws_to_ss, view.near, view.far)[:5]  # the rasteriser has no far plane
        distance = boxes @ planes[:, :3].T + planes[:, 3]
        slack = SLACK * (np.abs(boxes) @ np.abs(planes[:, :3].T) + np.abs(planes[:, 3]))
        # all corners of a box beyond one and the same plane
        if not (distance < -slack).reshape(-1, 8, 5).all(axis=1).any(axis=1).all():
            return True
    return False


def nothing_hides(work: Workspace, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> bool:
    """Fills ``visibility_out`` and returns True where nothing was drawn into the map (and skips are on).

    Args:
        work: Of the session that the map is of.
        gbuffer: The receivers, (H, W).
        light_map: The map.
        visibility_out: float32 (H, W); 1, or 0 where a surface is turned away from the light.
    """
    if not light_map.empty or not work.leave_out(EmptyMaps.UNCOMPARED):
        return False
    with work.timed("surfaces turned away"):
        work.launch(light_front, visibility_out.shape, [gbuffer, light_map.map.light_ws], [visibility_out])
    return True
