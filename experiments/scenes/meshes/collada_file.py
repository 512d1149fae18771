"""COLLADA 1.4 and 1.5 (.dae, .zae) through pycollada, with polygons that have holes, strips, fans and the up axis."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.meshes.axes import TO_Y_UP
from experiments.scenes.meshes.polygons import triangulate, triangulate_loops
from experiments.scenes.meshes.reading import MeshError, Parts, Tell, check_indices
from experiments.scenes.primitives import Triangles
from wkernels.errors import one_line

_WITHOUT_GEOMETRY = ("image", "texture", "sampler", "surface", "material", "effect", "camera", "light", "animation")
"""Words of errors that leave the geometry whole."""


def read(path: Path, tell: Tell) -> Triangles:
    """All triangles of the scene, turned so that y is up; lengths stay in the file's units."""
    if importlib.util.find_spec("collada") is None:
        raise MeshError("Collada files need an extra: pip install 'wkernels[formats]'.")
    import collada

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # NumPy's only word when a list of numbers holds others
            document = collada.Collada(str(path), ignore=[collada.common.DaeError])
    except Exception as error:  # of pycollada and of the XML parser below it
        raise MeshError(f"cannot be read: {one_line(error)}.") from None
    for fault in document.errors:
        broken = not isinstance(fault, collada.common.DaeUnsupportedError)
        if broken and not any(word in str(fault).lower() for word in _WITHOUT_GEOMETRY):
            raise MeshError(f"cannot be read: {one_line(fault)}.")
        tell(f"left out: {one_line(fault)}.")
    if document.scene is None:
        raise MeshError("has no scene.")
    turn, up = np.eye(4), str(document.assetInfo.upaxis or "Y_UP")[0]
    turn[:3, :3] = TO_Y_UP.get(up, np.eye(3))
    if up != "Y":
        tell(f"its up axis {up} is turned to y.")
    parts = Parts()
    for geometry, to_scene in _placed(document, tell):
        if not np.isfinite(to_scene).all():
            raise MeshError(f"the transform of geometry {geometry.id} is not finite.")
        for primitive in geometry.primitives:
            found = _primitive(primitive, geometry.id, tell)
            if found is not None:
                parts.add_placed(*found, turn @ to_scene)
    unit = document.assetInfo.unitmeter
    if unit not in (None, 1.0):
        tell(f"its unit is {unit:g} m; lengths are not scaled.")
    return parts.triangles()


def _placed(document: Any, tell: Tell) -> Iterator[tuple[Any, np.ndarray]]:
    """Every instance of a geometry with its matrix (4, 4) to the scene."""
    for bound in document.scene.objects("geometry"):
        yield bound.original, np.asarray(bound.matrix, np.float64)
    for bound in document.scene.objects("controller"):
        skin = getattr(bound, "skin", None)
        if skin is None:
            tell("a morph is drawn without its targets.")
            yield bound.original.source_geometry, np.asarray(bound.matrix, np.float64)
        else:
            tell("a skin is drawn in the pose that it was bound in.")
            yield skin.geometry, np.asarray(bound.matrix, np.float64) @ np.asarray(skin.bind_shape_matrix, np.float64)


def _primitive(primitive: Any, owner: str, tell: Tell) -> Triangles | None:
    from collada.polygons import Polygons
    from collada.polylist import Polylist
    from collada.triangleset import TriangleSet

    what = f"a face of geometry {owner}"
    if not isinstance(primitive, (Polylist, TriangleSet)):
        tell(f"left out: {type(primitive).__name__} of geometry {owner}.")
        return None
    vertices = np.asarray(primitive.sources["VERTEX"][0][4].data, np.float64).reshape(-1, 3)
    indices = np.zeros(0, np.int64)
    if primitive.vertex_index is not None:
        indices = np.asarray(primitive.vertex_index, np.int64).ravel()
    check_indices(indices, len(vertices), what=what)
    if isinstance(primitive, TriangleSet):
        return vertices, indices.reshape(-1, 3)
    counts = np.asarray(primitive.vcounts, np.int64)
    if np.any(counts < 0) or counts.sum() != len(indices):
        raise MeshError(f"{what} has not as many corners as its vcount says.")
    faces = [triangulate(vertices, counts, indices)]
    if isinstance(primitive, Polygons):
        for loops in _with_holes(primitive):
            check_indices(np.concatenate(loops), len(vertices), what=what)
            faces.append(triangulate_loops(vertices, loops))
    return vertices, np.concatenate(faces)


def _with_holes(primitive: Any) -> Iterator[list[np.ndarray]]:
    """The loops of every ``ph``, which pycollada does not read: its ``p`` and then its holes ``h``."""
    offset = primitive.sources["VERTEX"][0][0]
    stride = 1 + max(entry[0] for entries in primitive.sources.values() for entry in entries)
    for node in primitive.xmlnode:
        if _tag(node) != "ph":
            continue
        found = sorted((child for child in node if _tag(child) in ("p", "h")), key=lambda child: _tag(child) != "p")
        try:
            yield [np.array((child.text or "").split(), np.int64)[offset::stride] for child in found]
        except ValueError:
            raise MeshError("a polygon with holes has indices that are no whole numbers.") from None


def _tag(node: Any) -> str:
    return str(node.tag).rpartition("}")[2]
