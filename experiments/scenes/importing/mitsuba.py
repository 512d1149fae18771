"""Mitsuba 3 scenes: meshes, shapes, shape groups, cameras, and emitters, area emitters on simple shapes among them.

Written against the plugin reference of Mitsuba 3: a rectangle spans [-1, 1] in xy, a disk has radius 1, both look along
+z; a camera looks along its +z, its +x to the left, and a field of view is across x unless ``fov_axis`` says otherwise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.scenes import primitives
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
from experiments.scenes.importing.mitsuba_xml import Element, read_xml
from experiments.scenes.meshes import obj, ply
from experiments.scenes.meshes.reading import MeshError
from experiments.scenes.primitives import Triangles
from wkernels.scene.lights import DirectionalLight, DiscLight, Light, PointLight, RectangleLight, SphereLight

_FILES = {"obj": obj.read, "ply": ply.read}
_SPHERE_SUBDIVISIONS = 4
_FILM = (768, 576)
_Z_TO_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # turns +y into +z


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
            to_world = to_world @ _own_placement(element)
        name = element.keys.get("id") or Path(element.text("filename", element.kind)).stem
        pose = each_frame(to_world)
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
        elif kind in _SHAPES:
            vertices, faces = _SHAPES[kind]
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
            if material.kind == "mask":
                self._tell("shapes with a mask are drawn opaque.")
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
            to_world = to_world @ _own_placement(element)
        self._out.lights.append(ImportedLight(name, light, each_frame(to_world)))
        self._note("shapes that shine are lights; they cast no shadows themselves")

    def _add_emitter(self, element: Element) -> None:
        kind, to_world = element.kind, transform(element, "to_world")
        name = element.keys.get("id") or f"{kind} light"
        light: Light
        if kind in ("point", "spot"):
            if element.named("position", "point") is not None:
                to_world = _translation(element.vector("position", (0.0, 0.0, 0.0)))
            light = PointLight(position=np.zeros(3), radiance=self._strength(element, "intensity"))
            if kind == "spot":
                self._tell(f"the cone of the spot light {name!r} is left out: it shines everywhere.")
            pose = _translation(to_world[:3, 3])
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


def transform(element: Element, name: str) -> np.ndarray:
    """A ``transform`` below an element, float64 (4, 4): its parts one after the other; the identity without one."""
    found, out = element.named(name, "transform"), np.eye(4)
    for part in found.children if found else []:
        step = np.eye(4)
        if part.tag == "translate":
            step[:3, 3] = _xyz(part, 0.0)
        elif part.tag == "scale":
            step[:3, :3] = np.diag(_xyz(part, 1.0))
        elif part.tag == "rotate":
            axis = _xyz(part, 0.0)
            if not np.linalg.norm(axis) > 0.0:
                raise part.error("a rotation needs an axis.")
            turn = np.radians(part.numbers("angle", 1)[0]) * axis / np.linalg.norm(axis)
            step[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        elif part.tag == "lookat":
            step = _look_at(part)
        elif part.tag == "matrix":
            values = part.numbers("value", None)
            if len(values) not in (9, 16):
                raise part.error(f"a matrix has 9 or 16 numbers, not {len(values)}.")
            size = int(np.sqrt(len(values)))
            step[:size, :size] = np.reshape(values, (size, size))
            if size == 4 and not np.array_equal(step[3], [0.0, 0.0, 0.0, 1.0]):
                raise part.error("only affine matrices are supported, their last row being 0 0 0 1.")
        else:
            raise part.error(f"<{part.tag}> is no transform.")
        out = step @ out
    return out


def _xyz(part: Element, default: float) -> np.ndarray:
    if "value" in part.keys:
        values = part.numbers("value", None)
        if len(values) not in (1, 3):
            raise part.error(f"<{part.tag}> needs one number or three, not {len(values)}.")
        return np.array(values * 3 if len(values) == 1 else values)
    return np.array([part.numbers(axis, 1, str(default))[0] for axis in "xyz"])


def _look_at(part: Element) -> np.ndarray:
    origin, target = np.array(part.numbers("origin", 3)), np.array(part.numbers("target", 3))
    ahead, up = target - origin, np.array(part.numbers("up", 3, "0, 0, 0"))
    if not np.linalg.norm(ahead) > 0.0:
        raise part.error("the origin lies on the target.")
    ahead = ahead / np.linalg.norm(ahead)
    if not np.linalg.norm(np.cross(up, ahead)) > 1e-6 * np.linalg.norm(up):  # none, or along the view
        up = np.eye(3)[np.argmin(np.abs(ahead))]
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    out = np.eye(4)
    out[:3, :4] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    return out


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


def _own_placement(element: Element) -> np.ndarray:
    """The radius and the centre or ends that spheres and cylinders have besides their transform."""
    out = np.eye(4)
    if element.kind == "sphere":
        out[:3, :3] *= element.number("radius", 1.0)
        out[:3, 3] = element.vector("center", (0.0, 0.0, 0.0))
    elif element.kind == "cylinder":
        low, high = element.vector("p0", (0.0, 0.0, 0.0)), element.vector("p1", (0.0, 0.0, 1.0))
        along, radius = high - low, element.number("radius", 1.0)
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise element.error("a cylinder has no length.")
        turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
        out[:3, :3] = turn.as_matrix() * [radius, radius, length]
        out[:3, 3] = low
    return out


def _translation(offset: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = offset
    return out


def _materials(element: Element) -> Iterator[Element]:
    for child in element.all("bsdf"):
        yield child
        yield from _materials(child)


def _open_cylinder() -> Triangles:
    """From z = 0 to 1 about z, radius 1, without caps."""
    sides = primitives.CYLINDER_SEGMENTS
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    here = np.arange(sides)
    after = np.roll(here, -1)
    faces = np.concatenate(
        [np.stack([here, after, after + sides], axis=1), np.stack([here, after + sides, here + sides], axis=1)]
    )
    return np.concatenate([ring, ring + [0.0, 0.0, 1.0]]), faces


def _facing_z(triangles: Triangles) -> Triangles:
    return triangles[0] @ _Z_TO_Y.T, triangles[1]


_SHAPES: dict[str, Triangles] = {
    "rectangle": _facing_z(primitives.plane((2.0, 2.0))),
    "disk": _facing_z(primitives.disc(1.0)),
    "cube": primitives.box((2.0, 2.0, 2.0)),
    "sphere": primitives.sphere(1.0, _SPHERE_SUBDIVISIONS),
    "cylinder": _open_cylinder(),
}
