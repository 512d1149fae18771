"""Casters flattened onto planes, as seen from a light: the matrix M = (P.l) I - l P^T (Blinn 1988).

A plane is P = (n, d) with n.x + d = 0, a light sample l a point (w = 1) or a direction (w = 0), as everywhere. With the
height h = P.x above the plane, towards the light, M x / w is x - (l - x w) h / (P.l - h w). Points on the plane stay;
those at the light's height go to infinity, and those above it come out on the other side ("anti-shadows"). Only what
lies between plane and light is flattened: triangles that stick out are cut first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.casters.clearance import Clearance
from wkernels.casters.receiver_planes import ON_PLANE
from wkernels.raster import Rasteriser
from wkernels.raster.scratch import Scratch
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import View

BELOW_LIGHT = 1e-4
"""Of the light's height: what is closer below it is cut off. Its shadow would lie 10^4 times as far from the light's
foot as it does itself."""
LEAST_BELOW_LIGHT = 1e-9
"""The same where a caster comes so close to the light that its shadow would end before the receivers do."""
PIECES = wp.constant(3)  # triangles of a triangle cut to a slab


@wp.func
def height_above(plane: Any, position_ws: Any):
    """Signed distance of a point from a plane."""
    return plane[0] * position_ws[0] + plane[1] * position_ws[1] + plane[2] * position_ws[2] + plane[3]


@wp.func
def in_precision_of(plane: wp.vec4, position_ws: wp.vec3):
    """A position as the plane's numbers are kept."""
    return position_ws


@wp.func  # type: ignore[no-redef]
def in_precision_of(plane: wp.vec4d, position_ws: wp.vec3):
    """A position as the plane's numbers are kept: float64."""
    return wp.vec3d(position_ws)


@wp.func
def place_of(sample: wp.vec4):
    """A light sample without its w."""
    return wp.vec3(sample[0], sample[1], sample[2])


@wp.func  # type: ignore[no-redef]
def place_of(sample: wp.vec4d):
    """The same in float64."""
    return wp.vec3d(sample[0], sample[1], sample[2])


@wp.func
def flatten_point(plane: Any, light_ws: Any, position_ws: Any):
    """Where the line from the light through a point meets the plane: M x / w. The point is below the light's height."""
    height = height_above(plane, position_ws)
    fall = wp.dot(plane, light_ws) - height * light_ws[3]
    way = place_of(light_ws) - position_ws * light_ws[3]
    return position_ws - way * (height / fall)


@wp.func
def point_at_height(low_ws: Any, high_ws: Any, low: Any, high: Any, wanted: Any):
    """The point of an edge, given from its lower end to its higher one, at a height; between its ends."""
    rise = wp.max(high - low, type(low)(1.0e-30))
    share = wp.clamp((wanted - low) / rise, type(low)(0.0), type(low)(1.0))
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
    plane: Any,
    light_ws: Any,
    high: Any,
    first_point: int,
    first_index: int,
    flat_out: wp.array(dtype=wp.vec3),
    indices_out: wp.array(dtype=int),
):
    """The part of each triangle between plane and ``high``, flattened: a pentagon, which may be degenerate, as a fan.

    In float64 where ``high`` is closer to the light than float32 can tell.

    Its corners lie on the edge from the lowest vertex to the highest and on the way between them over the third one.
    """
    slot = first + wp.tid()
    t = which[slot]
    a = in_precision_of(plane, points_ws[indices[3 * t]])
    b = in_precision_of(plane, points_ws[indices[3 * t + 1]])
    c = in_precision_of(plane, points_ws[indices[3 * t + 2]])
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
    lowest = wp.max(h_a, type(high)(0.0))
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
        flat_out[at + i] = wp.vec3(flatten_point(plane, light_ws, point))
    for piece in range(PIECES):
        to = first_index + 3 * (PIECES * slot + piece)
        indices_out[to] = at
        indices_out[to + 1] = at + piece + 1
        indices_out[to + 2] = at + piece + 2


CUT = {
    scalar: wp.overload(cut_triangles, {"plane": vector, "light_ws": vector, "high": scalar})
    for scalar, vector in ((wp.float32, wp.vec4), (wp.float64, wp.vec4d))
}


class Flattener:
    """Draws flattened casters into an eye's view; keeps its memory between calls.

    Args:
        device: Warp device.
        threads: CPU threads; None for all.
    """

    def __init__(self, device: str, threads: int | None) -> None:
        self._scratch = Scratch(device, threads)
        self._rasteriser = Rasteriser(device, threads)
        self._clearance = Clearance()

    def draw(
        self,
        geometry: Geometry,
        plane: np.ndarray,
        light_ws: np.ndarray,
        extent: float,
        reach: float,
        view: View,
        depth_out: wp.array,
    ) -> int:
        """Draws the shadow that all casters throw on a whole plane.

        Args:
            geometry: The casters.
            plane: Of ``turned_to_light``, float64 (4,).
            light_ws: Light sample, float64 (4,), rebased world.
            extent: Largest coordinate of the scene: positions are known to ``ON_PLANE`` of it.
            reach: How far from a point light any receiver is at most.
            view: The eye's.
            depth_out: float32 (H, W): finite where the plane, seen there, lies in shadow.

        Returns:
            Triangles that had to be cut.

        Raises:
            InputError: A caster is cut out by a texture.
        """
        geometry.require_whole("flattened casters")
        scratch, count, vertices = self._scratch, geometry.caster_triangles, len(geometry.points_ws)
        points, indices = geometry.points_ws, geometry.caster_indices
        on_device, light = wp.vec4(*plane), wp.vec4(*light_ws)
        height = float(plane @ light_ws) if light_ws[3] > 0.0 else float("inf")
        high = (1.0 - BELOW_LIGHT) * height
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
            below = self._below_light(geometry, light_ws, reach)
            fine = below < BELOW_LIGHT
            bounds: list[Any] = [on_device, light, high]
            if fine:
                bounds = [wp.vec4d(*plane), wp.vec4d(*light_ws), (1.0 - below) * height]
            inputs = [points, indices, slots, *bounds, vertices, 3 * count]
            scratch.launch(CUT[wp.float64 if fine else wp.float32], len(which), inputs, [flat, drawn])
        self._rasteriser.draw(flat, drawn, view, depth_out)
        return len(which)

    def _below_light(self, geometry: Geometry, light_ws: np.ndarray, reach: float) -> float:
        """How far below a light casters are cut off, as a share of its height.

        Their shadows must go on as far as any receiver: the closer a caster comes to the light, the nearer to its
        height is what still casts on them.
        """
        if light_ws[3] == 0.0:
            return BELOW_LIGHT
        most = 4.0 * BELOW_LIGHT * reach
        clear = self._clearance.within(geometry, light_ws[:3], most)
        return max(LEAST_BELOW_LIGHT, BELOW_LIGHT * clear / most) if clear < most else BELOW_LIGHT
