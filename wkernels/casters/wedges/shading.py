"""Visibility of receivers: hard counts, and the shares of the light beyond the edges whose wedges they may lie in.

``shade`` is plain, ``shading_lanes`` its twin. Receivers whose count cannot be trusted come out of either as
``UNTRUSTED`` and are settled one by one by ``settle``.
"""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.coverage import beyond, clip_to_light, on_light, share_above
from wkernels.casters.wedges.light_shapes import FACING, SUN, LightShape, Sight, see_light, seen
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.recounting import blur_of, count_hiding_faces, is_left, passes_centre
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES

UNTRUSTED = wp.constant(-1.0)
"""Visibility of a receiver that ``settle`` has still to see to."""


@wp.struct
class Faces:
    """The casters' faces that volumes are the shadow of."""

    mesh_id: wp.uint64
    points_ws: wp.array(dtype=wp.vec3)
    indices: wp.array(dtype=int)  # those of one position have one number
    turns: wp.array(dtype=wp.int8)
    reach: float  # length of a way that leaves the scene


@wp.struct
class EdgeOnLight:
    """The part of an edge that a receiver sees before the light."""

    visible: int  # 0: there is none
    ends: wp.vec4  # on the light (x0, y0, x1, y1), half sizes
    nearest: float  # w of its nearer end


@wp.func
def edge_on_light(light: LightShape, sight: Sight, edges: WedgeEdges, e: int):
    """What a receiver sees of an edge before the light."""
    out = EdgeOnLight()
    p0 = seen(sight, edges.ends[2 * e])
    p1 = seen(sight, edges.ends[2 * e + 1])
    span = clip_to_light(light.shape, sight, p0, p1)
    if span[0] < span[1]:
        out.visible = 1
        out.ends = on_light(p0, p1, span)
        out.nearest = wp.min(p0[2] + span[0] * (p1[2] - p0[2]), p0[2] + span[1] * (p1[2] - p0[2]))
    return out


@wp.func
def is_at_centre(edge: EdgeOnLight, blur: float):
    """1 where an edge passes the light's centre so closely that the hard count may not know on which side."""
    ends = edge.ends
    return passes_centre(ends[0], ends[1], ends[2], ends[3], edge.nearest, blur)


@wp.func
def recount(faces: Faces, gbuffer: GBuffer, y: int, x: int, light_ws: wp.vec4d):
    """``count_hiding_faces`` of a pixel's surface."""
    own = gbuffer.triangle[y, x]
    position_ws = gbuffer.position_ws[y, x]
    return count_hiding_faces(
        faces.mesh_id, faces.points_ws, faces.indices, faces.turns, own, position_ws, light_ws, faces.reach
    )


@wp.func
def share_before(light: LightShape, sight: Sight, position_ws: wp.vec3, normal_ws: wp.vec3):
    """Share of the light that lies before a receiver's own plane, which hides the rest if it casts."""
    to_centre = light.centre_ws - position_ws
    a = wp.dot(normal_ws, light.half_u_ws)
    b = wp.dot(normal_ws, light.half_v_ws)
    c = wp.dot(normal_ws, to_centre)
    if light.kind == SUN:
        c = wp.dot(normal_ws, light.axis_n)
    if light.kind == FACING:
        along = c / wp.max(sight.depth, 1e-30)
        a = light.radius * wp.sqrt(wp.max(0.0, 1.0 - along * along))
        b = 0.0
    return share_above(light.shape, a, b, c)


@wp.func
def lit_share(light: LightShape, sight: Sight, gbuffer: GBuffer, y: int, x: int, visible: float):
    """Visibility within [0, 1], and no more than the receiver's own surface lets through if that is asked for."""
    share = wp.clamp(visible, 0.0, 1.0)
    if light.own_plane != 0 and (gbuffer.flags[y, x] & CASTS) != 0:
        share = wp.min(share, share_before(light, sight, gbuffer.position_ws[y, x], gbuffer.normal_ws[y, x]))
    return share


@wp.kernel
def shade(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    edges: WedgeEdges,
    near: NearLists,
    counts: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """1 less the faces before the light's centre, and for each edge the share of the light beyond it."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        sight = see_light(light, position_ws)
        blur = blur_of(gbuffer.view, sight, gbuffer.depth[y, x], position_ws)
        total = float(0.0)
        untrusted = int(0)
        tile = tile_at(near.lists, y, x)
        for i in range(near.lists.begin[tile], near.end[tile]):
            e = near.lists.shape[i]
            edge = edge_on_light(light, sight, edges, e)
            if edge.visible != 0:
                total += edges.weight[e] * beyond(light.shape, edge.ends)
                untrusted += is_at_centre(edge, blur)
        visible = lit_share(light, sight, gbuffer, y, x, 1.0 - float(counts[y, x]) + sight.turn * total)
        if untrusted > 0:
            visible = UNTRUSTED
    visibility_out[y, x] = visible


@wp.kernel
def settle(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    light_ws: wp.vec4d,
    edges: WedgeEdges,
    near: NearLists,
    faces: Faces,
    visibility_out: wp.array2d(dtype=float),
):
    """``shade`` of receivers that it did not trust itself with: faces counted, and sides told, by the same edges."""
    row, x = wp.tid()
    y = first + row
    if visibility_out[y, x] != UNTRUSTED:
        return
    position_ws = gbuffer.position_ws[y, x]
    at = wp.vec3d(position_ws)
    to_light = wp.vec3d(light_ws[0], light_ws[1], light_ws[2]) - at * light_ws[3]
    sight = see_light(light, position_ws)
    count = recount(faces, gbuffer, y, x, light_ws)
    total = float(0.0)
    tile = tile_at(near.lists, y, x)
    for i in range(near.lists.begin[tile], near.end[tile]):
        e = near.lists.shape[i]
        edge = edge_on_light(light, sight, edges, e)
        if edge.visible != 0:
            share = wp.abs(beyond(light.shape, edge.ends))
            ends = edges.vertices[e]
            if is_left(faces.points_ws, ends[0], ends[1], at, to_light):
                total += edges.weight[e] * share
            else:
                total -= edges.weight[e] * share
    visibility_out[y, x] = lit_share(light, sight, gbuffer, y, x, 1.0 - float(count) + total)


@wp.kernel
def hide_behind_own_plane(first: int, gbuffer: GBuffer, light: LightShape, visibility_out: wp.array2d(dtype=float)):
    """What ``shade`` does last, for visibility that several passes made."""
    row, x = wp.tid()
    y = first + row
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        sight = see_light(light, gbuffer.position_ws[y, x])
        visibility_out[y, x] = lit_share(light, sight, gbuffer, y, x, visibility_out[y, x])
