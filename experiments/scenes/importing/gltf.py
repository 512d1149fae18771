"""glTF 2.0 and GLB scenes: meshes, instances, skins, morph targets, cameras, lights and one animation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.importing.deformation import Morph
from experiments.scenes.importing.description import (
    Asked,
    Grey,
    ImportedCamera,
    ImportedLight,
    ImportedScene,
    Instance,
    Shape,
    each_frame,
    rigid,
)
from experiments.scenes.importing.gltf_animation import Animation
from experiments.scenes.importing.gltf_materials import Materials
from experiments.scenes.meshes import gltf_nodes
from experiments.scenes.meshes.gltf import GEOMETRY_EXTENSIONS, check_extensions
from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.gltf_primitives import Primitive, default_weights, joints_and_weights, primitives
from experiments.scenes.meshes.reading import MeshError
from wkernels.scene.lights import DirectionalLight, Light, PointLight

LIGHTS = "KHR_lights_punctual"


def read(path: Path, asked: Asked) -> ImportedScene:
    """The default scene of a file; raises MeshError."""
    document = Document(path)
    check_extensions(document, GEOMETRY_EXTENSIONS | {LIGHTS}, asked.tell)
    return _Reader(document, asked).scene()


class _Reader:
    """One file while it is read."""

    def __init__(self, document: Document, asked: Asked) -> None:
        self._document, self._tell = document, asked.tell
        self._animation = Animation(document, asked)
        self._out = ImportedScene(frames=self._animation.frames)
        self._shapes: dict[int, list[tuple[int, Grey | None]]] = {}  # of meshes that several nodes may show
        self._materials = Materials(document, asked.tell)

    def scene(self) -> ImportedScene:
        """Everything in the scene."""
        document = self._document
        nodes = list(gltf_nodes.walk(document, self._animation.local))
        worlds = {index: each_frame(world) for index, world, _ in nodes}
        hidden = 0
        for index, _, visible in nodes:
            node = document.item("nodes", index)
            if not visible:
                hidden += bool({"mesh", "camera"} & set(node))
                continue
            self._add_mesh(index, node, worlds)
            if "camera" in node:
                self._out.cameras.append(self._camera(index, node, worlds[index]))
            light = document.get(document.get(node, "extensions", dict, {}), LIGHTS, dict)
            if light is not None:
                self._out.lights.append(self._light(light.get("light"), node, worlds[index]))
        if hidden:
            self._tell(f"left out: {hidden} invisible nodes.")
        self._materials.finish()
        if self._animation.frames > 1:
            frames = f"{self._animation.frames} frames at {self._animation.fps:g} per second"
            self._out.notes.append(f"animation {self._animation.name!r}: {frames}")
        return self._out

    def _add_mesh(self, index: int, node: dict[str, Any], worlds: dict[int, np.ndarray]) -> None:
        if "mesh" not in node:
            return
        document, world = self._document, worlds[index]
        mesh = document.item("meshes", node["mesh"])
        name = str(node.get("name") or mesh.get("name") or f"mesh_{node['mesh']}")
        if "skin" in node or self._animation.weights(index) is not None or "weights" in node:
            parts = self._own_shapes(index, node, worlds)  # of this node alone
        else:
            if node["mesh"] not in self._shapes:
                self._shapes[node["mesh"]] = self._own_shapes(index, node, worlds)
            parts = self._shapes[node["mesh"]]
        pose = np.eye(4)[None] if "skin" in node else world
        for copy in [np.eye(4)] if "skin" in node else gltf_nodes.instances(document, index):
            self._out.instances += [Instance(name, shape, each_frame(pose @ copy), color) for shape, color in parts]

    def _own_shapes(self, index: int, node: dict[str, Any], worlds: dict[int, np.ndarray]) -> list:
        """Shapes of a node's mesh with their colours, one for each colour: a body of several parts stays closed.

        What is cut out by a texture stays apart.
        """
        document = self._document
        rest = default_weights(document, node, f"node {index}")
        if rest is None:
            mesh = document.item("meshes", node["mesh"])
            rest = default_weights(document, mesh, f"mesh {node['mesh']}")
        animated = self._animation.weights(index)
        deforms = "skin" in node or animated is not None
        held = np.zeros_like(animated[0]) if animated is not None else rest
        found: dict[tuple[Grey | None, int | None], list[Shape]] = {}
        for i, primitive in enumerate(primitives(document, node["mesh"], held, self._tell)):
            mask = self._materials.mask(primitive)
            shape = Shape(primitive.vertices, primitive.faces, mask=mask)
            if deforms:
                deformation = self._morph(primitive, node, animated, worlds)
                moves = len(deformation.weights) > 1 or len(deformation.matrices) > 1
                shape = Shape(deformation(0), primitive.faces, deformation if moves else None, mask)
            apart = None if mask is None else i
            found.setdefault((self._materials.diffuse(primitive), apart), []).append(shape)
        return [
            (self._out.add(shape), color) for (color, _), shapes in found.items() for shape in _merged(shapes, deforms)
        ]

    def _morph(
        self, primitive: Primitive, node: dict[str, Any], animated: np.ndarray | None, worlds: dict[int, np.ndarray]
    ) -> Morph:
        document, count = self._document, len(primitive.vertices)
        offsets, weights = np.zeros((0, count, 3)), np.zeros((1, 0))
        if animated is not None:
            offsets, weights = self._targets(primitive), animated
            if len(offsets) != animated.shape[1]:
                raise MeshError(f"an animation has {animated.shape[1]} weights for {len(offsets)} morph targets.")
        joints, shares, matrices = np.zeros((count, 0), np.int64), np.zeros((count, 0)), np.zeros((1, 0, 4, 4))
        if "skin" in node:
            matrices = self._joint_matrices(node["skin"], worlds)
            joints, shares = joints_and_weights(document, primitive, matrices.shape[1])
        return Morph(primitive.vertices, offsets, weights, joints, shares, matrices)

    def _targets(self, primitive: Primitive) -> np.ndarray:
        out = []
        for target in self._document.get(primitive.data, "targets", list, []):
            offsets = np.zeros_like(primitive.vertices)
            if isinstance(target, dict) and "POSITION" in target:
                offsets = self._document.accessor(target["POSITION"]).astype(np.float64)
            if offsets.shape != primitive.vertices.shape:
                raise MeshError(f"a morph target has {len(offsets)} vertices for {len(primitive.vertices)}.")
            out.append(offsets)
        return np.array(out).reshape(len(out), *primitive.vertices.shape)

    def _joint_matrices(self, skin: Any, worlds: dict[int, np.ndarray]) -> np.ndarray:
        """(n, J, 4, 4), n = 1 where no joint moves."""
        joints = {j for j in self._document.get(self._document.item("skins", skin), "joints", list, []) if j in worlds}
        frames = max((len(worlds[joint]) for joint in joints), default=1)
        held = {joint: np.broadcast_to(worlds[joint], (frames, 4, 4)) for joint in joints}
        return np.stack(
            [
                gltf_nodes.joint_matrices(self._document, skin, {joint: pose[i] for joint, pose in held.items()})
                for i in range(frames)
            ]
        )

    def _light(self, index: Any, node: dict[str, Any], world: np.ndarray) -> ImportedLight:
        document = self._document
        lights = document.get(
            document.get(document.get(document.json, "extensions", dict, {}), LIGHTS, dict, {}), "lights", list, []
        )
        if not isinstance(index, int) or not 0 <= index < len(lights) or not isinstance(lights[index], dict):
            raise MeshError(f"uses light {index}, of which there are {len(lights)}.")
        data, what = lights[index], f"light {index}"
        name = str(node.get("name") or data.get("name") or f"light_{index}")
        color = document.numbers(data, "color", 3, [1.0, 1.0, 1.0], what)
        strength = document.numbers({"intensity": [data.get("intensity", 1.0)]}, "intensity", 1, [], what)[0]
        if strength < 0.0 or np.any(color < 0.0):
            raise MeshError(f"{what} is darker than black.")
        red, green, blue = (strength * color).tolist()
        kind = data.get("type")
        light: Light
        if kind == "directional":
            light = DirectionalLight(direction=np.array([0.0, 0.0, -1.0]), radiance=(red, green, blue))
        elif kind in ("point", "spot"):
            light = PointLight(position=np.zeros(3), radiance=(red, green, blue))
            if kind == "spot":
                self._tell(f"the cone of the spot light {name!r} is left out: it shines everywhere.")
        else:
            raise MeshError(f"{what} is of the unknown type {str(kind)[:40]!r}.")
        return ImportedLight(name, light, each_frame(rigid(world)))

    def _camera(self, index: int, node: dict[str, Any], world: np.ndarray) -> ImportedCamera:
        document = self._document
        data, what = document.item("cameras", node["camera"]), f"camera {node['camera']}"
        name = str(node.get("name") or data.get("name") or what.replace(" ", "_"))
        kind = data.get("type")
        if kind not in ("perspective", "orthographic"):
            raise MeshError(f"{what} is of the unknown type {str(kind)[:40]!r}.")
        lens = document.get(data, kind, dict, {})

        def number(key: str) -> float | None:
            return None if key not in lens else float(document.numbers({key: [lens[key]]}, key, 1, [], what)[0])

        pose = each_frame(rigid(world))
        if kind == "orthographic":
            ymag = number("ymag")
            if not ymag:
                raise MeshError(f"{what} has no ymag.")
            return ImportedCamera(name, pose, height=2.0 * abs(ymag), near=number("znear"), far=number("zfar"))
        yfov = number("yfov")
        if yfov is None or not 0.0 < yfov < np.pi:
            raise MeshError(f"{what} has the yfov {yfov}, which must be above 0 and below pi.")
        return ImportedCamera(name, pose, fov_deg=float(np.degrees(yfov)), near=number("znear"), far=number("zfar"))


def _merged(shapes: list[Shape], deforms: bool) -> list[Shape]:
    """Shapes of one colour as one; those that deform stay apart."""
    if deforms or len(shapes) == 1:
        return shapes
    starts = np.cumsum([0] + [len(shape.vertices) for shape in shapes])
    faces = [shape.faces + start for shape, start in zip(shapes, starts[:-1], strict=True)]
    return [Shape(np.concatenate([shape.vertices for shape in shapes]), np.concatenate(faces))]
