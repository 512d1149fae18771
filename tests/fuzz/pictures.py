"""Whether a scene and its pictures hold numbers only, and whether an empty picture says why."""

from __future__ import annotations

import numpy as np
from isolation import Fault

from experiments.scenes.schema import LARGEST
from experiments.scenes.sight import why_nothing_is_seen
from wkernels.scene.model import Scene

WIDTH, HEIGHT = 16, 9
_ROUNDING = 1e-4  # visibilities are sums of a few hundred float32 terms


def check_triangles(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raises Fault unless vertices (V, 3) are finite and within a scene's limits, and faces (F, 3) use them."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise Fault(f"triangles of the shapes {vertices.shape} and {faces.shape}")
    if faces.dtype.kind != "i" or faces.min() < 0 or faces.max() >= len(vertices):
        raise Fault("a face uses a vertex that is not there")
    used = vertices[np.unique(faces)]
    if not np.isfinite(used).all() or np.abs(used).max() > LARGEST:
        raise Fault("a vertex that is drawn is not finite, or out of bounds")


def check_scene(scene: Scene) -> None:
    """Raises Fault unless everything in a scene is finite on its first and its last frame."""
    for frame in {0, scene.frames - 1}:
        camera = scene.camera(frame)
        numbers = [camera.eye, camera.target, camera.up, camera.near, camera.far, camera.fov_deg]
        if not all(np.isfinite(value).all() for value in numbers):
            raise Fault(f"the camera is not finite on frame {frame}")
        for mesh in scene.meshes:
            if not np.isfinite(mesh.object_to_ws(frame)).all():
                raise Fault(f"the pose of a mesh is not finite on frame {frame}")
            if not len(mesh.faces):
                continue
            if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
                raise Fault("a face uses a vertex that is not there")
            if not np.isfinite(mesh.vertices_at(frame)[np.unique(mesh.faces)]).all():
                raise Fault(f"a vertex that is drawn is not finite on frame {frame}")
        for index in range(len(scene.lights)):
            light = scene.light(index, frame)
            if not all(np.isfinite(value).all() for value in vars(light).values() if isinstance(value, np.ndarray)):
                raise Fault(f"a light is not finite on frame {frame}")


def check_picture(visibility: np.ndarray, receivers: np.ndarray) -> None:
    """Raises Fault unless visibility is a number from 0 to 1 where a receiver (bool (H, W)) is seen, and NaN elsewhere."""
    seen = np.isfinite(visibility)
    if not np.array_equal(seen, receivers):
        raise Fault(
            f"{np.count_nonzero(seen != receivers)} pixels are numbers without a receiver, or receivers without"
        )
    if seen.any() and not (visibility[seen].min() >= -_ROUNDING and visibility[seen].max() <= 1.0 + _ROUNDING):
        raise Fault(f"visibility runs from {visibility[seen].min()} to {visibility[seen].max()}")


def check_empty(scene: Scene, frame: int, visibility: np.ndarray) -> None:
    """Raises Fault where a picture shows nothing and nobody can say why."""
    if not np.isfinite(visibility).any() and not why_nothing_is_seen(scene, frame, *visibility.shape[::-1]):
        raise Fault("nothing is seen, without a word")
