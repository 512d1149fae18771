"""Solids that generators are built from, many at a time: every function returns their ``(vertices, faces)`` together.

All solids are closed and face outwards. Arrays are float64, lengths in scene units; ``n`` is the number of solids.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.scenes.primitives import Triangles, sphere

# Corners of a square in (x, z), counter-clockwise seen from above, as ``lofts`` wants them.
CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def merge(parts: Sequence[Triangles]) -> Triangles:
    """All parts as one."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    faces = [f + start for (_, f), start in zip(parts, starts[:-1], strict=True)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces).astype(np.int32)


def moved(part: Triangles, offset: Sequence[float]) -> Triangles:
    """The part, shifted."""
    return part[0] + np.asarray(offset, np.float64), part[1]


def copies(faces: np.ndarray, vertices: np.ndarray) -> Triangles:
    """The same faces (F, 3) n times, each time over its own vertices (n, V, 3)."""
    n, v = vertices.shape[:2]
    all_faces = faces[None] + (np.arange(n) * v)[:, None, None]
    return vertices.reshape(-1, 3), all_faces.reshape(-1, 3).astype(np.int32)


def lofts(rings: np.ndarray) -> Triangles:
    """Solids spanned between stacked rings, capped by fans.

    Args:
        rings: (n, k, m, 3), k >= 2 rings of m corners, counter-clockwise seen from the last ring back to the first.

    Returns:
        2 m (k - 1) + 2 (m - 2) triangles per solid.
    """
    n, k, m = rings.shape[:3]
    ring, corner = np.meshgrid(np.arange(k - 1), np.arange(m), indexing="ij")
    a, b = (ring * m + corner).ravel(), (ring * m + (corner + 1) % m).ravel()
    sides = np.concatenate([np.stack([a, b, b + m], axis=1), np.stack([a, b + m, a + m], axis=1)])
    fan = np.stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)], axis=1)
    faces = np.concatenate([sides, fan[:, ::-1], fan + (k - 1) * m])
    return copies(faces, rings.reshape(n, k * m, 3))


def cones(rims: np.ndarray, apexes: np.ndarray) -> Triangles:
    """Solids from rims (n, m, 3), counter-clockwise seen from the apex, to apexes (n, 3); 2 m - 2 triangles each."""
    m = rims.shape[1]
    here = np.arange(m)
    sides = np.stack([here, np.roll(here, -1), np.full(m, m)], axis=1)
    fan = np.stack([np.zeros(m - 2, int), np.arange(2, m), np.arange(1, m - 1)], axis=1)
    vertices = np.concatenate([rims, apexes[:, None]], axis=1)
    return copies(np.concatenate([sides, fan]), vertices)


def boxes(centre: np.ndarray, size: np.ndarray, heading: np.ndarray | float = 0.0) -> Triangles:
    """Boxes of ``size`` (n, 3) about ``centre`` (n, 3), turned by ``heading`` [rad] about +Y; 12 triangles each."""
    centre, size = np.atleast_2d(centre).astype(np.float64), np.atleast_2d(size).astype(np.float64)
    centre, size = np.broadcast_arrays(centre, size)
    heading = np.broadcast_to(heading, len(centre))
    local = 0.5 * CORNERS * size[:, None, [0, 2]]
    xz = turned(local, heading[:, None]) + centre[:, None, [0, 2]]
    rings = np.empty((len(centre), 2, 4, 3))
    rings[..., 0], rings[..., 2] = xz[:, None, :, 0], xz[:, None, :, 1]
    rings[:, 0, :, 1], rings[:, 1, :, 1] = (
        (centre[:, 1] - 0.5 * size[:, 1])[:, None],
        (centre[:, 1] + 0.5 * size[:, 1])[:, None],
    )
    return lofts(rings)


def turned(xz: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Points (..., 2) in (x, z) turned by ``heading`` [rad] (...) about +Y, which takes +z towards +x."""
    cos, sin = np.cos(heading), np.sin(heading)
    x, z = xz[..., 0], xz[..., 1]
    return np.stack([x * cos + z * sin, z * cos - x * sin], axis=-1)


def beams(start: np.ndarray, end: np.ndarray, width: np.ndarray | float) -> Triangles:
    """Square beams of ``width`` from ``start`` (n, 3) to ``end`` (n, 3); 12 triangles each."""
    along = end - start
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    upright = np.abs(along[:, 1]) > 0.95
    helper = np.where(upright[:, None], np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    u = np.cross(helper, along)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    half = 0.5 * np.broadcast_to(width, len(start))[:, None, None]
    # (u, v, along) is right-handed, so this order is counter-clockwise seen from the end.
    section = half * (np.array([-1, 1, 1, -1])[:, None] * u[:, None] + np.array([-1, -1, 1, 1])[:, None] * v[:, None])
    return lofts(np.stack([start[:, None] + section, end[:, None] + section], axis=1))


def polyline_beams(points: np.ndarray, width: float) -> Triangles:
    """Beams along polylines, (..., k, 3): k - 1 beams each."""
    return beams(points[..., :-1, :].reshape(-1, 3), points[..., 1:, :].reshape(-1, 3), width)


def lathe(profile: Sequence[Sequence[float]] | np.ndarray, segments: int) -> Triangles:
    """A solid of revolution about y; ``profile`` lists (radius > 0, y) from bottom to top; 2 m k - 4 triangles."""
    r, y = np.asarray(profile, np.float64).T
    angle = 2.0 * np.pi * np.arange(segments) / segments
    rings = np.empty((1, len(r), segments, 3))
    rings[0, ..., 0], rings[0, ..., 2] = r[:, None] * np.sin(angle), r[:, None] * np.cos(angle)
    rings[0, ..., 1] = y[:, None]
    return lofts(rings)


def tube(path: np.ndarray, normal: np.ndarray, radius: np.ndarray | float, sides: int) -> Triangles:
    """A closed tube around a closed curve: 2 * k * sides triangles.

    Args:
        path: (k, 3), the last point is joined to the first.
        normal: (k, 3), any directions not along the curve that vary smoothly and close with it.
        radius: (k,) or one number.
        sides: Corners of the section.
    """
    k = len(path)
    along = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    u = normal - along * np.sum(normal * along, axis=1, keepdims=True)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    section = np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None]
    vertices = path[:, None] + np.broadcast_to(radius, k)[:, None, None] * section
    i, j = np.meshgrid(np.arange(k), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = (i + 1) % k * sides + j, (i + 1) % k * sides + (j + 1) % sides
    faces = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces.astype(np.int32)


def torus(radius: float, thickness: float, segments: int, sides: int) -> Triangles:
    """A ring in XZ, centred on the origin."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    out = np.stack([np.sin(angle), np.zeros(segments), np.cos(angle)], axis=1)
    return tube(radius * out, out, thickness, sides)


def torus_knot_tube(
    radius: float, hole: float, thickness: float, p: int, q: int, segments: int, sides: int
) -> Triangles:
    """A (p, q) torus knot about y on a torus of radii ``radius`` and ``hole``; 2 * segments * sides triangles."""
    t = 2.0 * np.pi * np.arange(segments) / segments
    centre = np.stack([np.sin(p * t), np.zeros(segments), np.cos(p * t)], axis=1)
    out = np.cos(q * t)[:, None] * centre + np.sin(q * t)[:, None] * np.array([0.0, 1.0, 0.0])
    return tube(radius * centre + hole * out, out, thickness, sides)


def cage(radius: float, subdivisions: int, width: float) -> Triangles:
    """The edges of an icosphere as beams: 30 * 4^subdivisions beams."""
    vertices, faces = sphere(radius, subdivisions)
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    return beams(vertices[edges[:, 0]], vertices[edges[:, 1]], width)


def rotation(x_deg: float, y_deg: float = 0.0, z_deg: float = 0.0) -> np.ndarray:
    """A matrix (3, 3) that turns row vectors, ``vertices @ matrix``, about the fixed axes x, y, z in this order."""
    return np.asarray(Rotation.from_euler("xyz", [x_deg, y_deg, z_deg], degrees=True).as_matrix().T)


def sampling_of(triangles: int, sections_per_side: float = 18.0) -> tuple[int, int]:
    """Segments and sides of a tube or torus with about ``triangles`` triangles (off by less than twice the sides)."""
    sides = max(6, round(float(np.sqrt(0.5 * triangles / sections_per_side))))
    return max(12, triangles // (2 * sides)), sides
