"""Strips and fans of triangles."""

from __future__ import annotations

import numpy as np


def strips_to_triangles(strip: np.ndarray) -> np.ndarray:
    """Faces (n - 2, 3) of a strip of n vertex indices; every second one is turned, so that all look the same way."""
    count = max(len(strip) - 2, 0)
    odd = np.arange(count) % 2
    at = np.arange(count)
    return np.stack([strip[at], strip[at + 1 + odd], strip[at + 2 - odd]], axis=1).reshape(-1, 3)


def fan_to_triangles(fan: np.ndarray) -> np.ndarray:
    """Faces (n - 2, 3) about the first of n vertex indices."""
    at = np.arange(max(len(fan) - 2, 0))
    return np.stack([fan[at * 0], fan[at + 1], fan[at + 2]], axis=1).reshape(-1, 3)
