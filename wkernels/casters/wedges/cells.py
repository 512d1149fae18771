"""A light in 8 x 8 cells, each of which edges hide on their own: casters that overlap hide a cell once.

The penumbrae of two casters that hide the same part of a light take it away twice when shares are summed. So the light
is cut into cells, and the faces before each are counted on their own: those before the light's centre, less one for
every edge that the way from the centre to the cell's middle crosses outwards. A cell is dark where there is any, and
the light that is left is the share of cells that are not (after Forest, Barthe and Paulin 2006, of whose paper the
abstract alone was at hand: cells and counts are our own).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.light_shapes import DISC, LightShape, see_light
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.recounting import blur_of, is_left
from wkernels.casters.wedges.shading import Faces, edge_on_light, is_at_centre, lit_share, recount
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES

SIDE = wp.constant(8)
CELLS = wp.constant(64)
Cells = wp.types.vector(length=CELLS, dtype=wp.float32)


@wp.func
def subtract_edge(cells: Any, ends: wp.vec4, weight: float):
    """Faces before each cell, less ``weight`` where the way from the centre to it crosses an edge.

    Args:
        cells: Faces before each.
        ends: The edge's ends on the light (x0, y0, x1, y1).
        weight: How often it counts; negative where it passes the centre clockwise.
    """
    out = cells
    x0 = ends[0]
    y0 = ends[1]
    x1 = ends[2]
    y1 = ends[3]
    turn = wp.where(x0 * y1 - y0 * x1 < 0.0, -1.0, 1.0)
    for k in range(CELLS):
        x = (float(k % SIDE) + 0.5) * (2.0 / float(SIDE)) - 1.0
        y = (float(k / SIDE) + 0.5) * (2.0 / float(SIDE)) - 1.0
        after_first = wp.where(turn * (x0 * y - y0 * x) >= 0.0, weight, 0.0)
        before_last = wp.where(turn * (x * y1 - y * x1) > 0.0, after_first, 0.0)
        outside = wp.where(turn * ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) < 0.0, before_last, 0.0)
        out[k] = out[k] - outside
    return out


@wp.func
def lit_cells(shape: int, cells: Any):
    """Share of a light's cells that no face is before; those in the corners are no part of a disc."""
    lit = float(0.0)
    whole = float(0.0)
    for k in range(CELLS):
        x = (float(k % SIDE) + 0.5) * (2.0 / float(SIDE)) - 1.0
        y = (float(k / SIDE) + 0.5) * (2.0 / float(SIDE)) - 1.0
        own = wp.where(shape == DISC, wp.where(x * x + y * y < 1.0, 1.0, 0.0), 1.0)
        whole += own
        lit += wp.where(cells[k] < 0.5, own, 0.0)
    return lit / whole


@wp.kernel
def shade_cells(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    light_ws: wp.vec4d,
    edges: WedgeEdges,
    near: NearLists,
    faces: Faces,
    counts: wp.array2d(dtype=int),
    visibility_out: wp.array2d(dtype=float),
):
    """Visibility as the share of cells that are lit."""
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
        cells = Cells(0.0)
        for i in range(near.lists.begin[tile], near.end[tile]):
            e = near.lists.shape[i]
            edge = edge_on_light(light, sight, edges, e)
            if edge.visible != 0:
                ends = edge.ends
                close = is_at_centre(edge, blur)
                untrusted += close
                turn = sight.turn * wp.where(ends[0] * ends[3] - ends[1] * ends[2] < 0.0, -1.0, 1.0)
                if close > 0:
                    both = edges.vertices[e]
                    turn = wp.where(is_left(faces.points_ws, both[0], both[1], at, to_light), 1.0, -1.0)
                cells = subtract_edge(cells, ends, turn * edges.weight[e])
        count = counts[y, x]
        if untrusted > 0:
            count = recount(faces, gbuffer, y, x, light_ws)
        for k in range(CELLS):
            cells[k] = cells[k] + float(count)
        visible = lit_share(light, sight, gbuffer, y, x, lit_cells(light.shape, cells))
    visibility_out[y, x] = visible
