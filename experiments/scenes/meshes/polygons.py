"""Polygons to triangles: fans where they are convex, ear clipping (mapbox's earcut) in their own plane where not."""

from __future__ import annotations

import itertools

import mapbox_earcut
import numpy as np

_CONCAVE = 1e-12  # a turn the wrong way, relative to the polygon's extent squared
_MORE_THAN_ONCE = 2.0 * np.pi + 0.1


def triangulate(vertices: np.ndarray, counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Faces (F, 3) of polygons, in their order; each covers its polygon once and turns the way that it does.

    A polygon of n corners that is convex, without area or not finite gives the n - 2 triangles of a fan from its first
    corner; those of less than three corners give none. All corners are used, so that neighbours share edges.

    Args:
        vertices: Positions (V, 3).
        counts: Corners of every polygon, (P,).
        indices: Vertex indices of all corners, (sum of counts,), each within ``vertices``.
    """
    counts, indices = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    triangles = np.maximum(counts - 2, 0)
    owner = np.repeat(np.arange(len(counts)), triangles)
    first = np.concatenate([[0], np.cumsum(counts)])
    faces = _fans(first, triangles, owner, indices)
    concave = np.flatnonzero(_concave(vertices, counts, first, indices))
    if not len(concave):
        return faces
    clipped = [triangulate_loops(vertices, [indices[first[p] : first[p + 1]]]) for p in concave]
    kept = ~np.isin(owner, concave)
    owners = np.concatenate([owner[kept], np.repeat(concave, [len(part) for part in clipped])])
    return np.concatenate([faces[kept], *clipped])[np.argsort(owners, kind="stable")]


def triangulate_loops(vertices: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """Faces (F, 3) of one planar polygon: its outer loop of vertex indices and then those of its holes."""
    loops = [loop for loop in loops if len(loop) >= 3]
    if not loops:
        return np.zeros((0, 3), np.int64)
    corners = np.concatenate(loops)
    outer = len(loops[0])
    fan = np.stack([np.zeros(outer - 2, int), np.arange(1, outer - 1), np.arange(2, outer)], axis=1)
    points = _scaled(np.asarray(vertices, np.float64)[corners][None])[0]
    normal = _newell(points[None, :outer])[0]
    if not np.isfinite(points).all() or not np.linalg.norm(normal) > 0.0:
        return corners[fan]
    flat = points @ _axes(normal).T
    ends = np.cumsum([len(loop) for loop in loops]).astype(np.uint32)
    clipped = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3).astype(np.int64)
    if not len(clipped):
        return corners[fan]  # it crosses itself and has no inside
    area = _cross(flat[clipped[:, 1]] - flat[clipped[:, 0]], flat[clipped[:, 2]] - flat[clipped[:, 0]])
    clipped[area < 0.0] = clipped[area < 0.0][:, ::-1]
    return corners[_with_all_corners(clipped, flat, ends)]


def _with_all_corners(faces: np.ndarray, flat: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Puts corners on straight edges, which ear clipping drops, back: without them edges of neighbours do not meet."""
    used = np.zeros(len(flat), bool)
    used[faces] = True
    if used.all():
        return faces
    split = faces.tolist()
    face_of = {frozenset(edge): i for i, (a, b, c) in enumerate(split) for edge in ((a, b), (b, c), (c, a))}
    for begin, end in itertools.pairwise([0, *ends.tolist()]):
        kept = np.flatnonzero(used[begin:end]) + begin
        for before, after in zip(kept.tolist(), np.roll(kept, -1).tolist(), strict=True):
            between = range(before + 1, after) if before < after else [*range(before + 1, end), *range(begin, after)]
            for corner in between:
                at = face_of.get(frozenset((before, after)))
                if at is None or np.any(np.all(flat[[before, after]] == flat[corner], axis=1)):
                    continue
                x, y, z = split[at]
                while {x, y} != {before, after}:
                    x, y, z = y, z, x
                split[at] = [x, corner, z]
                split.append([corner, y, z])
                face_of |= {frozenset((x, corner)): at, frozenset((corner, z)): at, frozenset((x, z)): at}
                face_of |= {frozenset((corner, y)): len(split) - 1, frozenset((y, z)): len(split) - 1}
                before = corner
    return np.array(split, np.int64)


def _fans(first: np.ndarray, triangles: np.ndarray, owner: np.ndarray, indices: np.ndarray) -> np.ndarray:
    step = np.arange(len(owner)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    corner = first[owner]
    return np.stack([indices[corner], indices[corner + step + 1], indices[corner + step + 2]], axis=1).reshape(-1, 3)


def _concave(vertices: np.ndarray, counts: np.ndarray, first: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Whether a fan from the first corner would be wrong: a corner turns back, or the outline goes round twice."""
    out = np.zeros(len(counts), bool)
    for n in np.unique(counts[counts > 3]).tolist():
        chosen = np.flatnonzero(counts == n)
        points = _scaled(np.asarray(vertices, np.float64)[indices[first[chosen][:, None] + np.arange(n)]])
        normal = _newell(points)
        length = np.linalg.norm(normal, axis=1)
        edges = np.roll(points, -1, axis=1) - points
        after = np.roll(edges, -1, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            turn = np.einsum("pnk,pk->pn", np.cross(edges, after), normal / length[:, None])
            around = np.arctan2(turn, np.einsum("pnk,pnk->pn", edges, after)).sum(axis=1)
            out[chosen] = (length > 0.0) & (np.any(turn < -_CONCAVE, axis=1) | (around > _MORE_THAN_ONCE))
    return out


def _scaled(points: np.ndarray) -> np.ndarray:
    """Polygons (P, n, 3) moved to their first corner, with extent 1, so that thresholds and squares hold anywhere."""
    with np.errstate(invalid="ignore", divide="ignore"):
        points = points - points[:, :1]
        extent = np.abs(points).max(axis=(1, 2), keepdims=True)
        return points / np.where(extent > 0.0, extent, 1.0)


def _newell(points: np.ndarray) -> np.ndarray:
    """Normal (P, 3) of polygons (P, n, 3), twice their area long (Newell's: corners may leave the plane a little)."""
    with np.errstate(invalid="ignore"):
        normal: np.ndarray = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    return normal


def _axes(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) of the plane across ``normal``, counter-clockwise seen from its tip."""
    normal = normal / np.linalg.norm(normal)
    u = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u)])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    out: np.ndarray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out
