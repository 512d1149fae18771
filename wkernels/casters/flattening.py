"""Casters flattened onto planes, as seen from a light: the matrix M = (P.l) I - l P^T (Blinn 1988).

A plane is P = (n, d) with n.x + d = 0, a light sample l a point (w = 1) or a direction (w = 0), as everywhere. With the
height h = P.x above the plane, towards the light, M x / w is x - (l - x w) h / (P.l - h w). Points on the plane stay;
those at the light's height go to infinity, and those above it come out on the other side ("anti-shadows"). Only what
lies between plane and light is flattened: triangles that stick out are cut first.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from wkernels.raster import Rasteriser
from wkernels.raster.scratch import Scratch
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Mesh
from wkernels.scene.views import View

PLANAR_TOLERANCE = 1e-6
"""Of a mesh's extent: how far its vertices may lie off one plane."""
SAME_PLANE = 1e-6
"""Of the scene's extent: planes that nowhere in it lie farther apart are one."""
ON_PLANE = 2e-6
"""Of the scene's extent: what lies no higher than this lies on the plane, for float32 positions."""
BELOW_LIGHT = 1.0 - 1e-4
"""Of the light's height: what is higher is cut off. Its shadow would lie 10^4 times as far away as it is high."""
PIECES = wp.constant(3)  # triangles of a triangle cut to a slab


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


def receiver_planes(geometry: Geometry, frame: int, own_planes: dict[int, np.ndarray | None]) -> list[ReceiverPlane]:
    """The planes of all flat receiving meshes at a frame; meshes on one plane share it.

    Args:
        geometry: Gives the meshes and the rebasing.
        frame: Index of the frame, for the poses.
        own_planes: Object-space planes by mesh, filled here and kept by the caller: they change only where shapes do.
    """
    box = geometry.bounds(casters=True, receivers=True)
    extent = 0.0 if box.empty else float(np.abs([box.low, box.high]).max())
    planes: list[ReceiverPlane] = []
    for i, mesh in enumerate(geometry.meshes):
        if not mesh.receives:
            continue
        if i not in own_planes or mesh.deformed is not None:
            own_planes[i] = plane_of(mesh.vertices_at(frame))
        plane = _placed(own_planes[i], mesh, frame, geometry.origin_ws)
        if plane is None:
            continue
        for known in planes:
            side = np.sign(known.plane[:3] @ plane[:3])
            apart = np.abs(known.plane - side * plane)
            if apart[:3].sum() * extent + apart[3] <= SAME_PLANE * extent:
                known.meshes.append(i)
                break
        else:
            planes.append(ReceiverPlane(plane, [i]))
    return planes


def _placed(plane: np.ndarray | None, mesh: Mesh, frame: int, origin_ws: np.ndarray) -> np.ndarray | None:
    pose = mesh.object_to_ws(frame)
    if plane is None or abs(np.linalg.det(pose[:3, :3])) < 1e-300:
        return None
    normal = np.linalg.solve(pose[:3, :3].T, plane[:3])
    offset = plane[3] - normal @ pose[:3, 3] + normal @ origin_ws
    return np.append(normal, offset) / np.linalg.norm(normal)


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


@wp.func
def height_above(plane: wp.vec4, position_ws: wp.vec3):
    """Signed distance of a point from a plane."""
    return plane[0] * position_ws[0] + plane[1] * position_ws[1] + plane[2] * position_ws[2] + plane[3]


@wp.func
def flatten_point(plane: wp.vec4, light_ws: wp.vec4, position_ws: wp.vec3):
    """Where the line from the light through a point meets the plane: M x / w. The point is below the light's height."""
    height = height_above(plane, position_ws)
    fall = wp.dot(plane, light_ws) - height * light_ws[3]
    way = wp.vec3(light_ws[0], light_ws[1], light_ws[2]) - position_ws * light_ws[3]
    return position_ws - way * (height / fall)


@wp.func
def point_at_height(low_ws: wp.vec3, high_ws: wp.vec3, low: float, high: float, wanted: float):
    """The point of an edge, given from its lower end to its higher one, at a height; between its ends."""
    share = wp.clamp((wanted - low) / wp.max(high - low, 1.0e-30), 0.0, 1.0)
    return low_ws + (high_ws - low_ws) * share


@wp.kernel
def flatten_vertices(
    first: int, points_ws: wp.array(dtype=wp.vec3), plane: wp.vec4, light_ws: wp.vec4, flat_out: wp.array(dtype=wp.vec3)
):
    """``flatten_point`` of each vertex; of use only where a triangle is flattened whole."""
    i = first + wp.tid()
    flat_out[i] = flatten_point(plane, light_ws, points_ws[i])


@wp.kernel
def sort_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    plane: wp.vec4,
    low: float,
    high: float,
    cut_out: wp.array(dtype=wp.uint8),
    indices_out: wp.array(dtype=int),
):
    """Keeps triangles between the heights ``-low`` and ``high``, marks those to be cut, drops the others.

    A triangle no higher than ``low`` lies on the plane or behind it: it casts no shadow there, or the plane itself, if
    it casts, would lie in its own. Dropped and cut ones get three times the same index.
    """
    t = first + wp.tid()
    i = indices[3 * t]
    j = indices[3 * t + 1]
    k = indices[3 * t + 2]
    a = height_above(plane, points_ws[i])
    b = height_above(plane, points_ws[j])
    c = height_above(plane, points_ws[k])
    bottom = wp.min(a, wp.min(b, c))
    top = wp.max(a, wp.max(b, c))
    cut = wp.uint8(0)
    # written so that NaN drops the triangle
    if top > low and bottom < high:
        if not (bottom >= -low and top <= high):
            cut = wp.uint8(1)
    else:
        top = low
    if cut != wp.uint8(0) or not (top > low):
        j = i
        k = i
    cut_out[t] = cut
    indices_out[3 * t] = i
    indices_out[3 * t + 1] = j
    indices_out[3 * t + 2] = k


@wp.kernel
def cut_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    which: wp.array(dtype=int),
    plane: wp.vec4,
    light_ws: wp.vec4,
    high: float,
    first_point: int,
    first_index: int,
    flat_out: wp.array(dtype=wp.vec3),
    indices_out: wp.array(dtype=int),
):
    """The part of each triangle between plane and ``high``, flattened: a pentagon, which may be degenerate, as a fan.

    Its corners lie on the edge from the lowest vertex to the highest and on the way between them over the third one.
    """
    slot = first + wp.tid()
    t = which[slot]
    a = points_ws[indices[3 * t]]
    b = points_ws[indices[3 * t + 1]]
    c = points_ws[indices[3 * t + 2]]
    h_a = height_above(plane, a)
    h_b = height_above(plane, b)
    h_c = height_above(plane, c)
    if h_a > h_b:
        swapped = a
        a = b
        b = swapped
        height = h_a
        h_a = h_b
        h_b = height
    if h_b > h_c:
        swapped = b
        b = c
        c = swapped
        height = h_b
        h_b = h_c
        h_c = height
    if h_a > h_b:
        swapped = a
        a = b
        b = swapped
        height = h_a
        h_a = h_b
        h_b = height
    lowest = wp.max(h_a, 0.0)
    highest = wp.min(h_c, high)
    middle = wp.clamp(h_b, lowest, highest)
    at = first_point + 5 * slot
    for i in range(5):
        height = lowest
        if i == 2:
            height = middle
        if i > 2:
            height = highest
        if i == 2 and middle == h_b:
            point = b  # of two vertices at one height the search by height would find only the first
        elif i == 0 or i == 4:
            point = point_at_height(a, c, h_a, h_c, height)
        elif height <= h_b:
            point = point_at_height(a, b, h_a, h_b, height)
        else:
            point = point_at_height(b, c, h_b, h_c, height)
        flat_out[at + i] = flatten_point(plane, light_ws, point)
    for piece in range(PIECES):
        to = first_index + 3 * (PIECES * slot + piece)
        indices_out[to] = at
        indices_out[to + 1] = at + piece + 1
        indices_out[to + 2] = at + piece + 2


class Flattener:
    """Draws flattened casters into an eye's view; keeps its memory between calls.

    Args:
        device: Warp device.
        threads: CPU threads; None for all.
    """

    def __init__(self, device: str, threads: int | None) -> None:
        self._scratch = Scratch(device, threads)
        self._rasteriser = Rasteriser(device, threads)

    def draw(
        self,
        geometry: Geometry,
        plane: np.ndarray,
        light_ws: np.ndarray,
        extent: float,
        view: View,
        depth_out: wp.array,
    ) -> int:
        """Draws the shadow that all casters throw on a whole plane.

        Args:
            geometry: The casters.
            plane: Of ``turned_to_light``, float64 (4,).
            light_ws: Light sample, float64 (4,), rebased world.
            extent: Largest coordinate of the scene: positions are known to ``ON_PLANE`` of it.
            view: The eye's.
            depth_out: float32 (H, W): finite where the plane, seen there, lies in shadow.

        Returns:
            Triangles that had to be cut.
        """
        scratch, count, vertices = self._scratch, geometry.caster_triangles, len(geometry.points_ws)
        points, indices = geometry.points_ws, geometry.caster_indices
        on_device, light = wp.vec4(*plane), wp.vec4(*light_ws)
        high = BELOW_LIGHT * float(plane @ light_ws) if light_ws[3] > 0.0 else float("inf")
        cut = scratch.array("cut", (count,), wp.uint8)
        kept = scratch.array("kept", (3 * count,), int)
        inputs = [points, indices, on_device, ON_PLANE * extent, high]
        scratch.launch(sort_triangles, count, inputs, [cut, kept])
        which = np.flatnonzero(cut.numpy()[:count]).astype(np.int32)
        flat = scratch.array("flat", (vertices + 5 * len(which),), wp.vec3)
        drawn = kept[:]  # a new array, as the rasteriser knows the triangles of one that it has seen
        scratch.launch(flatten_vertices, vertices, [points, on_device, light], [flat])
        if len(which):
            drawn = scratch.array("drawn", (3 * count + 3 * int(PIECES) * len(which),), int)
            wp.copy(drawn, kept, count=3 * count)
            slots = wp.array(which, dtype=int, device=scratch.device)
            inputs = [points, indices, slots, on_device, light, high, vertices, 3 * count]
            scratch.launch(cut_triangles, len(which), inputs, [flat, drawn])
        self._rasteriser.draw(flat, drawn, view, depth_out)
        return len(which)
