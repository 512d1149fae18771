"""Silhouette edges as a light sees them, and how near a point lies to the light that just passes them.

A ball of light of radius R round the light point throws a penumbra on both sides of a silhouette's hard shadow. The
outer one is the union of cones, upside down, whose apexes are the points of the silhouette: at depth z from the light
the cone of a point at depth z_v has the radius R (z - z_v) / z_v (Haines 2001; Wyman and Hansen 2003).

All of this is plane geometry in the tangents X = x / z, Y = y / z of the light's view, with -1 / z for depth, the
*key*: an edge is a straight segment along which the key is affine, and the cone of key k_v has at key k the radius
R (k - k_v). For a directional light of half angle a the same holds of X = x, Y = y where a ray meets depth 0, the key z
and tan a for R, or, where depth is measured at an angle to the light, that over the angle's cosine. The envelope of an
edge's cones is a bilinear patch (a Coons patch of four straight sides), whose straight lines lean from the edge's
normal by what the cones grow along it. So what is asked of a point is the foot of its line on the edge; where that is
beyond an end, this end's cone is the nearest. The methods differ in what they make of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.casters.silhouettes import Loops, Silhouettes
from wkernels.raster.binning import Binner, TileLists
from wkernels.scene.lights import Light, orthonormal_frame
from wkernels.scene.views import HostView, View
from wkernels.workspace.workspace import Workspace

CORNERS = wp.constant(8)  # of an edge's outline: a square round each end
MOST_LEAN = wp.constant(0.99999)  # sine: beyond it one end's cone holds all; but close to the edge the edge counts


@wp.struct
class LightPlane:
    """The plane coordinates of a light's view; see above."""

    light_ws: wp.vec4
    right_ws: wp.vec3  # unit, perpendicular to the depth axis and to each other; right x up points to the light's side
    up_ws: wp.vec3
    depth_row: wp.vec4  # linear depth of a position p is dot(depth_row, (p, 1)); the first three are a unit axis


@wp.struct
class OuterEdges:
    """Silhouette edges in a light's plane, the outside on their right."""

    line: wp.array(dtype=wp.vec4)  # where it begins, and its unit direction
    ramp: wp.array(dtype=wp.vec4)  # its length, its key at the begin, how that changes per length, the lines' lean
    beside: wp.array(dtype=wp.vec2i)  # the edges before and after it in its loop; empty unless asked for


@wp.func
def depth_in_plane(plane: LightPlane, position_ws: wp.vec3):
    """Linear depth of a position."""
    return wp.dot(plane.depth_row, wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0))


@wp.func
def key_of_depth(plane: LightPlane, depth: float):
    """The key of a linear depth, which must be above 0 for a point light."""
    return wp.where(plane.light_ws[3] > 0.0, -1.0 / depth, depth)


@wp.func
def along_light(plane: LightPlane):
    """The way of a directional light's rays, for each unit of depth."""
    way = wp.vec3(plane.light_ws[0], plane.light_ws[1], plane.light_ws[2])
    return way / wp.dot(wp.vec3(plane.depth_row[0], plane.depth_row[1], plane.depth_row[2]), way)


@wp.func
def to_light_plane(plane: LightPlane, position_ws: wp.vec3):
    """X, Y and key of a position that is before a point light."""
    depth = depth_in_plane(plane, position_ws)
    way = position_ws
    if plane.light_ws[3] > 0.0:
        way = (position_ws - wp.vec3(plane.light_ws[0], plane.light_ws[1], plane.light_ws[2])) / depth
    else:
        way = position_ws - along_light(plane) * (depth - plane.depth_row[3])
    return wp.vec3(wp.dot(plane.right_ws, way), wp.dot(plane.up_ws, way), key_of_depth(plane, depth))


@wp.func
def from_light_plane(plane: LightPlane, x: float, y: float, depth: float):
    """The position at X, Y and a linear depth."""
    axis = wp.vec3(plane.depth_row[0], plane.depth_row[1], plane.depth_row[2])
    across = plane.right_ws * x + plane.up_ws * y
    position = wp.vec3(plane.light_ws[0], plane.light_ws[1], plane.light_ws[2]) + (across + axis) * depth
    if plane.light_ws[3] == 0.0:
        position = across + along_light(plane) * (depth - plane.depth_row[3])
    return position


@wp.kernel
def flatten_edges(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    ends: wp.array(dtype=wp.vec2i),
    plane: LightPlane,
    least: float,
    most: float,
    radius: float,
    width: float,
    edges_out: OuterEdges,
    outline_out: wp.array(dtype=wp.vec4),  # (CORNERS n,)
):
    """An edge between two depths in the light's plane, and an outline of all that its cones cover up to ``most``."""
    i = first + wp.tid()
    a = points_ws[ends[i][0]]
    b = points_ws[ends[i][1]]
    z_a = depth_in_plane(plane, a)
    z_b = depth_in_plane(plane, b)
    rise = z_b - z_a
    begin = float(0.0)
    end = float(1.0)
    if rise != 0.0:
        at_least = (least - z_a) / rise
        at_most = (most - z_a) / rise
        begin = wp.max(begin, wp.min(at_least, at_most))
        end = wp.min(end, wp.max(at_least, at_most))
    elif z_a < least or z_a > most:
        end = -1.0
    for k in range(CORNERS):
        outline_out[CORNERS * i + k] = wp.vec4()
    edges_out.line[i] = wp.vec4()
    edges_out.ramp[i] = wp.vec4()
    # written so that NaN leaves the edge out
    if begin < end and wp.abs(rise) < 1.0e30:
        p = to_light_plane(plane, a + (b - a) * begin)
        q = to_light_plane(plane, a + (b - a) * end)
        length = wp.sqrt((q[0] - p[0]) * (q[0] - p[0]) + (q[1] - p[1]) * (q[1] - p[1]))
        way_x = float(1.0)
        way_y = float(0.0)
        change = float(0.0)
        if length > 0.0:
            way_x = (q[0] - p[0]) / length
            way_y = (q[1] - p[1]) / length
            change = (q[2] - p[2]) / length
        growth = wp.clamp(change * radius, -MOST_LEAN, MOST_LEAN)
        edges_out.line[i] = wp.vec4(p[0], p[1], way_x, way_y)
        edges_out.ramp[i] = wp.vec4(length, p[2], change, growth / wp.sqrt(1.0 - growth * growth))
        farthest = key_of_depth(plane, most)
        for k in range(CORNERS):
            corner = p
            if k >= 4:
                corner = q
            reach = wp.where(width > 0.0, width, radius * (farthest - corner[2]))
            x = corner[0] + wp.where(k % 2 == 0, -reach, reach)
            y = corner[1] + wp.where(k % 4 < 2, -reach, reach)
            place = from_light_plane(plane, x, y, most)
            outline_out[CORNERS * i + k] = wp.vec4(place[0], place[1], place[2], 1.0)


@wp.func
def nearest_outside(line: wp.vec4, ramp: wp.vec4, x: float, y: float):
    """Distance of a point outside from its foot on an edge, and the key there; +inf inside.

    With a lean of 0 it is the nearest point of the edge.
    """
    dx = x - line[0]
    dy = y - line[1]
    along = dx * line[2] + dy * line[3]
    across = dx * line[3] - dy * line[2]
    foot = wp.clamp(along - across * ramp[3], 0.0, ramp[0])
    distance = wp.sqrt((along - foot) * (along - foot) + across * across)
    return wp.vec2(wp.where(across >= 0.0, distance, wp.inf), ramp[1] + ramp[2] * foot)


@dataclass(frozen=True, eq=False)
class EdgeBins:
    """Edges, and which of them come near the pixels of each tile.

    Attributes:
        edges: For kernels.
        lists: Valid until the next edges are binned.
        plane: Whose coordinates the edges have.
    """

    edges: OuterEdges
    lists: TileLists
    plane: LightPlane


def light_radius(light: Light) -> float:
    """R of the formulas: half the size of the light, whatever its shape; the tangent of half a direction's angle."""
    return float(np.tan(0.5 * light.size)) if light.is_directional else 0.5 * light.size


def light_plane(light_ws: np.ndarray, axis: np.ndarray, offset: float) -> LightPlane:
    """The plane across a depth axis.

    Args:
        light_ws: Light point (4,).
        axis: Unit depth axis (3,), away from the light.
        offset: Linear depth of the rebased world's origin.
    """
    up, right = orthonormal_frame(axis)  # right-handed with the axis, which looks away from the light
    out = LightPlane()
    out.light_ws, out.right_ws, out.up_ws = wp.vec4(*light_ws), wp.vec3(*right), wp.vec3(*up)
    out.depth_row = wp.vec4(*axis, offset)
    return out


def plane_of_view(light_ws: np.ndarray, view: HostView) -> LightPlane:
    """The plane coordinates of a light map's view, whose linear depth is theirs."""
    row = view.ws_to_ss[2]
    return light_plane(light_ws, row[:3], float(row[3]))


def pixel_to_plane(light_ws: np.ndarray, view: HostView, plane: LightPlane) -> np.ndarray:
    """Takes pixels (x, y, 1) of a light map's view, warped or not, to multiples of (X, Y, 1); float64 (3, 3)."""
    x, y, _, w = view.ws_to_ss
    rows = np.stack([x, y, w])
    axes = np.array([plane.right_ws, plane.up_ws, [plane.depth_row[i] for i in range(3)]], np.float64)
    to_screen = rows[:, :3] @ axes.T  # of (X, Y, 1) times depth, as seen from a point
    if light_ws[3] == 0.0:
        to_screen[:, 2] = rows[:, 3]
    to_ndc = np.array([[2.0 / view.width, 0.0, -1.0], [0.0, -2.0 / view.height, 1.0], [0.0, 0.0, 1.0]])
    return np.linalg.inv(to_screen) @ to_ndc


def neighbours(loops: Loops, count: int) -> np.ndarray:
    """The edges before and after each of ``count`` in its loop, int32 (n, 2); in one of them where it has several."""
    out = np.tile(np.arange(count, dtype=np.int32)[:, None], (1, 2))
    place = np.arange(len(loops.member))
    begin = np.repeat(loops.begin[:-1], np.diff(loops.begin))
    end = np.repeat(loops.begin[1:], np.diff(loops.begin))
    out[loops.member, 0] = loops.member[np.where(place == begin, end - 1, place - 1)]
    out[loops.member, 1] = loops.member[np.where(place == end - 1, begin, place + 1)]
    return out


def bin_edges(
    work: Workspace,
    binner: Binner,
    points_ws: wp.array,
    silhouettes: Silhouettes,
    plane: LightPlane,
    depths: tuple[float, float],
    radius: float,
    view: View,
    width: float = 0.0,
    loops: Loops | None = None,
) -> EdgeBins:
    """The silhouette's edges in a light's plane, in lists of what their cones may reach.

    Args:
        work: Where to run.
        binner: Keeps the lists.
        points_ws: vec3, shape (V,), the casters' vertices.
        silhouettes: From the light point.
        plane: Coordinates.
        depths: Least and greatest linear depth of what counts of edges; cones end at the greatest.
        radius: ``light_radius``.
        view: Whose pixels are asked about what lies at the greatest depth, or before it on the way to the light.
        width: Of what edges cover, in the plane, where that is the same everywhere; 0: their cones.
        loops: Of the silhouette, where each edge needs to know the next.
    """
    count = len(silhouettes.edge)
    edges = OuterEdges()
    edges.line, edges.ramp = (wp.empty(count, dtype=wp.vec4, device=work.device) for _ in range(2))
    outline = wp.empty(int(CORNERS) * count, dtype=wp.vec4, device=work.device)
    ends = wp.array(silhouettes.ends, dtype=wp.vec2i, device=work.device)
    inputs = [points_ws, ends, plane, *map(float, depths), radius, width]
    work.launch(flatten_edges, count, inputs, [edges, outline])
    if loops is not None:
        edges.beside = wp.array(neighbours(loops, count), dtype=wp.vec2i, device=work.device)
    begin = wp.array(np.arange(count + 1, dtype=np.int32) * int(CORNERS), dtype=int, device=work.device)
    return EdgeBins(edges, binner.bin(outline, begin, view), plane)
