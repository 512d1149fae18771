"""The planes on which something receives, as 4-vectors (n, d) with n.x + d = 0, and how well their places are known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Mesh
from wkernels.workspace.left_out import Omission
from wkernels.workspace.workspace import Workspace

PLANAR_TOLERANCE = 1e-6
"""Of a mesh's extent: how far its vertices may lie off one plane."""
SAME_PLANE = 1e-6
"""Of the scene's extent: planes that nowhere in it lie farther apart are one."""
ON_PLANE = 2e-6
"""Of the scene's extent: what lies no higher than this lies on the plane, for float32 positions."""


@dataclass(frozen=True, eq=False)
class ReceiverPlane:
    """A plane on which something receives.

    Attributes:
        plane: float64 (4,), unit normal and offset, rebased world; the normal's side is arbitrary.
        meshes: Indices of the receiving meshes that lie on it, in the geometry's order.
    """

    plane: np.ndarray
    meshes: list[int] = field(default_factory=list)


def plane_of(vertices: np.ndarray) -> np.ndarray | None:
    """The plane through all ``vertices`` (n, 3), float64 (4,) with a unit normal; None where there is no single one."""
    vertices = np.asarray(vertices, np.float64)
    vertices = vertices[np.isfinite(vertices).all(axis=1)]
    if len(vertices) < 3:
        return None
    middle = vertices.mean(axis=0)
    _, extents, axes = np.linalg.svd(vertices - middle, full_matrices=False)
    if extents[2] > PLANAR_TOLERANCE * extents[0] or extents[1] <= PLANAR_TOLERANCE * extents[0]:
        return None
    return np.append(axes[2], -axes[2] @ middle)


def extent_of(geometry: Geometry) -> float:
    """Largest coordinate of what is around the eye, rebased world: positions are known to ``ON_PLANE`` of it."""
    box = geometry.bounds(casters=True, receivers=True, noticed=True)
    return 0.0 if box.empty else float(np.abs([box.low, box.high]).max())


def receiver_planes(geometry: Geometry, frame: int, own_planes: dict[int, np.ndarray | None]) -> list[ReceiverPlane]:
    """The planes of all flat receiving meshes at a frame; meshes on one plane share it.

    Args:
        geometry: Gives the meshes and the rebasing.
        frame: Index of the frame, for the poses.
        own_planes: Object-space planes by mesh, filled here and kept by the caller: they change only where shapes do.
    """
    extent = extent_of(geometry)
    planes: list[ReceiverPlane] = []
    known = np.empty((len(geometry.meshes), 4))  # a city has thousands, which are compared all at once
    for i, mesh in enumerate(geometry.meshes):
        if not mesh.receives:
            continue
        if i not in own_planes or mesh.deformed is not None:
            own_planes[i] = plane_of(mesh.vertices_at(frame))
        plane = _placed(own_planes[i], mesh, frame, geometry.origin_ws)
        if plane is None:
            continue
        others = known[: len(planes)]
        side = np.sign(others[:, :3] @ plane[:3])
        apart = np.abs(others - side[:, None] * plane)
        same = np.flatnonzero(apart[:, :3].sum(axis=1) * extent + apart[:, 3] <= SAME_PLANE * extent)
        if len(same):
            planes[same[0]].meshes.append(i)
        else:
            known[len(planes)] = plane
            planes.append(ReceiverPlane(plane, [i]))
    return planes


def _placed(plane: np.ndarray | None, mesh: Mesh, frame: int, origin_ws: np.ndarray) -> np.ndarray | None:
    pose = mesh.object_to_ws(frame)
    if plane is None or abs(np.linalg.det(pose[:3, :3])) < 1e-300:
        return None
    normal = np.linalg.solve(pose[:3, :3].T, plane[:3])
    offset = plane[3] - normal @ pose[:3, 3] + normal @ origin_ws
    return np.append(normal, offset) / np.linalg.norm(normal)


def pull_planes(
    work: Workspace, geometry: Geometry, frame: int, gbuffer: GBuffer, unseen: Omission, flat_none: Omission
) -> list[tuple[int, ReceiverPlane]]:
    """Numbered planes at a frame, found anew when something has moved; without those that no pixel shows.

    Args:
        work: Keeps them.
        geometry: Gives the meshes.
        frame: Index of the frame.
        gbuffer: What the eye sees.
        unseen: What is left out where no pixel shows a plane.
        flat_none: What is told where there is none at all.
    """

    def build(old: tuple | None) -> tuple:
        own_planes = old[1] if old else {}
        return receiver_planes(geometry, frame, own_planes), own_planes

    planes = work.product("receiver planes", "receiver planes", geometry.version, build)[0]
    if not planes:
        work.tell(flat_none)
    numbered = list(enumerate(planes))
    if len(numbered) > 1 and work.may_leave_out(unseen):
        mesh = gbuffer.mesh.numpy()
        shown = set(np.flatnonzero(np.bincount(mesh[mesh >= 0], minlength=1)))
        seen = [(number, plane) for number, plane in numbered if shown.intersection(plane.meshes)]
        if len(seen) < len(numbered):
            work.leave_out(unseen, count=len(numbered) - len(seen))
        numbered = seen
    return numbered


def turned_to_light(plane: np.ndarray, light_ws: np.ndarray, extent: float) -> np.ndarray | None:
    """The plane with its normal on the light's side, (4,); None where the light lies in it and M has rank 1.

    Args:
        plane: (4,), unit normal.
        light_ws: Light sample (4,).
        extent: Of the scene, which says how well positions are known.
    """
    height = float(plane @ light_ws)
    least = ON_PLANE * (extent if light_ws[3] > 0.0 else 1.0)
    return None if abs(height) <= least else plane * np.sign(height)
