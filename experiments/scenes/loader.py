"""Reads a scene file: every mesh, light and camera key is checked, resolved and put into a ``Scene``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.config.source import Source, from_dict, load_yaml
from experiments.scenes import generators, primitives, schema
from experiments.scenes.assets import without_prefix
from experiments.scenes.cameras import CameraPath, camera_path
from experiments.scenes.files import read_triangles
from experiments.scenes.importing.building import import_file, imported_camera
from experiments.scenes.importing.schema import ImportingSceneFile
from experiments.scenes.lights import build_light
from experiments.scenes.masks import flat_mask
from experiments.scenes.place import FreeNames, Place, misspelt
from experiments.scenes.poses import KeyframedPose, Moving, pose
from experiments.scenes.primitives import Triangles
from wkernels.errors import nearest
from wkernels.scene.cutouts import WRAPS
from wkernels.scene.geometry import box_of
from wkernels.scene.lights import Light
from wkernels.scene.model import Mesh, Scene

_DIFFUSE = (0.8, 0.8, 0.8)
ROUND = 1.0 + 1e-6
"""Times the largest coordinate: what stands there may have a size."""


def load_scene(source: str | Path | Mapping[str, Any], *, base: Path | None = None) -> Scene:
    """Reads a scene (docs/formats.md).

    Args:
        source: A YAML file, or its keys as a dict.
        base: Folder that relative file names are looked up in; default: the folder of the YAML file, for a dict the
            current folder.

    Raises:
        InputError: Anything in the scene is wrong; names file, line and key.
    """
    if isinstance(source, Mapping):
        return scene_from_source(from_dict(source), base=base or Path())
    return scene_from_source(load_yaml(source), base=base or Path(source).parent, name=Path(source).stem)


def scene_from_source(source: Source, loc: tuple[str | int, ...] = (), *, base: Path, name: str | None = None) -> Scene:
    """The scene at ``loc`` of a source that is read already; ``name`` defaults to that of its first generator."""
    place = Place(source, base, loc)
    if isinstance(place.data, dict):
        if "import" in place.data:
            return _importing_scene(place, name)
        if (wrong := misspelt("import", place.data)) is not None:
            raise place.at(wrong).error("is not a known key. Did you mean 'import'?")
    scene_file = place.validated(schema.SceneFile)
    meshes: list[Mesh] = []
    names = FreeNames()
    files: dict[str, Triangles] = {}
    for i in range(len(scene_file.meshes)):
        _add_meshes(meshes, place.at("meshes", i), names, files)
    lights = tuple(build_light(place.at("lights", i)) for i in range(len(scene_file.lights)))
    camera, frames = camera_path(scene_file.camera, scene_file.path, meshes, place)
    if name is None:
        generated = [m["generate"] for m in scene_file.meshes if "generate" in m]
        name = str(generated[0]) if generated else "scene"
    return Scene(name, tuple(meshes), lights, camera, frames, content_hash(meshes, lights, camera, frames))


def _importing_scene(place: Place, name: str | None) -> Scene:
    """The scene of a file that imports another one, its own keys beside it."""
    scene_file = place.validated(ImportingSceneFile)
    imported = import_file(scene_file, place)
    meshes = list(imported.meshes)
    files: dict[str, Triangles] = {}
    for i in range(len(scene_file.meshes)):
        _add_meshes(meshes, place.at("meshes", i), imported.names, files)
    lights: list[Light] = []
    for i, item in enumerate(["from_file"] if scene_file.lights == "from_file" else scene_file.lights):
        lights += imported.lights if item == "from_file" else [build_light(place.at("lights", i))]
    if not lights:
        raise place.at("lights").error("there is no light: the file has none, or none that is supported.")
    camera, frames = imported_camera(scene_file, imported, meshes, place)
    digest = content_hash(meshes, lights, camera, frames)
    name = name or Path(scene_file.import_file).stem
    return Scene(name, tuple(meshes), tuple(lights), camera, frames, digest, imported.notes)


def _add_meshes(meshes: list[Mesh], place: Place, names: FreeNames, files: dict[str, Triangles]) -> None:
    """Appends what one entry of ``meshes`` stands for: one mesh, or all parts of a generator.

    ``files`` holds what was read for this scene already: a file that is named often is read and told of once.
    """
    kind = _mesh_kind(place)
    if kind == "generate":
        name = place.data["generate"]
        if not isinstance(name, str) or name not in generators.names():
            raise place.at("generate").error(f"{name!r} is not a generator." + nearest(str(name), generators.names()))
        options: schema.MeshOptions = place.validated(generators.parameters_model(name))
        prefix = f"{options.name}/" if options.name else ""
        parts = [replace(part, name=prefix + part.name) for part in generators.run(options)]
    elif kind == "file":
        options = file_options = place.validated(schema.MeshFile)
        default = Path(without_prefix(file_options.file)).stem
        if file_options.file not in files:
            files[file_options.file] = read_triangles(file_options.file, place.at("file"))
        parts = [Mesh(options.name or default, *files[file_options.file])]
    else:
        options = place.validated(place.choice("primitive", schema.PRIMITIVES))
        triangles = primitives.triangulate(options)
        mask = None
        if isinstance(options, (schema.Plane, schema.Grid)) and options.mask is not None:
            mask = flat_mask(options.mask, triangles, options.size, place.at("mask"))
        parts = [Mesh(options.name or place.data["primitive"], *triangles, mask=mask)]
    object_to_ws = pose(options.transform, options.motion, place)
    moving = isinstance(object_to_ws, KeyframedPose) and object_to_ws.moving
    if options.name is not None and any(part.name in names for part in parts):
        raise place.at("name").error(f"another mesh has the name '{options.name}' already.")
    _check_reach(parts, object_to_ws, options, place)
    for part in parts:
        diffuse = options.diffuse or (_DIFFUSE if kind != "generate" else part.diffuse)
        meshes.append(
            replace(
                part,
                name=names.take(part.name),
                diffuse=diffuse,
                casts=options.casts and part.casts,
                receives=options.receives and part.receives,
                object_to_ws=object_to_ws,
                moving=moving,
            )
        )


def _check_reach(parts: Sequence[Mesh], object_to_ws: Any, options: schema.MeshOptions, place: Place) -> None:
    """Raises InputError where a transform or a keyframe takes a vertex beyond the largest coordinate."""
    frames = [0] if options.motion is None else [key.frame for key in options.motion.keyframes]
    key = "transform" if options.motion is None else "motion"
    for part in parts:
        box = box_of(part.vertices)
        if box is None:
            continue
        middle, half = box.mean(axis=0), 0.5 * (box[1] - box[0])
        for pose_ws in map(object_to_ws, frames):
            reach = np.abs(pose_ws[:3, :3] @ middle + pose_ws[:3, 3]) + np.abs(pose_ws[:3, :3]) @ half
            if not reach.max() <= ROUND * schema.LARGEST:
                raise place.at(key).error(
                    f"takes the mesh '{part.name}' to a coordinate of {reach.max():.3g}; lengths beyond "
                    f"{schema.LARGEST:g} cannot be drawn."
                )


def _mesh_kind(place: Place) -> str:
    kinds = ("primitive", "file", "generate")
    data = place.data
    given = [kind for kind in kinds if isinstance(data, dict) and kind in data]
    if len(given) == 1:
        return given[0]
    if given:
        raise place.at(given[1]).error(f"a mesh has only one of {', '.join(kinds)}, not {' and '.join(given)}.")
    if isinstance(data, dict):
        for kind in kinds:
            wrong = misspelt(kind, data)
            if wrong is not None:
                raise place.at(wrong).error(f"is not a known key. Did you mean '{kind}'?")
        raise place.error(f"a mesh needs one of the keys {', '.join(kinds)}.")
    raise place.error("must be a mapping such as {primitive: box, size: [1, 1, 1]}.")


def content_hash(meshes: Sequence[Mesh], lights: Sequence[Light], camera: CameraPath, frames: int) -> str:
    """Hex digest (SHA-256) over everything that changes pixels.

    Names are left out, and so is how a scene was described: equal geometry, poses, lights and cameras hash equally.
    """
    digest = hashlib.sha256()

    def add(*values: Any) -> None:
        for value in values:
            array = np.ascontiguousarray(value, np.int64 if np.asarray(value).dtype.kind in "biu" else np.float64)
            digest.update(repr(array.shape).encode())
            digest.update((array + 0).tobytes())  # + 0 makes -0.0 and 0.0 the same

    for mesh in meshes:
        add(mesh.vertices, mesh.faces, mesh.diffuse, mesh.casts, mesh.receives, mesh.moving)
        if isinstance(mesh.object_to_ws, Moving) and mesh.moving:
            add(*mesh.object_to_ws.description)
        else:
            add(mesh.object_to_ws(0))
        if isinstance(mesh.deformed, Moving):
            add(*mesh.deformed.description)
        if mesh.mask is not None:
            mask = mesh.mask
            add(mask.uv, mask.alpha, mask.cutoff, [WRAPS[wrap] for wrap in mask.wrap], mask.nearest)
    for light in lights:
        digest.update(light.kind.encode())
        for item in fields(light):
            value = getattr(light, item.name)
            if item.name != "motion":
                add(() if value is None else value)
            elif isinstance(value, Moving):
                add(*value.description)
    fixed = camera.options
    at = np.arange(frames, dtype=np.float64)
    add(camera.eye_target(at), fixed.up, [fixed.fov_deg, camera.near, camera.far])
    if camera.ups is not None:
        add(camera.ups(at))
    if fixed.height is not None:
        add(fixed.height)
    return digest.hexdigest()
