"""Receivers that are their own occluder: casting surfaces behind whose seen side the whole light lies.

No sample of the light is seen there, so nothing needs to be tested, remembered or smoothed.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Ints
from wkernels.light_maps.point_lanes import PointRun
from wkernels.light_maps.receiver_lanes import LaneViews
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import CASTS
from wkernels.scene.lights import Light
from wkernels.workspace.workspace import Workspace


def pull_light_corners(work: Workspace, light: Light) -> wp.array:
    """Corners of a convex body that holds the whole light, vec4 (n,), homogeneous, rebased world."""
    hull = light.hull.astype(np.float32)

    def build(old: wp.array | None) -> wp.array:
        out = old or wp.empty(len(hull), dtype=wp.vec4, device=work.device)
        out.assign(hull)
        return out

    corners: wp.array = work.product("light hull", "light corners", hull.tobytes(), build)
    return corners


@wp.func
def is_own_umbra(gbuffer: GBuffer, y: int, x: int, corners: wp.array(dtype=wp.vec4)) -> bool:
    """Whether every point of the light is behind the seen side of the pixel's surface, and that surface casts.

    Args:
        gbuffer: Receivers. y, x: One of them.
        corners: Of the light's hull, ``pull_light_corners``; with none nothing is said to be hidden.
    """
    hidden = corners.shape[0] > 0
    for i in range(corners.shape[0]):
        hidden = hidden and is_back_lit(gbuffer, y, x, to_light(corners[i], gbuffer.position_ws[y, x]))
    return hidden


@wp.func
def own_umbra_run(views: LaneViews, points: PointRun, x0: int, y: int, corners: wp.array(dtype=wp.vec4)):
    """``is_own_umbra`` of the run that begins at (x0, y); 0 where nothing receives."""
    flags = views.flags[y * views.width + x0]
    px = points.x
    py = points.y
    pz = points.z
    nx = points.normal_x
    ny = points.normal_y
    nz = points.normal_z
    out = Ints(0)
    if corners.shape[0] > 0:
        for k in range(LANES):
            out[k] = wp.where((flags[k] & CASTS) != 0, points.receives[k], 0)
        for i in range(corners.shape[0]):
            corner = corners[i]
            c_x, c_y, c_z, c_w = corner[0], corner[1], corner[2], corner[3]
            for k in range(LANES):
                facing = nx[k] * (c_x - px[k] * c_w) + ny[k] * (c_y - py[k] * c_w) + nz[k] * (c_z - pz[k] * c_w)
                out[k] = wp.where(facing <= 0.0, out[k], 0)
    return out
