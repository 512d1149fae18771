"""One frame seen from the next: what the flicker metric compares, and what the frame before did not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.metrics.measured import HARD_EDGE

# Largest miss, as a share of the distance to the furthest of the four pixels. Across a depth edge, pixels of the wrong
# side then have at most this weight.
_MATCH = 0.1
# Largest difference of depths, relative, at which a neighbouring pixel still saw the same surface.
_SAME_DEPTH = 0.005


@dataclass(frozen=True, eq=False)
class _Lookup:
    """Points that fall on the previous image, each between four of its pixels.

    Attributes:
        inside: Which of all points, bool (N,).
        depth: Linear depth in the previous view, (M,).
        corners: Rows and columns of the pixels around, four of ((M,), (M,)).
        weights: Theirs, (4, M).
        near: What they saw, (4, M, 3).
        matches: Whether these positions interpolate to the point, bool (M,).
    """

    inside: np.ndarray
    depth: np.ndarray
    corners: list[tuple[np.ndarray, np.ndarray]]
    weights: np.ndarray
    near: np.ndarray
    matches: np.ndarray


def carry_over(
    previous_visibility: np.ndarray,
    previous_position_ws: np.ndarray,
    previous_ws_to_ss: np.ndarray,
    position_ws: np.ndarray,
    *,
    across_edges: bool = False,
) -> np.ndarray:
    """The previous frame's visibility at this frame's receiver points, found by reprojection.

    Interpolates between the four previous pixels around a point, and only where the positions they saw interpolate to
    the point itself. That leaves out disocclusions, silhouettes and meshes that moved, so that what remains is change
    of shadow. A hard edge between the four is left out too: on which side of it the point was is not known, and a guess
    would count as flicker in a picture of rays, which has none.

    Args:
        previous_visibility: (H, W), NaN where no receiver was seen.
        previous_position_ws: (H, W, 3), in the same world space as the other arguments.
        previous_ws_to_ss: (4, 4), rows x, y, linear depth, w as in ``wkernels.scene.views``.
        position_ws: (H, W, 3) of this frame.
        across_edges: Keep points at hard edges, to compare pictures whose edges are not equally hard.

    Returns:
        float64 (H, W), NaN where there is no trustworthy match.
    """
    out = np.full(previous_visibility.size, np.nan)
    found = _look_up(previous_position_ws, previous_ws_to_ss, position_ws)
    if found is not None:
        seen = np.stack([previous_visibility[r, c].astype(np.float64) for r, c in found.corners])
        known = found.matches & (across_edges | (np.ptp(seen, axis=0) <= HARD_EDGE))
        out[found.inside] = np.where(known, (found.weights * seen).sum(axis=0), np.nan)
    return out.reshape(previous_visibility.shape)


def disoccluded(previous_position_ws: np.ndarray, previous_ws_to_ss: np.ndarray, position_ws: np.ndarray) -> np.ndarray:
    """Which points the previous frame did not see: outside its image, behind a surface, or on one that moved away.

    A point counts as seen where the positions around it interpolate to it, or where one of the four pixels saw the same
    depth within half a percent: at silhouettes the four lie on two surfaces. Points are followed by the camera's motion
    alone, as temporal techniques do it.

    Args:
        previous_position_ws: (H, W, 3), NaN where nothing was seen.
        previous_ws_to_ss: (4, 4), rows x, y, linear depth, w as in ``wkernels.scene.views``.
        position_ws: (H, W, 3) of this frame.

    Returns:
        bool (H, W); False where this frame sees nothing.
    """
    shape = position_ws.shape[:2]
    unseen = np.isfinite(position_ws[..., 0]).ravel()
    found = _look_up(previous_position_ws, previous_ws_to_ss, position_ws, border_px=0.5)
    if found is None:
        return unseen.reshape(shape)
    seen, open_ = found.matches.copy(), ~found.matches
    if open_.any():
        row = previous_ws_to_ss[2]
        depths = found.near[:, open_] @ row[:3] + row[3]
        with np.errstate(invalid="ignore"):
            seen[open_] = (np.abs(depths - found.depth[open_]) <= _SAME_DEPTH * found.depth[open_]).any(axis=0)
    unseen[np.flatnonzero(found.inside)[seen]] = False
    return unseen.reshape(shape)


def _look_up(
    previous_position_ws: np.ndarray, previous_ws_to_ss: np.ndarray, position_ws: np.ndarray, border_px: float = 0.0
) -> _Lookup | None:
    """None where no point falls between four pixel centres, or less than ``border_px`` outside them."""
    height, width = previous_position_ws.shape[:2]
    points = position_ws.reshape(-1, 3).astype(np.float64)
    ss = points @ previous_ws_to_ss[:, :3].T + previous_ws_to_ss[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (0.5 + 0.5 * ss[:, 0] / ss[:, 3]) * width - 0.5
        y = (0.5 - 0.5 * ss[:, 1] / ss[:, 3]) * height - 0.5
        right, bottom = width - 1 + border_px, height - 1 + border_px
        inside = (ss[:, 2] > 0.0) & (x >= -border_px) & (y >= -border_px) & (x <= right) & (y <= bottom)
    if width < 2 or height < 2 or not inside.any():
        return None
    x, y, points = np.clip(x[inside], 0.0, width - 1), np.clip(y[inside], 0.0, height - 1), points[inside]
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
    return _Lookup(inside, ss[inside, 2], corners, weights, near, miss <= _MATCH * reach)
