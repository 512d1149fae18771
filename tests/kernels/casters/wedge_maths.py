"""Penumbra wedges in NumPy, float64: the twin of ``wkernels.casters.wedges.coverage``, and exact areas by clipping polygons.

Light space: the light's plane is z = 0, the receiver a point p = (x, y, z) with z < 0, edges lie between.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def seen(p: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(u, v, w) of points (..., 3) as p sees them on z = 0."""
    w = ends[..., 2] - p[2]
    u = p[0] * ends[..., 2] - ends[..., 0] * p[2]
    v = p[1] * ends[..., 2] - ends[..., 1] * p[2]
    return np.stack([u, v, w], axis=-1)


def clip(shape: str, p0: np.ndarray, p1: np.ndarray, depth: float) -> np.ndarray | None:
    """Both ends on the light (2, 2) of what an edge shows of itself before it; None if nothing."""
    low, high = 0.0, 1.0
    planes = [np.array([0.0, 0.0, 1.0, -1e-6 * depth]), np.array([0.0, 0.0, -1.0, depth])]
    if shape == "square":
        planes += [
            np.array([s if k == 0 else 0.0, s if k == 1 else 0.0, 1.0, 0.0]) for k in (0, 1) for s in (-1.0, 1.0)
        ]
    for plane in planes:
        f0, f1 = plane[:3] @ p0 + plane[3], plane[:3] @ p1 + plane[3]
        if f0 < 0.0 and f1 < 0.0:
            return None
        if f0 < 0.0:
            low = max(low, f0 / (f0 - f1))
        elif f1 < 0.0:
            high = min(high, f0 / (f0 - f1))
    if low >= high:
        return None
    a, b = p0 + low * (p1 - p0), p0 + high * (p1 - p0)
    a, b = a[:2] / a[2], b[:2] / b[2]
    if shape == "disc":
        length = np.linalg.norm(b - a)
        along = (b - a) / max(length, 1e-300)
        across = np.array([along[1], -along[0]])
        distance = across @ a
        if abs(distance) >= 1.0 or length == 0.0:
            return None
        half = np.sqrt(1.0 - distance * distance)
        first, last = max(along @ a, -half), min(along @ b, half)
        if first >= last:
            return None
        a, b = distance * across + first * along, distance * across + last * along
    return np.stack([a, b])


def beyond(shape: str, ends: np.ndarray) -> float:
    """Signed share of the light beyond an edge: sector of the rays through its ends less their triangle."""
    (x0, y0), (x1, y1) = ends
    cross = x0 * y1 - y0 * x1
    turn = np.arctan2(cross, x0 * x1 + y0 * y1)
    if shape == "disc":
        return float((turn - cross) / (2.0 * np.pi))
    # the sector of the square, cut at the corners between the rays
    start = np.arctan2(y0, x0)
    corners = [c for c in np.pi / 4.0 + np.pi / 2.0 * np.arange(-6, 7) if min(0.0, turn) < c - start < max(0.0, turn)]
    angles = [start, *(corners if turn > 0.0 else corners[::-1]), start + turn]
    at = [np.array([np.cos(t), np.sin(t)]) / max(abs(np.cos(t)), abs(np.sin(t))) for t in angles]
    sector = sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise(at))
    return float((sector - cross) / 8.0)


def hidden_by_loops(shape: str, p: np.ndarray, loops: list[np.ndarray], centre: int) -> float:
    """Mean over the light of how many loops (n, 3) hide a point of it: ``centre`` of them hide its centre."""
    total = float(centre)
    for loop in loops:
        ends = seen(p, loop)
        for p0, p1 in zip(ends, np.roll(ends, -1, axis=0), strict=True):
            clipped = clip(shape, p0, p1, -p[2])
            if clipped is not None:
                total -= beyond(shape, clipped)
    return total


def winding(loop: np.ndarray) -> int:
    """How often a loop (n, 2) goes counter-clockwise round the origin."""
    after = np.roll(loop, -1, axis=0)
    cross = loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0]
    return int(round(float(np.arctan2(cross, (loop * after).sum(axis=1)).sum()) / (2.0 * np.pi)))


def clipped_area(loop: np.ndarray, sides: int | None) -> float:
    """Share of a light that a convex polygon (n, 2) covers, by clipping to the square or a disc of so many sides."""
    if sides is None:
        border = np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    else:
        angle = 2.0 * np.pi * np.arange(sides) / sides
        border = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rest = loop
    for a, b in zip(border, np.roll(border, -1, axis=0), strict=True):
        if len(rest) == 0:
            return 0.0
        inside = (b - a)[0] * (rest[:, 1] - a[1]) - (b - a)[1] * (rest[:, 0] - a[0])
        out = []
        for k in range(len(rest)):
            m = (k + 1) % len(rest)
            if inside[k] >= 0.0:
                out.append(rest[k])
            if (inside[k] >= 0.0) != (inside[m] >= 0.0):
                out.append(rest[k] + (rest[m] - rest[k]) * inside[k] / (inside[k] - inside[m]))
        rest = np.array(out).reshape(-1, 2)
    return _area(rest) / _area(border)


def _area(loop: np.ndarray) -> float:
    after = np.roll(loop, -1, axis=0)
    return 0.5 * float((loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0]).sum()) if len(loop) else 0.0
