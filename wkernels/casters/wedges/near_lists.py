"""Lists of wedges per tile, and of these the ones in which any of a tile's receivers can lie.

A tile's list has every wedge that comes near its pixels, and may show far less of them: its receivers fill a ball,
often a small one. From there the light is seen through the hull of that ball and a ball around the light; an edge that
a plane parts from both hides nothing from any of them (the culling of Assarsson et al. 2003, section 4.4, for whole
tiles).
"""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.light_shapes import SUN, LightShape
from wkernels.raster.binning import TileLists
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES

SLACK = wp.constant(1.0001)
"""On radii, for what float32 rounds."""


@wp.struct
class NearLists:
    """Wedges near the pixels of each tile."""

    lists: TileLists
    end: wp.array(dtype=int)  # (tiles,): where the part of a tile's list ends that is to be gone through


@wp.func
def is_parted(n: wp.vec3, a: wp.vec3, b: wp.vec3, from_: wp.vec3, near: float, to: wp.vec3, far: float):
    """Whether a plane of some normal, or of its opposite, parts an edge from two balls.

    Args:
        n: The normal, of any length.
        a, b: The edge's ends.
        from_, near: Middle and radius of one ball.
        to, far: Of the other.
    """
    length = wp.length(n)
    before = wp.min(wp.dot(n, a - from_), wp.dot(n, b - from_)) - near * length
    behind = wp.min(wp.dot(n, a - to), wp.dot(n, b - to)) - far * length
    other_before = -wp.max(wp.dot(n, a - from_), wp.dot(n, b - from_)) - near * length
    other_behind = -wp.max(wp.dot(n, a - to), wp.dot(n, b - to)) - far * length
    return (before > 0.0 and behind > 0.0) or (other_before > 0.0 and other_behind > 0.0)


@wp.kernel
def keep_near(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    points_ws: wp.array(dtype=wp.vec3),
    edges: WedgeEdges,
    reach: float,
    near_out: NearLists,
):
    """Moves what a tile's receivers can see of its list to the front, in its order."""
    tile = first + wp.tid()
    lists = near_out.lists
    begin = lists.begin[tile]
    end = lists.begin[tile + 1]
    top = (tile / lists.tiles_x) * lists.tile
    left = (tile % lists.tiles_x) * lists.tile
    bottom = wp.min(top + lists.tile, gbuffer.depth.shape[0])
    right = wp.min(left + lists.tile, gbuffer.depth.shape[1])
    low = wp.vec3(wp.inf)
    high = wp.vec3(-wp.inf)
    kept = begin
    if begin < end:
        for y in range(top, bottom):
            for x in range(left, right):
                if (gbuffer.flags[y, x] & RECEIVES) != 0:
                    low = wp.min(low, gbuffer.position_ws[y, x])
                    high = wp.max(high, gbuffer.position_ws[y, x])
    if low[0] <= high[0]:
        middle = 0.5 * (low + high)
        near = float(0.0)
        for y in range(top, bottom):
            for x in range(left, right):
                if (gbuffer.flags[y, x] & RECEIVES) != 0:
                    near = wp.max(near, wp.length(gbuffer.position_ws[y, x] - middle))
        near = near * SLACK + 1e-6 * (wp.length(middle) + reach)
        to = light.centre_ws
        far = light.bound * SLACK
        if light.kind == SUN:
            to = middle + reach * light.axis_n
            far = near + reach * light.bound * SLACK
        along = to - middle
        over = 1.0 / wp.max(wp.dot(along, along), 1e-30)
        for i in range(begin, end):
            e = lists.shape[i]
            a = points_ws[edges.vertices[e][0]]
            b = points_ws[edges.vertices[e][1]]
            from_a = a - middle
            from_b = b - middle
            aside_a = from_a - along * (wp.dot(from_a, along) * over)
            aside_b = from_b - along * (wp.dot(from_b, along) * over)
            apart = is_parted(wp.cross(b - a, along), a, b, middle, near, to, far)
            apart = apart or is_parted(aside_a, a, b, middle, near, to, far)
            apart = apart or is_parted(aside_b, a, b, middle, near, to, far)
            apart = apart or is_parted(aside_a + aside_b, a, b, middle, near, to, far)
            apart = apart or is_parted(along, a, b, middle, near, to, far)
            if not apart:
                lists.shape[kept] = e
                kept += 1
    near_out.end[tile] = kept


@wp.kernel
def keep_all(first: int, near_out: NearLists):
    """Every tile's whole list."""
    tile = first + wp.tid()
    near_out.end[tile] = near_out.lists.begin[tile + 1]
