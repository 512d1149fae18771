"""How close casters come to a point light."""

from __future__ import annotations

import numpy as np
import trimesh

from wkernels.scene.geometry import Geometry


class Clearance:
    """Distances of a geometry's casters from points; keeps their corners while they stand still."""

    def __init__(self) -> None:
        self._corners: np.ndarray | None = None
        self._version = -1

    def within(self, geometry: Geometry, point_ws: np.ndarray, most: float) -> float:
        """Distance of a point (3,), rebased world, from the nearest casting triangle; ``most`` if none is so close."""
        if self._corners is None or self._version != geometry.version:
            points = geometry.points_ws.numpy().astype(np.float64)
            self._corners = points[geometry.caster_indices.numpy()].reshape(-1, 3, 3)
            self._version = geometry.version
        corners = self._corners
        apart = np.maximum(0.0, np.maximum(corners.min(axis=1) - point_ws, point_ws - corners.max(axis=1)))
        close = corners[(apart**2).sum(axis=1) < most**2]  # what is not finite is not close
        if not len(close):
            return most
        nearest = trimesh.triangles.closest_point(close, np.tile(point_ws, (len(close), 1)))
        distance = np.linalg.norm(nearest - point_ws, axis=1)
        return float(min(most, np.nanmin(distance, initial=most)))
