"""What a run of pixels sees: its points, normals and eye depths, 16 at a time (``docs/lanes.md``)."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.receiver_lanes import LaneViews
from wkernels.scene.geometry import MOVES, RECEIVES


@wp.struct
class PointRun:
    """What a run's pixels see; zeros where nothing receives."""

    receives: Ints
    moves: Ints  # 1: the surface itself does
    x: Floats
    y: Floats
    z: Floats
    normal_x: Floats
    normal_y: Floats
    normal_z: Floats
    depth: Floats  # linear eye depth


@wp.func
def points_of_run(views: LaneViews, eye_depth: wp.array(dtype=Floats), x0: int, y: int):
    """The points of pixels x0, x0 + 1, ... of row y; ``eye_depth`` is the G-buffer's, in runs."""
    out = PointRun()
    begin = y * views.width + x0
    flags = views.flags[begin]
    position = views.position_ws[3 * begin]
    normal = views.normal_ws[3 * begin]
    eye_depths = eye_depth[begin]
    receives = Ints(0)
    moves = Ints(0)
    px = Floats(0.0)
    py = Floats(0.0)
    pz = Floats(0.0)
    nx = Floats(0.0)
    ny = Floats(0.0)
    nz = Floats(0.0)
    depth = Floats(0.0)
    for k in range(LANES):
        receives[k] = wp.where((flags[k] & RECEIVES) != 0, 1, 0)
        moves[k] = wp.where((flags[k] & MOVES) != 0, receives[k], 0)
        px[k] = position[3 * k]
        py[k] = position[3 * k + 1]
        pz[k] = position[3 * k + 2]
        nx[k] = normal[3 * k]
        ny[k] = normal[3 * k + 1]
        nz[k] = normal[3 * k + 2]
        depth[k] = wp.where(receives[k] != 0, eye_depths[k], 0.0)
    out.receives = receives
    out.moves = moves
    out.x = px
    out.y = py
    out.z = pz
    out.normal_x = nx
    out.normal_y = ny
    out.normal_z = nz
    out.depth = depth
    return out
