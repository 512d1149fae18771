"""Moments of depth, and what share of the depths under a filter they say can be lit (Donnelly and Lauritzen 2006)."""

from __future__ import annotations

import numpy as np
import warp as wp


@wp.struct
class Chebyshev:
    """How moments become visibility."""

    near: float  # linear depth that is -1/2, scene units
    per_length: float  # 1 / (depth range), per scene unit
    min_variance: float  # of normalised depth
    bleeding: float  # share of the bound that is cut off


@wp.func
def normalised(chebyshev: Chebyshev, depth: float):
    """Linear depth to [-1/2, 1/2] over the range; empty texels (+inf) and what lies beyond it to 1/2."""
    return wp.min((depth - chebyshev.near) * chebyshev.per_length, 1.0) - 0.5


@wp.func
def lit_share(chebyshev: Chebyshev, moments: wp.vec2, depth: float):
    """Upper bound of the share of depths, with these moments, at or beyond ``depth`` (all normalised), in [0, 1]."""
    behind = depth - moments[0]
    bound = float(1.0)
    if behind > 0.0:
        variance = wp.max(moments[1] - moments[0] * moments[0], chebyshev.min_variance)
        bound = variance / (variance + behind * behind)
    return wp.max(bound - chebyshev.bleeding, 0.0) / (1.0 - chebyshev.bleeding)


@wp.func
def smaller_step(before: float, here: float, after: float):
    """The smaller of the two one-sided differences."""
    return wp.min(wp.abs(here - before), wp.abs(after - here))


@wp.kernel
def find_moments(
    first: int,
    depth: wp.array3d(dtype=float),
    chebyshev: Chebyshev,
    slope_variance: int,
    layer: int,
    moments_out: wp.array2d(dtype=wp.vec2),
):
    """Depth and squared depth of each texel of a layer."""
    row, x = wp.tid()
    y = first + row
    last = depth.shape[1] - 1
    z = normalised(chebyshev, depth[layer, y, x])
    square = z * z
    if slope_variance != 0:
        left = normalised(chebyshev, depth[layer, y, wp.max(x - 1, 0)])
        right = normalised(chebyshev, depth[layer, y, wp.min(x + 1, last)])
        above = normalised(chebyshev, depth[layer, wp.max(y - 1, 0), x])
        below = normalised(chebyshev, depth[layer, wp.min(y + 1, last), x])
        dx = smaller_step(left, z, right)
        dy = smaller_step(above, z, below)
        square += 0.25 * (dx * dx + dy * dy)
    moments_out[y, x] = wp.vec2(z, square)


@wp.func
def sample_bilinear(image: wp.array3d(dtype=wp.vec2), layer: int, x: float, y: float):
    """Bilinear lookup at a position in texels; beyond the border the nearest texel repeats."""
    last = image.shape[1] - 1
    left = wp.floor(x - 0.5)
    top = wp.floor(y - 0.5)
    x0 = wp.clamp(int(left), 0, last)
    x1 = wp.clamp(int(left) + 1, 0, last)
    y0 = wp.clamp(int(top), 0, last)
    y1 = wp.clamp(int(top) + 1, 0, last)
    fx = x - 0.5 - left
    fy = y - 0.5 - top
    upper = image[layer, y0, x0] * (1.0 - fx) + image[layer, y0, x1] * fx
    lower = image[layer, y1, x0] * (1.0 - fx) + image[layer, y1, x1] * fx
    return upper * (1.0 - fy) + lower * fy


def depth_range(ws_to_ls: np.ndarray, corners_ws: np.ndarray) -> tuple[float, float]:
    """Least and greatest linear depth of a box in front of a light.

    Args:
        ws_to_ls: The map's matrices, (layers, 4, 4).
        corners_ws: Corners of the box, (8, 3), rebased world; none for a scene without meshes.

    Returns:
        near >= 0 and far > near, scene units, over all layers.
    """
    if len(corners_ws) == 0:
        return 0.0, 1.0
    depth = corners_ws @ ws_to_ls[:, 2, :3].T + ws_to_ls[:, 2, 3]
    near, far = max(float(depth.min()), 0.0), max(float(depth.max()), 0.0)
    return near, max(far, near + 1e-6 * max(near, 1e-6))
