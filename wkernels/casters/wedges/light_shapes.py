"""What a light looks like from a point: a disc or a square of half size 1, in coordinates linear in the edge's ends.

Light space has the light's centre in its origin. From a point p the ends of an edge become (u, v, w): u/w, v/w is where
the way from p through the end meets the light's plane, in half sizes of the light, and w grows along the way to the
light, from 0 at p to the light's ``depth``. So what hides the light is clipped before anything is divided (Assarsson et
al. 2003, section 4.2.2), and p may be anywhere.

Spheres are taken for the disc through their centre that faces p (section 4.2.1); rectangles and discs for themselves; a
sun for a disc at infinity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.scene.lights import DirectionalLight, DiscLight, Light, RectangleLight, SphereLight, orthonormal_frame

FACING, FLAT, SUN = wp.constant(0), wp.constant(1), wp.constant(2)
DISC, SQUARE = wp.constant(0), wp.constant(1)
NEAREST = wp.constant(1e-6)
"""Share of the way to the light, or of the scene's size for a sun, below which nothing of an edge is seen."""
FARTHEST = wp.constant(1e30)
"""Depth of a sun."""


@wp.struct
class LightShape:
    """Device form of ``HostShape``."""

    kind: int
    shape: int
    centre_ws: wp.vec3
    axis_u: wp.vec3  # light space is (axis_u, axis_v, axis_n) . (p - centre)
    axis_v: wp.vec3
    axis_n: wp.vec3
    half_u_ws: wp.vec3  # from the centre to the middle of the light's border; FACING: not used
    half_v_ws: wp.vec3
    radius: float  # FACING, scene units
    per_length: float  # 1 over the least half size
    nearest: float  # SUN: least w, scene units
    bound: float  # radius of a ball around the light, scene units; of a sun the tangent of its half angle
    own_plane: int  # whether a receiver's own surface hides what lies behind it


@dataclass(frozen=True, eq=False)
class HostShape:
    """A light's kind, form and place in float64, rebased world.

    Attributes:
        kind: FACING, FLAT or SUN.
        shape: DISC or SQUARE.
        centre_ws: (3,); of a sun any point near the casters.
        axes: Rows that take p - centre to light space (3, 3).
        halves_ws: Half axes (2, 3); of a sun tangents.
        radius: FACING: scene units.
        light_ws: The light's centre (4,), w = 0 for a sun.
        corners_ws: Corners of a convex body around the light (n, 3); of a sun directions towards it.
        size: Half size, scene units, or tangent.
    """

    kind: int
    shape: int
    centre_ws: np.ndarray
    axes: np.ndarray
    halves_ws: np.ndarray
    radius: float
    light_ws: np.ndarray
    corners_ws: np.ndarray
    size: float

    def to_device(self, span: float) -> LightShape:
        """The struct that kernels take; ``span``: size of what is around the eye, scene units."""
        out = LightShape()
        out.kind, out.shape = int(self.kind), int(self.shape)
        out.centre_ws = wp.vec3(*self.centre_ws)
        out.axis_u, out.axis_v, out.axis_n = (wp.vec3(*axis) for axis in self.axes)
        out.half_u_ws, out.half_v_ws = (wp.vec3(*half) for half in self.halves_ws)
        out.own_plane = 1
        out.bound = self.bound
        out.radius, out.per_length, out.nearest = self.radius, 1.0 / self.size, float(NEAREST) * span
        return out

    @property
    def bound(self) -> float:
        """Radius of a ball around the light, scene units; of a sun the tangent of its half angle."""
        if self.shape == int(DISC):
            return self.size
        return float(np.linalg.norm(self.corners_ws - self.centre_ws, axis=1).max())

    def in_light_space(self, points_ws: np.ndarray) -> np.ndarray:
        """Points (n, 3), rebased world, in the space that the kernels' edges are in."""
        # the kernels' centre, so that what is rounded there is the same for edges and receivers
        out: np.ndarray = (points_ws - self.centre_ws.astype(np.float32)) @ self.axes.T
        return out


def shape_of(light: Light, middle_ws: np.ndarray) -> HostShape | None:
    """The form of a light that has an area and one of these kinds, else None.

    Args:
        light: Sphere, disc, sun or rectangle, rebased world.
        middle_ws: A point near the casters (3,).
    """
    if not light.has_area:
        return None
    centre = light.centre
    if isinstance(light, SphereLight):
        return HostShape(
            int(FACING),
            int(DISC),
            centre[:3],
            np.eye(3),
            np.zeros((2, 3)),
            light.radius,
            centre,
            light.hull[:, :3],
            light.radius,
        )
    if isinstance(light, DiscLight):
        normal = light.normal / np.linalg.norm(light.normal)
        halves = light.radius * np.stack(orthonormal_frame(normal))
        return _flat(int(DISC), centre, halves, light.hull[:, :3])
    if isinstance(light, RectangleLight):
        return _flat(int(SQUARE), centre, 0.5 * np.stack([light.edge_u, light.edge_v]), light.hull[:, :3])
    if isinstance(light, DirectionalLight):
        axis, tangent = centre[:3], float(np.tan(0.5 * light.size))
        e_u, e_v = orthonormal_frame(axis)
        axes = np.stack([e_u / tangent, e_v / tangent, axis])
        halves = tangent * np.stack([e_u, e_v])
        return HostShape(int(SUN), int(DISC), middle_ws, axes, halves, 0.0, centre, light.hull[:, :3], tangent)
    return None


def _flat(shape: int, centre: np.ndarray, halves: np.ndarray, corners: np.ndarray) -> HostShape | None:
    """A light in a plane, also one whose half axes are not square to each other."""
    normal = np.cross(*halves)
    if not np.linalg.norm(normal) > 0.0:
        return None  # a line has no area that could be covered
    normal /= np.linalg.norm(normal)
    axes = np.linalg.inv(np.stack([*halves, normal], axis=1))
    size = float(np.linalg.norm(halves, axis=1).min())
    return HostShape(int(FLAT), shape, centre[:3], axes, halves, 0.0, centre, corners, size)


@wp.struct
class Sight:
    """How a point sees the light: (u, v, w) = (row_u, row_v, row_w) . end + offset, ends in light space."""

    row_u: wp.vec3
    row_v: wp.vec3
    row_w: wp.vec3
    offset: wp.vec3
    depth: float  # w at the light
    nearest: float  # least w that is seen
    turn: float  # -1 where u and v run clockwise as seen from behind the light, else 1
    reach: float  # how far a shift of the point by one scene unit shifts an edge at w = 1 on the light, half sizes


@wp.func
def to_light_space(light: LightShape, point_ws: wp.vec3):
    """A point in light space."""
    away = point_ws - light.centre_ws
    return wp.vec3(wp.dot(light.axis_u, away), wp.dot(light.axis_v, away), wp.dot(light.axis_n, away))


@wp.func
def see_light(light: LightShape, point_ws: wp.vec3):
    """How a receiver sees the light; from within a flat light's plane it sees nothing, depth 0."""
    out = Sight()
    p = to_light_space(light, point_ws)
    out.turn = 1.0
    if light.kind == FACING:
        out.depth = wp.length(p)
        inverse = 1.0 / wp.max(out.depth, 1e-30)
        x = -p[0] * inverse
        y = -p[1] * inverse
        z = -p[2] * inverse
        # a frame about the way to the light without a branch (Duff et al. 2017)
        side = wp.where(z < 0.0, -1.0, 1.0)
        a = -1.0 / (side + z)
        b = x * y * a
        scale = out.depth / light.radius
        out.row_u = wp.vec3(scale * (1.0 + side * x * x * a), scale * side * b, -scale * side * x)
        out.row_v = wp.vec3(scale * b, scale * (side + y * y * a), -scale * y)
        out.row_w = wp.vec3(x, y, z)
        out.offset = wp.vec3(0.0, 0.0, out.depth)
        out.nearest = NEAREST * out.depth
        out.reach = light.per_length * out.depth
    elif light.kind == FLAT:
        out.turn = wp.where(p[2] > 0.0, -1.0, 1.0)
        out.depth = wp.abs(p[2])
        out.row_u = wp.vec3(out.depth, 0.0, out.turn * p[0])
        out.row_v = wp.vec3(0.0, out.depth, out.turn * p[1])
        out.row_w = wp.vec3(0.0, 0.0, out.turn)
        out.offset = wp.vec3(0.0, 0.0, out.depth)
        out.nearest = NEAREST * out.depth
        out.reach = light.per_length * wp.length(point_ws - light.centre_ws)
    else:
        out.depth = FARTHEST
        out.row_u = wp.vec3(1.0, 0.0, 0.0)
        out.row_v = wp.vec3(0.0, 1.0, 0.0)
        out.row_w = wp.vec3(0.0, 0.0, 1.0)
        out.offset = -p
        out.nearest = light.nearest
        out.reach = light.per_length
    return out


@wp.func
def seen(sight: Sight, end: wp.vec3):
    """(u, v, w) of an edge's end, light space."""
    return wp.vec3(wp.dot(sight.row_u, end), wp.dot(sight.row_v, end), wp.dot(sight.row_w, end)) + sight.offset
