"""Plain host data of a scene: what a scene file becomes and what a frame is rendered from, on no device yet."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from wkernels.scene.cutouts import Mask
from wkernels.scene.light_motion import light_at
from wkernels.scene.lights import Light


@dataclass(frozen=True, eq=False)
class Mesh:
    """One triangle mesh.

    Attributes:
        name: Unique within the scene.
        vertices: Object-space positions, float64, shape (V, 3), scene units.
        faces: Vertex indices, int32, shape (F, 3), counter-clockwise seen from outside.
        diffuse: Reflectance, 3 values in [0, 1].
        casts: Whether the mesh blocks light.
        receives: Whether visibility is computed on the mesh.
        object_to_ws: Pose at a frame, float64 (4, 4).
        moving: Whether the pose or the shape differs between frames.
        deformed: Object-space positions at a frame, float64 (V, 3), of a mesh that changes its shape; ``vertices`` are
            those of frame 0. None: it keeps its shape.
        mask: Where the mesh is there; None: everywhere.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    diffuse: tuple[float, float, float] = (0.8, 0.8, 0.8)
    casts: bool = True
    receives: bool = True
    object_to_ws: Callable[[int], np.ndarray] = lambda frame: np.eye(4)
    moving: bool = False
    deformed: Callable[[int], np.ndarray] | None = None
    mask: Mask | None = None

    def vertices_at(self, frame: int) -> np.ndarray:
        """Object-space positions at a frame, shape (V, 3)."""
        return self.vertices if self.deformed is None else self.deformed(frame)


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera in world space, ``0 < near < far`` in scene units.

    A pinhole whose vertical field of view is ``fov_deg``; or orthographic, where ``height`` says what it sees from top
    to bottom, scene units.
    """

    eye: np.ndarray
    target: np.ndarray
    up: np.ndarray
    fov_deg: float
    near: float
    far: float
    height: float | None = None

    @property
    def key(self) -> Hashable:
        """All of it, comparable."""
        numbers = [*self.eye, *self.target, *self.up, self.fov_deg, self.near, self.far, self.height or 0.0]
        return tuple(float(x) for x in numbers)


@dataclass(frozen=True, eq=False)
class Scene:
    """Meshes, lights and a camera path.

    Attributes:
        name: File stem or generator name.
        meshes: All meshes, in file order.
        lights: All lights, in file order, each as it is without its motion.
        camera: Camera at a frame index (any int; indices outside the path hold its ends).
        frames: Length of the path; 1 where the scene has none.
        content_hash: Hex digest over everything that changes pixels; the key of cached references.
        notes: Sentences for people about how the scene was read: what an imported file brought, what was left out.
    """

    name: str
    meshes: tuple[Mesh, ...]
    lights: tuple[Light, ...]
    camera: Callable[[int], Camera]
    frames: int = 1
    content_hash: str = ""
    notes: tuple[str, ...] = ()

    @property
    def cut_caster(self) -> Mesh | None:
        """The first mesh that casts and is cut out by a texture, so that its triangles do not say where it is."""
        return next((mesh for mesh in self.meshes if mesh.casts and mesh.mask is not None), None)

    def light(self, index: int, frame: int) -> Light:
        """A light where it is at a frame."""
        return light_at(self.lights[index], frame)
