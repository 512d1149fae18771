"""Imported descriptions to meshes, lights and camera paths, and what there is to tell about them."""

from __future__ import annotations

import importlib
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from experiments.scenes import schema
from experiments.scenes.assets import find_file
from experiments.scenes.cameras import CameraPath, camera_path, check_lens
from experiments.scenes.files import MeshWarning
from experiments.scenes.importing.description import Asked, ImportedCamera, ImportedScene, Shape, each_frame
from experiments.scenes.importing.schema import ImportingSceneFile
from experiments.scenes.meshes.reading import MeshError
from experiments.scenes.place import FreeNames, Place
from experiments.scenes.poses import SampledPose, StaticPose
from experiments.scenes.sight import depth_planes
from wkernels.errors import nearest
from wkernels.scene.light_motion import transformed
from wkernels.scene.lights import DirectionalLight, DiscLight, Light, PointLight, SphereLight
from wkernels.scene.model import Mesh
from wkernels.scene.origin import looked_at

FORMATS = {
    **dict.fromkeys((".glb", ".gltf"), "gltf"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "usd"),
    ".xml": "mitsuba",
}
_UNEVEN = 1e-6  # relative difference of scales along axes that says that a disc or sphere is none any more


@dataclass(frozen=True, eq=False)
class Imported:
    """What came in, in scene space.

    Attributes:
        meshes, lights: Of the file.
        names: Those of the meshes.
        scene: The description.
        notes: Sentences for ``explain``.
    """

    meshes: tuple[Mesh, ...]
    lights: tuple[Light, ...]
    names: FreeNames
    scene: ImportedScene
    notes: tuple[str, ...]


def import_file(options: ImportingSceneFile, place: Place) -> Imported:
    """Reads the file that the scene at ``place`` imports; warns of what is left out.

    Raises:
        InputError: The file is missing, broken, of an unknown format, or requires what is not supported.
    """
    at = place.at("import")
    path = find_file(options.import_file, at)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise at.error(f"'{path}' is of no format that can be imported, which are {', '.join(FORMATS)}.")
    left_out: list[str] = []

    def tell(message: str) -> None:
        if message not in left_out:
            left_out.append(message)
            warnings.warn(MeshWarning(str(at.error(f"'{path}': {message}"))), stacklevel=2)

    reader = importlib.import_module(f"experiments.scenes.importing.{FORMATS[suffix]}")
    try:
        scene: ImportedScene = reader.read(path, Asked(options.fps, options.animation, tell))
        names = FreeNames()
        meshes = _meshes(scene, names, tell)
        lights = tuple(_light(one, scene, options, tell) for one in scene.lights)
    except MeshError as error:
        raise at.error(f"'{path}': {error}") from None
    notes = [f"{path.name}: {_came_in(scene, meshes)}", *scene.notes, *left_out]
    return Imported(meshes, lights, names, scene, tuple(notes))


def _came_in(scene: ImportedScene, meshes: Sequence[Mesh]) -> str:
    kinds = Counter(one.light.kind for one in scene.lights)
    cameras = ", ".join(
        f"{camera.name} ({'orthographic' if camera.fov_deg is None else 'perspective'})" for camera in scene.cameras
    )
    moving, masked = sum(mesh.moving for mesh in meshes), sum(mesh.mask is not None for mesh in meshes)
    cut = f", {masked} cut out by a texture" if masked else ""
    return "; ".join(
        [
            f"{len(meshes)} meshes of {len(scene.shapes)} shapes, {moving} of them moving{cut}",
            f"lights: {', '.join(f'{count} {kind}' for kind, count in kinds.items()) or 'none'}",
            f"cameras: {cameras or 'none'}",
            f"{scene.frames} frame{'' if scene.frames == 1 else 's'}",
        ]
    )


def _meshes(scene: ImportedScene, names: FreeNames, tell: Any) -> tuple[Mesh, ...]:
    shapes = [_finite(shape, tell) for shape in scene.shapes]
    mirrored: dict[int, np.ndarray] = {}  # faces by shape, shared like those that are not
    meshes = []
    for one in scene.instances:
        shape = shapes[one.shape]
        if not len(shape.faces):
            continue
        pose = each_frame(scene.to_scene @ one.pose)
        if not np.isfinite(pose).all():
            raise MeshError(f"the transform of {one.name!r} is not finite.")
        _check_extent(shape, pose, one.name)
        faces = shape.faces
        if np.linalg.det(pose[0, :3, :3]) < 0.0:
            faces = mirrored.setdefault(one.shape, np.ascontiguousarray(faces[:, ::-1]))
        sampled = SampledPose(pose)
        mesh = Mesh(
            names.take(one.name),
            shape.vertices,
            faces,
            object_to_ws=sampled if len(pose) > 1 else StaticPose(pose[0]),
            moving=sampled.moving or shape.deformation is not None,
            deformed=shape.deformation,
            mask=shape.mask,
        )
        meshes.append(mesh if one.diffuse is None else replace(mesh, diffuse=one.diffuse))
    return tuple(meshes)


def _finite(shape: Shape, tell: Any) -> Shape:
    """The shape without triangles that use a vertex that is not finite."""
    faces = np.ascontiguousarray(shape.faces, np.int32)
    good = np.all(np.isfinite(shape.vertices), axis=1)[faces].all(axis=1)
    if not good.all():
        tell(f"{np.count_nonzero(~good)} of {len(good)} triangles have non-finite vertices and are left out.")
    return replace(shape, faces=faces[good])


def _check_extent(shape: Shape, pose: np.ndarray, name: str) -> None:
    """Raises MeshError where the corners of the shape's box are beyond the largest coordinate on the first frame."""
    used = shape.vertices[np.isfinite(shape.vertices).all(axis=1)]
    if len(used):
        corners = np.stack([used.min(axis=0), used.max(axis=0)])
        if np.abs(corners @ pose[0, :3, :3].T + pose[0, :3, 3]).max() > schema.LARGEST:
            raise MeshError(f"{name!r} has coordinates beyond {schema.LARGEST:g}.")


def _light(one: Any, scene: ImportedScene, options: ImportingSceneFile, tell: Any) -> Light:
    pose = each_frame(scene.to_scene @ one.pose)
    light: Light = one.light
    if not (np.isfinite(pose).all() and np.isfinite(light.radiance).all()):
        raise MeshError(f"the light {one.name!r} is not finite.")
    scales = np.linalg.svd(pose[:, :3, :3], compute_uv=False)
    if not np.all(scales[:, 2] > 0.0):
        raise MeshError(f"the light {one.name!r} has a transform that leaves it no extent.")
    uneven = bool(np.any(scales[:, 0] - scales[:, 2] > _UNEVEN * scales[:, 0]))
    if isinstance(light, (DiscLight, SphereLight)) and uneven:
        tell(f"the {light.kind} light {one.name!r} is scaled unevenly; it stays round.")
    if isinstance(light, PointLight) and options.light_size is not None:
        pose = pose.copy()
        pose[:, :3, :3] = np.eye(3)  # its size is in scene units
        light = SphereLight(center=light.position, radius=0.5 * options.light_size, radiance=light.radiance)
    if isinstance(light, DirectionalLight) and light.angle_deg == 0.0 and options.light_angle_deg is not None:
        light = replace(light, angle_deg=options.light_angle_deg)
    sampled = SampledPose(pose)
    return replace(light, motion=sampled) if sampled.moving else transformed(light, pose[0])


def imported_camera(
    options: ImportingSceneFile, imported: Imported, meshes: Sequence[Mesh], place: Place
) -> tuple[CameraPath, int]:
    """The camera of a scene of ``meshes`` that imports a file, and the number of its frames.

    Raises:
        InputError: There is no such camera, or none at all, or its keys do not go together.
    """
    cameras, at = imported.scene.cameras, place.at("camera")
    keys = schema.CameraOptions()
    chosen = cameras[0] if cameras else None
    if isinstance(options.camera, dict):
        keys = at.validated(schema.CameraOptions)
    elif options.camera != "from_file":
        names = [camera.name for camera in cameras]
        if options.camera not in names:
            raise at.error(f"the file has no camera '{options.camera}'." + nearest(options.camera, names))
        chosen = cameras[names.index(options.camera)]
    placed = keys.eye is not None or keys.target is not None or options.path is not None
    if chosen is None and not placed:
        raise at.error("is required: the file has no camera.")
    lens = keys if chosen is None else _lens(chosen, keys, imported, at)
    if placed or chosen is None:
        path, frames = camera_path(lens, options.path, meshes, place)
    else:
        check_lens(lens, at)
        path, frames = _path(chosen, lens, imported, meshes), 1
    return path, max(frames, imported.scene.frames) if options.path is None else frames


def _lens(camera: ImportedCamera, keys: schema.CameraOptions, imported: Imported, at: Place) -> schema.CameraOptions:
    """The file's lens and clipping planes, with what the scene file says in place of them."""
    unit = float(np.cbrt(abs(np.linalg.det(imported.scene.to_scene[:3, :3]))))
    planes = {"near": camera.near, "far": camera.far}  # a plane at 0, as orthographic cameras may have, is none
    out: dict[str, Any] = {key: unit * value for key, value in planes.items() if value}
    given = keys.model_fields_set
    changed = "projection" in given and keys.projection != ("orthographic" if camera.fov_deg is None else "perspective")
    if camera.fov_deg is None and not changed:
        out |= {"projection": "orthographic", "height": unit * float(camera.height or 0.0)}
    elif camera.fov_deg is not None and not changed:
        out["fov_deg"] = camera.fov_deg
    try:
        return schema.CameraOptions.model_validate({**out, **{key: getattr(keys, key) for key in given}})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        message = f"{where} of the file's camera '{camera.name}' cannot be used: {first['msg'].lower()}."
        raise at.error(message) from None


def _path(camera: ImportedCamera, lens: schema.CameraOptions, imported: Imported, meshes: Sequence[Mesh]) -> CameraPath:
    """The path of a camera of the file, which may turn about its own axis."""
    pose = imported.scene.to_scene @ camera.pose
    axes = pose[:, :3, :3] / np.linalg.norm(pose[:, :3, :3], axis=1, keepdims=True)
    rows = np.concatenate([pose[:, :3, 3], pose[:, :3, 3] - axes[:, :, 2]], axis=1)
    ups = np.tile(np.array(lens.up), (len(pose), 1)) if "up" in lens.model_fields_set else axes[:, :, 1]

    def held(values: np.ndarray, frame: np.ndarray) -> np.ndarray:
        return values[np.clip(frame.astype(np.int64), 0, len(values) - 1)]

    near, far = depth_planes(meshes, rows[looked_at(len(rows)), :3], lens.near, lens.far)
    return CameraPath(lambda frame: held(rows, frame), lens, near, far, lambda frame: held(ups, frame))
