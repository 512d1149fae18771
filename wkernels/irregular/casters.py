"""Casters as the light sees them: the cells that each triangle may touch, and lists of triangles per band of rows."""

from __future__ import annotations

import warp as wp

from wkernels.irregular.grid import TINY, LightFace, to_face

NO_ROWS = wp.constant(1)  # packed rows of a triangle that touches no cell: from 1 to 0
CELL = wp.constant(wp.float64(256.0))  # boxes are found in this part of a cell
FAR_OUT = wp.constant(wp.float64(1.0e8))
ALONG_LIGHT = wp.constant(wp.float64(1.0e-4))  # z / |x y| of a corner beside the light, whose u and v say nothing


@wp.func
def pack_span(begin: int, end: int):
    """Two numbers of 16 bits."""
    return begin | (end << 16)


@wp.func
def subcell(position: wp.float64):
    """A grid coordinate in 1/256 cell."""
    return int(wp.clamp(wp.floor(position * CELL), -FAR_OUT, FAR_OUT))


@wp.func
def is_beside(x: wp.float64, y: wp.float64, w: wp.float64):
    """Whether a corner lies behind the light or nearly beside it."""
    return not (w > ALONG_LIGHT * (wp.abs(x) + wp.abs(y)) and w > TINY)


@wp.func
def planes_of(face: LightFace, a: wp.vec4d):
    """A bit for each side of the grid's pyramid that a corner is outside of, and 16 where it is behind the light."""
    margin = wp.float64(face.margin) / CELL
    left = wp.float64(face.left) - margin / wp.float64(face.columns_per_u)
    right = wp.float64(face.left) + (wp.float64(face.resolution) + margin) / wp.float64(face.columns_per_u)
    low = wp.float64(face.low) - margin / wp.float64(face.rows_per_v)
    high = wp.float64(face.low) + (wp.float64(face.resolution) + margin) / wp.float64(face.rows_per_v)
    return (
        wp.where(a[0] < left * a[2], 1, 0)
        | wp.where(a[0] > right * a[2], 2, 0)
        | wp.where(a[1] < low * a[2], 4, 0)
        | wp.where(a[1] > high * a[2], 8, 0)
        | wp.where(a[2] <= wp.float64(0.0), 16, 0)
    )


@wp.kernel
def bound_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    face: LightFace,
    rows_out: wp.array(dtype=int),
    columns_out: wp.array(dtype=int),
):
    """The rows and columns of cells that hold every receiver which a triangle may hide; NO_ROWS where there is none."""
    t = first + wp.tid()
    a = to_face(face, points_ws[indices[3 * t]])
    b = to_face(face, points_ws[indices[3 * t + 1]])
    c = to_face(face, points_ws[indices[3 * t + 2]])
    last = face.resolution - 1
    rows = int(NO_ROWS)
    columns = int(0)
    if is_beside(a[0], a[1], a[2]) or is_beside(b[0], b[1], b[2]) or is_beside(c[0], c[1], c[2]):
        # its edges, not its corners, say which cells it touches
        outside = planes_of(face, a) & planes_of(face, b) & planes_of(face, c)
        size = wp.length_sq(a) + wp.length_sq(b) + wp.length_sq(c)
        if outside == 0 and size < wp.float64(1.0e300):
            rows = pack_span(0, last)
            columns = pack_span(0, last)
    else:
        left = wp.float64(face.left)
        low = wp.float64(face.low)
        per_u = wp.float64(face.columns_per_u)
        per_v = wp.float64(face.rows_per_v)
        a_column = subcell((a[0] / a[2] - left) * per_u)
        b_column = subcell((b[0] / b[2] - left) * per_u)
        c_column = subcell((c[0] / c[2] - left) * per_u)
        a_row = subcell((a[1] / a[2] - low) * per_v)
        b_row = subcell((b[1] / b[2] - low) * per_v)
        c_row = subcell((c[1] / c[2] - low) * per_v)
        x0 = wp.max((wp.min(wp.min(a_column, b_column), c_column) - face.margin) >> 8, 0)
        x1 = wp.min((wp.max(wp.max(a_column, b_column), c_column) + face.margin) >> 8, last)
        y0 = wp.max((wp.min(wp.min(a_row, b_row), c_row) - face.margin) >> 8, 0)
        y1 = wp.min((wp.max(wp.max(a_row, b_row), c_row) + face.margin) >> 8, last)
        highest = wp.max(wp.max(a[3] / a[2], b[3] / b[2]), c[3] / c[2])
        if x0 <= x1 and y0 <= y1 and highest > wp.float64(face.lowest):
            rows = pack_span(y0, y1)
            columns = pack_span(x0, x1)
    rows_out[t] = rows
    columns_out[t] = columns


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
