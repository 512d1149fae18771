"""Ellipsoids round casters, and the soft blob that one throws along the way to the light: no real shadow at all.

A blob is the caster's bounding ellipsoid, of the shape of its vertices' second moments. What counts is how near the
line from the receiver to the light passes to its centre, in units of the ellipsoid: 1 where it grazes it. That is the
projected ellipse on any receiver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.scene.model import Mesh

THINNEST = 1e-3
"""Of the longest axis: how thin an ellipsoid may be, so that flat casters have one."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Points x with |to_unit (x - centre)| <= 1; float64, object space or rebased world.

    Attributes:
        centre: (3,).
        to_unit: (3, 3).
        axes: Half axes as columns, (3, 3): the inverse of ``to_unit``.
    """

    centre: np.ndarray
    to_unit: np.ndarray
    axes: np.ndarray

    @property
    def size(self) -> float:
        """Longest diameter, scene units."""
        return 2.0 * float(np.linalg.svd(self.axes, compute_uv=False)[0])


def bounding_ellipsoid(vertices: np.ndarray) -> Ellipsoid | None:
    """The ellipsoid of the vertices' covariance, scaled until it holds them all; None of no points, or of one.

    Args:
        vertices: (n, 3); those that are not finite do not count.
    """
    vertices = np.unique(np.asarray(vertices, np.float64), axis=0)
    vertices = vertices[np.isfinite(vertices).all(axis=1)]
    if len(vertices) < 2:
        return None
    centre = vertices.mean(axis=0)
    # three rows at least, so that there are three directions; full matrices would have a side of n
    rows = np.concatenate([vertices - centre, np.zeros((max(0, 3 - len(vertices)), 3))])
    _, spread, directions = np.linalg.svd(rows, full_matrices=False)
    spread = spread / np.sqrt(len(vertices))
    spread = np.maximum(spread, THINNEST * spread[0])
    reach = np.linalg.norm((vertices - centre) @ directions.T / spread, axis=1).max()
    axes = directions.T * (spread * reach)
    return Ellipsoid(centre, np.linalg.inv(axes), axes)


def placed_ellipsoid(own: Ellipsoid | None, mesh: Mesh, frame: int, origin_ws: np.ndarray) -> Ellipsoid | None:
    """An object-space ellipsoid at a mesh's pose, rebased; None where the pose leaves no volume."""
    pose = mesh.object_to_ws(frame)
    if own is None or abs(np.linalg.det(pose[:3, :3])) < 1e-300:
        return None
    axes = pose[:3, :3] @ own.axes
    return Ellipsoid(pose[:3, :3] @ own.centre + pose[:3, 3] - origin_ws, np.linalg.inv(axes), axes)


@wp.struct
class Blob:
    """A caster's ellipsoid on the device."""

    centre_ws: wp.vec3
    to_unit: wp.mat33
    size: float  # longest diameter, scene units
    mesh: int  # which gets no blob of its own


@wp.func
def distance_to_blob(blob: Blob, position_ws: wp.vec3, way: wp.vec3):
    """How the line through ``position_ws`` along ``way`` passes a blob.

    Returns:
        Least distance from its centre, in units of the ellipsoid, and where on the line that is, in units of ``way``.
    """
    offset = blob.to_unit * (blob.centre_ws - position_ws)
    along = blob.to_unit * way
    at = wp.dot(offset, along) / wp.max(wp.dot(along, along), 1.0e-30)
    return wp.vec2(wp.length(offset - along * at), at)
