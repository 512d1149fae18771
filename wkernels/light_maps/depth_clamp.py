"""Casters before a light view's near plane, moved onto it (Brabec, Annen and Seidel 2002).

The near plane of a light view may lie at what the eye sees instead of at the first caster, if casters before it are
not clipped there but clamped to it: they hide everything behind them as before, and only their distance is lost.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, runs_of
from wkernels.device.launch import launch
from wkernels.device.twin import Twin


@wp.kernel
def clamp_depth(first: int, near: float, depth_out: wp.array2d(dtype=float)):
    """Moves depths up to ``near``; the sign that tags moving casters stays."""
    row, x = wp.tid()
    y = first + row
    depth = depth_out[y, x]
    if wp.abs(depth) < near:
        depth_out[y, x] = wp.where(depth < 0.0, -near, near)


@wp.kernel
def clamp_depth_lanes(first: int, near: float, depth_out: wp.array(dtype=Floats)):
    """``clamp_depth`` of a run of texels."""
    at = (first + wp.tid()) * LANES
    depth = depth_out[at]
    for k in range(LANES):
        size = wp.max(wp.abs(depth[k]), near)
        depth[k] = wp.where(depth[k] < 0.0, -size, size)
    depth_out[at] = depth


CLAMP_DEPTH = Twin(
    clamp_depth,
    clamp_depth_lanes,
    outputs=lambda depth: [runs_of(depth, Floats)],
    grid=lambda grid: (grid[0] * grid[1] // int(LANES),),
    fits=lambda near, depth: depth.is_contiguous and depth.size % int(LANES) == 0,
)


def clamp_casters(depth: wp.array, near: float, threads: int | None = None) -> None:
    """Moves everything in a depth map that lies before ``near`` onto it.

    Args:
        depth: float32 (H, W), linear depth; +inf empty, negative where the caster moves.
        near: Linear depth, scene units, above 0.
        threads: CPU threads; None for all.
    """
    launch(CLAMP_DEPTH, depth.shape, [near], [depth], device=str(depth.device), threads=threads)
