"""The camera of a scene and its path: keyframes, an orbit, or a file of keyframes."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError
from scipy.interpolate import CubicHermiteSpline

from experiments.config.source import load_yaml, validate
from experiments.scenes.place import Place
from experiments.scenes.poses import check_order
from experiments.scenes.schema import CameraKeyframe, CameraOptions, Orbit, PathOptions
from experiments.scenes.sight import depth_planes
from wkernels.errors import InputError
from wkernels.scene.model import Camera, Mesh
from wkernels.scene.origin import looked_at
from wkernels.scene.views import ALONG_UP

_COLUMNS = ("frame", "eye_x", "eye_y", "eye_z", "target_x", "target_y", "target_z")


class CameraWarning(UserWarning):
    """A picture is not turned as the camera's keys say."""


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A camera at every frame.

    Attributes:
        eye_target: Maps frame numbers (n,) to eyes and targets, float64 (n, 6); holds its ends.
        options: What does not change along the path.
        near, far: Depth planes, scene units.
        ups: Maps frame numbers (n,) to vertical axes, float64 (n, 3), of a camera that rolls; None: ``options`` has it.
    """

    eye_target: Callable[[np.ndarray], np.ndarray]
    options: CameraOptions
    near: float
    far: float
    ups: Callable[[np.ndarray], np.ndarray] | None = None

    def __call__(self, frame: int) -> Camera:
        """The camera at a frame index; indices outside the path hold its ends."""
        at = np.array([frame], np.float64)
        eye_target = self.eye_target(at)[0]
        o = self.options
        up = np.array(o.up) if self.ups is None else self.ups(at)[0]
        return Camera(eye_target[:3], eye_target[3:], up, o.fov_deg, self.near, self.far, o.height)


def camera_path(
    camera: CameraOptions, path: PathOptions | None, meshes: Sequence[Mesh], place: Place
) -> tuple[CameraPath, int]:
    """The camera of a scene of ``meshes`` whose file is at ``place``, and the number of frames of its path.

    Raises:
        InputError: No eye or target, several or no paths, keyframes out of order, ``far <= near``, an eye on its
            target, an orthographic camera without height or another with one.
    """
    check_lens(camera, place.at("camera"))
    if path is None:
        if camera.eye is None or camera.target is None:
            missing = "eye" if camera.eye is None else "target"
            raise place.at("camera").error(f"{missing} is required where the scene has no path.")
        eye_target, frames = _still(camera.eye, camera.target), 1
    else:
        eye_target, frames = _path(path, place.at("path"))
    eyes_targets = eye_target(np.arange(frames, dtype=np.float64))
    distance = np.linalg.norm(eyes_targets[:, 3:] - eyes_targets[:, :3], axis=1)
    for frame in np.flatnonzero(~(distance > 0.0))[:1]:
        raise place.at("camera" if path is None else "path").error(f"the eye lies on the target at frame {frame}.")
    _tell_of_up(camera, eyes_targets, distance, place.at("camera") if path is None else place.at("path"), place)
    near, far = depth_planes(meshes, eye_target(looked_at(frames).astype(np.float64))[:, :3], camera.near, camera.far)
    return CameraPath(eye_target, camera, near, far), frames


def _tell_of_up(
    camera: CameraOptions, eyes_targets: np.ndarray, distance: np.ndarray, way: Place, place: Place
) -> None:
    """Tells of frames on which the eye looks along its vertical axis, so that it is another axis that points up."""
    up = np.asarray(camera.up) / np.linalg.norm(camera.up)
    forward = (eyes_targets[:, 3:] - eyes_targets[:, :3]) / distance[:, None]
    along = np.flatnonzero(np.linalg.norm(np.cross(forward, up), axis=1) < ALONG_UP)
    if len(along):
        where = place.at("camera", "up") if "up" in camera.model_fields_set else way
        when = f" at frame {along[0]}" if len(distance) > 1 else ""
        message = f"the eye looks along camera.up{when}; another axis of the scene is up in the picture."
        warnings.warn(CameraWarning(str(where.error(message))), stacklevel=4)


def check_lens(camera: CameraOptions, place: Place) -> None:
    """Raises InputError where the keys of the camera at ``place`` do not go together."""
    if camera.near is not None and camera.far is not None and not camera.near < camera.far:
        raise place.at("far").error(f"must be greater than near ({camera.near}), not {camera.far}.")
    orthographic = camera.projection == "orthographic"
    if orthographic and camera.height is None:
        raise place.at("height").error("is required for an orthographic camera.")
    if orthographic and "fov_deg" in camera.model_fields_set:
        raise place.at("fov_deg").error("an orthographic camera has no field of view, but a height.")
    if not orthographic and camera.height is not None:
        raise place.at("height").error("only a camera with projection: orthographic has a height.")


def _still(eye: tuple[float, ...], target: tuple[float, ...]) -> Callable[[np.ndarray], np.ndarray]:
    row = np.array([*eye, *target])
    return lambda frame: np.tile(row, (len(frame), 1))


def _path(path: PathOptions, place: Place) -> tuple[Callable[[np.ndarray], np.ndarray], int]:
    given = [key for key in ("keyframes", "orbit", "file") if getattr(path, key) is not None]
    if len(given) != 1:
        found = f"not {' and '.join(given)}" if given else "there is none"
        raise place.error(f"needs exactly one of keyframes, orbit and file, {found}.")
    if path.orbit is not None:
        if path.frames is None:
            raise place.at("frames").error("is required for an orbit.")
        return _orbit(path.orbit, path.frames), path.frames
    if path.keyframes is not None:
        keys = path.keyframes
        check_order([key.frame for key in keys], place.at("keyframes"))
    else:
        keys = _read_keyframes(str(path.file), place.at("file"))
    frames = path.frames or keys[-1].frame + 1
    if frames < 1:
        raise place.error("the last keyframe lies before frame 0.")
    return _catmull_rom(keys), frames


def _catmull_rom(keys: list[CameraKeyframe]) -> Callable[[np.ndarray], np.ndarray]:
    """Exact at the keyframes, with the slope between a key's neighbours there (Catmull and Rom 1974, uneven knots)."""
    at = np.array([key.frame for key in keys], np.float64)
    values = np.array([[*key.eye, *key.target] for key in keys])
    if len(keys) == 1:
        return _still(keys[0].eye, keys[0].target)
    before, after = np.maximum(np.arange(len(at)) - 1, 0), np.minimum(np.arange(len(at)) + 1, len(at) - 1)
    slopes = (values[after] - values[before]) / (at[after] - at[before])[:, None]
    spline = CubicHermiteSpline(at, values, slopes)
    return lambda frame: np.asarray(spline(np.clip(frame, at[0], at[-1])))


def _orbit(orbit: Orbit, frames: int) -> Callable[[np.ndarray], np.ndarray]:
    centre = np.array(orbit.center)

    def eye_target(frame: np.ndarray) -> np.ndarray:
        # The last frame is one step short of `degrees`, so that a full turn repeats without a stutter.
        turn = np.radians(orbit.start_deg + orbit.degrees * np.clip(frame, 0, frames - 1) / frames)
        height = np.full(len(frame), orbit.height)
        offset = np.stack([orbit.radius * np.sin(turn), height, orbit.radius * np.cos(turn)], axis=1)
        return np.concatenate([centre + offset, np.tile(centre, (len(frame), 1))], axis=1)

    return eye_target


def _read_keyframes(name: str, place: Place) -> list[CameraKeyframe]:
    path = place.existing_file(name)
    if path.suffix.lower() == ".json":  # JSON is YAML, and the YAML reader knows the lines
        source = load_yaml(path)
        if not isinstance(source.data, list) or not source.data:
            raise source.error("must be a list of {frame, eye, target}.")
        keys = [validate(CameraKeyframe, source, (i,)) for i in range(len(source.data))]
        check_order([key.frame for key in keys], Place(source, path.parent))
        return keys
    if path.suffix.lower() != ".csv":
        raise place.error(f"a path file must be .csv or .json, not '{path.name}'.")
    keys = []
    with path.open(newline="", encoding="utf-8-sig") as lines:
        reader = csv.reader(lines)
        try:
            for row in reader:
                if not any(cell.strip() for cell in row) or (not keys and row[0].strip() == _COLUMNS[0]):
                    continue
                keys.append(_csv_keyframe(row, str(path), reader.line_num, keys))
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read: {error}.", file=path, line=reader.line_num + 1) from None
    if not keys:
        raise InputError("has no keyframes.", file=path)
    return keys


def _csv_keyframe(row: list[str], file: str, line: int, before: list[CameraKeyframe]) -> CameraKeyframe:
    if len(row) != len(_COLUMNS):
        raise InputError(
            f"must have the {len(_COLUMNS)} columns {', '.join(_COLUMNS)}, not {len(row)}.", file=file, line=line
        )
    values = []
    for column, cell in zip(_COLUMNS, row, strict=True):
        try:
            values.append(float(cell))
        except ValueError:
            raise InputError(f"must be a number, not {cell!r}.", file=file, line=line, key=column) from None
        if not math.isfinite(values[-1]):
            raise InputError(f"must be a finite number, not {cell.strip()}.", file=file, line=line, key=column)
    if values[0] != int(values[0]):
        raise InputError(f"must be a whole number, not {row[0]!r}.", file=file, line=line, key="frame")
    if before and values[0] <= before[-1].frame:
        message = f"keyframes must come in rising order, {int(values[0])} follows {before[-1].frame}."
        raise InputError(message, file=file, line=line, key="frame")
    eye, target = (values[1], values[2], values[3]), (values[4], values[5], values[6])
    try:
        return CameraKeyframe(frame=int(values[0]), eye=eye, target=target)
    except ValidationError as error:
        raise InputError(f"a value is too large: {error.errors()[0]['msg'].lower()}.", file=file, line=line) from None
