"""Light sources: their geometry, and points on them for a low-discrepancy set.

A sample is a homogeneous 4-vector ``(x, y, z, w)``: ``w = 1`` for a point on the light, ``w = 0`` for a unit direction
*towards* a directional light, so that every kernel finds the way to the light as ``sample.xyz - position * sample.w``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np


def orthonormal_frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that complete the unit vector ``axis`` to a right-handed frame ``(u, v, axis)``."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(helper, axis)
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def _square_to_disc(u: np.ndarray) -> np.ndarray:
    """Equal-area map of the unit square to the unit disc, concentric in radius; ``u`` (n, 2) -> (n, 2)."""
    radius = np.sqrt(u[:, 0])
    angle = 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def _points(xyz: np.ndarray) -> np.ndarray:
    return np.concatenate([xyz, np.ones((len(xyz), 1))], axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """Base of all lights. Positions are world space, float64, scene units.

    Attributes:
        radiance: RGB, >= 0.
        motion: Affine map float64 (4, 4) of the light at a frame, applied by ``light_motion``; None: it stands.
        kind: Name in scene files.
        is_directional: Whether samples are directions.
    """

    radiance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    motion: Callable[[int], np.ndarray] | None = None
    kind: ClassVar[str] = ""
    is_directional: ClassVar[bool] = False

    def sample(self, u: np.ndarray) -> np.ndarray:
        """Points uniform over the light for ``u`` in [0, 1)^3, shape (n, 3); returns float64 (n, 4)."""
        raise NotImplementedError

    def weights(self, u: np.ndarray) -> np.ndarray:
        """Relative radiance of the same samples, mean about 1, shape (n,); constant unless the light has a texture."""
        return np.ones(len(u))

    @property
    def centre(self) -> np.ndarray:
        """The sample that stands for the whole light in single-map methods, float64 (4,)."""
        raise NotImplementedError

    @property
    def size(self) -> float:
        """L of the penumbra formulas: edge length or diameter in scene units, full angle [rad] if directional, or 0."""
        return 0.0

    @property
    def has_area(self) -> bool:
        """Whether the light casts penumbrae."""
        return self.size > 0.0

    @property
    def hull(self) -> np.ndarray:
        """Corners of a convex body that holds every sample, homogeneous like samples, float64 (n, 4)."""
        raise NotImplementedError

    def moved(self, offset: np.ndarray) -> Light:
        """The same light shifted by ``offset`` (3,)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, kw_only=True)
class PointLight(Light):
    """An omnidirectional point."""

    position: np.ndarray
    kind: ClassVar[str] = "point"

    def sample(self, u: np.ndarray) -> np.ndarray:
        return np.tile(self.centre, (len(u), 1))

    @property
    def centre(self) -> np.ndarray:
        return np.append(self.position, 1.0)

    @property
    def hull(self) -> np.ndarray:
        return self.centre[None]

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, position=self.position + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class DirectionalLight(Light):
    """Parallel light that travels along ``direction``; ``angle_deg`` is the full angular diameter (the sun: 0.53)."""

    direction: np.ndarray
    angle_deg: float = 0.0
    kind: ClassVar[str] = "directional"
    is_directional: ClassVar[bool] = True

    @property
    def centre(self) -> np.ndarray:
        return np.append(-self.direction / np.linalg.norm(self.direction), 0.0)

    @property
    def size(self) -> float:
        return float(np.radians(self.angle_deg))

    def sample(self, u: np.ndarray) -> np.ndarray:
        axis = self.centre[:3]
        e_u, e_v = orthonormal_frame(axis)
        disc = _square_to_disc(u) * np.tan(0.5 * self.size)
        towards = axis + disc[:, :1] * e_u + disc[:, 1:] * e_v
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        return np.concatenate([towards, np.zeros((len(u), 1))], axis=1)

    @property
    def hull(self) -> np.ndarray:
        axis = self.centre[:3]
        spread = np.tan(0.5 * self.size) * _SQUARE @ np.stack(orthonormal_frame(axis))
        return np.concatenate([axis + spread, np.zeros((4, 1))], axis=1)

    def moved(self, offset: np.ndarray) -> Light:
        return self


@dataclass(frozen=True, eq=False, kw_only=True)
class RectangleLight(Light):
    """A parallelogram ``center + a edge_u + b edge_v``, a and b in [-1/2, 1/2].

    ``texture`` (rows, cols) scales its radiance.
    """

    center: np.ndarray
    edge_u: np.ndarray
    edge_v: np.ndarray
    texture: np.ndarray | None = None
    kind: ClassVar[str] = "rectangle"

    def sample(self, u: np.ndarray) -> np.ndarray:
        a, b = u[:, :1] - 0.5, u[:, 1:2] - 0.5
        return _points(self.center + a * self.edge_u + b * self.edge_v)

    def weights(self, u: np.ndarray) -> np.ndarray:
        return texture_weights(self.texture, u[:, 0], u[:, 1])

    @property
    def centre(self) -> np.ndarray:
        return np.append(self.center, 1.0)

    @property
    def size(self) -> float:
        return float(0.5 * (np.linalg.norm(self.edge_u) + np.linalg.norm(self.edge_v)))

    @property
    def hull(self) -> np.ndarray:
        return _points(self.center + 0.5 * _SQUARE @ np.stack([self.edge_u, self.edge_v]))

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, center=self.center + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscLight(Light):
    """A disc of ``radius`` around ``center`` with unit ``normal``."""

    center: np.ndarray
    normal: np.ndarray
    radius: float
    kind: ClassVar[str] = "disc"

    def sample(self, u: np.ndarray) -> np.ndarray:
        e_u, e_v = orthonormal_frame(self.normal / np.linalg.norm(self.normal))
        disc = self.radius * _square_to_disc(u)
        return _points(self.center + disc[:, :1] * e_u + disc[:, 1:] * e_v)

    @property
    def centre(self) -> np.ndarray:
        return np.append(self.center, 1.0)

    @property
    def size(self) -> float:
        return 2.0 * self.radius

    @property
    def hull(self) -> np.ndarray:
        axes = np.stack(orthonormal_frame(self.normal / np.linalg.norm(self.normal)))
        return _points(self.center + self.radius * _SQUARE @ axes)

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, center=self.center + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class SphereLight(Light):
    """A sphere that looks like a uniform disc from everywhere.

    One point set has to serve every receiver, so points fill the ball with density ~ 1/sqrt(R^2 - r^2), the one radial
    density whose projection along any direction is a uniform disc (the inverse Abel transform of a constant).
    """

    center: np.ndarray
    radius: float
    kind: ClassVar[str] = "sphere"

    def sample(self, u: np.ndarray) -> np.ndarray:
        z = 1.0 - 2.0 * u[:, 0]
        ring = np.sqrt(np.maximum(0.0, 1.0 - z * z))
        angle = 2.0 * np.pi * u[:, 1]
        towards = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
        return _points(self.center + self.radius * _abel_radius(u[:, 2])[:, None] * towards)

    @property
    def centre(self) -> np.ndarray:
        return np.append(self.center, 1.0)

    @property
    def size(self) -> float:
        return 2.0 * self.radius

    @property
    def hull(self) -> np.ndarray:
        corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        return _points(self.center + self.radius * corners)

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, center=self.center + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearLight(Light):
    """The segment from ``a`` to ``b``."""

    a: np.ndarray
    b: np.ndarray
    kind: ClassVar[str] = "linear"

    def sample(self, u: np.ndarray) -> np.ndarray:
        return _points(self.a + u[:, :1] * (self.b - self.a))

    @property
    def centre(self) -> np.ndarray:
        return np.append(0.5 * (self.a + self.b), 1.0)

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self.b - self.a))

    @property
    def hull(self) -> np.ndarray:
        return _points(np.stack([self.a, self.b]))

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, a=self.a + offset, b=self.b + offset)


@dataclass(frozen=True, eq=False, kw_only=True)
class PolygonLight(Light):
    """A planar convex polygon, ``vertices`` (n, 3) in order; ``texture`` covers its bounding rectangle."""

    vertices: np.ndarray
    texture: np.ndarray | None = None
    kind: ClassVar[str] = "polygon"

    def _triangles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        v = self.vertices
        e1, e2 = v[1:-1] - v[0], v[2:] - v[0]
        return e1, e2, 0.5 * np.linalg.norm(np.cross(e1, e2), axis=1)

    def sample(self, u: np.ndarray) -> np.ndarray:
        e1, e2, area = self._triangles()
        area = np.maximum(area, 1e-300)  # a polygon without area still has points
        cumulative = np.cumsum(area) / area.sum()
        which = np.minimum(np.searchsorted(cumulative, u[:, 0], side="right"), len(area) - 1)
        below = np.concatenate([[0.0], cumulative])[which]
        first = (u[:, 0] - below) / (
            area[which] / area.sum()
        )  # the first coordinate is used twice, stratification survives
        root = np.sqrt(first)[:, None]
        return _points(self.vertices[0] + root * (1.0 - u[:, 1:2]) * e1[which] + root * u[:, 1:2] * e2[which])

    def weights(self, u: np.ndarray) -> np.ndarray:
        if self.texture is None:
            return np.ones(len(u))
        v = self.vertices
        e_u = (v[1] - v[0]) / np.linalg.norm(v[1] - v[0])
        normal = np.cross(v[1] - v[0], v[2] - v[0])
        e_v = np.cross(normal / np.linalg.norm(normal), e_u)
        frame = np.stack([e_u, e_v], axis=1)
        corners, points = v @ frame, self.sample(u)[:, :3] @ frame
        low, high = corners.min(axis=0), corners.max(axis=0)
        s, t = ((points - low) / (high - low)).T
        return texture_weights(self.texture, s, t)

    @property
    def centre(self) -> np.ndarray:
        e1, e2, area = self._triangles()
        if not area.sum() > 0.0:  # shrunk to a point or a line
            return np.append(self.vertices.mean(axis=0), 1.0)
        middles = self.vertices[0] + (e1 + e2) / 3.0
        return np.append((middles * area[:, None]).sum(axis=0) / area.sum(), 1.0)

    @property
    def size(self) -> float:
        return float(np.sqrt(self._triangles()[2].sum()))

    @property
    def hull(self) -> np.ndarray:
        return _points(self.vertices)

    def moved(self, offset: np.ndarray) -> Light:
        return replace(self, vertices=self.vertices + offset)


def texture_weights(texture: np.ndarray | None, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Nearest-texel luminance of ``texture`` (rows, cols) at s, t in [0, 1), divided by its mean; ones without one."""
    if texture is None:
        return np.ones(len(s))
    rows, cols = texture.shape[:2]
    col = np.clip((s * cols).astype(int), 0, cols - 1)
    row = np.clip((t * rows).astype(int), 0, rows - 1)
    return texture[row, col] / max(float(texture.mean()), 1e-12)


def _abel_radius(u: np.ndarray) -> np.ndarray:
    """Inverts the radial distribution of density r^2/sqrt(1 - r^2).

    Solves theta - sin(2 theta)/2 = pi u / 2 by Newton's method and returns sin(theta).
    """
    theta = 0.5 * np.pi * np.cbrt(np.clip(u, 0.0, 1.0))
    for _ in range(8):
        slope = np.maximum(1.0 - np.cos(2.0 * theta), 1e-9)
        theta = np.clip(theta - (theta - 0.5 * np.sin(2.0 * theta) - 0.5 * np.pi * u) / slope, 0.0, 0.5 * np.pi)
    return np.sin(theta)


LIGHT_KINDS: dict[str, type[Light]] = {
    cls.kind: cls
    for cls in (PointLight, DirectionalLight, RectangleLight, DiscLight, SphereLight, LinearLight, PolygonLight)
}
