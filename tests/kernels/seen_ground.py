"""An eye over the plane y = -1, and what a history of it says of a point, one texel at a time."""

from __future__ import annotations

import numpy as np

from wkernels.scene.views import HostView

WIDTH, HEIGHT = 24, 18

EYE = HostView(
    eye_ws=np.array([0.3, 2.0, 5.0]),
    right_ws=np.array([1.0, 0.0, 0.0]),
    up_ws=np.array([0.0, np.cos(0.5), -np.sin(0.5)]),
    forward_ws=np.array([0.0, -np.sin(0.5), -np.cos(0.5)]),
    window=(-0.6, 0.6, -0.45, 0.45),
    near=0.1,
    far=40.0,
    width=WIDTH,
    height=HEIGHT,
)


def ground_depth(x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
    """Linear depth of the plane y = -1 at screen positions of ``EYE``."""
    return (-1.0 - EYE.eye_ws[1]) / ray(x_px, y_px)[..., 1]


def ray(x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
    left, right, bottom, top = EYE.window
    s = left + (right - left) * np.asarray(x_px)[..., None] / WIDTH
    t = top + (bottom - top) * np.asarray(y_px)[..., None] / HEIGHT
    return EYE.forward_ws + s * EYE.right_ws + t * EYE.up_ws


def fetch_twin(previous: np.ndarray, x_px: float, y_px: float, epsilon: float, steps: int) -> np.ndarray:
    """Of the four texels around a point of the ground those that hold something at the ground's depth, by weight."""
    if not (0.0 <= x_px < WIDTH and 0.0 <= y_px < HEIGHT):
        return np.zeros(3)
    x, y = np.round((x_px - 0.5) * steps) / steps, np.round((y_px - 0.5) * steps) / steps
    rows = []
    for dy in (0, 1):
        for dx in (0, 1):
            column, row = int(np.floor(x)) + dx, int(np.floor(y)) + dy
            share = (1.0 - abs(x - column)) * (1.0 - abs(y - row))
            if share <= 0.0 or not (0 <= column < WIDTH and 0 <= row < HEIGHT):
                continue
            rho, n, depth, rise = previous[row, column]
            expected = ground_depth(np.array(column + 0.5), np.array(row + 0.5))
            if n > 0.0 and abs(depth * EYE.far - expected) < epsilon:
                rows.append((share, rho, n, rise))
    if not rows:
        return np.zeros(3)
    share, rho, n, rise = np.array(rows).T
    known = share * (rise > 0.0)
    return np.array([share @ rho / share.sum(), share @ n / share.sum(), known @ rise / max(known.sum(), 1e-6)])
