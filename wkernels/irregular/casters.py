"""Casters as the light sees them: the cells that each triangle may touch, and lists of triangles per band of rows."""

from __future__ import annotations

import warp as wp

from wkernels.irregular.grid import TINY, LightFace, to_face

NO_ROWS = wp.constant(1)  # packed rows of a triangle that hides nothing: from 1 to 0
CELL = wp.constant(wp.float64(256.0))  # vertices are placed in this part of a cell
FAR_OUT = wp.constant(wp.float64(1.0e8))
BESIDE = wp.constant(1 << 28)  # column of a vertex behind the light or beside it
ALONG_LIGHT = wp.constant(wp.float64(1.0e-4))  # z / |x y| of a vertex beside the light, whose u and v say nothing


@wp.func
def pack_span(begin: int, end: int):
    """Two numbers of 16 bits."""
    return begin | (end << 16)


@wp.func
def pack_vertex(column: int, row: int):
    """Grid coordinates as one number: a gather of two costs twice as much."""
    return (wp.int64(row) << wp.int64(32)) | (wp.int64(column) & wp.int64(0xFFFFFFFF))


@wp.func
def column_of_vertex(vertex: wp.int64):
    """The column in ``pack_vertex``."""
    return wp.int32(vertex)


@wp.func
def row_of_vertex(vertex: wp.int64):
    """The row in ``pack_vertex``."""
    return wp.int32(vertex >> wp.int64(32))


@wp.func
def place_vertex(face: LightFace, position_ws: wp.vec3):
    """A vertex in 1/256 cells; where it has no place, BESIDE and a bit for each border that it is outside of."""
    a = to_face(face, position_ws)
    left = wp.float64(face.left)
    low = wp.float64(face.low)
    per_u = wp.float64(face.columns_per_u)
    per_v = wp.float64(face.rows_per_v)
    placed = a[2] > ALONG_LIGHT * (wp.abs(a[0]) + wp.abs(a[1])) and a[2] > TINY
    w = wp.where(placed, a[2], wp.float64(1.0))
    column = int(wp.clamp(wp.floor((a[0] / w - left) * per_u * CELL), -FAR_OUT, FAR_OUT))
    row = int(wp.clamp(wp.floor((a[1] / w - low) * per_v * CELL), -FAR_OUT, FAR_OUT))
    if not placed:
        margin = wp.float64(face.margin) / CELL
        over = wp.float64(face.resolution) + margin
        column = BESIDE
        row = (
            wp.where(a[0] < (left - margin / per_u) * a[2], 1, 0)
            | wp.where(a[0] > (left + over / per_u) * a[2], 2, 0)
            | wp.where(a[1] < (low - margin / per_v) * a[2], 4, 0)
            | wp.where(a[1] > (low + over / per_v) * a[2], 8, 0)
            | wp.where(a[2] <= wp.float64(0.0), 16, 0)
        )
    return pack_vertex(column, row)


@wp.kernel
def place_vertices(
    first: int, points_ws: wp.array(dtype=wp.vec3), face: LightFace, vertex_out: wp.array(dtype=wp.int64)
):
    """``place_vertex`` of every vertex."""
    i = first + wp.tid()
    vertex_out[i] = place_vertex(face, points_ws[i])


@wp.func
def borders_of(vertex: wp.int64, margin: int, last: int):
    """A bit for each border of the grid that a vertex is outside of, 16 where it is behind the light."""
    column = column_of_vertex(vertex)
    row = row_of_vertex(vertex)
    beyond = wp.where(column + margin < 0, 1, 0) | wp.where((column - margin) >> 8 > last, 2, 0)
    beyond = beyond | wp.where(row + margin < 0, 4, 0) | wp.where((row - margin) >> 8 > last, 8, 0)
    return wp.where(column == BESIDE, row, beyond)


@wp.func
def bound_triangle(
    vertex: wp.array(dtype=wp.int64),
    indices: wp.array(dtype=int),
    face: LightFace,
    occupied: wp.array2d(dtype=int),
    t: int,
):
    """Rows and columns of the cells that hold every receiver which a triangle may hide, both packed.

    Triangles with a vertex beside the light get the whole grid: their edges, not their corners, say what they touch.
    """
    a = vertex[indices[3 * t]]
    b = vertex[indices[3 * t + 1]]
    c = vertex[indices[3 * t + 2]]
    last = face.resolution - 1
    a_column = column_of_vertex(a)
    b_column = column_of_vertex(b)
    c_column = column_of_vertex(c)
    a_row = row_of_vertex(a)
    b_row = row_of_vertex(b)
    c_row = row_of_vertex(c)
    x0 = wp.max((wp.min(wp.min(a_column, b_column), c_column) - face.margin) >> 8, 0)
    x1 = wp.min((wp.max(wp.max(a_column, b_column), c_column) + face.margin) >> 8, last)
    y0 = wp.max((wp.min(wp.min(a_row, b_row), c_row) - face.margin) >> 8, 0)
    y1 = wp.min((wp.max(wp.max(a_row, b_row), c_row) + face.margin) >> 8, last)
    beside = wp.max(wp.max(a_column, b_column), c_column) == BESIDE
    outside = (
        borders_of(a, face.margin, last) & borders_of(b, face.margin, last) & borders_of(c, face.margin, last)
    ) != 0
    x0 = wp.where(beside, 0, x0)
    x1 = wp.where(beside, last, x1)
    y0 = wp.where(beside, 0, y0)
    y1 = wp.where(beside, last, y1)
    empty = outside or x0 > x1 or y0 > y1
    if not empty:
        inside = occupied[y1 + 1, x1 + 1] - occupied[y0, x1 + 1] - occupied[y1 + 1, x0] + occupied[y0, x0]
        empty = inside == 0
    return wp.vec2i(wp.where(empty, NO_ROWS, pack_span(y0, y1)), wp.where(empty, 0, pack_span(x0, x1)))


@wp.kernel
def bound_triangles(
    first: int,
    vertex: wp.array(dtype=wp.int64),
    indices: wp.array(dtype=int),
    face: LightFace,
    occupied: wp.array2d(dtype=int),  # (R + 1, R + 1) receivers in the cells before a row and a column
    rows_out: wp.array(dtype=int),
    columns_out: wp.array(dtype=int),
):
    """``bound_triangle`` of every triangle."""
    t = first + wp.tid()
    box = bound_triangle(vertex, indices, face, occupied, t)
    rows_out[t] = box[0]
    columns_out[t] = box[1]


@wp.func
def chunk_begin(count: int, chunk: int, chunks: int):
    """First triangle of a chunk."""
    return int(wp.int64(count) * wp.int64(chunk) / wp.int64(chunks))


@wp.kernel
def count_bands(
    first: int,
    rows: wp.array(dtype=int),
    count: int,
    band_shift: int,  # a band has 1 << this rows
    chunks: int,
    counts_out: wp.array2d(dtype=int),  # (bands, chunks)
):
    """How many triangles of each chunk touch each band."""
    chunk = first + wp.tid()
    for band in range(counts_out.shape[0]):
        counts_out[band, chunk] = 0
    for t in range(chunk_begin(count, chunk, chunks), chunk_begin(count, chunk + 1, chunks)):
        if rows[t] != NO_ROWS:
            for band in range((rows[t] & 65535) >> band_shift, (rows[t] >> (16 + band_shift)) + 1):
                counts_out[band, chunk] += 1


@wp.kernel
def list_bands(
    first: int,
    rows: wp.array(dtype=int),
    count: int,
    band_shift: int,
    chunks: int,
    next_slot: wp.array2d(dtype=int),  # (bands, chunks), advanced
    list_out: wp.array(dtype=int),
):
    """Writes the triangles of each chunk into the bands' lists, in triangle order."""
    chunk = first + wp.tid()
    for t in range(chunk_begin(count, chunk, chunks), chunk_begin(count, chunk + 1, chunks)):
        if rows[t] != NO_ROWS:
            for band in range((rows[t] & 65535) >> band_shift, (rows[t] >> (16 + band_shift)) + 1):
                slot = next_slot[band, chunk]
                next_slot[band, chunk] = slot + 1
                list_out[slot] = t
