"""Mitsuba 3 scenes: meshes, shapes, shape groups, cameras, and emitters, area emitters on simple shapes among them.

Written against the plugin reference of Mitsuba 3: a rectangle spans [-1, 1] in xy, a disk has radius 1, both look along
+z; a camera looks along its +z, its +x to the left, and a field of view is across x unless ``fov_axis`` says otherwise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

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
from experiments.scenes.importing.mitsuba_masks import mask_of
from experiments.scenes.importing.mitsuba_shapes import SHAPES, own_placement, transform, translation
from experiments.scenes.importing.mitsuba_xml import Element, read_xml
from experiments.scenes.meshes import obj, ply
from experiments.scenes.meshes.reading import MeshError
from experiments.scenes.primitives import Triangles
from wkernels.scene.lights import DirectionalLight, DiscLight, Light, PointLight, RectangleLight, SphereLight

_FILES = {"obj": obj.read, "ply": ply.read}
_FILM = (768, 576)


def read(path: Path, asked: Asked) -> ImportedScene:
    """The scene of a file; raises MeshError, with the line."""
    if asked.animation not in (None, "none"):
        raise MeshError(f"has no animation {asked.animation!r}: Mitsuba scenes stand still.")
    return _Reader(path, asked).scene()


class _Reader:
    """One scene while it is read."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self._root, self._tell = read_xml(path), asked.tell
        self._out = ImportedScene()
        self._files: dict[tuple[str, bool], int] = {}
        self._left_out: Counter[str] = Counter()

    def scene(self) -> ImportedScene:
        """Everything in the scene."""
        for element in self._root.children:
            if element.tag == "shape" and element.kind != "shapegroup":
                self._add_shape(element, np.eye(4))
            elif element.tag == "emitter":
                self._add_emitter(element)
            elif element.tag == "sensor":
                self._add_camera(element)
        for kind, count in sorted(self._left_out.items()):
            self._tell(f"left out: {count} {kind}.")
        return self._out

    # ---- shapes ----

    def _add_shape(self, element: Element, above: np.ndarray) -> None:
        to_world = above @ transform(element, "to_world")
        if element.kind == "instance":
            for group in element.all("shape"):
                for part in group.all("shape"):
                    self._add_shape(part, to_world)
            return
        emitters = [child for child in element.all("emitter") if child.kind == "area"]
        if emitters and element.kind in ("rectangle", "disk", "sphere"):
            self._add_area_light(element, emitters[0], to_world)
            return
        if emitters:
            self._left_out[f"shapes of type {element.kind} that shine, as lights; they are drawn as shapes"] += 1
        index = self._shape(element)
        if index is None:
            self._left_out[f"shapes of type {element.kind}"] += 1
            return
        if element.kind in ("sphere", "cylinder", "disk"):
            to_world = to_world @ own_placement(element)
        name = element.keys.get("id") or Path(element.text("filename", element.kind)).stem
        pose = each_frame(to_world)
        for material in _materials(element):
            if material.kind == "mask":
                shape = self._out.shapes[index]
                mask = mask_of(element, material, shape.vertices, self._tell)
                index = index if mask is None else self._out.add(replace(shape, mask=mask))
        self._out.instances.append(Instance(name, index, pose, self._diffuse(element)))

    def _shape(self, element: Element) -> int | None:
        """Index of the shape in its own space; None of a type that there is not."""
        kind, flips = element.kind, element.flag("flip_normals", False)
        filename = element.text("filename", "") if kind in _FILES else kind
        file = (element.file.parent / filename).as_posix() if kind in _FILES else kind
        if (file, flips) in self._files:
            return self._files[file, flips]
        if kind in _FILES:
            if not Path(file).is_file():
                raise element.error(f"no such file: '{file}'.")
            vertices, faces = self._read_mesh(element, Path(file))
        elif kind in SHAPES:
            vertices, faces = SHAPES[kind]
        else:
            return None
        faces = faces[:, ::-1] if flips else faces
        self._files[file, flips] = self._out.add(Shape(np.asarray(vertices), np.asarray(faces)))
        return self._files[file, flips]

    def _read_mesh(self, element: Element, file: Path) -> Triangles:
        try:
            return _FILES[element.kind](file, lambda message: self._tell(f"'{file.name}': {message}"))
        except MeshError as error:
            raise MeshError(f"'{file}': {error}") from None

    def _diffuse(self, element: Element) -> Grey | None:
        """The reflectance of the material, or of the one inside it; None where it has none, or a texture."""
        for material in _materials(element):
            for name in ("reflectance", "diffuse_reflectance", "base_color"):
                color = material.color(name)
                if color is not None:
                    red, green, blue = np.clip(color, 0.0, 1.0).tolist()
                    return red, green, blue
        return None

    # ---- lights ----

    def _add_area_light(self, element: Element, emitter: Element, to_world: np.ndarray) -> None:
        name = element.keys.get("id") or emitter.keys.get("id") or f"{element.kind} light"
        radiance = self._strength(emitter, "radiance")
        light: Light
        if element.kind == "rectangle":
            edges = np.array([2.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])
            light = RectangleLight(center=np.zeros(3), edge_u=edges[0], edge_v=edges[1], radiance=radiance)
        elif element.kind == "disk":
            light = DiscLight(center=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), radius=1.0, radiance=radiance)
        else:
            light = SphereLight(center=np.zeros(3), radius=1.0, radiance=radiance)
            to_world = to_world @ own_placement(element)
        self._out.lights.append(ImportedLight(name, light, each_frame(to_world)))
        self._note("shapes that shine are lights; they cast no shadows themselves")

    def _add_emitter(self, element: Element) -> None:
        kind, to_world = element.kind, transform(element, "to_world")
        name = element.keys.get("id") or f"{kind} light"
        light: Light
        if kind in ("point", "spot"):
            if element.named("position", "point") is not None:
                to_world = translation(element.vector("position", (0.0, 0.0, 0.0)))
            light = PointLight(position=np.zeros(3), radiance=self._strength(element, "intensity"))
            if kind == "spot":
                self._tell(f"the cone of the spot light {name!r} is left out: it shines everywhere.")
            pose = translation(to_world[:3, 3])
        elif kind == "directional":
            ahead = to_world[:3, :3] @ np.array([0.0, 0.0, 1.0])
            if element.named("direction", "vector", "point") is not None:
                ahead = element.vector("direction", (0.0, 0.0, 1.0))
            if not np.linalg.norm(ahead) > 0.0:
                raise element.error(f"the light {name!r} has no direction.")
            light = DirectionalLight(direction=ahead, radiance=self._strength(element, "irradiance"))
            pose = np.eye(4)
        else:
            self._left_out[f"emitters of type {kind}"] += 1
            return
        self._out.lights.append(ImportedLight(name, light, each_frame(pose)))

    def _strength(self, element: Element, key: str) -> tuple[float, float, float]:
        color = element.color(key)
        if color is None:
            if element.named(key) is not None:
                self._tell(f"the {key} of an emitter of type {element.kind} is no constant colour; it is taken as 1.")
            return 1.0, 1.0, 1.0
        if min(color) < 0.0:
            raise element.error(f"the {key} of an emitter is darker than black.")
        return color

    # ---- cameras ----

    def _add_camera(self, element: Element) -> None:
        kind = element.kind
        if kind not in ("perspective", "thinlens", "orthographic"):
            self._left_out[f"sensors of type {kind}"] += 1
            return
        if kind == "thinlens":
            self._tell("the lens of a thinlens camera is left out: it is a pinhole.")
        films = [child for child in element.children if child.tag == "film"]
        width, height = (
            films[0].number(key, size) if films else size for key, size in zip(("width", "height"), _FILM, strict=True)
        )
        if not min(width, height) > 0.0:
            raise element.error(f"a film of {width:g} x {height:g} pixels shows nothing.")
        to_world = transform(element, "to_world")
        name = element.keys.get("id") or f"camera_{len(self._out.cameras)}"
        pose = rigid(each_frame(to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])))
        lens: dict[str, Any] = {"near": element.number("near_clip", 1e-2), "far": element.number("far_clip", 1e4)}
        if kind == "orthographic":
            lens["height"] = 2.0 * float(np.linalg.norm(to_world[:3, 0])) * height / width
        else:
            lens["fov_deg"] = _vertical_fov(element, width, height)
        self._out.cameras.append(ImportedCamera(name, pose, **lens))

    def _note(self, note: str) -> None:
        if note not in self._out.notes:
            self._out.notes.append(note)


def _vertical_fov(element: Element, width: float, height: float) -> float:
    """Degrees, from the field of view along whichever axis the camera says, or its focal length on 35 mm film."""
    aspect = width / height
    axis = element.text("fov_axis", "x")
    fov = element.number("fov", 0.0)
    if element.named("fov") is None:
        focal = element.text("focal_length", "50mm")
        try:
            length = float(focal.removesuffix("mm"))
        except ValueError:
            raise element.error(f"{focal!r} is no focal length.") from None
        axis, fov = "diagonal", 2.0 * np.degrees(np.arctan2(np.sqrt(36.0**2 + 24.0**2), 2.0 * length))
    if not 0.0 < fov < 180.0:
        raise element.error(f"the field of view is {fov:g} degrees; it must be above 0 and below 180.")
    tangent = np.tan(np.radians(0.5 * fov))
    shares = {
        "x": 1.0 / aspect,
        "y": 1.0,
        "smaller": 1.0 / aspect if aspect < 1.0 else 1.0,
        "larger": 1.0 / aspect if aspect > 1.0 else 1.0,
        "diagonal": 1.0 / np.hypot(1.0, aspect),
    }
    if axis not in shares:
        raise element.error(f"{axis!r} is no fov_axis; it is one of {', '.join(shares)}.")
    return float(2.0 * np.degrees(np.arctan(tangent * shares[axis])))


def _materials(element: Element) -> Iterator[Element]:
    for child in element.all("bsdf"):
        yield child
        yield from _materials(child)
