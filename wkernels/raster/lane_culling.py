"""Passes 1 to 3 of the lane rasteriser: vertices to the screen, triangles culled and listed per band of rows."""

from __future__ import annotations

import warp as wp

from wkernels.raster.triangles import CLIP_TRIANGLES, CULL_BACK, CULL_NONE, GUARD_PIXELS, HALF_PIXEL, SUBPIXELS
from wkernels.views import View

LANES = wp.constant(128)  # vertices or triangles in one step
OUTSIDE = wp.constant(1 << 28)  # column of a vertex that needs clipping
SMALL = wp.constant(32767)  # subpixels: the widest box whose edge functions fit 32 bits

Ints = wp.types.vector(length=LANES, dtype=wp.int32)
Floats = wp.types.vector(length=LANES, dtype=wp.float32)


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


@wp.kernel
def project_lanes(
    first: int,
    points_ws: wp.array(dtype=float),  # flat (3 V,)
    count: int,
    view: View,
    perspective: int,
    column_out: wp.array(dtype=int),
    row_out: wp.array(dtype=int),
    key_out: wp.array(dtype=float),
):
    """Snapped screen position and depth key of 128 vertices.

    Where a vertex needs clipping its column is OUTSIDE, and its row has a bit for each plane that it is outside of.
    """
    begin = (first + wp.tid()) * LANES
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    near = view.near
    width = float(view.width)
    height = float(view.height)
    columns = Ints(0)
    rows = Ints(0)
    keys = Floats(0.0)
    for k in range(LANES):
        i = 3 * wp.min(begin + k, count - 1)
        x = points_ws[i]
        y = points_ws[i + 1]
        z = points_ws[i + 2]
        w = m30 * x + m31 * y + m32 * z + m33
        depth = m20 * x + m21 * y + m22 * z + m23
        x_h = 0.5 * ((m00 * x + m01 * y + m02 * z + m03) + w) * width
        y_h = 0.5 * (w - (m10 * x + m11 * y + m12 * z + m13)) * height
        guard = GUARD_PIXELS * w
        behind = wp.where(depth >= near, wp.where(w > 0.0, 0, 1), 1)
        beside = wp.where(x_h < -guard, 2, wp.where(x_h > guard, 4, 0))
        above = wp.where(y_h < -guard, 8, wp.where(y_h > guard, 16, 0))
        planes = behind | beside | above
        inside = wp.where(planes == 0, 1, 0)
        over_w = 1.0 / wp.where(inside == 1, w, 1.0)
        columns[k] = wp.where(
            inside == 1, int(wp.floor(wp.where(inside == 1, x_h, 0.0) * over_w * float(SUBPIXELS) + 0.5)), OUTSIDE
        )
        snapped_y = int(wp.floor(wp.where(inside == 1, y_h, 0.0) * over_w * float(SUBPIXELS) + 0.5))
        rows[k] = wp.where(inside == 1, snapped_y, planes)
        keys[k] = wp.where(perspective == 1, -over_w, depth)
    for k in range(wp.min(LANES, count - begin)):
        column_out[begin + k] = columns[k]
        row_out[begin + k] = rows[k]
        key_out[begin + k] = keys[k]


@wp.kernel
def append_clipped(
    first: int,
    clip_screen: wp.array(dtype=wp.vec4),
    clip_corners: wp.array(dtype=wp.vec3i),
    vertices: int,
    triangles: int,
    perspective: int,
    column_out: wp.array(dtype=int),
    row_out: wp.array(dtype=int),
    key_out: wp.array(dtype=float),
    corners_out: wp.array(dtype=int),
):
    """Adds the fan of one clipped triangle behind the mesh's own vertices and triangles."""
    slot = first + wp.tid()
    for i in range(slot * CLIP_TRIANGLES, (slot + 1) * CLIP_TRIANGLES):
        for k in range(3):
            v = clip_corners[i][k]
            screen = clip_screen[v]
            column_out[vertices + v] = int(wp.floor(screen[0] * float(SUBPIXELS) + 0.5))
            row_out[vertices + v] = int(wp.floor(screen[1] * float(SUBPIXELS) + 0.5))
            key_out[vertices + v] = wp.where(perspective == 1, -screen[3], screen[2])
            corners_out[3 * (triangles + i) + k] = vertices + v


@wp.kernel
def cull_lanes(
    first: int,
    corners: wp.array(dtype=int),  # flat (3 T,)
    column: wp.array(dtype=int),
    row: wp.array(dtype=int),
    begin: int,
    end: int,
    chunk: int,
    chunks: int,
    width: int,
    height: int,
    band_rows: int,
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
    t_begin = begin + int(wp.int64(end - begin) * wp.int64(part) / wp.int64(chunks))
    t_end = begin + int(wp.int64(end - begin) * wp.int64(part + 1) / wp.int64(chunks))
    for band in range(counts_out.shape[0]):
        counts_out[band, own] = 0
    keep = Ints(0)
    outside = Ints(0)
    tops = Ints(0)
    bottoms = Ints(0)
    kept = Ints(0)
    survivors = int(t_begin)
    clipped = int(t_begin)
    for t0 in range(t_begin, t_end, LANES):
        for k in range(LANES):
            t = 3 * wp.min(t0 + k, t_end - 1)
            a = corners[t]
            b = corners[t + 1]
            c = corners[t + 2]
            ax = column[a]
            bx = column[b]
            cx = column[c]
            ay = row[a]
            by = row[b]
            cy = row[c]
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
            tops[k] = top
            bottoms[k] = bottom
        n = int(0)
        crossing = int(0)
        for k in range(wp.min(LANES, t_end - t0)):
            kept[n] = k
            n += keep[k]
            crossing += outside[k]
        for i in range(n):
            k = kept[i]
            band_a = tops[k] / band_rows
            band_b = bottoms[k] / band_rows
            survivor_out[survivors] = t0 + k
            span_out[survivors] = band_a + (band_b << 16)
            survivors += 1
            for band in range(band_a, band_b + 1):
                counts_out[band, own] += 1
        if crossing > 0:
            for k in range(wp.min(LANES, t_end - t0)):
                if outside[k] != 0:
                    clipped_out[clipped] = t0 + k
                    clipped += 1
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
    for i in range(chunk_begin[chunk], chunk_begin[chunk] + found[0, chunk]):
        for band in range(span[i] & 65535, (span[i] >> 16) + 1):
            slot = next_slot[band, chunk]
            next_slot[band, chunk] = slot + 1
            list_out[slot] = survivor[i]
