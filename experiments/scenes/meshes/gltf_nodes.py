"""The node hierarchy of a glTF file: where every node stands, its instances and the joints of its skin."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.reading import MeshError

INSTANCING = "EXT_mesh_gpu_instancing"
VISIBILITY = "KHR_node_visibility"

LocalMatrix = Callable[[int], np.ndarray]
"""Node to parent space, float64 (4, 4), by the index of the node."""


def local_matrix(document: Document, index: int) -> np.ndarray:
    """Node to parent space as the file itself poses it, float64 (4, 4); raises MeshError where it is not finite."""
    node, what = document.item("nodes", index), f"node {index}"
    if "matrix" in node:
        out: np.ndarray = document.numbers(node, "matrix", 16, [], what).reshape(4, 4).T  # stored by columns
        return out
    translation = document.numbers(node, "translation", 3, [0.0, 0.0, 0.0], what)
    rotation = document.numbers(node, "rotation", 4, [0.0, 0.0, 0.0, 1.0], what)
    scale = document.numbers(node, "scale", 3, [1.0, 1.0, 1.0], what)
    return composed(translation, rotation, scale, what)


def composed(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray, what: str) -> np.ndarray:
    """Scale, then rotate by a quaternion x, y, z, w, then translate: float64 (4, 4)."""
    if not np.linalg.norm(rotation) > 0.0:
        raise MeshError(f"the rotation of {what} is no quaternion.")
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(rotation).as_matrix() * scale
    out[:3, 3] = translation
    return out


def roots(document: Document) -> list[int]:
    """The nodes of the default scene; without scenes all that are nobody's children."""
    if document.items("scenes"):
        scene = document.item("scenes", document.get(document.json, "scene", int, 0))
        return document.indices(scene, "nodes")
    children = {child for node in document.items("nodes") for child in document.indices(node, "children")}
    return [index for index in range(len(document.items("nodes"))) if index not in children]


def walk(document: Document, local: LocalMatrix | None = None) -> Iterator[tuple[int, np.ndarray, bool]]:
    """Every node of the scene, parents first: its index, node to world space (4, 4), and whether it is visible.

    Args:
        document: The file.
        local: Poses of the nodes, where they are not the file's own ones (at a time of an animation).

    Raises:
        MeshError: A node is its own ancestor or has several parents, or a matrix is not finite.
    """
    seen: set[int] = set()
    waiting = [(index, np.eye(4), True) for index in reversed(roots(document))]
    while waiting:
        index, parent, visible = waiting.pop()
        node = document.item("nodes", index)
        if index in seen:
            raise MeshError(f"node {index} is the child of several nodes, or of itself.")
        seen.add(index)
        world = parent @ (local_matrix(document, index) if local is None else local(index))
        shown = document.get(document.get(node, "extensions", dict, {}), VISIBILITY, dict, {}).get("visible", True)
        visible = visible and shown is not False
        yield index, world, visible
        waiting += [(child, world, visible) for child in reversed(document.indices(node, "children"))]


def instances(document: Document, index: int) -> list[np.ndarray]:
    """Instance to node space, one (4, 4) per copy of the node's mesh: EXT_mesh_gpu_instancing, else the node itself."""
    extensions = document.get(document.item("nodes", index), "extensions", dict, {})
    if INSTANCING not in extensions:
        return [np.eye(4)]
    attributes = document.get(document.get(extensions, INSTANCING, dict, {}), "attributes", dict, {})
    found = {
        key: document.accessor(attributes[key]) for key in ("TRANSLATION", "ROTATION", "SCALE") if key in attributes
    }
    lengths = {len(values) for values in found.values()}
    if len(lengths) != 1:
        raise MeshError(f"the instances of node {index} have attributes of different lengths, or none.")
    count = lengths.pop()
    defaults: dict[str, Any] = {"TRANSLATION": [0, 0, 0], "ROTATION": [0, 0, 0, 1], "SCALE": [1, 1, 1]}
    columns = [found.get(key, np.tile(np.array(value, float), (count, 1))) for key, value in defaults.items()]
    if not all(np.isfinite(column).all() for column in columns):
        raise MeshError(f"the instances of node {index} have transforms that are not finite.")
    if [column.shape[1] for column in columns] != [3, 4, 3]:
        raise MeshError(f"the instances of node {index} have attributes of wrong types.")
    return [composed(t, r, s, f"an instance of node {index}") for t, r, s in zip(*columns, strict=True)]


def joint_matrices(document: Document, skin: Any, worlds: dict[int, np.ndarray]) -> np.ndarray:
    """Bind to world space of every joint of a skin, (J, 4, 4), from node to world space of all nodes."""
    data = document.item("skins", skin)
    joints = document.indices(data, "joints")
    if not joints or not all(joint in worlds for joint in joints):
        raise MeshError(f"skin {skin} has no joints, or joints that are not in the scene.")
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in data:
        stored = document.accessor(data["inverseBindMatrices"])
        if stored.shape[1] != 16 or len(stored) < len(joints) or not np.isfinite(stored).all():
            raise MeshError(f"the inverse bind matrices of skin {skin} do not fit its joints.")
        bind = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    out: np.ndarray = np.stack([worlds[joint] for joint in joints]) @ bind
    return out
