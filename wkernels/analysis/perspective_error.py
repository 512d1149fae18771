"""Closed forms of perspective aliasing along the view vector (Stingl 2011, section 2.3; Lloyd et al. 2006). float64.

The error ``m`` is the length of a map texel over that of a pixel at the same point: above 1 the map is undersampled. A
warp is a perspective projection within the map's plane; its strength is the distance n' from its centre to the near
side of what it covers: infinite for none, ``near`` for perspective shadow maps under overhead light.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


def err_accurate(
    resolution_ratio: float,
    dg_dt: float,
    width_ratio: float,
    near_ratio: float,
    distance_ratio: float,
    cos_phi: tuple[float, float],
    cos_psi: tuple[float, float],
) -> float:
    """m of a surface element anywhere, for any light, equation 2.2.

    Args:
        resolution_ratio: r_j / r_t, image over map.
        dg_dt: Derivative of the map's parametrisation.
        width_ratio: W_l / W_e, light's over eye's image plane.
        near_ratio: n_e / n_l, near planes, eye's over light's.
        distance_ratio: d_l / d_e, depths of the element along the views' axes (with distances along the beams the
            cosines of phi would have to be squared); d_l / n_l becomes 1 for a directional light.
        cos_phi: Cosines between beam and image plane's normal, (light, eye).
        cos_psi: Cosines between beam and the element's normal, (light, eye).
    """
    lengths = resolution_ratio * dg_dt * width_ratio * near_ratio * distance_ratio
    return lengths * (cos_phi[0] / cos_phi[1]) * (cos_psi[1] / cos_psi[0])


def texels_per_pixel(
    ws_to_ls: np.ndarray, resolution: int, ws_to_ss: np.ndarray, size: tuple[int, int], points: np.ndarray, normals
) -> np.ndarray:
    """Jacobian of map position by screen position on surfaces, which is what equation 2.2 is one direction of.

    Args:
        ws_to_ls: Map's rows x, y, depth, w, (4, 4).
        resolution: Map texels per side.
        ws_to_ss: The eye's rows, (4, 4).
        size: Image (width, height) in pixels.
        points: World positions (n, 3).
        normals: Unit surface normals (n, 3).

    Returns:
        float64 (n, 2, 2): [texel axis, pixel axis], both to the right and up.
    """
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    e1 = np.cross(helper, normals)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    plane = np.stack([e1, np.cross(normals, e1)], axis=2)  # (n, 3, 2)
    half_map, half_image = np.full(2, 0.5 * resolution), 0.5 * np.asarray(size, float)
    to_map = _gradient(ws_to_ls, points) * half_map[None, :, None] @ plane
    to_image = _gradient(ws_to_ss, points) * half_image[None, :, None] @ plane
    return to_map @ np.linalg.inv(to_image)


def _gradient(rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivative of (x/w, y/w) by world position, (n, 2, 3)."""
    h = points @ rows[:, :3].T + rows[:, 3]
    ndc = h[:, :2] / h[:, 3:]
    out: np.ndarray = (rows[None, :2, :3] - ndc[:, :, None] * rows[None, 3:, :3]) / h[:, 3, None, None]
    return out


@dataclass(frozen=True)
class TiltedFrustum:
    """A view frustum under a directional light in the plane of view and up vector.

    Attributes:
        near, far: Depth range, scene units.
        half_fov: Half the field of view in that plane, radians.
        gamma: Angle between light and view direction, radians, above 0 and below pi; 90 degrees is overhead light.

    Points of the frustum have the map coordinates x and v = z sin(gamma) - y cos(gamma).
    """

    near: float
    far: float
    half_fov: float
    gamma: float = 0.5 * np.pi

    def _v(self, z: float, side: float) -> float:
        tangent = np.tan(self.half_fov)
        return float(z * (np.sin(self.gamma) - side * tangent * np.cos(self.gamma)))

    @property
    def first(self) -> float:
        """Least v of the frustum, scene units."""
        return min(self._v(z, side) for z in (self.near, self.far) for side in (-1.0, 1.0))

    @property
    def extent(self) -> float:
        """W_lz, the frustum's extent in v: W'_n + W'_s2 + W'_s1 of equation 3.5 with W'_s1 = W_s sin(theta - gamma).

        Printed there is W_s (1 - cos(theta - gamma)), which is not the projected width (73.63 where it is 115.47).
        """
        return max(self._v(z, side) for z in (self.near, self.far) for side in (-1.0, 1.0)) - self.first

    @property
    def end_depths(self) -> tuple[float, float]:
        """z_0 and z_1 of equation 3.2: depths of two points on a line along v, ``extent`` apart."""
        return self.near, self.near + self.extent * float(np.sin(self.gamma))

    def _spread(self, distance: float) -> float:
        """Most |x| over the frustum per unit of relative warped width."""
        corners = [(z, self._v(z, side) - self.first) for z in (self.near, self.far) for side in (-1.0, 1.0)]
        return max(z * np.tan(self.half_fov) / (1.0 + v / distance) for z, v in corners)

    def errors(self, z: np.ndarray | float, distance: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """m_x and m_z on the view vector at unit resolution ratios; equations 2.3 and 2.4 for overhead light."""
        z = np.asarray(z, float)
        width = 1.0 + (z * np.sin(self.gamma) - self.first) / distance
        pixel = z * np.tan(self.half_fov)
        m_x = self._spread(distance) * width / pixel
        m_z = self.extent * width**2 / (1.0 + self.extent / distance) / (2.0 * pixel)
        return m_x, m_z

    def max_m_x(self, distance: float = np.inf) -> float:
        """Greatest m_x over the whole frustum; it lies at a corner, because width over depth is monotone on lines."""
        corners = [(z, self._v(z, side) - self.first) for z in (self.near, self.far) for side in (-1.0, 1.0)]
        spread = self._spread(distance)
        return float(max(spread * (1.0 + v / distance) / (z * np.tan(self.half_fov)) for z, v in corners))


def partitioned_errors(
    borders: np.ndarray, half_fov: float, distances: Sequence[float], gamma: float = 0.5 * np.pi, steps: int = 64
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """m_x and m_z over a partitioned depth range at unit resolution ratios.

    Args:
        borders: Split planes (m + 1,), ascending.
        half_fov: Half the vertical field of view, radians.
        distances: n' of each split's warp, (m,).
        gamma: Angle between light and view direction, radians.
        steps: Depths per split, both ends included: each inner border comes twice, once from either side.

    Returns:
        Depths, m_x and m_z, (m * steps,) each.
    """
    z = np.stack([np.geomspace(a, b, steps) for a, b in itertools.pairwise(borders)])
    z[:, 0], z[:, -1] = borders[:-1], borders[1:]
    pairs = [
        TiltedFrustum(float(part[0]), float(part[-1]), half_fov, gamma).errors(part, distance)
        for part, distance in zip(z, distances, strict=True)
    ]
    return z.ravel(), np.concatenate([m_x for m_x, _ in pairs]), np.concatenate([m_z for _, m_z in pairs])


def storage_factor(borders: np.ndarray, half_fov: float, distances: Sequence[float]) -> float:
    """S = m max(m_x) max(m_z) for overhead light: how much map a picture needs (Lloyd et al. 2006; Stingl Fig 3.19).

    Args:
        borders, half_fov, distances: As for ``partitioned_errors``.
    """
    # both errors are greatest at an end of a split: m_x falls, and m_z has no inner maximum
    _, m_x, m_z = partitioned_errors(borders, half_fov, distances, steps=2)
    return float(len(distances) * m_x.max() * m_z.max())
