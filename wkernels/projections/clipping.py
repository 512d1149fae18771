"""Convex clipping: polyhedra in float64 on the host, small polygons in homogeneous coordinates in kernels.

The host half builds the bodies that light-space focusing intersects (B of Stingl 2011, section 3.1). A plane is
``(a, b, c, d)`` and keeps the points with ``a x + b y + c z + d >= 0``. The kernel half clips *before* the division by
w, so that corners beside and behind the projection centre need no special case (Assarsson et al. 2003, section 4.2.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull, QhullError

from wkernels.scene.views import HostView

_ON_PLANE = 1e-12  # distance that counts as none, relative to the size of the body's coordinates
# corner x + 2 y + 4 z, for x, y, z in {0, 1}
_BOX_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A convex polyhedron; it may be empty, or flat (two opposite faces).

    Attributes:
        faces: Planar convex polygons, float64 (k, 3) each, counter-clockwise seen from outside.
    """

    faces: tuple[np.ndarray, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return not self.faces

    @property
    def vertices(self) -> np.ndarray:
        """All corners once, float64 (n, 3)."""
        return np.unique(np.concatenate(self.faces), axis=0) if self.faces else np.zeros((0, 3))

    @property
    def volume(self) -> float:
        """In cubic scene units; 0 for flat and empty bodies."""
        apex = self.vertices.mean(axis=0) if self.faces else np.zeros(3)
        return float(sum(np.dot(face[0] - apex, _area_vector(face)) for face in self.faces) / 3.0)


def _area_vector(polygon: np.ndarray) -> np.ndarray:
    """The normal of a planar polygon (k, 3), as long as its area."""
    spokes = polygon[1:] - polygon[0]
    return 0.5 * np.cross(spokes[:-1], spokes[1:]).sum(axis=0)


def _snapped_distance(points: np.ndarray, plane: np.ndarray, scale: float) -> np.ndarray:
    """Signed distance (n,) to ``plane``; exactly 0 for points that lie on it but for rounding."""
    distance = (points @ plane[:3] + plane[3]) / np.linalg.norm(plane[:3])
    return np.where(np.abs(distance) <= _ON_PLANE * scale, 0.0, distance)


def _clip(polygon: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """One Sutherland-Hodgman step for corners (k, 3) at signed ``distance`` (k,)."""
    out: list[np.ndarray] = []
    for i in range(len(polygon)):
        a, b, d_a, d_b = polygon[i - 1], polygon[i], distance[i - 1], distance[i]
        if d_a * d_b < 0.0:
            # always from the inside outwards, so that both faces at an edge find the same point, bit for bit
            inner, outer, d_in, d_out = (a, b, d_a, d_b) if d_a > 0.0 else (b, a, d_b, d_a)
            out.append(inner + d_in / (d_in - d_out) * (outer - inner))
        if d_b >= 0.0:
            out.append(b)
    return np.array(out).reshape(-1, 3)


def clip_polygon(vertices: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """The part of a planar convex polygon that lies inside all planes.

    Args:
        vertices: Corners in order, (n, 3).
        planes: (m, 4), of any length but 0.

    Returns:
        float64 (k, 3) in the same order; (0, 3) where nothing but a corner or an edge is left.

    Source: Sutherland and Hodgman 1974.
    """
    polygon = np.asarray(vertices, float).reshape(-1, 3)
    for plane in np.asarray(planes, float).reshape(-1, 4):
        if len(polygon) == 0:
            break
        polygon = _clip(polygon, _snapped_distance(polygon, plane, float(np.abs(polygon).max())))
        if len(polygon) < 3:
            polygon = np.zeros((0, 3))
    return polygon


def clip_polyhedron(faces: ConvexBody | Sequence[np.ndarray], planes: np.ndarray) -> ConvexBody:
    """The part of a convex body inside all planes, closed with a cap where a plane cuts it.

    Args:
        faces: A body, or its faces, (k, 3) each, counter-clockwise seen from outside.
        planes: (m, 4), of any length but 0.

    Returns:
        A closed body. It is empty where the planes leave only a face, an edge or a corner of a solid body.
    """
    body = faces if isinstance(faces, ConvexBody) else ConvexBody(tuple(np.asarray(face, float) for face in faces))
    for plane in np.asarray(planes, float).reshape(-1, 4):
        body = _clip_body(body, plane)
    return body


def _clip_body(body: ConvexBody, plane: np.ndarray) -> ConvexBody:
    if body.is_empty:
        return body
    scale = max(float(np.abs(face).max()) for face in body.faces)
    distances = [_snapped_distance(face, plane, scale) for face in body.faces]
    if all((distance >= 0.0).all() for distance in distances):
        return body
    if all((distance <= 0.0).all() for distance in distances):
        return ConvexBody()
    faces = [_clip(face, distance) for face, distance in zip(body.faces, distances, strict=True)]
    kept = [face for face in faces if len(face) >= 3]
    # whatever the cut left on the plane bounds the cap
    rim = [face[_snapped_distance(face, plane, scale) == 0.0] for face in faces if len(face)]
    if not rim:  # no face is left, or the plane is not finite
        return ConvexBody()
    cap = _cap(np.concatenate(rim), plane[:3], scale)
    return ConvexBody(tuple(kept if cap is None else [*kept, cap]))


def _cap(points: np.ndarray, inwards: np.ndarray, scale: float) -> np.ndarray | None:
    """The convex polygon through coplanar ``points`` (n, 3) that faces against ``inwards``; None if it has no area."""
    points = np.unique(points, axis=0)
    if len(points) < 3:
        return None
    axis = -inwards / np.linalg.norm(inwards)
    e_u = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    e_u /= np.linalg.norm(e_u)
    spokes = points - points.mean(axis=0)
    cap = points[np.argsort(np.arctan2(spokes @ np.cross(axis, e_u), spokes @ e_u))]
    return cap if np.linalg.norm(_area_vector(cap)) > _ON_PLANE * scale * scale else None


def box_polyhedron(lo: np.ndarray, hi: np.ndarray) -> ConvexBody:
    """The axis-aligned box between the corners ``lo`` and ``hi``, (3,) each; flat where they agree in a coordinate."""
    corners = [np.where([i & 1, i & 2, i & 4], hi, lo).astype(float) for i in range(8)]
    return ConvexBody(tuple(np.array([corners[i] for i in face]) for face in _BOX_FACES))


def view_polyhedron(view: HostView) -> ConvexBody:
    """What ``view`` sees between its near and far plane, in world space."""
    x, y, depth, w = view.ws_to_ss
    corners = []
    for i in range(8):
        at_x, at_y, at_depth = (1.0 if i & 1 else -1.0), (1.0 if i & 2 else -1.0), view.far if i & 4 else view.near
        planes = np.stack([x - at_x * w, y - at_y * w, depth])
        corners.append(np.linalg.solve(planes[:, :3], np.array([0.0, 0.0, at_depth]) - planes[:, 3]))
    mirrored = np.linalg.det(np.stack([view.right_ws, view.up_ws, view.forward_ws])) < 0.0
    order = -1 if mirrored else 1
    return ConvexBody(tuple(np.array([corners[i] for i in face[::order]]) for face in _BOX_FACES))


def frustum_planes(ws_to_ss: np.ndarray, near: float, far: float) -> np.ndarray:
    """The six planes of a view volume: left, right, bottom, top, near, far.

    Args:
        ws_to_ss: Rows x, y, linear depth, w (``HostView.ws_to_ss``), (4, 4).
        near: Least linear depth, scene units.
        far: Greatest linear depth, scene units.

    Returns:
        float64 (6, 4), unit normals that point inwards.
    """
    x, y, depth, w = np.asarray(ws_to_ss, float)
    offset = np.array([0.0, 0.0, 0.0, 1.0])
    planes = np.stack([w + x, w - x, w + y, w - y, depth - near * offset, far * offset - depth])
    return planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)


def convex_hull(points: np.ndarray) -> ConvexBody:
    """The convex hull of ``points`` (n, 3), in triangles.

    Coplanar points give a flat body of two opposite polygons, collinear ones an empty body.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    if len(points) < 3:
        return ConvexBody()
    centred = points - points.mean(axis=0)
    size = float(np.abs(centred).max())
    if size == 0.0:
        return ConvexBody()
    centred /= size  # Qhull judges flatness by absolute thresholds
    try:
        hull = ConvexHull(centred)
    except QhullError:
        return _flat_hull(points, centred)
    triangles = points[hull.simplices]
    flipped = [np.dot(_area_vector(t), n) < 0.0 for t, n in zip(triangles, hull.equations[:, :3], strict=True)]
    return ConvexBody(tuple(t[::-1] if flip else t for t, flip in zip(triangles, flipped, strict=True)))


def _flat_hull(points: np.ndarray, centred: np.ndarray) -> ConvexBody:
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    try:
        outline = points[ConvexHull(centred @ axes[:2].T).vertices]
    except QhullError:
        return ConvexBody()
    return ConvexBody((outline, outline[::-1]))


def extrude_towards(points: np.ndarray, direction: np.ndarray, distance: float) -> ConvexBody:
    """The hull of ``points`` (n, 3) and of the same points moved by ``distance`` along ``direction`` (3,).

    Towards a directional light, with the diagonal of the scene's box for ``distance``, this holds every occluder.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    direction = np.asarray(direction, float)
    return convex_hull(np.concatenate([points, points + distance / np.linalg.norm(direction) * direction]))


MAX_CORNERS = 12
"""Corners that a clipped polygon may have. Each line adds one at most, so 8 corners can be clipped to a rectangle."""


class Corners(wp.types.matrix(shape=(MAX_CORNERS, 3), dtype=float)):  # type: ignore[misc]
    """Storage of a polygon's corners."""


@wp.struct
class HomogeneousPolygon:
    """A convex polygon in the projection plane before the division: corner i is (x/w, y/w), and w may have any sign."""

    corners: Corners  # rows (x, y, w)
    count: int


@wp.func
def clip_edge(a: wp.vec3, b: wp.vec3, line: wp.vec3):
    """The part of the edge from ``a`` to ``b``, points (x, y, w), where ``dot(line, point) >= 0``.

    Returns:
        Its two ends, in the same order, and whether any of it is left.
    """
    side_a = wp.dot(line, a)
    side_b = wp.dot(line, b)
    start = a
    end = b
    if side_a < 0.0 and side_b >= 0.0:
        start = b + side_b / (side_b - side_a) * (a - b)
    if side_b < 0.0 and side_a >= 0.0:
        end = a + side_a / (side_a - side_b) * (b - a)
    return start, end, side_a >= 0.0 or side_b >= 0.0


@wp.func
def clip_to_line(polygon: HomogeneousPolygon, line: wp.vec3) -> HomogeneousPolygon:
    """The part of ``polygon`` where ``dot(line, (x, y, w)) >= 0`` (Sutherland-Hodgman)."""
    corners = Corners()
    count = int(0)
    before = polygon.corners[wp.max(polygon.count - 1, 0)]
    for i in range(polygon.count):
        corner = polygon.corners[i]
        start, end, visible = clip_edge(before, corner, line)
        if visible:
            if wp.dot(line, before) < 0.0 and count < MAX_CORNERS:
                corners[count] = start
                count += 1
            if count < MAX_CORNERS:
                corners[count] = end
                count += 1
        before = corner
    out = HomogeneousPolygon()
    out.corners = corners
    out.count = count
    return out


@wp.func
def clip_to_rect(polygon: HomogeneousPolygon, lo: wp.vec2, hi: wp.vec2) -> HomogeneousPolygon:
    """The part of ``polygon`` that projects into the rectangle ``lo`` to ``hi``. Its w are >= 0, up to rounding."""
    out = clip_to_line(polygon, wp.vec3(1.0, 0.0, -lo[0]))
    out = clip_to_line(out, wp.vec3(-1.0, 0.0, hi[0]))
    out = clip_to_line(out, wp.vec3(0.0, 1.0, -lo[1]))
    return clip_to_line(out, wp.vec3(0.0, -1.0, hi[1]))


@wp.func
def _project_into_rect(corner: wp.vec3, lo: wp.vec2, hi: wp.vec2) -> wp.vec2:
    # clipping leaves a corner outside by its rounding error, which division by a tiny w would blow up
    return wp.vec2(wp.clamp(corner[0] / corner[2], lo[0], hi[0]), wp.clamp(corner[1] / corner[2], lo[1], hi[1]))


@wp.func
def polygon_area_in_rect(polygon: HomogeneousPolygon, lo: wp.vec2, hi: wp.vec2) -> float:
    """Area of the part of ``polygon``, up to 8 corners, that projects into the rectangle from ``lo`` to ``hi``.

    It is >= 0 for either orientation, and 0 for polygons seen edge-on or behind the centre (w < 0). Where the centre
    lies in the polygon itself, between a half-plane and nothing, it is finite and no larger than the rectangle.
    """
    clipped = clip_to_rect(polygon, lo, hi)
    twice = float(0.0)
    if clipped.count >= 3:
        origin = _project_into_rect(clipped.corners[0], lo, hi)
        before = _project_into_rect(clipped.corners[1], lo, hi) - origin
        for i in range(2, clipped.count):
            spoke = _project_into_rect(clipped.corners[i], lo, hi) - origin
            twice += before[0] * spoke[1] - before[1] * spoke[0]
            before = spoke
    return 0.5 * wp.abs(twice)


@wp.func
def rect_overlap_area(lo_a: wp.vec2, hi_a: wp.vec2, lo_b: wp.vec2, hi_b: wp.vec2) -> float:
    """Area that two axis-aligned rectangles share."""
    width = wp.min(hi_a[0], hi_b[0]) - wp.max(lo_a[0], lo_b[0])
    height = wp.min(hi_a[1], hi_b[1]) - wp.max(lo_a[1], lo_b[1])
    return wp.max(width, 0.0) * wp.max(height, 0.0)
