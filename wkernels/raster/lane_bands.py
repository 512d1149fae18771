"""Pass 4 of the lane rasteriser: the triangles of one band of rows into depths, 8 pixels of a row at a time."""

from __future__ import annotations

import warp as wp

from wkernels.raster.lane_culling import SMALL, column_of, edge_32, first_centre, last_centre, row_of
from wkernels.raster.lane_target import PIECE, DepthKey, Piece, Target, clear_rows, draw_piece, finish_rows
from wkernels.raster.triangles import (
    CULL_BACK,
    CULL_FRONT,
    HALF_PIXEL,
    SUBPIXELS,
    edge,
    top_left_bias,
)

BAND_LANES = wp.constant(64)  # triangles set up in one step
PIECE_64 = wp.constant(wp.float64(8.0))
PIXEL_64 = wp.constant(wp.float64(256.0))
UNCOVERED = wp.constant(-4.0e30)  # times (edge function + 1/2): beyond any key where negative, below any where not

Ints = wp.types.vector(length=BAND_LANES, dtype=wp.int32)
Floats = wp.types.vector(length=BAND_LANES, dtype=wp.float32)


@wp.func
def bias_32(ax: int, ay: int, bx: int, by: int):
    """``triangles.top_left_bias``."""
    return wp.where(by < ay, 0, wp.where(by == ay, wp.where(bx > ax, 0, -1), -1))


@wp.func
def add_row(low: wp.int64, step: wp.int64, span: wp.vec2i):
    """Narrows a span of pixels to where ``low + step * pixel >= 0``.

    Where an edge is nearly parallel to the row, the pixel at its border may be beyond 32 bits, on either side.
    """
    begin = span[0]
    end = span[1]
    if step > wp.int64(0):
        pixel = -low / step
        if pixel * step < -low:
            pixel += wp.int64(1)
        begin = wp.max(begin, int(wp.clamp(pixel, wp.int64(0), wp.int64(65536))))
    elif step < wp.int64(0):
        pixel = low / -step
        if pixel * -step > low:
            pixel -= wp.int64(1)
        end = wp.min(end, int(wp.clamp(pixel, wp.int64(-1), wp.int64(65536))))
    elif low < wp.int64(0):
        end = -1
    return wp.vec2i(begin, end)


@wp.func
def draw_wide(
    target: Target,
    corners: wp.array(dtype=int),
    corner_pitch: int,
    vertex: wp.array(dtype=wp.int64),
    key: wp.array(dtype=float),
    t: int,
    triangle: float,
    box: wp.vec4i,
    cull: int,
    steps: Piece,
):
    """Draws a triangle of any size within ``box`` (x0, y0, x1, y1), row by row between its exact borders."""
    a = corners[t]
    b = corners[corner_pitch + t]
    c = corners[2 * corner_pitch + t]
    ax = wp.int64(column_of(vertex[a]))
    ay = wp.int64(row_of(vertex[a]))
    bx = wp.int64(column_of(vertex[b]))
    by = wp.int64(row_of(vertex[b]))
    cx = wp.int64(column_of(vertex[c]))
    cy = wp.int64(row_of(vertex[c]))
    key_a = wp.float64(key[a])
    key_b = wp.float64(key[b])
    key_c = wp.float64(key[c])
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == wp.int64(0) or (area < wp.int64(0) and cull == CULL_FRONT) or (area > wp.int64(0) and cull == CULL_BACK):
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
        (wp.float64(step_a) * key_a + wp.float64(step_b) * key_b + wp.float64(step_c) * key_c) * over_area * PIXEL_64
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
        for _piece in range(wp.max(count, 0) / PIECE):
            draw_piece(target, at, wp.min(wp.max(rise + Piece(float(value)), low_piece), high_piece), triangle_piece)
            value += PIECE_64 * slope
            at += PIECE
        for k in range(wp.max(count, 0) % PIECE):
            near = wp.clamp(float(value + wp.float64(k) * slope), lowest, highest)
            farther = target.peels != 2
            if not farther:
                farther = near > target.nearer[at + k]
            if farther and near < target.key[at + k]:
                target.key[at + k] = near
                if target.with_triangles != 0:
                    target.triangle[at + k] = triangle


@wp.kernel
def draw_band(
    first: int,
    corners: wp.array(dtype=int),
    corner_pitch: int,
    vertex: wp.array(dtype=wp.int64),
    key: wp.array(dtype=float),
    clip_triangle: wp.array(dtype=int),
    first_clipped: int,
    band_begin: wp.array(dtype=int),
    band_list: wp.array(dtype=Ints),  # a run of triangles from every entry on
    band_rows: int,
    far: float,
    depth_key: DepthKey,
    cull: int,
    steps: Piece,
    target: Target,
):
    """Clears one band of rows, draws its triangles, and turns keys into depths and floats into triangle numbers."""
    band = first + wp.tid()
    width = target.width
    top = band * band_rows
    bottom = wp.min(top + band_rows, target.height) - 1
    pitch = target.pitch
    clear_rows(target, depth_key, top, bottom)
    e_a = Floats(0.0)
    e_b = Floats(0.0)
    e_c = Floats(0.0)
    dx_a = Floats(0.0)
    dx_b = Floats(0.0)
    dx_c = Floats(0.0)
    dy_a = Floats(0.0)
    dy_b = Floats(0.0)
    dy_c = Floats(0.0)
    key_0 = Floats(0.0)
    lowest = Floats(0.0)
    highest = Floats(0.0)
    by_a = Floats(0.0)
    by_b = Floats(0.0)
    by_c = Floats(0.0)
    x0 = Ints(0)
    x1 = Ints(0)
    y0 = Ints(0)
    y1 = Ints(0)
    wide = Ints(0)
    list_end = band_begin[band + 1]
    for i0 in range(band_begin[band], list_end, BAND_LANES):
        listed = band_list[i0]
        for k in range(BAND_LANES):
            t = listed[k]
            a = corners[t]
            b = corners[corner_pitch + t]
            c = corners[2 * corner_pitch + t]
            vertex_a = vertex[a]
            vertex_b = vertex[b]
            vertex_c = vertex[c]
            ax = column_of(vertex_a)
            ay = row_of(vertex_a)
            b_x = column_of(vertex_b)
            b_y = row_of(vertex_b)
            c_x = column_of(vertex_c)
            c_y = row_of(vertex_c)
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
            x1[k] = wp.min(last_centre(high_x), width - 1)
            y0[k] = upper
            y1[k] = wp.min(last_centre(high_y), bottom)
            wide[k] = wp.where(wp.max(high_x - low_x, high_y - low_y) > SMALL, 1, 0)
        for k in range(wp.min(BAND_LANES, list_end - i0)):
            t = listed[k]
            name = float(t)
            if t >= first_clipped:
                name = float(clip_triangle[t - first_clipped])
            if wide[k] != 0:
                box = wp.vec4i(x0[k], y0[k], x1[k], y1[k])
                draw_wide(target, corners, corner_pitch, vertex, key, t, name, box, cull, steps)
            else:
                name_piece = Piece(name)
                rest = Piece(key_0[k])
                low_piece = Piece(lowest[k])
                high_piece = Piece(highest[k])
                down_a = Piece(dy_a[k])
                down_b = Piece(dy_b[k])
                down_c = Piece(dy_c[k])
                for x in range(x0[k], x1[k] + 1, PIECE):
                    column_0 = wp.min(x, width - PIECE)  # pixels may be drawn twice, but none of the next row
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
    finish_rows(target, depth_key, top, bottom, far, steps)
