"""Where meshes are: static transforms and keyframed motion, as float64 matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from experiments.scenes.place import Place
from experiments.scenes.schema import Motion, Transform


def matrix(transform: Transform) -> np.ndarray:
    """Object to parent space, float64 (4, 4): scale, rotate about the fixed axes x, y, z in this order, translate."""
    if not any(transform.rotate_deg):  # of most meshes, where there are thousands
        return _compose(np.array(transform.translate), np.eye(3), np.array(transform.scale))
    rotation = Rotation.from_euler("xyz", transform.rotate_deg, degrees=True).as_matrix()
    return _compose(np.array(transform.translate), rotation, np.array(transform.scale))


def _compose(translate: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = rotation * scale
    out[:3, 3] = translate
    return out


@runtime_checkable
class Moving(Protocol):
    """What changes from frame to frame in a way that arrays determine."""

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        """Arrays that determine it at every frame."""


@dataclass(frozen=True, eq=False)
class StaticPose:
    """The same matrix (4, 4) at every frame."""

    object_to_ws: np.ndarray

    def __call__(self, frame: int) -> np.ndarray:
        """Object to world space, float64 (4, 4)."""
        return self.object_to_ws.copy()


HALF_TURN_DEG = 180.0
"""Between keyframes that are less apart about every axis the shorter way round is the one that they name."""


class KeyframedPose:
    """A motion applied to a mesh that is already placed by its static transform.

    Between two keyframes that differ by less than half a turn about every axis it turns the shorter way round;
    else each angle goes from the one to the other, so that 0 to 360 is one turn and 0 to -270 three quarters of
    one, backwards.
    """

    def __init__(self, motion: Motion, object_to_parent: np.ndarray) -> None:
        keys = motion.keyframes
        self.frames = np.array([key.frame for key in keys], np.float64)
        self.object_to_parent = object_to_parent
        self._translate = np.array([key.translate for key in keys])
        self._scale = np.array([key.scale for key in keys])
        self._angles = np.array([key.rotate_deg for key in keys], np.float64)
        self._rotations = Rotation.from_euler("xyz", self._angles, degrees=True)
        self._slerp = Slerp(self.frames, self._rotations) if len(keys) > 1 else None
        self._turns = np.abs(np.diff(self._angles, axis=0)).max(axis=1) >= HALF_TURN_DEG  # by interval

    def __call__(self, frame: int) -> np.ndarray:
        """Object to world space, float64 (4, 4); the first and last keyframe are held outside their range."""
        at = float(np.clip(frame, self.frames[0], self.frames[-1]))
        rotation = self._rotation(at)
        translate = [np.interp(at, self.frames, self._translate[:, axis]) for axis in range(3)]
        scale = [np.interp(at, self.frames, self._scale[:, axis]) for axis in range(3)]
        return _compose(np.array(translate), rotation.as_matrix(), np.array(scale)) @ self.object_to_parent

    def _rotation(self, at: float) -> Rotation:
        if self._slerp is None:
            return self._rotations[0]
        interval = min(int(np.searchsorted(self.frames, at, side="right")) - 1, len(self._turns) - 1)
        if not self._turns[interval]:
            return self._slerp(at)
        angles = [np.interp(at, self.frames, self._angles[:, axis]) for axis in range(3)]
        return Rotation.from_euler("xyz", angles, degrees=True)

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        """Arrays that determine the pose at every frame."""
        turns = (self._angles,) if self._turns.any() else ()  # matrices do not tell 0 from 360 degrees
        return self.frames, self.object_to_parent, self._translate, self._scale, self._rotations.as_matrix(), *turns

    @property
    def moving(self) -> bool:
        """Whether any frame differs from the first."""
        first = self(int(self.frames[0]))
        ends = any(not np.array_equal(first, self(int(frame))) for frame in self.frames[1:])
        return ends or bool(self._turns.any())


@dataclass(frozen=True, eq=False)
class SampledPose:
    """A matrix for every frame, float64 (n, 4, 4)."""

    matrices: np.ndarray

    def __call__(self, frame: int) -> np.ndarray:
        """Object to world space, float64 (4, 4); the first and last frame are held outside their range."""
        return self.matrices[min(max(int(frame), 0), len(self.matrices) - 1)].copy()

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        """Arrays that determine the pose at every frame."""
        return (self.matrices,)

    @property
    def moving(self) -> bool:
        """Whether any matrix differs from the first."""
        return bool(np.any(self.matrices != self.matrices[0]))


def pose(transform: Transform, motion: Motion | None, place: Place) -> StaticPose | KeyframedPose:
    """The pose that a mesh at ``place`` asks for; raises InputError where keyframes are out of order."""
    if motion is None:
        return StaticPose(matrix(transform))
    check_order([key.frame for key in motion.keyframes], place.at("motion", "keyframes"))
    return KeyframedPose(motion, matrix(transform))


def check_order(frames: list[int], place: Place) -> None:
    """Raises InputError at the first keyframe whose frame does not lie after the one before."""
    for i in range(1, len(frames)):
        if frames[i] <= frames[i - 1]:
            raise place.at(i, "frame").error(
                f"keyframes must come in rising order, {frames[i]} follows {frames[i - 1]}."
            )
