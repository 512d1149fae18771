"""The extent of lights as a map sees it: all that single-map soft shadow methods know of a light's shape."""

from __future__ import annotations

import numpy as np

from wkernels.scene.lights import (
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    PolygonLight,
    RectangleLight,
    orthonormal_frame,
)


def light_half_axes(light: Light, right_ws: np.ndarray, up_ws: np.ndarray) -> np.ndarray:
    """The light's extent as a map sees it.

    A rectangle keeps its own edges, a line its length, a disc its orientation; a polygon is replaced by the rectangle
    with the same second moments; a sphere and the sun are the same disc from everywhere.

    Args:
        light: Any light.
        right_ws: The map's axis to the right, unit, (3,).
        up_ws: The map's axis upwards, unit, (3,).

    Returns:
        float64 (2, 2); columns are the half-axes in (right, up): scene units, tangents for a directional light.
    """
    onto_map = np.stack([right_ws, up_ws])
    match light:
        case PointLight():
            return np.zeros((2, 2))
        case RectangleLight():
            return 0.5 * onto_map @ np.stack([light.edge_u, light.edge_v], axis=1)
        case LinearLight():
            return 0.5 * onto_map @ np.stack([light.b - light.a, np.zeros(3)], axis=1)
        case DiscLight():
            normal = np.asarray(light.normal, float) / np.linalg.norm(light.normal)
            return light.radius * onto_map @ np.stack(orthonormal_frame(normal), axis=1)
        case PolygonLight():
            return onto_map @ _polygon_axes(light)
    radius = 0.5 * light.size
    return np.eye(2) * (np.tan(radius) if light.is_directional else radius)


def _polygon_axes(light: PolygonLight) -> np.ndarray:
    v = np.asarray(light.vertices, float)
    corners = np.stack([np.broadcast_to(v[0], v[1:-1].shape), v[1:-1], v[2:]], axis=1)
    corners = corners - light.centre[:3]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.sum() > 0.0:
        return np.zeros((3, 2))
    middle = corners.mean(axis=1)
    # the mean of x x^T over a triangle is (sum of that of its corners + 9 times that of its middle) / 12
    moment = np.einsum("tci,tcj->tij", corners, corners) + 9.0 * np.einsum("ti,tj->tij", middle, middle)
    covariance = np.einsum("t,tij->ij", area, moment) / (12.0 * area.sum())
    values, axes = np.linalg.eigh(covariance)
    # a rectangle with half-axis h has the second moment h^2 / 3 along it
    return axes[:, 1:] * np.sqrt(3.0 * np.maximum(values[1:], 0.0))
