"""Shares of a light with a texture: its light beyond an edge, exact if constant in each texel, or from a table.

The light beyond an edge is that between the two rays from the centre through its ends, less the triangle's; by Green's
theorem it is the integral of S dy around that region, S(x, y) being the texture's integral along the row from the left
border to x. In a texel S is linear, so that a straight piece within one is exact by its middle.

The table is the published one (Assarsson et al. 2003, sections 4.2.2 and 6): both ends in 32 steps along each axis, one
byte each, 1 MB.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.coverage import border_at
from wkernels.casters.wedges.light_shapes import LightShape, see_light
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.recounting import blur_of, is_left
from wkernels.casters.wedges.shading import Faces, edge_on_light, is_at_centre, lit_share, recount
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES
from wkernels.workspace.workspace import Workspace

STEPS = wp.constant(32)


@wp.struct
class LightTexture:
    """A texture over x, y in [-1, 1], whose integral is 1."""

    texel: wp.array2d(dtype=float)  # (rows, columns): light per area
    before: wp.array2d(dtype=float)  # (rows, columns): integral along the row up to the texel
    table: wp.array(dtype=wp.uint8)  # (STEPS^4,), shares of 255 beyond edges; none: exact


@wp.func
def piece_integral(texture: LightTexture, x0: float, y0: float, x1: float, y1: float):
    """Integral of S dy along the way from one point of the light to another."""
    rows = texture.texel.shape[0]
    columns = texture.texel.shape[1]
    total = float(0.0)
    c0 = (x0 + 1.0) * 0.5 * float(columns)
    c1 = (x1 + 1.0) * 0.5 * float(columns)
    r0 = (y0 + 1.0) * 0.5 * float(rows)
    r1 = (y1 + 1.0) * 0.5 * float(rows)
    d_c = c1 - c0
    d_r = r1 - r0
    if d_r != 0.0:
        step_c = wp.where(d_c < 0.0, -1.0, 1.0)
        step_r = wp.where(d_r < 0.0, -1.0, 1.0)
        next_c = wp.where(d_c < 0.0, wp.ceil(c0) - 1.0, wp.floor(c0) + 1.0)
        next_r = wp.where(d_r < 0.0, wp.ceil(r0) - 1.0, wp.floor(r0) + 1.0)
        t = float(0.0)
        for _ in range(rows + columns + 2):
            if t < 1.0:
                t_c = float(2.0)
                if d_c != 0.0:
                    t_c = (next_c - c0) / d_c
                t_r = (next_r - r0) / d_r
                until = wp.min(1.0, wp.min(t_c, t_r))
                middle = 0.5 * (t + until)
                c = c0 + middle * d_c
                column = wp.clamp(int(wp.floor(c)), 0, columns - 1)
                row = wp.clamp(int(wp.floor(r0 + middle * d_r)), 0, rows - 1)
                up_to = texture.before[row, column]
                up_to += texture.texel[row, column] * (c - float(column)) * (2.0 / float(columns))
                total += up_to * (until - t) * (y1 - y0)
                if t_c <= until:
                    next_c += step_c
                if t_r <= until:
                    next_r += step_r
                t = until
    return total


@wp.func
def border_point(way: float):
    """The point of the square's border at a way along it, as ``border_at`` has it, any times round."""
    way = way - 8.0 * wp.floor(0.125 * (way + 1.0))
    x = float(1.0)
    y = way
    if way > 5.0:
        x = way - 6.0
        y = -1.0
    elif way > 3.0:
        x = -1.0
        y = 4.0 - way
    elif way > 1.0:
        x = 2.0 - way
        y = 1.0
    return wp.vec2(x, y)


@wp.func
def light_beyond(texture: LightTexture, ends: wp.vec4):
    """Signed share of the light beyond an edge, ends (x0, y0, x1, y1); positive: counter-clockwise round the centre."""
    first = border_at(ends[0], ends[1])
    apart = border_at(ends[2], ends[3]) - first
    if apart > 4.0:
        apart -= 8.0
    if apart < -4.0:
        apart += 8.0
    counter_clockwise = ends[0] * ends[3] - ends[1] * ends[2] >= 0.0
    if apart < 0.0 and counter_clockwise and apart < -3.0:
        apart += 8.0  # rays that point away from each other, but for rounding
    if apart > 3.0 and not counter_clockwise:
        apart -= 8.0
    at = border_point(first)
    total = piece_integral(texture, ends[0], ends[1], at[0], at[1])
    way = first
    last = first + apart
    for _ in range(4):  # no more than three corners, at odd ways, lie between two rays
        ahead = wp.min(last, 2.0 * wp.floor(0.5 * (way + 1.0)) + 1.0)
        behind = wp.max(last, 2.0 * wp.ceil(0.5 * (way + 1.0)) - 3.0)
        way = wp.where(apart < 0.0, behind, ahead)
        to = border_point(way)
        total += piece_integral(texture, at[0], at[1], to[0], to[1])
        at = to
    total += piece_integral(texture, at[0], at[1], ends[2], ends[3])
    return total + piece_integral(texture, ends[2], ends[3], ends[0], ends[1])


@wp.func
def table_index(at: float):
    """Step of a coordinate."""
    return wp.clamp(int((at + 1.0) * (0.5 * float(STEPS))), 0, STEPS - 1)


@wp.kernel
def fill_table(first: int, texture: LightTexture, table_out: wp.array(dtype=wp.uint8)):
    """Shares beyond the edges between the middles of all pairs of steps, of 255."""
    i = first + wp.tid()
    half = 0.5 * float(STEPS)
    at = wp.vec4()
    rest = i
    for k in range(4):
        at[3 - k] = (float(rest % STEPS) + 0.5) / half - 1.0
        rest = rest / STEPS
    table_out[i] = wp.uint8(wp.clamp(wp.abs(light_beyond(texture, at)), 0.0, 1.0) * 255.0 + 0.5)


@wp.func
def textured_share(texture: LightTexture, ends: wp.vec4):
    """``light_beyond``, or what the table says of it."""
    share = float(0.0)
    if texture.table.shape[0] == 0:
        share = light_beyond(texture, ends)
    else:
        i = int(0)
        at = wp.vec4()
        for k in range(4):
            step = table_index(ends[k])
            at[k] = (float(step) + 0.5) * (2.0 / float(STEPS)) - 1.0
            i = i * STEPS + step
        share = float(texture.table[i]) / 255.0
        left = ends[0] * ends[3] - ends[1] * ends[2] >= 0.0
        # the table's edge may pass on the other side of the centre, and have the other part of the light beyond it
        if left != (at[0] * at[3] - at[1] * at[2] >= 0.0) and at[0] * at[2] + at[1] * at[3] < 0.0:
            share = 1.0 - share
        if not left:
            share = -share
    return share


@wp.kernel
def shade_textured(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    light_ws: wp.vec4d,
    edges: WedgeEdges,
    near: NearLists,
    faces: Faces,
    texture: LightTexture,
    counts: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """``shading.shade`` for a light with a texture."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        at = wp.vec3d(position_ws)
        to_light = wp.vec3d(light_ws[0], light_ws[1], light_ws[2]) - at * light_ws[3]
        sight = see_light(light, position_ws)
        blur = blur_of(gbuffer.view, sight, gbuffer.depth[y, x], position_ws)
        tile = tile_at(near.lists, y, x)
        untrusted = int(0)
        total = float(0.0)
        for i in range(near.lists.begin[tile], near.end[tile]):
            e = near.lists.shape[i]
            edge = edge_on_light(light, sight, edges, e)
            if edge.visible != 0:
                share = sight.turn * textured_share(texture, edge.ends)
                if is_at_centre(edge, blur) > 0:
                    untrusted += 1
                    both = edges.vertices[e]
                    left = is_left(faces.points_ws, both[0], both[1], at, to_light)
                    if left and share < 0.0:  # the other part of the light
                        share += 1.0
                    elif share > 0.0 and not left:
                        share -= 1.0
                total += edges.weight[e] * share
        count = counts[y, x]
        if untrusted > 0:
            count = recount(faces, gbuffer, y, x, light_ws)
        visible = lit_share(light, sight, gbuffer, y, x, 1.0 - float(count) + total)
    visibility_out[y, x] = visible


def light_texture(work: Workspace, texels: np.ndarray, stored: bool) -> LightTexture:
    """A texture for kernels.

    Args:
        work: Where it is needed.
        texels: Radiance (rows, columns), the columns along a rectangle's first edge.
        stored: Whether shares come from the table.
    """
    rows, columns = texels.shape
    density = texels / max(float(texels.sum()), 1e-30) * (0.25 * rows * columns)
    before = np.cumsum(density, axis=1) - density
    out = LightTexture()
    out.texel = wp.array(density.astype(np.float32), dtype=float, device=work.device)
    out.before = wp.array((before * (2.0 / columns)).astype(np.float32), dtype=float, device=work.device)
    if stored:
        table = wp.empty(int(STEPS) ** 4, dtype=wp.uint8, device=work.device)
        work.launch(fill_table, len(table), [out], [table])
        out.table = table
    return out
