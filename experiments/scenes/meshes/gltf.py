"""glTF 2.0 and GLB as one mesh: every mesh of the scene where its node, instance or skin puts it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.meshes import gltf_meshopt, gltf_nodes
from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.gltf_primitives import (
    DRACO,
    Primitive,
    default_weights,
    joints_and_weights,
    primitives,
)
from experiments.scenes.meshes.reading import MeshError, Parts, Tell
from experiments.scenes.primitives import Triangles

GEOMETRY_EXTENSIONS = {
    *("KHR_mesh_quantization", DRACO, *gltf_meshopt.NAMES),
    *(gltf_nodes.INSTANCING, gltf_nodes.VISIBILITY),
}
_SURFACES_ONLY = ("KHR_materials_", "EXT_materials_", "KHR_texture_", "EXT_texture_", "KHR_xmp")


def read(path: Path, tell: Tell) -> Triangles:
    """All triangles of the default scene, in its space; animations stand at the pose that the nodes have."""
    document = Document(path)
    check_extensions(document, GEOMETRY_EXTENSIONS, tell)
    if document.items("animations"):
        tell("its animations are not read; it is drawn as its nodes stand.")
    nodes = list(gltf_nodes.walk(document))
    worlds = {index: world for index, world, _ in nodes}
    parts = Parts()
    hidden = 0
    materials: set[int] = set()
    for index, world, visible in nodes:
        node = document.item("nodes", index)
        if "mesh" not in node:
            continue
        if not visible:
            hidden += 1
            continue
        copies = gltf_nodes.instances(document, index)
        weights = default_weights(document, node, f"node {index}")
        for primitive in primitives(document, node["mesh"], weights, tell):
            materials.add(primitive.data.get("material", -1))
            if "skin" in node:
                joints = gltf_nodes.joint_matrices(document, node["skin"], worlds)
                parts.add(skinned(document, primitive, joints), primitive.faces)
                continue
            for copy in copies:
                parts.add_placed(primitive.vertices, primitive.faces, world @ copy)
    if hidden:
        tell(f"left out: {hidden} invisible nodes.")
    _tell_of_alpha(document, materials, tell)
    return parts.triangles()


def check_extensions(document: Document, supported: set[str], tell: Tell) -> None:
    """Refuses a file that requires an extension which is not supported, and tells of those that are merely used.

    Extensions of materials and textures are about surfaces alone, and visibility does not ask for them.
    """
    required, used = (
        [name for name in names if name not in supported and not name.startswith(_SURFACES_ONLY)]
        for names in document.extensions_used()
    )
    if required:
        raise MeshError(f"requires {' and '.join(required)}, which is not supported.")
    if used:
        tell(f"uses {' and '.join(used)}, which is not read.")


def skinned(document: Document, primitive: Primitive, joints: np.ndarray) -> np.ndarray:
    """Vertices (V, 3) in world space under the joint matrices (J, 4, 4) of a skin; the node's own pose has no part."""
    index, weight = joints_and_weights(document, primitive, len(joints))
    out = np.zeros_like(primitive.vertices)
    homogeneous = np.append(primitive.vertices, np.ones((len(out), 1)), axis=1)
    for column in range(index.shape[1]):
        matrices = joints[index[:, column], :3]
        out += weight[:, column, None] * np.einsum("vij,vj->vi", matrices, homogeneous)
    return out


def _tell_of_alpha(document: Document, materials: set[Any], tell: Tell) -> None:
    modes: dict[str, int] = {}
    for index in materials:
        if index == -1:
            continue
        mode = document.get(document.item("materials", index), "alphaMode", str, "OPAQUE")
        if mode != "OPAQUE":
            modes[mode] = modes.get(mode, 0) + 1
    for mode, count in sorted(modes.items()):
        remedy = " (`import` of the file cuts them out)" if mode == "MASK" else ""
        tell(f"{count} materials with alphaMode {mode} are drawn opaque{remedy}.")
