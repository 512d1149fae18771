"""The depths that a layer of a light map can hold: those of all meshes' boxes inside its window."""

from __future__ import annotations

import itertools

import numpy as np

_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
_PAIRS = np.array(list(itertools.combinations(range(8), 2)))
_EDGES = _PAIRS[np.abs(_CORNERS[_PAIRS[:, 0]] - _CORNERS[_PAIRS[:, 1]]).sum(axis=1) == 1]
_SIDES = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
_LEAST = 1e-6  # of the depth: what a range spans at least


def depth_range(ws_to_ls: np.ndarray, boxes: np.ndarray) -> tuple[float, float]:
    """Least and greatest linear depth in front of a light of what lies in boxes and in one layer's window.

    The corners of a box cut to the window lie on the box's edges and on the window's four edge lines.

    Args:
        ws_to_ls: The layer's matrix, rows x, y, linear depth, w, (4, 4).
        boxes: Low and high corners, float64 (n, 2, 3), rebased world.

    Returns:
        near >= 0 and far > near, scene units; 0 and 1 where no box meets the window.
    """
    rows = np.asarray(ws_to_ls, np.float64)
    depth = np.concatenate([_on_edges(rows, boxes), _on_window_lines(rows, boxes)])
    if not len(depth):
        return 0.0, 1.0
    near, far = max(float(depth.min()), 0.0), max(float(depth.max()), 0.0)
    return near, max(far, near + _LEAST * max(near, _LEAST))


def _window_planes(rows: np.ndarray) -> np.ndarray:
    """What is not negative inside the window: w - x, w + x, w - y, w + y; (4, 4)."""
    x, y, _, w = rows
    return np.stack([w - x, w + x, w - y, w + y])


def _on_edges(rows: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Depths of the ends of the boxes' edges, cut to the window."""
    corners = boxes[:, _CORNERS, np.arange(3)]
    inside = corners @ _window_planes(rows)[:, :3].T + _window_planes(rows)[:, 3]
    depth = corners @ rows[2, :3] + rows[2, 3]
    a, b = inside[:, _EDGES[:, 0]], inside[:, _EDGES[:, 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = a / (a - b)
    begin = np.where((a < 0.0) & (b >= 0.0), cut, np.where((a < 0.0) & (b < 0.0), np.inf, 0.0)).max(axis=2)
    end = np.where((a >= 0.0) & (b < 0.0), cut, 1.0).min(axis=2)
    held = begin <= end
    first, last = depth[:, _EDGES[:, 0]][held], depth[:, _EDGES[:, 1]][held]
    return np.concatenate([first + share[held] * (last - first) for share in (begin, end)])


def _on_window_lines(rows: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Depths of where the window's edge lines enter and leave the boxes."""
    out: list[np.ndarray] = []
    x, y, z, w = rows
    for side_x, side_y in _SIDES:
        planes = np.stack([w - side_x * x, w - side_y * y])
        along = np.cross(planes[0, :3], planes[1, :3])
        length = float(np.linalg.norm(along))
        if length == 0.0:
            continue
        along /= length
        start = -np.linalg.pinv(planes[:, :3]) @ planes[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort((boxes - start) / along, axis=1)  # not a number on a side of a box that is along the line
        free = (along == 0.0) & (boxes[:, 0] <= start) & (start <= boxes[:, 1])
        begin = np.where(free, -np.inf, ends[:, 0]).max(axis=1)
        end = np.where(free, np.inf, ends[:, 1]).min(axis=1)
        ahead, rate = float(w[:3] @ start + w[3]), float(w[:3] @ along)
        # only where w is not negative are these the window's edges
        if rate > 0.0:
            begin = np.maximum(begin, -ahead / rate)
        elif rate < 0.0:
            end = np.minimum(end, -ahead / rate)
        held = begin <= end
        out += [z[:3] @ start + z[3] + share[held] * float(z[:3] @ along) for share in (begin, end)]
    return np.concatenate(out) if out else np.zeros(0)
