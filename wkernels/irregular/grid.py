"""Light grids: homogeneous light coordinates of points, and the cells that receivers are sorted into.

A face of a light has coordinates in which the light's rays are straight and parallel: ``u``, ``v`` across and the
height ``h``, which grows towards the light. For a direction they are lengths along the face's axes (h is the negative
depth), for a point u = x / z, v = y / z and h = 1 / z. Planes stay planes in (u, v, h), so whether a triangle hides a
point is a matter of four linear functions. Before the division a point is (x, y, w, h w), which is finite behind the
light too.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.scene.views import HostView

ROUNDING = wp.constant(wp.float64(2.0e-7))  # of a float32 coordinate, and of what is added up from a few of them
TINY = wp.constant(wp.float64(1.0e-300))


@wp.struct
class LightFace:
    """One view of the light and the square grid of cells laid over the receivers in it."""

    origin_ws: wp.vec3d  # the light, or any point for a direction
    right_ws: wp.vec3d
    up_ws: wp.vec3d
    forward_ws: wp.vec3d
    perspective: int
    left: float  # u of the grid's border
    low: float  # v
    columns_per_u: float
    rows_per_v: float
    resolution: int  # cells per side
    first_row: int  # the face's first row, of all faces' rows
    across_error: wp.float64  # what rounding may have moved a receiver's u and v by
    highest: wp.float64  # largest |h| of a receiver
    margin: int  # cells / 256 that boxes are widened by, so that they hold every receiver that the triangle may hide


@wp.func
def to_face(face: LightFace, position_ws: wp.vec3):
    """(x, y, w, h w) of a point; w > 0 in front of the light."""
    way = wp.vec3d(position_ws) - face.origin_ws
    x = wp.dot(face.right_ws, way)
    y = wp.dot(face.up_ws, way)
    z = wp.dot(face.forward_ws, way)
    result = wp.vec4d(x, y, wp.float64(1.0), -z)
    if face.perspective != 0:
        result = wp.vec4d(x, y, z, wp.float64(1.0))
    return result


@wp.func
def row_of(face: LightFace, v: float):
    """Row of cells of a receiver, within its face."""
    return wp.clamp(int((v - face.low) * face.rows_per_v), 0, face.resolution - 1)


@wp.func
def column_of(face: LightFace, u: float):
    """Column of a receiver."""
    return wp.clamp(int((u - face.left) * face.columns_per_u), 0, face.resolution - 1)


def light_faces(views: list[HostView], light_ws: np.ndarray, resolution: int) -> list[LightFace]:
    """Faces without a grid, along the axes of some views from a light sample (4,)."""
    faces = []
    for k, view in enumerate(views):
        face = LightFace()
        # the light where float32 has it, which is where rays are cast to
        origin = np.float32(light_ws[:3]).astype(float) if view.perspective else np.zeros(3)
        right, up, forward = view.right_ws, view.up_ws, view.forward_ws
        if not view.perspective:
            forward = -np.float32(light_ws[:3]).astype(float)
            forward /= np.linalg.norm(forward)
            right = right - (right @ forward) * forward
            right /= np.linalg.norm(right)
            up = np.cross(right, forward)
        face.origin_ws, face.right_ws = wp.vec3d(*origin), wp.vec3d(*right)
        face.up_ws, face.forward_ws = wp.vec3d(*up), wp.vec3d(*forward)
        face.perspective, face.resolution, face.first_row = int(view.perspective), resolution, k * resolution
        faces.append(face)
    return faces


def fit_grid(face: LightFace, bounds: np.ndarray) -> None:
    """Lays a face's grid over its receivers.

    Args:
        face: Changed.
        bounds: (least u, least v, least h, largest u, largest v, largest h) of the receivers; there must be some.
    """
    low, high = bounds[:3].astype(float), bounds[3:].astype(float)
    furthest = max(float(np.abs(bounds[[0, 1, 3, 4]]).max()), 1e-30)
    size = np.maximum(high - low, 1e-5 * furthest)
    face.left, face.low = float(np.float32(low[0])), float(np.float32(low[1]))
    face.columns_per_u, face.rows_per_v = face.resolution / size[0], face.resolution / size[1]
    error = float(ROUNDING) * furthest
    face.across_error, face.highest = error, max(abs(low[2]), abs(high[2]))
    # a receiver's rounding, and that of its own column and row, which are found in float32
    steps = 256.0 * (2.0 * error * max(face.columns_per_u, face.rows_per_v) + 4e-7 * face.resolution)
    face.margin = 2 + int(np.ceil(min(steps, 256.0 * face.resolution)))
