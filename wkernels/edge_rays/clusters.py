"""Receivers in clusters of at most 64 pixels, and the edges that may matter to any of a cluster.

A cluster is a part of a tile of 8 x 8 pixels within a quarter of its range of depths, so that one across the border of
an object falls apart there and its box stays small. An edge matters where it touches the hull of box and light, unless
its two faces cancel from everywhere in the box.
"""

from __future__ import annotations

import warp as wp

from wkernels.edge_rays.light_plane import LightPlane
from wkernels.edge_rays.potential import PotentialEdges
from wkernels.raster.gbuffer import GBuffer
from wkernels.rays.caster_tree import WIDTH, CasterTree
from wkernels.rays.shaft_rays import Stack
from wkernels.rays.single_rays import ray_origin
from wkernels.scene.geometry import RECEIVES

TILE = wp.constant(8)  # pixels
PARTS = wp.constant(4)  # clusters of a tile
EDGE_LANES = wp.constant(16)  # edges of a block
EdgeFloats = wp.types.vector(length=EDGE_LANES, dtype=wp.float32)
ROUNDING_OF_BOX = wp.constant(1.0e-5)  # of distances from its middle
FAR = wp.constant(1.0e30)


@wp.struct
class Clusters:
    """Boxes of the clusters' ray origins, (tiles, PARTS); low beyond high where there is none."""

    low: wp.array2d(dtype=wp.vec3)
    high: wp.array2d(dtype=wp.vec3)


@wp.struct
class HullPlanes:
    """A body that holds a box and a light: dot(side, x - middle) >= its least for four sides."""

    middle: wp.vec3
    half: wp.vec3
    left: wp.vec3
    right: wp.vec3
    bottom: wp.vec3
    top: wp.vec3
    least: wp.vec4


@wp.func
def part_of(depth: float, near: float, far: float):
    """In which quarter of a tile's range of depths, in powers of it, a pixel lies."""
    share = wp.log(wp.max(depth / near, 1.0)) / wp.max(wp.log(far / near), 1.0e-3)
    return wp.clamp(int(share * float(PARTS)), 0, PARTS - 1)


@wp.kernel
def find_clusters(first: int, gbuffer: GBuffer, tiles_x: int, part_out: wp.array2d(dtype=int), clusters_out: Clusters):
    """The part of each pixel of one tile, -1 without a receiver, and the box of each part."""
    tile = first + wp.tid()
    y0 = (tile / tiles_x) * TILE
    x0 = (tile % tiles_x) * TILE
    y1 = wp.min(y0 + TILE, gbuffer.flags.shape[0])
    x1 = wp.min(x0 + TILE, gbuffer.flags.shape[1])
    near = float(FAR)
    far = float(1.0e-30)
    for y in range(y0, y1):
        for x in range(x0, x1):
            if (gbuffer.flags[y, x] & RECEIVES) != 0:
                near = wp.min(near, wp.max(gbuffer.depth[y, x], 1.0e-30))
                far = wp.max(far, gbuffer.depth[y, x])
    for part in range(PARTS):
        clusters_out.low[tile, part] = wp.vec3(FAR, FAR, FAR)
        clusters_out.high[tile, part] = wp.vec3(-FAR, -FAR, -FAR)
    for y in range(y0, y1):
        for x in range(x0, x1):
            part = int(-1)
            if (gbuffer.flags[y, x] & RECEIVES) != 0:
                part = part_of(gbuffer.depth[y, x], near, far)
                origin = ray_origin(gbuffer, y, x)
                clusters_out.low[tile, part] = wp.min(clusters_out.low[tile, part], origin)
                clusters_out.high[tile, part] = wp.max(clusters_out.high[tile, part], origin)
            part_out[y, x] = part


@wp.func
def corner_of(half: wp.vec3, i: int):
    """One of the eight corners of a box around 0."""
    return wp.vec3(
        wp.where((i & 1) != 0, half[0], -half[0]),
        wp.where((i & 2) != 0, half[1], -half[1]),
        wp.where((i & 4) != 0, half[2], -half[2]),
    )


@wp.func
def hull_planes(low: wp.vec3, high: wp.vec3, light: LightPlane):
    """Sides as steep as the ways from the box's border to the light's; any slope holds, a good one narrowly."""
    out = HullPlanes()
    out.middle = 0.5 * (low + high)
    out.half = 0.5 * (high - low)
    axis = wp.normalize(light.centre - out.middle * light.is_point)
    u = wp.normalize(wp.cross(axis, wp.where(wp.abs(axis[0]) < 0.6, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))))
    v = wp.cross(axis, u)
    box_low = wp.vec2(FAR, FAR)
    box_high = -box_low
    for i in range(8):
        corner = corner_of(out.half, i)
        across = wp.vec2(wp.dot(corner, u), wp.dot(corner, v))
        box_low = wp.min(box_low, across)
        box_high = wp.max(box_high, across)
    slope_low = wp.vec2(FAR, FAR)
    slope_high = -slope_low
    distance = wp.max(wp.length(light.centre - out.middle), 1.0e-3 * light.size) * light.is_point
    holds = bool(True)
    for i in range(light.corners.shape[0]):
        way = light.corners[i] - out.middle * light.is_point
        across = wp.vec2(wp.dot(way, u), wp.dot(way, v))
        depth = distance
        if light.is_point == 0.0:
            depth = wp.dot(way, axis)
            holds = holds and depth > 1.0e-2 * wp.length(way)
        scale = 1.0 / wp.max(depth, 1.0e-30)
        slope_low = wp.min(slope_low, (across - box_low * light.is_point) * scale)
        slope_high = wp.max(slope_high, (across - box_high * light.is_point) * scale)
    base_low = wp.vec2(FAR, FAR)
    base_high = -base_low
    points = 8 + wp.where(light.is_point > 0.0, light.corners.shape[0], 0)
    for i in range(points):
        way = corner_of(out.half, i & 7)
        if i >= 8:
            way = light.corners[i - 8] - out.middle
        depth = wp.dot(way, axis)
        across = wp.vec2(wp.dot(way, u), wp.dot(way, v))
        base_low = wp.min(base_low, across - slope_low * depth)
        base_high = wp.max(base_high, across - slope_high * depth)
    if holds:
        out.left = u - axis * slope_low[0]
        out.right = axis * slope_high[0] - u
        out.bottom = v - axis * slope_low[1]
        out.top = axis * slope_high[1] - v
        slack = ROUNDING_OF_BOX * (wp.length(out.middle) + wp.length(out.half) + distance)
        steepest = 1.0 + wp.length(slope_low) + wp.length(slope_high)
        slack = slack * steepest
        out.least = wp.vec4(base_low[0] - slack, -base_high[0] - slack, base_low[1] - slack, -base_high[1] - slack)
    return out


@wp.func
def reaches(side: wp.vec3, a: wp.vec3, b: wp.vec3):
    """The farthest that a box with these extreme corners, about the middle, lies on the inner side of a plane."""
    return (
        wp.max(a[0] * side[0], b[0] * side[0])
        + wp.max(a[1] * side[1], b[1] * side[1])
        + wp.max(a[2] * side[2], b[2] * side[2])
    )


@wp.func
def touches(hull: HullPlanes, a_ws: wp.vec3, b_ws: wp.vec3):
    """Whether a box may touch the hull."""
    a = a_ws - hull.middle
    b = b_ws - hull.middle
    least = hull.least
    inside = wp.min(reaches(hull.left, a, b) - least[0], reaches(hull.right, a, b) - least[1])
    inside = wp.min(inside, wp.min(reaches(hull.bottom, a, b) - least[2], reaches(hull.top, a, b) - least[3]))
    return inside >= 0.0


@wp.func
def segment_touches(hull: HullPlanes, a_ws: wp.vec3, b_ws: wp.vec3):
    """Whether a segment may touch the hull."""
    a = a_ws - hull.middle
    b = b_ws - hull.middle
    least = hull.least
    left = wp.max(wp.dot(hull.left, a), wp.dot(hull.left, b)) - least[0]
    right = wp.max(wp.dot(hull.right, a), wp.dot(hull.right, b)) - least[1]
    bottom = wp.max(wp.dot(hull.bottom, a), wp.dot(hull.bottom, b)) - least[2]
    top = wp.max(wp.dot(hull.top, a), wp.dot(hull.top, b)) - least[3]
    return wp.min(wp.min(left, right), wp.min(bottom, top)) >= 0.0


@wp.func
def side_of_box(plane: wp.vec4, middle: wp.vec3, half: wp.vec3):
    """1 or -1 where all of a box lies on one side of a plane beyond rounding, else 0."""
    along = plane[3] - (plane[0] * middle[0] + plane[1] * middle[1] + plane[2] * middle[2])
    radius = wp.abs(plane[0]) * half[0] + wp.abs(plane[1]) * half[1] + wp.abs(plane[2]) * half[2]
    radius = radius * 1.001 + 2.0e-6 * (wp.length(middle) + wp.abs(plane[3]))
    return wp.where(along > radius, 1.0, wp.where(along < -radius, -1.0, 0.0))


@wp.func
def cancels(edges: PotentialEdges, e: int, middle: wp.vec3, half: wp.vec3):
    """Whether an edge is no silhouette from anywhere in a box."""
    turns = edges.turns[e]
    first = side_of_box(edges.first_plane[e], middle, half)
    second = side_of_box(edges.second_plane[e], middle, half)
    none = turns[0] == 0.0 and turns[1] == 0.0
    return none or (first * second != 0.0 and first * turns[0] + second * turns[1] == 0.0)


@wp.kernel
def list_edges(
    first: int,
    clusters: Clusters,
    tree: CasterTree,
    edges: PotentialEdges,
    light: LightPlane,
    first_tile: int,
    begin: wp.array(dtype=int),  # of each cluster's blocks
    fill: int,  # 0 counts only
    count_out: wp.array(dtype=int),
    block_out: wp.array2d(dtype=EdgeFloats),
):
    """The edges that matter to the clusters of one tile: how many, or their blocks of 16.

    A block has the coordinates of both ends, both planes and both turns, 16 runs.
    """
    tile = first_tile + first + wp.tid()
    for part in range(PARTS):
        cluster = tile * PARTS + part
        low = clusters.low[tile, part]
        high = clusters.high[tile, part]
        found = int(0)
        top = int(0)
        stack = Stack()
        if low[0] <= high[0] and tree.levels > 0:
            stack[0] = tree.levels - 1
            top = 1
        hull = hull_planes(low, high, light)
        while top > 0:
            top -= 1
            level = stack[top] & 15
            index = stack[top] >> 4
            begin_child = index * WIDTH
            if level > 0:
                at = tree.level_begin[level] + index
                for k in range(wp.min(WIDTH, tree.level_size[level - 1] - begin_child)):
                    box_low = wp.vec3(tree.low_x[at][k], tree.low_y[at][k], tree.low_z[at][k])
                    box_high = wp.vec3(tree.high_x[at][k], tree.high_y[at][k], tree.high_z[at][k])
                    if touches(hull, box_low, box_high):
                        stack[top] = ((begin_child + k) << 4) | (level - 1)
                        top += 1
                continue
            for e in range(begin_child, wp.min(begin_child + WIDTH, edges.count)):
                a = edges.a_ws[e]
                b = edges.b_ws[e]
                if segment_touches(hull, a, b):
                    if not cancels(edges, e, hull.middle, hull.half):
                        if fill != 0:
                            block = begin[cluster] + found / EDGE_LANES
                            lane = found % EDGE_LANES
                            for i in range(3):
                                block_out[block, i][lane] = a[i]
                                block_out[block, 3 + i][lane] = b[i]
                            for i in range(4):
                                block_out[block, 6 + i][lane] = edges.first_plane[e][i]
                                block_out[block, 10 + i][lane] = edges.second_plane[e][i]
                            block_out[block, 14][lane] = edges.turns[e][0]
                            block_out[block, 15][lane] = edges.turns[e][1]
                        found += 1
        if fill == 0:
            count_out[cluster] = found
