"""The CPU rasteriser: four passes whose inner loops LLVM turns into SIMD.

1. ``project_lanes``: vertices to snapped screen coordinates and a depth key that is affine on the screen.
2. ``cull_lanes``: bounding boxes, orientation and area of 128 triangles at a time; survivors are counted per band of rows.
3. ``list_bands``: survivors into the bands' lists, in triangle order.
4. ``draw_band``: 64 triangles at a time are set up, then each is drawn in pieces of 8 pixels of a row.

A loop becomes SIMD where it has a constant trip count, fixed-size local vectors for storage, and flat scalar arrays; that is
why coordinates are kept apart, and why ``where`` stands for ``if``. Coverage is that of ``triangles.edge``: edge functions of
triangles up to 128 pixels wide fit 32 bits, and as all pixel centres share their value modulo one pixel, what is left after
dividing by 256 fits the 24 bits of a float exactly. Wider triangles get the exact span of each row from 64-bit divisions.
The key is the depth itself for orthographic views and -1/depth for perspective ones, so that nearer is less in both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.raster.scratch import Scratch
from wkernels.raster.triangles import (
    CLIP_TRIANGLES,
    CLIP_VERTICES,
    CULL_BACK,
    CULL_NONE,
    GUARD_PIXELS,
    HALF_PIXEL,
    NO_TRIANGLE,
    PIXEL_STEP,
    SUBPIXELS,
    clip_triangles,
    edge,
    top_left_bias,
)
from wkernels.views import View

MAX_TRIANGLES = 2**24  # the triangle of a pixel is kept in a float, next to its depth
CHUNKS = 32
BAND_BYTES = 2**18  # a band's depths stay in the second-level cache
PERSPECTIVE, ORTHOGRAPHIC = 1, 0
PIECE = wp.constant(8)  # pixels drawn at once
PIECE_64 = wp.constant(wp.float64(8.0))
PIXEL_64 = wp.constant(wp.float64(256.0))
CULLED = wp.constant(128)  # triangles culled at once
SET_UP = wp.constant(64)  # triangles set up at once
OUTSIDE = wp.constant(1 << 28)  # column of a vertex that needs clipping
SMALL = wp.constant(32767)  # subpixels: the widest box whose edge functions fit 32 bits
FAR_KEY = wp.constant(1.0e30)
UNCOVERED = wp.constant(-4.0e30)  # times (edge function + 1/2): beyond any key where negative, below any where not
HUGE = wp.constant(1.0e38)

Culled = wp.types.vector(length=CULLED, dtype=wp.int32)
CulledFloat = wp.types.vector(length=CULLED, dtype=wp.float32)
SetUp = wp.types.vector(length=SET_UP, dtype=wp.int32)
SetUpFloat = wp.types.vector(length=SET_UP, dtype=wp.float32)
Piece = wp.types.vector(length=PIECE, dtype=wp.float32)

_STEPS = Piece(*range(PIECE))


def projection_kind(view: View) -> int | None:
    """PERSPECTIVE, ORTHOGRAPHIC, or None for a view whose depth key is not affine on the screen (a warped one)."""
    rows = np.array(view.ws_to_ss, dtype=np.float32).reshape(4, 4)
    if np.array_equal(rows[3], (0.0, 0.0, 0.0, 1.0)):
        return ORTHOGRAPHIC
    return PERSPECTIVE if np.array_equal(rows[3], rows[2]) else None


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
def bias_32(ax: int, ay: int, bx: int, by: int):
    """``triangles.top_left_bias``."""
    return wp.where(by < ay, 0, wp.where(by == ay, wp.where(bx > ax, 0, -1), -1))


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
    begin = (first + wp.tid()) * CULLED
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    near = view.near
    width = float(view.width)
    height = float(view.height)
    columns = Culled(0)
    rows = Culled(0)
    keys = CulledFloat(0.0)
    for k in range(CULLED):
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
    for k in range(wp.min(CULLED, count - begin)):
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
    keep = Culled(0)
    outside = Culled(0)
    tops = Culled(0)
    bottoms = Culled(0)
    kept = Culled(0)
    survivors = int(t_begin)
    clipped = int(t_begin)
    for t0 in range(t_begin, t_end, CULLED):
        for k in range(CULLED):
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
        for k in range(wp.min(CULLED, t_end - t0)):
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
            for k in range(wp.min(CULLED, t_end - t0)):
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


@wp.func
def add_row(low: wp.int64, step: wp.int64, span: wp.vec2i):
    """Narrows a span of pixels to where ``low + step * pixel >= 0``."""
    begin = span[0]
    end = span[1]
    if step > wp.int64(0):
        pixel = -low / step
        if pixel * step < -low:
            pixel += wp.int64(1)
        begin = wp.max(begin, int(wp.min(pixel, wp.int64(65536))))
    elif step < wp.int64(0):
        pixel = low / -step
        if pixel * -step > low:
            pixel -= wp.int64(1)
        end = wp.min(end, int(wp.max(pixel, wp.int64(-1))))
    elif low < wp.int64(0):
        end = -1
    return wp.vec2i(begin, end)


@wp.struct
class Target:
    """What one band is drawn into: rows of ``pitch`` floats, of which pieces may start anywhere."""

    key: wp.array(dtype=float)
    key_piece: wp.array(dtype=Piece)  # the same memory, a piece from every float on
    triangle: wp.array(dtype=float)
    triangle_piece: wp.array(dtype=Piece)
    with_triangles: int
    pitch: int
    width: int


@wp.func
def draw_piece(target: Target, at: int, key: Piece, triangle: Piece):
    """Keeps the nearer of a piece's keys and the target's, and its triangle; the first stays where they are equal."""
    old = target.key_piece[at]
    if target.with_triangles != 0:
        nearer = wp.min(wp.max((old - key) * HUGE, Piece(0.0)), Piece(1.0))
        held = target.triangle_piece[at]
        target.triangle_piece[at] = held + wp.cw_mul(nearer, triangle - held)
    target.key_piece[at] = wp.min(old, key)


@wp.func
def draw_wide(
    target: Target,
    corners: wp.array(dtype=int),
    column: wp.array(dtype=int),
    row: wp.array(dtype=int),
    key: wp.array(dtype=float),
    t: int,
    triangle: float,
    box: wp.vec4i,
    cull: int,
    steps: Piece,
):
    """Draws a triangle of any size within ``box`` (x0, y0, x1, y1), row by row between its exact borders."""
    a = corners[3 * t]
    b = corners[3 * t + 1]
    c = corners[3 * t + 2]
    ax = wp.int64(column[a])
    ay = wp.int64(row[a])
    bx = wp.int64(column[b])
    by = wp.int64(row[b])
    cx = wp.int64(column[c])
    cy = wp.int64(row[c])
    key_a = wp.float64(key[a])
    key_b = wp.float64(key[b])
    key_c = wp.float64(key[c])
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == wp.int64(0) or (area < wp.int64(0) and cull == 2) or (area > wp.int64(0) and cull == 1):
        return
    if area < wp.int64(0):
        other_x = bx
        other_y = by
        other_key = key_b
        bx = cx
        by = cy
        key_b = key_c
        cx = other_x
        cy = other_y
        key_c = other_key
        area = -area
    lowest = float(wp.min(wp.min(key_a, key_b), key_c))
    highest = float(wp.max(wp.max(key_a, key_b), key_c))
    over_area = wp.float64(1.0) / wp.float64(area)
    step_a = by - cy
    step_b = cy - ay
    step_c = ay - by
    slope = (
        (wp.float64(step_a) * key_a + wp.float64(step_b) * key_b + wp.float64(step_c) * key_c)
        * over_area
        * PIXEL_64
    )
    rise = steps * float(slope)
    low_piece = Piece(lowest)
    high_piece = Piece(highest)
    triangle_piece = Piece(triangle)
    x = wp.int64(box[0] * SUBPIXELS + HALF_PIXEL)
    for y_px in range(box[1], box[3] + 1):
        y = wp.int64(y_px * SUBPIXELS + HALF_PIXEL)
        e_a = edge(bx, by, cx, cy, x, y)
        e_b = edge(cx, cy, ax, ay, x, y)
        e_c = edge(ax, ay, bx, by, x, y)
        span = wp.vec2i(0, box[2] - box[0])
        span = add_row((e_a + top_left_bias(bx, by, cx, cy)) >> wp.int64(8), step_a, span)
        span = add_row((e_b + top_left_bias(cx, cy, ax, ay)) >> wp.int64(8), step_b, span)
        span = add_row((e_c + top_left_bias(ax, ay, bx, by)) >> wp.int64(8), step_c, span)
        count = span[1] - span[0] + 1
        # in double up to each piece: what 8 pixels add in float stays below the rounding of the key
        value = (wp.float64(e_a) * key_a + wp.float64(e_b) * key_b + wp.float64(e_c) * key_c) * over_area
        value += wp.float64(span[0]) * slope
        at = y_px * target.pitch + box[0] + span[0]
        for piece in range(wp.max(count, 0) / PIECE):
            draw_piece(target, at, wp.min(wp.max(rise + Piece(float(value)), low_piece), high_piece), triangle_piece)
            value += PIECE_64 * slope
            at += PIECE
        for k in range(wp.max(count, 0) % PIECE):
            near = wp.clamp(float(value + wp.float64(k) * slope), lowest, highest)
            if near < target.key[at + k]:
                target.key[at + k] = near
                if target.with_triangles != 0:
                    target.triangle[at + k] = triangle


@wp.kernel
def draw_band(
    first: int,
    corners: wp.array(dtype=int),
    column: wp.array(dtype=int),
    row: wp.array(dtype=int),
    key: wp.array(dtype=float),
    clip_triangle: wp.array(dtype=int),
    triangles: int,
    band_begin: wp.array(dtype=int),
    band_list: wp.array(dtype=int),
    band_rows: int,
    height: int,
    far: float,
    perspective: int,
    cull: int,
    steps: Piece,
    target: Target,
    depth_piece: wp.array(dtype=Piece),
    depth_out: wp.array2d(dtype=float),
    triangle_out: wp.array2d(dtype=int),
):
    """Clears one band of rows, draws its triangles, and turns keys into depths."""
    band = first + wp.tid()
    pitch = target.pitch
    top = band * band_rows
    bottom = wp.min(top + band_rows, height) - 1
    background = wp.where(perspective == 1, 0.0, FAR_KEY)
    clear = Piece(background)
    nothing = Piece(-1.0)
    for at in range(top * pitch, (bottom + 1) * pitch, PIECE):
        target.key_piece[at] = clear
    if target.with_triangles != 0:
        for at in range(top * pitch, (bottom + 1) * pitch, PIECE):
            target.triangle_piece[at] = nothing
    e_a = SetUpFloat(0.0)
    e_b = SetUpFloat(0.0)
    e_c = SetUpFloat(0.0)
    dx_a = SetUpFloat(0.0)
    dx_b = SetUpFloat(0.0)
    dx_c = SetUpFloat(0.0)
    dy_a = SetUpFloat(0.0)
    dy_b = SetUpFloat(0.0)
    dy_c = SetUpFloat(0.0)
    key_0 = SetUpFloat(0.0)
    lowest = SetUpFloat(0.0)
    highest = SetUpFloat(0.0)
    by_a = SetUpFloat(0.0)
    by_b = SetUpFloat(0.0)
    by_c = SetUpFloat(0.0)
    name = SetUpFloat(0.0)
    x0 = SetUp(0)
    x1 = SetUp(0)
    y0 = SetUp(0)
    y1 = SetUp(0)
    wide = SetUp(0)
    list_end = band_begin[band + 1]
    for i0 in range(band_begin[band], list_end, SET_UP):
        for k in range(SET_UP):
            t = band_list[wp.min(i0 + k, list_end - 1)]
            a = corners[3 * t]
            b = corners[3 * t + 1]
            c = corners[3 * t + 2]
            ax = column[a]
            ay = row[a]
            b_x = column[b]
            b_y = row[b]
            c_x = column[c]
            c_y = row[c]
            area = edge_32(ax, ay, b_x, b_y, c_x, c_y)
            swap = wp.where(area < 0, 1, 0)
            bx = wp.where(swap == 1, c_x, b_x)
            by = wp.where(swap == 1, c_y, b_y)
            cx = wp.where(swap == 1, b_x, c_x)
            cy = wp.where(swap == 1, b_y, c_y)
            key_a = key[a]
            key_b = wp.where(swap == 1, key[c], key[b])
            key_c = wp.where(swap == 1, key[b], key[c])
            low_x = wp.min(wp.min(ax, bx), cx)
            high_x = wp.max(wp.max(ax, bx), cx)
            low_y = wp.min(wp.min(ay, by), cy)
            high_y = wp.max(wp.max(ay, by), cy)
            left = wp.max(first_centre(low_x), 0)
            upper = wp.max(first_centre(low_y), top)
            x = left * SUBPIXELS + HALF_PIXEL
            y = upper * SUBPIXELS + HALF_PIXEL
            f_a = edge_32(bx, by, cx, cy, x, y)
            f_b = edge_32(cx, cy, ax, ay, x, y)
            f_c = edge_32(ax, ay, bx, by, x, y)
            g_a = (f_a + bias_32(bx, by, cx, cy)) >> 8
            g_b = (f_b + bias_32(cx, cy, ax, ay)) >> 8
            g_c = (f_c + bias_32(ax, ay, bx, by)) >> 8
            e_a[k] = float(g_a)
            e_b[k] = float(g_b)
            e_c[k] = float(g_c)
            dx_a[k] = float(by - cy)
            dx_b[k] = float(cy - ay)
            dx_c[k] = float(ay - by)
            dy_a[k] = float(cx - bx)
            dy_b[k] = float(ax - cx)
            dy_c[k] = float(bx - ax)
            # The key is the edge functions' weighted sum. Inside, no term has another sign, so that nothing cancels.
            over_area = 1.0 / float(wp.max(wp.abs(area), 1))
            key_0[k] = (
                float(f_a - 256 * g_a) * key_a + float(f_b - 256 * g_b) * key_b + float(f_c - 256 * g_c) * key_c
            ) * over_area
            lowest[k] = wp.min(wp.min(key_a, key_b), key_c)
            highest[k] = wp.max(wp.max(key_a, key_b), key_c)
            by_a[k] = key_a * (over_area * float(SUBPIXELS))
            by_b[k] = key_b * (over_area * float(SUBPIXELS))
            by_c[k] = key_c * (over_area * float(SUBPIXELS))
            x0[k] = left
            x1[k] = wp.min(last_centre(high_x), target.width - 1)
            y0[k] = upper
            y1[k] = wp.min(last_centre(high_y), bottom)
            wide[k] = wp.where(wp.max(high_x - low_x, high_y - low_y) > SMALL, 1, 0)
            name[k] = float(wp.where(t < triangles, t, clip_triangle[wp.max(t - triangles, 0)]))
        for k in range(wp.min(SET_UP, list_end - i0)):
            if wide[k] != 0:
                box = wp.vec4i(x0[k], y0[k], x1[k], y1[k])
                draw_wide(target, corners, column, row, key, band_list[i0 + k], name[k], box, cull, steps)
            else:
                name_piece = Piece(name[k])
                rest = Piece(key_0[k])
                low_piece = Piece(lowest[k])
                high_piece = Piece(highest[k])
                down_a = Piece(dy_a[k])
                down_b = Piece(dy_b[k])
                down_c = Piece(dy_c[k])
                for column_0 in range(x0[k], x1[k] + 1, PIECE):
                    right = float(column_0 - x0[k])
                    in_a = steps * dx_a[k] + Piece(e_a[k] + right * dx_a[k])
                    in_b = steps * dx_b[k] + Piece(e_b[k] + right * dx_b[k])
                    in_c = steps * dx_c[k] + Piece(e_c[k] + right * dx_c[k])
                    at = y0[k] * pitch + column_0
                    for _y in range(y0[k], y1[k] + 1):
                        inside = wp.min(wp.min(in_a, in_b), in_c)
                        near = in_a * by_a[k] + in_b * by_b[k] + in_c * by_c[k] + rest
                        near = wp.min(wp.max(near, low_piece), high_piece)
                        draw_piece(target, at, wp.max(near, (inside + Piece(0.5)) * UNCOVERED), name_piece)
                        in_a += down_a
                        in_b += down_b
                        in_c += down_c
                        at += pitch
    # Keys become depths; what lies beyond the far plane, and the background, overflows to infinity.
    one = Piece(1.0)
    zero = Piece(0.0)
    limit = Piece(far)
    for y in range(top, bottom + 1):
        for x in range(0, target.width - PIECE + 1, PIECE):
            depth = target.key_piece[y * pitch + x]
            if perspective == 1:
                depth = wp.cw_div(one, zero - depth)  # 0 - 0 is +0, whose reciprocal is +inf
            depth_piece[y * target.width + x] = depth + wp.max(depth - limit, zero) * HUGE * HUGE
        for x in range(target.width - target.width % PIECE, target.width):
            last = float(target.key[y * pitch + x])
            if perspective == 1:
                last = 1.0 / (0.0 - last)
            depth_out[y, x] = wp.where(last <= far, last, wp.inf)
        if target.with_triangles != 0:
            for x in range(target.width):
                triangle_out[y, x] = wp.where(depth_out[y, x] <= far, int(target.triangle[y * pitch + x]), NO_TRIANGLE)


class LaneRasteriser:
    """Draws perspective and orthographic views on the CPU.

    Args:
        scratch: Memory, device and threads.
    """

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch
        self._corners_of: wp.array | None = None  # whose copy the first part of the scratch "corners" is

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        perspective: int,
        depth_out: wp.array,
        triangle_out: wp.array | None,
        cull: int,
    ) -> None:
        """``Rasteriser.draw`` for fewer than MAX_TRIANGLES triangles; ``perspective`` is the view's ``projection_kind``."""
        scratch = self._scratch
        vertices, triangles = len(points_ws), len(indices) // 3
        pitch = -(-(view.width + PIECE) // PIECE) * PIECE  # a piece may begin at the last pixel of a row
        band_rows = min(64, max(8, BAND_BYTES // (4 * pitch)), max(1, -(-view.height // 4)))
        bands = -(-view.height // band_rows)

        corners = self._corners(indices, 3 * triangles)
        column, row, key = self._vertices(vertices)
        flat = wp.array(ptr=points_ws.ptr, dtype=float, shape=3 * vertices, device="cpu") if vertices else points_ws
        inputs: list[Any] = [flat, vertices, view, perspective]
        scratch.launch(project_lanes, -(-vertices // CULLED), inputs, [column, row, key])

        survivor, span, clipped = (scratch.array(name, (triangles,), int) for name in ("survivor", "span", "clipped"))
        found = scratch.array("found", (2, CHUNKS + 1), int)
        counts = scratch.array("counts", (bands, CHUNKS + 1), int)
        chunk_begin = np.array([triangles * k // CHUNKS for k in range(CHUNKS + 1)], dtype=np.int32)
        shape = [view.width, view.height, band_rows, cull]
        outputs = [survivor, span, clipped, found, counts]
        found.numpy()[:] = 0
        counts.numpy()[:] = 0
        if triangles:
            inputs = [corners, column, row, 0, triangles, 0, CHUNKS, *shape]
            scratch.launch(cull_lanes, CHUNKS, inputs, outputs, tile=1)
        crossing = [clipped.numpy()[b : b + n] for b, n in zip(chunk_begin, found.numpy()[1, :CHUNKS], strict=False) if n]
        slots = sum(len(part) for part in crossing)
        clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
        if slots:
            which = wp.array(np.concatenate(crossing), dtype=int, device="cpu")
            clip_screen = scratch.array("clip screen", (slots * CLIP_VERTICES,), wp.vec4)
            clip_corners = scratch.array("clip corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
            inputs = [points_ws, indices, which, view]
            scratch.launch(clip_triangles, slots, inputs, [clip_screen, clip_corners, clip_triangle])
            total = triangles + slots * CLIP_TRIANGLES
            corners = self._corners(indices, 3 * total)
            column, row, key = self._vertices(vertices + slots * CLIP_VERTICES, keep=vertices)
            survivor, span = (self._grown(name, total, triangles) for name in ("survivor", "span"))
            inputs = [clip_screen, clip_corners, vertices, triangles, perspective]
            scratch.launch(append_clipped, slots, inputs, [column, row, key, corners])
            inputs = [corners, column, row, triangles, total, CHUNKS, 1, *shape]
            scratch.launch(cull_lanes, 1, inputs, [survivor, span, clipped, found, counts])

        starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
        band_begin = scratch.array("band begin", (bands + 1,), int)
        band_begin.numpy()[: bands + 1] = starts[:: CHUNKS + 1]
        counts.numpy().ravel()[:] = starts[:-1]
        band_list = scratch.array("band list", (int(starts[-1]),), int)
        begins = wp.array(chunk_begin, dtype=int, device="cpu")
        scratch.launch(list_bands, CHUNKS + 1, [survivor, span, begins, found, counts], [band_list], tile=1)

        target = self._target(pitch, bands * band_rows, view.width, triangle_out is not None)
        if triangle_out is None:
            triangle_out = scratch.array("no triangles", (1, 1), int)
        pixels = view.width * view.height
        inputs = [corners, column, row, key, clip_triangle, triangles, band_begin, band_list, band_rows, view.height]
        inputs += [view.far, perspective, cull, _STEPS, target, _pieces(depth_out.ptr, pixels)]
        scratch.launch(draw_band, bands, inputs, [depth_out, triangle_out], tile=1)

    def _vertices(self, count: int, keep: int = 0) -> list[wp.array]:
        names = (("column", int), ("row", int), ("key", float))
        return [self._grown(name, count, keep, dtype) for name, dtype in names]

    def _grown(self, name: str, count: int, keep: int, dtype: type = int) -> wp.array:
        """A scratch array of at least ``count``; its first ``keep`` elements survive if it has to grow."""
        old = self._scratch.array(name, (keep,), dtype) if keep else None
        new = self._scratch.array(name, (count,), dtype)
        if old is not None and old.ptr != new.ptr:
            wp.copy(new, old, count=keep)
        return new

    def _corners(self, indices: wp.array, count: int) -> wp.array:
        """The mesh's indices with room for the corners of clipped triangles behind them."""
        before = self._scratch.array("corners", (len(indices),), int)
        out = self._scratch.array("corners", (count,), int)
        if self._corners_of is not indices or before.ptr != out.ptr:
            if len(indices):
                wp.copy(out, indices)
            self._corners_of = indices
        return out

    def _target(self, pitch: int, rows: int, width: int, with_triangles: bool) -> Target:
        size = pitch * rows + 2 * PIECE
        out = Target()
        out.key = self._scratch.array("target key", (size,), float)
        out.triangle = self._scratch.array("target triangle", (size if with_triangles else 1,), float)
        out.key_piece = _pieces(out.key.ptr, size)
        out.triangle_piece = _pieces(out.triangle.ptr, size if with_triangles else PIECE)
        out.with_triangles, out.pitch, out.width = int(with_triangles), pitch, width
        return out


def _pieces(address: int, floats: int) -> wp.array:
    """Memory of so many floats as overlapping pieces, one from every float on that has 7 more behind it."""
    return wp.array(ptr=address, dtype=Piece, shape=max(1, floats - PIECE + 1), strides=(4,), device="cpu")
