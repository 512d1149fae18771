"""How meshes moved since an earlier frame, so that a point of a moving surface can be followed back to where it was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry

NOWHERE = 1e15
"""Scene units; beyond every coordinate of a scene, and squares of it are finite in float32."""


@dataclass
class MeshMotion:
    """Matrices of every mesh, in the order of the G-buffer's ``mesh``.

    Attributes:
        points: mat44 (M,), rebased world of this frame to that of the earlier one.
        normals: mat33 (M,), the same for normals, which do not stay of unit length.
    """

    points: wp.array
    normals: wp.array


def mesh_motion(geometry: Geometry, now: int, then: int) -> tuple[np.ndarray, np.ndarray]:
    """``MeshMotion`` on the host, float64 (M, 4, 4) and (M, 3, 3).

    Meshes that were or are flat stay where they are. No matrix follows a mesh that changed its shape: its points are
    sent where nothing is seen, so that they have no history.
    """
    points = np.tile(np.eye(4), (len(geometry.meshes), 1, 1))
    to_world, to_rebased = np.eye(4), np.eye(4)
    to_world[:3, 3], to_rebased[:3, 3] = geometry.origin_ws, -geometry.origin_ws
    for i, mesh in enumerate(geometry.meshes):
        if mesh.deformed is not None and not np.array_equal(mesh.vertices_at(now), mesh.vertices_at(then)):
            points[i, :3, 3] = NOWHERE
        elif mesh.moving:
            poses = mesh.object_to_ws(now), mesh.object_to_ws(then)
            if all(np.linalg.matrix_rank(pose[:3, :3]) == 3 for pose in poses):
                points[i] = to_rebased @ poses[1] @ np.linalg.inv(poses[0]) @ to_world
    return points, np.linalg.inv(points[:, :3, :3]).transpose(0, 2, 1)


def pull_mesh_motion(frame: Session, then: int) -> MeshMotion:
    """Motion since frame ``then`` as a product of the frame."""

    def build(old: MeshMotion | None) -> MeshMotion:
        points, normals = mesh_motion(frame.geometry, frame.index, then)
        points, normals = points.astype(np.float32), normals.astype(np.float32)
        if old is None:
            return MeshMotion(
                wp.array(points, dtype=wp.mat44, device=frame.device),
                wp.array(normals, dtype=wp.mat33, device=frame.device),
            )
        old.points.assign(points)
        old.normals.assign(normals)
        return old

    out: MeshMotion = frame.product("mesh motion", "mesh motion", (frame.index, then), build)
    return out
