"""What an imported file describes, whatever its format: shapes, where they stand, lights, cameras, and how all move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from experiments.scenes.importing.deformation import Deformation
from experiments.scenes.meshes.reading import MeshError
from wkernels.scene.cutouts import Mask
from wkernels.scene.lights import Light

MOST_FRAMES = 100_000
Grey = tuple[float, float, float]


@dataclass(frozen=True)
class Asked:
    """What the scene file asks of an import.

    Attributes:
        fps: Frames per second; None: as many as the file says, or 24.
        animation: Name of one of several animations; ``none`` for the rest pose; None: the first.
        tell: Takes a sentence about what was left out or taken otherwise than the file says.
    """

    fps: float | None = None
    animation: str | None = None
    tell: Callable[[str], None] = lambda _: None


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles in their own space.

    Attributes:
        vertices: float64 (V, 3), on the first frame.
        faces: int (F, 3), counter-clockwise seen from outside.
        deformation: Vertices on every frame; None where they stay.
        mask: Where it is there; None: everywhere.
    """

    vertices: np.ndarray
    faces: np.ndarray
    deformation: Deformation | None = None
    mask: Mask | None = None


@dataclass(frozen=True, eq=False)
class Instance:
    """A shape where it stands.

    Attributes:
        name: As the file has it, not unique.
        shape: Index of the shape.
        pose: Shape to file space, float64 (n, 4, 4), a matrix per frame, or n = 1.
        diffuse: Reflectance; None where the file says nothing.
    """

    name: str
    shape: int
    pose: np.ndarray
    diffuse: Grey | None = None


@dataclass(frozen=True, eq=False)
class ImportedLight:
    """A light of the file.

    Attributes:
        name: As the file has it.
        light: In its own space.
        pose: Light to file space, (n, 4, 4) as in ``Instance``.
    """

    name: str
    light: Light
    pose: np.ndarray


@dataclass(frozen=True, eq=False)
class ImportedCamera:
    """A camera that looks along its -z, its +y upwards.

    Attributes:
        name: As the file has it.
        pose: Camera to file space, (n, 4, 4) as in ``Instance``; its scale does not count.
        fov_deg: Vertical field of view; None for an orthographic camera.
        height: What an orthographic camera sees from top to bottom, file units.
        near, far: File units; None where the file has none.
    """

    name: str
    pose: np.ndarray
    fov_deg: float | None = None
    height: float | None = None
    near: float | None = None
    far: float | None = None


@dataclass
class ImportedScene:
    """All that a file brings.

    Attributes:
        shapes, instances, lights, cameras: What there is.
        to_scene: File space to scene space, float64 (4, 4): units and up axis.
        frames: Length of its animation; 1 where nothing moves.
        notes: Sentences about how it was brought in; what was left out is told while it is read.
    """

    shapes: list[Shape] = field(default_factory=list)
    instances: list[Instance] = field(default_factory=list)
    lights: list[ImportedLight] = field(default_factory=list)
    cameras: list[ImportedCamera] = field(default_factory=list)
    to_scene: np.ndarray = field(default_factory=lambda: np.eye(4))
    frames: int = 1
    notes: list[str] = field(default_factory=list)

    def add(self, shape: Shape) -> int:
        """The index of a new shape; vertices that no face uses are dropped, or they would widen its bounds."""
        used = np.unique(shape.faces)
        if len(used) < len(shape.vertices):
            deformation = shape.deformation.only(used) if shape.deformation else None
            mask = replace(shape.mask, uv=shape.mask.uv[used]) if shape.mask else None
            shape = Shape(shape.vertices[used], np.searchsorted(used, shape.faces), deformation, mask)
        self.shapes.append(shape)
        return len(self.shapes) - 1


def frame_count(seconds: float, fps: float) -> int:
    """Frames of an animation, its end included; raises MeshError where they are too many to hold."""
    count = seconds * fps
    if not count < MOST_FRAMES:
        raise MeshError(f"its animation of {seconds:g} s has more than {MOST_FRAMES} frames at {fps:g} per second.")
    return int(np.floor(count + 1e-6)) + 1


def each_frame(pose: np.ndarray) -> np.ndarray:
    """A pose as (n, 4, 4); (1, 4, 4) where no frame differs from the first."""
    pose = np.asarray(pose, np.float64).reshape(-1, 4, 4)
    return pose[:1] if len(pose) > 1 and np.array_equal(pose, np.broadcast_to(pose[:1], pose.shape)) else pose


def rigid(pose: np.ndarray) -> np.ndarray:
    """Poses (n, 4, 4) whose scale and shear are taken out: -z keeps its direction, +y as nearly as it can.

    Raises:
        MeshError: An axis has no length.
    """
    back, up = pose[:, :3, 2], pose[:, :3, 1]
    lengths = np.linalg.norm(back, axis=1)
    right = np.cross(up, back)
    across = np.linalg.norm(right, axis=1)
    if not (np.all(lengths > 0.0) and np.all(across > 0.0)):
        raise MeshError("a light or a camera has a transform that leaves it no direction.")
    out = np.tile(np.eye(4), (len(pose), 1, 1))
    out[:, :3, 2] = back / lengths[:, None]
    out[:, :3, 0] = right / across[:, None]
    out[:, :3, 1] = np.cross(out[:, :3, 2], out[:, :3, 0])
    out[:, :3, 3] = pose[:, :3, 3]
    return out
