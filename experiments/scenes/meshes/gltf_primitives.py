"""The triangles of a glTF mesh: strips, fans, morph targets, skins, quantised and Draco-compressed attributes."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.reading import MeshError, Tell, check_indices
from experiments.scenes.meshes.strips import fan_to_triangles, strips_to_triangles
from wkernels.errors import one_line

DRACO = "KHR_draco_mesh_compression"
_POINTS_AND_LINES = (0, 1, 2, 3)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True, eq=False)
class Primitive:
    """One primitive of a mesh in the mesh's own space.

    Attributes:
        vertices: float64 (V, 3), the default weights of morph targets applied.
        faces: int64 (F, 3).
        data: Its JSON: material, attributes, extensions.
    """

    vertices: np.ndarray
    faces: np.ndarray
    data: dict[str, Any]


def primitives(document: Document, mesh: Any, weights: np.ndarray | None, tell: Tell) -> Iterator[Primitive]:
    """The primitives of a mesh that are made of triangles.

    Args:
        document: The file.
        mesh: Index of the mesh.
        weights: Of its morph targets; those that the mesh itself gives unless a node does.
        tell: Told of what is left out.
    """
    data = document.item("meshes", mesh)
    if weights is None:
        weights = default_weights(document, data, f"mesh {mesh}")
    for index, primitive in enumerate(document.objects(data, "primitives")):
        what = f"primitive {index} of mesh {mesh}"
        mode = document.get(primitive, "mode", int, _TRIANGLES)
        if mode in _POINTS_AND_LINES:
            tell(f"left out: {what}, which is made of points or lines.")
            continue
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            raise MeshError(f"{what} has the unknown mode {mode}.")
        vertices, corners = _attributes(document, primitive, what)
        if vertices is None:
            tell(f"left out: {what}, which has no positions.")
            continue
        vertices = _morphed(document, primitive, vertices, weights, what)
        check_indices(corners, len(vertices), what=what)
        yield Primitive(vertices, _faces(corners, mode, what, tell), primitive)


def default_weights(document: Document, data: dict[str, Any], what: str) -> np.ndarray | None:
    """The key ``weights`` of a mesh or node, None where it has none."""
    weights = document.get(data, "weights", list)
    return None if weights is None else document.numbers(data, "weights", len(weights), [], what)


def joints_and_weights(document: Document, primitive: Primitive, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Joint indices and weights (V, 4 n) of a skinned primitive, weights of every vertex adding up to 1."""
    attributes = document.get(primitive.data, "attributes", dict, {})
    found: list[tuple[np.ndarray, np.ndarray]] = []
    while f"JOINTS_{len(found)}" in attributes and f"WEIGHTS_{len(found)}" in attributes:
        at = len(found)
        pair = document.accessor(attributes[f"JOINTS_{at}"]), document.accessor(attributes[f"WEIGHTS_{at}"])
        if any(part.shape != (len(primitive.vertices), 4) for part in pair):
            raise MeshError("a skinned mesh has joints or weights that do not fit its vertices.")
        found.append((pair[0].astype(np.int64), pair[1].astype(np.float64)))
    if not found:
        raise MeshError("a mesh with a skin has no joints and weights.")
    index, weight = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
    check_indices(index[weight > 0.0], joints, what="a skinned mesh")
    total = weight.sum(axis=1, keepdims=True)
    return np.minimum(index, joints - 1), weight / np.where(total > 0.0, total, 1.0)


def texture_coordinates(document: Document, primitive: Primitive, channel: Any) -> np.ndarray | None:
    """Texture coordinates ``TEXCOORD_<channel>`` of a primitive's vertices, float64 (V, 2); None where it has none."""
    attributes, name = document.get(primitive.data, "attributes", dict, {}), f"TEXCOORD_{channel}"
    what = "a primitive with a texture"
    extension = document.get(document.get(primitive.data, "extensions", dict, {}), DRACO, dict, {})
    packed = document.get(extension, "attributes", dict, {})
    if name in packed and "bufferView" not in document.item("accessors", attributes.get(name)):
        out = _draco_attribute(_draco(document, extension, what), packed[name], what)
    elif name in attributes:
        out = document.accessor(attributes[name]).astype(np.float64)
    else:
        return None
    if out.shape != (len(primitive.vertices), 2) or not np.isfinite(out).all():
        raise MeshError(f"{what} has {name} that does not fit its vertices.")
    return out


def _attributes(document: Document, primitive: dict[str, Any], what: str) -> tuple[np.ndarray | None, np.ndarray]:
    """Positions (V, 3) or None, and the vertex of every corner in the primitive's own order."""
    attributes = document.get(primitive, "attributes", dict, {})
    if "POSITION" not in attributes:
        return None, np.zeros(0, np.int64)
    extensions = document.get(primitive, "extensions", dict, {})
    stored = document.item("accessors", attributes["POSITION"])
    if DRACO in extensions and "bufferView" not in stored and "sparse" not in stored:
        return _decode_draco(document, document.get(extensions, DRACO, dict, {}), what)
    vertices = document.accessor(attributes["POSITION"])
    if vertices.shape[1] != 3:
        raise MeshError(f"{what} has positions of {vertices.shape[1]} coordinates.")
    if "indices" not in primitive:
        return vertices.astype(np.float64), np.arange(len(vertices))
    indices = document.accessor(primitive["indices"])
    if indices.shape[1] != 1 or indices.dtype.kind != "i":
        raise MeshError(f"{what} has indices that are no whole numbers.")
    return vertices.astype(np.float64), indices.ravel()


def _draco(document: Document, extension: dict[str, Any], what: str) -> Any:
    """The decoded mesh of a compressed primitive."""
    if importlib.util.find_spec("DracoPy") is None:
        raise MeshError(f"{what} is compressed by {DRACO}, which needs an extra: pip install 'wkernels[formats]'.")
    import DracoPy

    payload, _ = document.view_bytes(extension.get("bufferView"))
    try:
        return DracoPy.decode(payload)
    except Exception as error:  # a C++ library's own exceptions
        raise MeshError(f"{what} is compressed by {DRACO} and cannot be decoded: {one_line(error)}.") from None


def _draco_attribute(decoded: Any, index: Any, what: str) -> np.ndarray:
    """An attribute of a decoded mesh by its unique id, float64 (V, width)."""
    try:
        values = np.asarray(decoded.get_attribute_by_unique_id(index)["data"], np.float64)
        return values.reshape(len(values), -1)
    except Exception as error:  # a C++ library's own exceptions
        raise MeshError(f"{what} is compressed by {DRACO} and cannot be decoded: {one_line(error)}.") from None


def _decode_draco(document: Document, extension: dict[str, Any], what: str) -> tuple[np.ndarray, np.ndarray]:
    decoded = _draco(document, extension, what)
    position = document.get(extension, "attributes", dict, {}).get("POSITION")
    vertices = _draco_attribute(decoded, position, what)
    return vertices.reshape(-1, 3), np.asarray(decoded.faces, np.int64).ravel()


def _morphed(
    document: Document, primitive: dict[str, Any], vertices: np.ndarray, weights: np.ndarray | None, what: str
) -> np.ndarray:
    targets = document.objects(primitive, "targets")
    if not targets or weights is None:
        return vertices
    if len(weights) != len(targets):
        raise MeshError(f"{what} has {len(targets)} morph targets, but {len(weights)} weights.")
    for weight, target in zip(weights, targets, strict=True):
        if weight == 0.0 or "POSITION" not in target:
            continue
        offsets = document.accessor(target["POSITION"])
        if offsets.shape != vertices.shape:
            raise MeshError(f"{what} has a morph target of {len(offsets)} vertices for its {len(vertices)}.")
        vertices = vertices + weight * offsets
    return vertices


def _faces(corners: np.ndarray, mode: int, what: str, tell: Tell) -> np.ndarray:
    if mode == _STRIP:
        return strips_to_triangles(corners)
    if mode == _FAN:
        return fan_to_triangles(corners)
    whole = len(corners) // 3 * 3
    if whole != len(corners):
        tell(f"left out: the last {len(corners) - whole} corners of {what}, which make no triangle.")
    return corners[:whole].reshape(-1, 3)
