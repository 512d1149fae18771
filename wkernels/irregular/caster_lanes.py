"""``casters`` on the CPU: vertices placed and triangles bounded 128 at a time; what is left over, one at a time."""

from __future__ import annotations

import warp as wp

from wkernels.irregular.casters import (
    ALONG_LIGHT,
    BESIDE,
    CELL,
    FAR_OUT,
    NO_ROWS,
    borders_of,
    bound_triangle,
    column_of_vertex,
    pack_span,
    pack_vertex,
    place_vertex,
    row_of_vertex,
)
from wkernels.irregular.grid import TINY, LightFace
from wkernels.raster.lane_culling import MESH_LANES, Ints, Longs, Points

Corners = wp.types.vector(length=3 * MESH_LANES, dtype=wp.int32)


@wp.kernel
def place_vertices_lanes(
    first: int,
    runs: wp.array(dtype=Points),  # whole runs of the points' memory
    points_ws: wp.array(dtype=wp.vec3),
    face: LightFace,
    vertex_runs_out: wp.array(dtype=Longs),  # whole runs of the vertices' memory
    vertex_out: wp.array(dtype=wp.int64),
):
    """``place_vertices`` for a run of vertices."""
    run = first + wp.tid()
    if run >= runs.shape[0]:
        for i in range(run * MESH_LANES, points_ws.shape[0]):
            vertex_out[i] = place_vertex(face, points_ws[i])
        return
    points = runs[run]
    origin_x, origin_y, origin_z = face.origin_ws[0], face.origin_ws[1], face.origin_ws[2]
    right_x, right_y, right_z = face.right_ws[0], face.right_ws[1], face.right_ws[2]
    up_x, up_y, up_z = face.up_ws[0], face.up_ws[1], face.up_ws[2]
    forward_x, forward_y, forward_z = face.forward_ws[0], face.forward_ws[1], face.forward_ws[2]
    in_perspective = face.perspective != 0
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    left = wp.float64(face.left)
    low = wp.float64(face.low)
    per_u = wp.float64(face.columns_per_u)
    per_v = wp.float64(face.rows_per_v)
    margin = wp.float64(face.margin) / CELL
    over = wp.float64(face.resolution) + margin
    border_0 = left - margin / per_u
    border_1 = left + over / per_u
    border_2 = low - margin / per_v
    border_3 = low + over / per_v
    vertices = Longs()
    for k in range(MESH_LANES):
        wx = wp.float64(points[3 * k]) - origin_x
        wy = wp.float64(points[3 * k + 1]) - origin_y
        wz = wp.float64(points[3 * k + 2]) - origin_z
        x = right_x * wx + right_y * wy + right_z * wz
        y = up_x * wx + up_y * wy + up_z * wz
        z = forward_x * wx + forward_y * wy + forward_z * wz
        w = wp.where(in_perspective, z, one)
        placed = wp.where(w > ALONG_LIGHT * (wp.abs(x) + wp.abs(y)), wp.where(w > TINY, 1, 0), 0)
        over_w = one / wp.where(placed == 1, w, one)
        column = int(wp.clamp(wp.floor((x * over_w - left) * per_u * CELL), -FAR_OUT, FAR_OUT))
        row = int(wp.clamp(wp.floor((y * over_w - low) * per_v * CELL), -FAR_OUT, FAR_OUT))
        across = wp.where(x < border_0 * w, 1, wp.where(x > border_1 * w, 2, 0))
        along = wp.where(y < border_2 * w, 4, wp.where(y > border_3 * w, 8, 0))
        borders = across | along | wp.where(w <= zero, 16, 0)
        vertices[k] = pack_vertex(wp.where(placed == 1, column, BESIDE), wp.where(placed == 1, row, borders))
    vertex_runs_out[run] = vertices


@wp.kernel
def bound_triangles_lanes(
    first: int,
    vertex: wp.array(dtype=wp.int64),
    runs: wp.array(dtype=Corners),  # whole runs of the indices' memory
    indices: wp.array(dtype=int),
    face: LightFace,
    occupied: wp.array2d(dtype=int),
    occupied_flat: wp.array(dtype=int),  # its memory
    rows_runs_out: wp.array(dtype=Ints),
    columns_runs_out: wp.array(dtype=Ints),
    rows_out: wp.array(dtype=int),
    columns_out: wp.array(dtype=int),
):
    """``bound_triangles`` for a run of triangles."""
    run = first + wp.tid()
    if run >= runs.shape[0]:
        for t in range(run * MESH_LANES, indices.shape[0] / 3):
            box = bound_triangle(vertex, indices, face, occupied, t)
            rows_out[t] = box[0]
            columns_out[t] = box[1]
        return
    corners = runs[run]
    margin = face.margin
    last = face.resolution - 1
    pitch = face.resolution + 1
    rows = Ints(0)
    columns = Ints(0)
    for k in range(MESH_LANES):
        a = vertex[corners[3 * k]]
        b = vertex[corners[3 * k + 1]]
        c = vertex[corners[3 * k + 2]]
        a_column = column_of_vertex(a)
        b_column = column_of_vertex(b)
        c_column = column_of_vertex(c)
        a_row = row_of_vertex(a)
        b_row = row_of_vertex(b)
        c_row = row_of_vertex(c)
        most = wp.max(wp.max(a_column, b_column), c_column)
        x0 = wp.max((wp.min(wp.min(a_column, b_column), c_column) - margin) >> 8, 0)
        x1 = wp.min((most + margin) >> 8, last)
        y0 = wp.max((wp.min(wp.min(a_row, b_row), c_row) - margin) >> 8, 0)
        y1 = wp.min((wp.max(wp.max(a_row, b_row), c_row) + margin) >> 8, last)
        outside = borders_of(a, margin, last) & borders_of(b, margin, last) & borders_of(c, margin, last)
        x0 = wp.where(most == BESIDE, 0, x0)
        x1 = wp.where(most == BESIDE, last, x1)
        y0 = wp.where(most == BESIDE, 0, y0)
        y1 = wp.where(most == BESIDE, last, y1)
        kept = wp.where(outside != 0, 0, wp.where(x0 > x1, 0, wp.where(y0 > y1, 0, 1)))
        above = kept * (y0 * pitch)
        below = kept * ((y1 + 1) * pitch)
        before = kept * x0
        behind = kept * (x1 + 1)
        held = (
            occupied_flat[below + behind]
            - occupied_flat[above + behind]
            - occupied_flat[below + before]
            + occupied_flat[above + before]
        )
        rows[k] = wp.where(held == 0, NO_ROWS, pack_span(y0, y1))
        columns[k] = wp.where(held == 0, 0, pack_span(x0, x1))
    rows_runs_out[run] = rows
    columns_runs_out[run] = columns
