"""One frame's visibility seen from the next: the correspondence that the flicker metric needs."""

from __future__ import annotations

import numpy as np

from experiments.measured import HARD_EDGE

# Largest miss, as a share of the distance to the furthest of the four pixels. Across a depth edge, pixels of the wrong
# side then have at most this weight.
_MATCH = 0.1


def carry_over(
    previous_visibility: np.ndarray,
    previous_position_ws: np.ndarray,
    previous_ws_to_ss: np.ndarray,
    position_ws: np.ndarray,
) -> np.ndarray:
    """The previous frame's visibility at this frame's receiver points, found by reprojection.

    Interpolates between the four previous pixels around a point, and only where the positions they saw interpolate to
    the point itself. That leaves out disocclusions, silhouettes and meshes that moved, so that what remains is change
    of shadow. A hard edge between the four is left out too: on which side of it the point was is not known, and a guess
    would count as flicker in a picture of rays, which has none.

    Args:
        previous_visibility: (H, W), NaN where no receiver was seen.
        previous_position_ws: (H, W, 3), in the same world space as the other arguments.
        previous_ws_to_ss: (4, 4), rows x, y, linear depth, w as in ``wkernels.views``.
        position_ws: (H, W, 3) of this frame.

    Returns:
        float64 (H, W), NaN where there is no trustworthy match.
    """
    height, width = previous_visibility.shape
    points = position_ws.reshape(-1, 3).astype(np.float64)
    ss = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ previous_ws_to_ss.T
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (0.5 + 0.5 * ss[:, 0] / ss[:, 3]) * width - 0.5
        y = (0.5 - 0.5 * ss[:, 1] / ss[:, 3]) * height - 0.5
        inside = (ss[:, 2] > 0.0) & (x >= 0.0) & (y >= 0.0) & (x <= width - 1) & (y <= height - 1)
    out = np.full(len(points), np.nan)
    if width < 2 or height < 2 or not inside.any():
        return out.reshape(height, width)
    x, y, points = x[inside], y[inside], points[inside]
    column, row = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    fraction_x, fraction_y = x - column, y - row
    corners = [(row + dy, column + dx) for dy in (0, 1) for dx in (0, 1)]
    near = np.stack([previous_position_ws[r, c].astype(np.float64) for r, c in corners])
    weights = np.stack(
        [
            (1.0 - fraction_y) * (1.0 - fraction_x),
            (1.0 - fraction_y) * fraction_x,
            fraction_y * (1.0 - fraction_x),
            fraction_y * fraction_x,
        ]
    )
    miss = np.linalg.norm((weights[:, :, None] * near).sum(axis=0) - points, axis=1)
    reach = np.linalg.norm(near - points, axis=2).max(axis=0)
    seen = np.stack([previous_visibility[r, c].astype(np.float64) for r, c in corners])
    known = (miss <= _MATCH * reach) & (np.ptp(seen, axis=0) <= HARD_EDGE)
    out[inside] = np.where(known, (weights * seen).sum(axis=0), np.nan)
    return out.reshape(height, width)
