"""Mesh files to triangles: OBJ, PLY, STL, OFF, glTF/GLB and Collada through trimesh, USD through usd-core."""

from __future__ import annotations

import importlib.util
import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from experiments.scenes.place import Place
from experiments.scenes.primitives import Triangles

_USD = (".usd", ".usda", ".usdc", ".usdz")
_COLLADA = (".dae", ".zae")
_TRIMESH = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
_WARP_PREFIX = "warp:"


def read_triangles(name: str, place: Place) -> Triangles:
    """All triangles of a mesh file in the file's own coordinates, its scene graph applied.

    Vertices at exactly the same position become one (formats that split them for normals or texture coordinates would
    hide the adjacency that silhouettes need). Triangles that use a non-finite vertex are left out with a warning; those
    without area stay.

    Args:
        name: Path relative to the scene file, or ``warp:NAME`` for one of Warp's example assets.
        place: Where the scene file names it.

    Returns:
        Vertices float64 (V, 3) and faces int32 (F, 3).

    Raises:
        InputError: The file is missing, unreadable, of an unknown format, needs a package that is not installed, or has
            no triangles with finite vertices.
    """
    asset = name.startswith(_WARP_PREFIX)
    path = place.existing_file(name.removeprefix(_WARP_PREFIX), _warp_assets() if asset else None)
    suffix = path.suffix.lower()
    if suffix not in (*_USD, *_COLLADA, *_TRIMESH):
        known = ", ".join((*_TRIMESH, *_COLLADA, *_USD))
        raise place.error(f"'{path}' is of no known mesh format, which are {known}.")
    vertices, faces = _read_usd(path, place) if suffix in _USD else _read_trimesh(path, place)
    if not len(faces):
        raise place.error(f"'{path}' has no triangles.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise place.error(f"'{path}' has faces that use vertices it does not have.")
    finite = np.all(np.isfinite(vertices), axis=1)
    if not finite.any():
        raise place.error(f"'{path}' has no finite vertices.")
    good = np.all(finite[faces], axis=1)
    if not good.any():
        raise place.error(f"'{path}' has no triangle with finite vertices only.")
    if not good.all():
        left_out = f"{np.count_nonzero(~good)} of {len(faces)} triangles have non-finite vertices and are left out."
        warnings.warn(str(place.error(f"'{path}': {left_out}")), stacklevel=2)
    return _weld(vertices, faces[good])


def _warp_assets() -> Path:
    spec = importlib.util.find_spec("warp")
    assert spec is not None and spec.origin is not None, "warp-lang is a dependency"
    return Path(spec.origin).parent / "examples" / "assets"


def _weld(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """Merges vertices that are equal to the last bit and drops unused ones; keeps the order of first use."""
    used = vertices[faces.ravel()] + 0.0  # -0.0 equals 0.0
    _, first, inverse = np.unique(used, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return used[first[order]], rank[inverse.ravel()].reshape(-1, 3).astype(np.int32)


def _read_trimesh(path: Path, place: Place) -> Triangles:
    if path.suffix.lower() in _COLLADA and importlib.util.find_spec("collada") is None:
        raise _missing_reader("Collada", place)
    level = logging.getLogger("trimesh").level
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it would print the traceback of an error that we report
    try:
        # Unprocessed: trimesh would drop the vertices and triangles that the caller wants to count.
        loaded = trimesh.load_scene(str(path), process=False).to_geometry()
    except Exception as error:  # readers of foreign formats fail in any way they like
        raise place.error(f"'{path}' cannot be read: {_one_line(error)}.") from None
    finally:
        logging.getLogger("trimesh").setLevel(level)
    if not isinstance(loaded, trimesh.Trimesh):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    return np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)


def _read_usd(path: Path, place: Place) -> Triangles:
    if importlib.util.find_spec("pxr") is None:
        raise _missing_reader("USD", place)
    from pxr import Tf, Usd, UsdGeom

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise place.error(f"'{path}' cannot be read: {_one_line(error)}.") from None
    time = Usd.TimeCode.EarliestTime()
    all_vertices, all_faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        mesh = UsdGeom.Mesh(prim)
        if not mesh or mesh.ComputeVisibility(time) == UsdGeom.Tokens.invisible:
            continue
        vertices, faces = _usd_mesh(mesh, time, path, place)
        all_vertices.append(vertices)
        all_faces.append(faces + count)
        count += len(vertices)
    return np.concatenate(all_vertices), np.concatenate(all_faces)


def _usd_mesh(mesh: Any, time: Any, path: Path, place: Place) -> Triangles:
    """One UsdGeomMesh in world space, polygons split into fans."""
    from pxr import UsdGeom

    points = np.array(mesh.GetPointsAttr().Get(time) or [], np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time) or [], np.int64)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(time) or [], np.int64)
    if counts.sum() != len(indices) or np.any(counts < 0):
        raise place.error(f"'{path}' has a mesh ({mesh.GetPath()}) whose face counts do not fit its face indices.")
    faces = _fans(counts, indices)
    object_to_ws = np.array(mesh.ComputeLocalToWorldTransform(time)).T  # USD multiplies row vectors from the left
    left_handed = mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded
    if left_handed != (np.linalg.det(object_to_ws[:3, :3]) < 0.0):
        faces = faces[:, ::-1]
    return points @ object_to_ws[:3, :3].T + object_to_ws[:3, 3], faces


def _fans(counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Faces (F, 3) of polygons given by their vertex counts (P,) and concatenated vertex indices."""
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    corner = first[polygon]
    return np.stack([indices[corner], indices[corner + step + 1], indices[corner + step + 2]], axis=1).reshape(-1, 3)


def _missing_reader(format_name: str, place: Place) -> Exception:
    return place.error(f"{format_name} files need an extra: pip install 'wkernels[formats]'.")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200].rstrip(".") or type(error).__name__
