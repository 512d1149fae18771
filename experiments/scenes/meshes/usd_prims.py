"""The prims of a USD stage that have a surface, as triangles in their own space: meshes and implicit shapes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from experiments.scenes import primitives
from experiments.scenes.meshes.polygons import triangulate
from experiments.scenes.meshes.reading import MeshError, Tell, check_indices
from experiments.scenes.primitives import Triangles

_SECTIONS = primitives.CYLINDER_SEGMENTS
_SUBDIVISIONS = 4  # 5120 triangles, whose distance from the sphere is below 0.002 of the radius
_AXES = {  # from shapes along z; all of them turn, none mirrors
    "X": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "Y": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "Z": np.eye(3),
}


def prim_triangles(prim: Any, time: Any, tell: Tell) -> Triangles | None:
    """Vertices (V, 3) and faces (F, 3) of a mesh or an implicit shape in the prim's own space; None of any other prim.

    The control mesh of a subdivision surface is taken as it is. Raises MeshError.
    """
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.Mesh):
        return _mesh(UsdGeom.Mesh(prim), time, tell)
    shape = _SHAPES.get(str(prim.GetTypeName()))
    if shape is None:
        return None

    def value(name: str) -> Any:
        found = prim.GetAttribute(name).Get(time)
        if isinstance(found, float) and not 0.0 <= found < math.inf:
            raise ValueError(f"{name} {found:g}")
        return found

    try:
        return shape(value)
    except (ValueError, TypeError, KeyError) as error:  # an attribute without a value, an axis of another name
        raise MeshError(f"the {prim.GetTypeName()} {prim.GetPath()} has a size without a shape: {error}.") from None


@dataclass(frozen=True, eq=False)
class Corners:
    """The corners of a mesh's faces, each by itself, as texture coordinates may differ where they meet.

    Attributes:
        points: float64 (C, 3).
        faces: int (F, 3), triangles of corners.
        vertex, number, face: int (C,): the point of each, which of the file's corners it is, and of which face.
    """

    points: np.ndarray
    faces: np.ndarray
    vertex: np.ndarray
    number: np.ndarray
    face: np.ndarray


def mesh_corners(mesh: Any, time: Any, tell: Tell) -> Corners:
    """A mesh by its corners; raises MeshError."""
    polygons = _polygons(mesh, time, tell)
    points = polygons.points[polygons.indices]
    faces = triangulate(points, polygons.counts, np.arange(len(points)))
    return Corners(points, polygons.turned(faces), polygons.indices, polygons.number, polygons.face)


@dataclass(frozen=True, eq=False)
class _Polygons:
    """Points (V, 3) and polygons: their corners' counts (P,); of each corner, point, number in the file and face."""

    points: np.ndarray
    counts: np.ndarray
    indices: np.ndarray
    number: np.ndarray
    face: np.ndarray
    left_handed: bool

    def turned(self, faces: np.ndarray) -> np.ndarray:
        """Triangles counter-clockwise seen from outside."""
        return faces[:, ::-1] if self.left_handed else faces


def _mesh(mesh: Any, time: Any, tell: Tell) -> Triangles:
    polygons = _polygons(mesh, time, tell)
    return polygons.points, polygons.turned(triangulate(polygons.points, polygons.counts, polygons.indices))


def _polygons(mesh: Any, time: Any, tell: Tell) -> _Polygons:
    from pxr import UsdGeom

    points = attribute_values(mesh.GetPointsAttr(), time, np.float64)
    if points.size % 3:
        raise MeshError(f"the points of {mesh.GetPath()} are of a wrong type.")
    points = points.reshape(-1, 3)
    counts = attribute_values(mesh.GetFaceVertexCountsAttr(), time, np.int64)
    indices = attribute_values(mesh.GetFaceVertexIndicesAttr(), time, np.int64)
    if counts.sum() != len(indices) or np.any(counts < 0):
        raise MeshError(f"has a mesh ({mesh.GetPath()}) whose face counts do not fit its face indices.")
    check_indices(indices, len(points), what=f"a face of {mesh.GetPath()}")
    number, face = np.arange(len(indices)), np.repeat(np.arange(len(counts)), counts)
    holes = attribute_values(mesh.GetHoleIndicesAttr(), time, np.int64)
    if len(holes):  # faces that are not drawn
        check_indices(holes, len(counts), what=f"a hole of {mesh.GetPath()}")
        drawn = np.ones(len(counts), bool)
        drawn[holes] = False
        kept = np.repeat(drawn, counts)
        indices, number, face, counts = indices[kept], number[kept], face[kept], counts[drawn]
    scheme = mesh.GetSubdivisionSchemeAttr()
    if scheme.IsAuthored() and scheme.Get(time) != UsdGeom.Tokens.none:
        tell(f"{mesh.GetPath()} is a subdivision surface ({scheme.Get(time)}); its control mesh is drawn.")
    left_handed = mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded
    return _Polygons(points, counts, indices, number, face, bool(left_handed))


def attribute_values(attribute: Any, time: Any, kind: type) -> np.ndarray:
    """An array attribute's values, none where it has none."""
    try:
        return np.array(attribute.Get(time) or [], kind)
    except (TypeError, ValueError):
        raise MeshError(f"{attribute.GetPath()} is of a wrong type.") from None


Value = Callable[[str], Any]


def _turned(mesh: trimesh.Trimesh, axis: str) -> Triangles:
    return np.asarray(mesh.vertices, np.float64) @ _AXES[str(axis)].T, np.asarray(mesh.faces, np.int64)


def _cube(value: Value) -> Triangles:
    return primitives.box((value("size"),) * 3)


def _sphere(value: Value) -> Triangles:
    return primitives.sphere(value("radius"), _SUBDIVISIONS)


def _cylinder(value: Value) -> Triangles:
    mesh = trimesh.creation.cylinder(value("radius"), value("height"), sections=_SECTIONS)
    return _turned(mesh, value("axis"))


def _tapered(value: Value) -> Triangles:
    """A cylinder of two radii: the outline turned about the axis."""
    half = 0.5 * value("height")
    outline = [[0.0, -half], [value("radiusBottom"), -half], [value("radiusTop"), half], [0.0, half]]
    return _turned(trimesh.creation.revolve(outline, sections=_SECTIONS), value("axis"))


def _cone(value: Value) -> Triangles:
    half = 0.5 * value("height")
    outline = [[0.0, -half], [value("radius"), -half], [0.0, half]]
    return _turned(trimesh.creation.revolve(outline, sections=_SECTIONS), value("axis"))


def _capsule(value: Value) -> Triangles:
    return _rounded(value, value("radius"), value("radius"))


def _tapered_capsule(value: Value) -> Triangles:
    return _rounded(value, value("radiusBottom"), value("radiusTop"))


def _rounded(value: Value, bottom: float, top: float) -> Triangles:
    half, angle = 0.5 * value("height"), np.linspace(0.0, 0.5 * np.pi, _SECTIONS // 4 + 1)
    below = np.stack([bottom * np.sin(angle), -half - bottom * np.cos(angle)], axis=1)
    above = np.stack([top * np.cos(angle), half + top * np.sin(angle)], axis=1)
    outline = np.concatenate([below, above])
    outline[[0, -1], 0] = 0.0
    return _turned(trimesh.creation.revolve(outline, sections=_SECTIONS), value("axis"))


def _plane(value: Value) -> Triangles:
    """``width`` runs along x (along z where the plane looks along x), ``length`` along the other axis."""
    axis, width, length = str(value("axis")), 0.5 * value("width"), 0.5 * value("length")
    x, y = {"X": (length, width), "Y": (length, width), "Z": (width, length)}[axis]
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return corners @ _AXES[axis].T, np.array([[0, 1, 2], [0, 2, 3]])


_SHAPES: dict[str, Callable[[Value], Triangles]] = {
    **{"Cube": _cube, "Sphere": _sphere, "Cylinder": _cylinder, "Cylinder_1": _tapered, "Cone": _cone},
    **{"Capsule": _capsule, "Capsule_1": _tapered_capsule, "Plane": _plane},
}
