"""Where a receiver projects edges and samples: onto the plane of a flat light, or one across the way to any other.

The coordinates are homogeneous and linear in the way from the receiver: (u, v) = (U / Z, V / Z). Z is 0 at the receiver
and 1 in the plane of a light at a finite place.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.scene.lights import DirectionalLight, Light, PolygonLight, SphereLight

BALL_MARGIN = 3.0
"""Half the side of the cube, in radii, that holds what receivers see of the plane through a ball's centre within the
square around the ball, from 1.2 radii on: sqrt(2) / sqrt(1 - 1.2^-2) = 2.6."""

FLAT_MARGIN = 1.0e-3
"""By which share a flat light's corners are moved outwards, against rounding."""

FLATTEST_LIGHT = 1.0e-4
"""Least width of a flat light, as a share of its length; a thinner one counts as a ball."""

NEAREST_BALL = wp.constant(1.2)  # radii
FLATTEST = wp.constant(1.0e-3)  # sine of the angle at which a flat light is still projected onto its own plane


@wp.struct
class LightPlane:
    """A light for projections, rebased world; a flat one covers u and v from -1/2 to 1/2.

    A direction is projected onto the plane at distance 1.
    """

    centre: wp.vec3
    to_u: wp.vec3  # of a flat light: a way along it to its u; of a ball: one direction across, not 0
    to_v: wp.vec3
    normal: wp.vec3
    size: float  # radius of a ball; half the longer diagonal of a flat light
    is_flat: int
    is_point: float  # 1 points, 0 directions
    corners: wp.array(dtype=wp.vec3)  # their hull holds the light, and all that a path between samples visits


@wp.struct
class Projection:
    """What is linear in a way from one receiver: U, V and Z; and where the light ends."""

    u: wp.vec3
    v: wp.vec3
    z: wp.vec3
    usable: int  # 0: too flat, or too near


def hull_for_paths(light: Light) -> np.ndarray:
    """Corners (n, 4) of a body that holds a light and every path from sample to sample along u and v."""
    if _is_flat(light):
        centre, edge_u, edge_v = _flat_frame(light)
        half = 0.5 + FLAT_MARGIN
        corners = [centre + half * (a * edge_u + b * edge_v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    else:
        radius = BALL_MARGIN * _radius(light)
        corners = [light.centre[:3] + radius * (2.0 * np.array(c) - 1.0) for c in np.ndindex(2, 2, 2)]
    w = 0.0 if light.is_directional else 1.0
    return np.concatenate([np.array(corners), np.full((len(corners), 1), w)], axis=1)


def light_plane(light: Light, device: str) -> LightPlane:
    """A light with an area, for kernels."""
    out = LightPlane()
    out.is_flat, out.is_point = int(_is_flat(light)), 0.0 if light.is_directional else 1.0
    if out.is_flat:
        centre, edge_u, edge_v = _flat_frame(light)
        normal = centre if light.is_directional else np.cross(edge_u, edge_v)
        normal = normal / np.linalg.norm(normal)
        dual = np.linalg.inv(np.stack([edge_u, edge_v, normal], axis=1))
        out.to_u, out.to_v, out.normal = wp.vec3(*dual[0]), wp.vec3(*dual[1]), wp.vec3(*normal)
        out.size = 0.5 * float(max(np.linalg.norm(edge_u + edge_v), np.linalg.norm(edge_u - edge_v)))
    else:
        centre, hull = light.centre[:3], light.hull[:, :3]
        across = max(hull - hull[0], key=np.linalg.norm)
        out.to_u, out.size = wp.vec3(*(across / np.linalg.norm(across))), _radius(light)
    out.centre = wp.vec3(*centre)
    out.corners = wp.array(hull_for_paths(light)[:, :3].astype(np.float32), dtype=wp.vec3, device=device)
    return out


def touching(light: Light, triangles: np.ndarray) -> np.ndarray:
    """Which triangles (n, 3, 3), rebased world, may reach into the body of ``hull_for_paths``: bool (n,).

    A caster elsewhere is before all of the light or behind all of it, for what it hides from any one receiver.
    """
    if light.is_directional or not len(triangles):
        return np.zeros(len(triangles), bool)
    points = triangles.astype(np.float64)
    if not _is_flat(light):
        radius = BALL_MARGIN * _radius(light)
        way = points - light.centre[:3]
        return ((way.min(axis=1) <= radius) & (way.max(axis=1) >= -radius)).all(axis=1)
    centre, edge_u, edge_v = _flat_frame(light)
    normal = np.cross(edge_u, edge_v)
    normal /= np.linalg.norm(normal)
    with np.errstate(invalid="ignore"):  # corners that are no finite positions reach nowhere
        local = (points - centre) @ np.linalg.inv(np.stack([edge_u, edge_v, normal], axis=1)).T
    slab = 1.0e-3 * max(np.linalg.norm(edge_u), np.linalg.norm(edge_v)) + 1.0e-5 * np.abs(centre).max()
    out = np.zeros(len(points), bool)
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((local[:, :, 2].min(axis=1) <= slab) & (local[:, :, 2].max(axis=1) >= -slab))
    if len(near):
        start, way = local[near], np.roll(local[near], -1, axis=1) - local[near]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.array([-slab, slab]) - start[:, :, 2:]) / way[:, :, 2:]  # (n, 3, 2) shares of each side
        parallel = way[:, :, 2] == 0.0
        inside = np.abs(start[:, :, 2]) <= slab
        first = np.where(parallel, 0.0, np.maximum(np.min(ends, axis=2), 0.0))
        last = np.where(parallel, np.where(inside, 1.0, -1.0), np.minimum(np.max(ends, axis=2), 1.0))
        held = first <= last
        cut = np.stack([start + way * first[..., None], start + way * last[..., None]], axis=2)[..., :2]
        low = np.where(held[..., None, None], cut, np.inf).min(axis=(1, 2))
        high = np.where(held[..., None, None], cut, -np.inf).max(axis=(1, 2))
        out[near] = ((low <= 0.5 + 2.0 * FLAT_MARGIN) & (high >= -0.5 - 2.0 * FLAT_MARGIN)).all(axis=1)
    return out


@wp.func
def projection_from(light: LightPlane, origin: wp.vec3):
    """How a receiver projects onto the plane."""
    out = Projection()
    out.usable = 1
    if light.is_flat != 0:
        from_centre = (origin - light.centre) * light.is_point
        depth = wp.where(light.is_point > 0.0, -wp.dot(from_centre, light.normal), 1.0)
        if wp.abs(depth) < FLATTEST * (light.size + wp.length(from_centre)) * light.is_point:
            out.usable = 0
            depth = 1.0
        out.z = light.normal / depth
        out.u = light.to_u + out.z * wp.dot(from_centre, light.to_u)
        out.v = light.to_v + out.z * wp.dot(from_centre, light.to_v)
    else:
        way = light.centre - origin
        length = wp.length(way)
        if length < NEAREST_BALL * light.size:
            out.usable = 0
            length = light.size
        axis = way / length
        across = light.to_u - axis * wp.dot(light.to_u, axis)
        if wp.length(across) < 1.0e-2:
            across = wp.cross(axis, wp.where(wp.abs(axis[0]) < 0.6, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)))
        across = wp.normalize(across)
        out.u = across / (2.0 * light.size)
        out.v = wp.cross(axis, across) / (2.0 * light.size)
        out.z = axis / length
    return out


def _is_flat(light: Light) -> bool:
    if light.kind not in ("rectangle", "disc", "polygon", "directional"):
        return False
    with np.errstate(divide="ignore", invalid="ignore"):
        _, edge_u, edge_v = _flat_frame(light)
        area = np.linalg.norm(np.cross(edge_u, edge_v))
        return bool(area > FLATTEST_LIGHT * max(edge_u @ edge_u, edge_v @ edge_v))


def _radius(light: Light) -> float:
    """Of a ball around a light, which may be thin or a line, at its centre."""
    if isinstance(light, SphereLight):
        return light.radius
    return float(np.linalg.norm(light.hull[:, :3] - light.centre[:3], axis=1).max())


def _flat_frame(light: Light) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre and edges of the smallest known parallelogram around a flat light."""
    corners = light.hull[:, :3]
    if isinstance(light, PolygonLight):
        edge = corners[1] - corners[0]
        across = np.cross(np.cross(edge, corners[2] - corners[0]), edge)
        axes = np.stack([edge / np.linalg.norm(edge), across / np.linalg.norm(across)])
        flat = (corners - corners[0]) @ axes.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        middle = corners[0] + (0.5 * (low + high)) @ axes
        return middle, axes[0] * (high - low)[0], axes[1] * (high - low)[1]
    centre = light.centre[:3] if isinstance(light, DirectionalLight) else corners.mean(axis=0)
    return centre, corners[1] - corners[0], corners[3] - corners[0]
