"""Passes 1 to 3 of the lane rasteriser: vertices to the screen, triangles culled and listed per band of rows."""

from __future__ import annotations

import warp as wp

from wkernels.raster.clipping import CLIP_TRIANGLES
from wkernels.raster.triangles import CULL_BACK, CULL_NONE, GUARD_PIXELS, HALF_PIXEL, SUBPIXELS
from wkernels.scene.views import View

MESH_LANES = wp.constant(128)  # vertices or triangles in one step
OUTSIDE = wp.constant(1 << 28)  # column of a vertex that needs clipping
SMALL = wp.constant(32767)  # subpixels: the widest box whose edge functions fit 32 bits

Ints = wp.types.vector(length=MESH_LANES, dtype=wp.int32)
Longs = wp.types.vector(length=MESH_LANES, dtype=wp.int64)
Floats = wp.types.vector(length=MESH_LANES, dtype=wp.float32)
Points = wp.types.vector(length=3 * MESH_LANES, dtype=wp.float32)


@wp.func
def first_centre(low: int):
    """First pixel whose centre is not before a coordinate in subpixels."""
    return (low + HALF_PIXEL - 1) >> 8


@wp.func
def last_centre(high: int):
    """Last pixel whose centre is not behind a coordinate in subpixels."""
    return (high - HALF_PIXEL) >> 8


@wp.func
def edge_32(ax: int, ay: int, bx: int, by: int, x: int, y: int):
    """``triangles.edge`` for coordinates less than 128 pixels apart."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@wp.func
def pack(column: int, row: int):
    """Snapped coordinates as one number, as fetching two costs twice as much."""
    return (wp.int64(row) << wp.int64(32)) | (wp.int64(column) & wp.int64(0xFFFFFFFF))


@wp.func
def column_of(vertex: wp.int64):
    """The column in ``pack``."""
    return wp.int32(vertex)


@wp.func
def row_of(vertex: wp.int64):
    """The row in ``pack``."""
    return wp.int32(vertex >> wp.int64(32))


@wp.kernel
def project_lanes(
    first: int,
    points_ws: wp.array(dtype=Points),  # (V / 128,), whole runs only
    last_points_ws: wp.array2d(dtype=Points),  # (1, 1): what is left, anything behind it
    view: View,
    perspective: int,
    vertex_out: wp.array(dtype=Longs),
    key_out: wp.array(dtype=Floats),
):
    """Snapped screen position and depth key of 128 vertices.

    Where a vertex needs clipping its column is OUTSIDE, and its row has a bit for each plane that it is outside of.
    """
    run = first + wp.tid()
    points = last_points_ws[0, 0]
    if run < points_ws.shape[0]:
        points = points_ws[run]
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    near = view.near
    width = float(view.width)
    height = float(view.height)
    vertices = Longs()
    keys = Floats(0.0)
    for k in range(MESH_LANES):
        x = points[3 * k]
        y = points[3 * k + 1]
        z = points[3 * k + 2]
        w = m30 * x + m31 * y + m32 * z + m33
        depth = m20 * x + m21 * y + m22 * z + m23
        x_h = 0.5 * ((m00 * x + m01 * y + m02 * z + m03) + w) * width
        y_h = 0.5 * (w - (m10 * x + m11 * y + m12 * z + m13)) * height
        guard = GUARD_PIXELS * w
        behind = wp.where(depth >= near, 0, 1) | wp.where(w > 0.0, 0, 32)  # two planes where the projection is warped
        beside = wp.where(x_h < -guard, 2, wp.where(x_h > guard, 4, 0))
        above = wp.where(y_h < -guard, 8, wp.where(y_h > guard, 16, 0))
        planes = behind | beside | above
        inside = wp.where(planes == 0, 1, 0)
        over_w = 1.0 / wp.where(inside == 1, w, 1.0)
        column = wp.where(
            inside == 1, int(wp.floor(wp.where(inside == 1, x_h, 0.0) * over_w * float(SUBPIXELS) + 0.5)), OUTSIDE
        )
        snapped_y = int(wp.floor(wp.where(inside == 1, y_h, 0.0) * over_w * float(SUBPIXELS) + 0.5))
        vertices[k] = pack(column, wp.where(inside == 1, snapped_y, planes))
        keys[k] = wp.where(perspective == 1, -over_w, depth * over_w)
    vertex_out[run] = vertices
    key_out[run] = keys


@wp.kernel
def append_clipped(
    first: int,
    clip_screen: wp.array(dtype=wp.vec4),
    clip_corners: wp.array(dtype=wp.vec3i),
    vertices: int,  # where the first new vertex and triangle go
    triangles: int,
    perspective: int,
    vertex_out: wp.array(dtype=wp.int64),
    key_out: wp.array(dtype=float),
    corners_out: wp.array(dtype=int),
    pitch: int,
):
    """Adds the fan of one clipped triangle behind the mesh's own vertices and triangles."""
    slot = first + wp.tid()
    for i in range(slot * CLIP_TRIANGLES, (slot + 1) * CLIP_TRIANGLES):
        for k in range(3):
            v = clip_corners[i][k]
            screen = clip_screen[v]
            column = int(wp.floor(screen[0] * float(SUBPIXELS) + 0.5))
            vertex_out[vertices + v] = pack(column, int(wp.floor(screen[1] * float(SUBPIXELS) + 0.5)))
            key_out[vertices + v] = wp.where(perspective == 1, -screen[3], screen[2])
            corners_out[k * pitch + triangles + i] = vertices + v


@wp.func
def chunk_start(begin: int, end: int, part: int, chunks: int):
    """First triangle of a part of begin..end: a whole number of runs, or the end."""
    runs = (end + MESH_LANES - 1) / MESH_LANES - begin / MESH_LANES
    return wp.clamp(
        (begin / MESH_LANES + int(wp.int64(runs) * wp.int64(part) / wp.int64(chunks))) * MESH_LANES, begin, end
    )


@wp.kernel
def cull_lanes(
    first: int,
    corners: wp.array(dtype=Ints),  # all first corners, from run ``pitch`` on all second ones, then all third ones
    pitch: int,
    vertex: wp.array(dtype=wp.int64),  # (V,)
    begin: int,
    end: int,
    chunk: int,
    chunks: int,
    width: int,
    height: int,
    band_shift: int,  # a band has 1 << this rows
    cull: int,
    survivor_out: wp.array(dtype=int),  # from each chunk's first triangle on
    span_out: wp.array(dtype=int),  # first band, and last band << 16
    clipped_out: wp.array(dtype=int),  # likewise: triangles with a vertex that needs clipping
    found_out: wp.array2d(dtype=int),  # (2, chunks): survivors, clipped
    counts_out: wp.array2d(dtype=int),  # (bands, chunks)
):
    """Which triangles of one chunk of begin..end cover a pixel centre's box, and how many each band gets."""
    part = first + wp.tid()
    own = chunk + part
    t_begin = chunk_start(begin, end, part, chunks)
    t_end = chunk_start(begin, end, part + 1, chunks)
    for band in range(counts_out.shape[0]):
        counts_out[band, own] = 0
    keep = Ints(0)
    outside = Ints(0)
    spans = Ints(0)
    kept = Ints(0)
    survivors = int(t_begin)
    clipped = int(t_begin)
    # neighbouring triangles mostly lie in the same band: they are counted when another one comes
    last_span = int(0)
    alike = int(0)
    for t0 in range(t_begin, t_end, MESH_LANES):
        corners_a = corners[t0 / MESH_LANES]
        corners_b = corners[pitch + t0 / MESH_LANES]
        corners_c = corners[2 * pitch + t0 / MESH_LANES]
        for k in range(MESH_LANES):
            a = vertex[corners_a[k]]
            b = vertex[corners_b[k]]
            c = vertex[corners_c[k]]
            ax = column_of(a)
            bx = column_of(b)
            cx = column_of(c)
            ay = row_of(a)
            by = row_of(b)
            cy = row_of(c)
            low_x = wp.min(wp.min(ax, bx), cx)
            high_x = wp.max(wp.max(ax, bx), cx)
            low_y = wp.min(wp.min(ay, by), cy)
            high_y = wp.max(wp.max(ay, by), cy)
            top = wp.max(first_centre(low_y), 0)
            bottom = wp.min(last_centre(high_y), height - 1)
            across = wp.min(last_centre(high_x), width - 1) - wp.max(first_centre(low_x), 0)
            # rows run downwards, so a triangle that is counter-clockwise seen from the view has negative area here
            area = edge_32(ax, ay, bx, by, cx, cy)
            side = wp.where(cull == CULL_NONE, wp.abs(area), wp.where(cull == CULL_BACK, -area, area))
            faces = wp.where(wp.max(high_x - low_x, high_y - low_y) > SMALL, 1, wp.where(side > 0, 1, 0))
            covers = wp.where(across >= 0, wp.where(bottom >= top, faces, 0), 0)
            keep[k] = wp.where(high_x < OUTSIDE, covers, 0)
            beyond_a = wp.where(ax < OUTSIDE, 0, ay)
            beyond_b = wp.where(bx < OUTSIDE, 0, by)
            beyond_c = wp.where(cx < OUTSIDE, 0, cy)
            hidden = beyond_a & beyond_b & beyond_c  # all three outside of one plane: nothing would be left
            outside[k] = wp.where(high_x < OUTSIDE, 0, wp.where(hidden != 0, 0, 1))
            spans[k] = (top >> band_shift) | ((bottom >> band_shift) << 16)
        n = int(0)
        crossing = int(0)
        for k in range(wp.min(MESH_LANES, t_end - t0)):
            kept[n] = k
            n += keep[k]
            crossing += outside[k]
        for i in range(n):
            k = kept[i]
            span = spans[k]
            survivor_out[survivors] = t0 + k
            span_out[survivors] = span
            survivors += 1
            if span != last_span:
                for band in range(last_span & 65535, (last_span >> 16) + 1):
                    counts_out[band, own] += alike
                last_span = span
                alike = 0
            alike += 1
        if crossing > 0:
            for k in range(wp.min(MESH_LANES, t_end - t0)):
                if outside[k] != 0:
                    clipped_out[clipped] = t0 + k
                    clipped += 1
    for band in range(last_span & 65535, (last_span >> 16) + 1):
        counts_out[band, own] += alike
    found_out[0, own] = survivors - t_begin
    found_out[1, own] = clipped - t_begin


@wp.kernel
def list_bands(
    first: int,
    survivor: wp.array(dtype=int),
    span: wp.array(dtype=int),
    chunk_begin: wp.array(dtype=int),
    found: wp.array2d(dtype=int),
    next_slot: wp.array2d(dtype=int),  # (bands, chunks), advanced
    list_out: wp.array(dtype=int),
):
    """Writes the survivors of one chunk into the bands' lists, in triangle order."""
    chunk = first + wp.tid()
    current = int(-1)  # the band whose next slot is held
    slot = int(0)
    for i in range(chunk_begin[chunk], chunk_begin[chunk] + found[0, chunk]):
        band_a = span[i] & 65535
        band_b = span[i] >> 16
        if band_a != current or band_b != current:
            if current >= 0:
                next_slot[current, chunk] = slot
            current = wp.where(band_a == band_b, band_a, -1)
            if current >= 0:
                slot = next_slot[current, chunk]
        if current >= 0:
            list_out[slot] = survivor[i]
            slot += 1
        else:
            for band in range(band_a, band_b + 1):
                slot = next_slot[band, chunk]
                next_slot[band, chunk] = slot + 1
                list_out[slot] = survivor[i]
    if current >= 0:
        next_slot[current, chunk] = slot
