"""Pass 4 of the lane rasteriser where coverage is counted: the counts of one band of rows, 8 pixels at a time.

Passes 1 to 3, the edge functions and the depth keys are those of ``lanes``; a triangle counts in exactly the
pixels that ``draw_band`` would draw it into. Counts are kept in floats, which hold integers up to 2^24 exactly.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.raster.counting import COUNT_ALL, Counted
from wkernels.raster.lane_bands import BAND_LANES, PIECE_64, PIXEL_64, Floats, Ints, add_row, bias_32
from wkernels.raster.lane_culling import SMALL, column_of, edge_32, first_centre, last_centre, row_of
from wkernels.raster.lane_lists import LaneLists
from wkernels.raster.lane_target import HUGE, PIECE, DepthKey, IntPiece, Piece
from wkernels.raster.lanes import pieces
from wkernels.raster.triangles import HALF_PIXEL, SUBPIXELS, edge, top_left_bias
from wkernels.scene.views import View

ALWAYS = (1.0, 0.0, 1.0)  # what a covered pixel adds for COUNT_ALL, _NEARER and _FARTHER,
IF_NEARER = (0.0, 1.0, -1.0)  # and what it adds if the triangle is nearer there than what is seen
_STEPS = Piece(*range(PIECE))


@wp.struct
class CountTarget:
    """What one band is counted into: rows of ``pitch`` floats, of which pieces may start anywhere."""

    seen: wp.array(dtype=float)  # depth keys of what is seen
    seen_piece: wp.array(dtype=Piece)  # the same memory, a piece from every float on
    count_piece: wp.array(dtype=Piece)
    count: wp.array(dtype=float)
    pitch: int
    width: int
    always: float
    if_nearer: float


@wp.func
def count_piece(target: CountTarget, at: int, covered: Piece, key: Piece, weight: float):
    """Adds a weight where a piece is covered (1, else 0) and passes the depth test."""
    nearer = wp.min(wp.max((target.seen_piece[at] - key) * HUGE, Piece(0.0)), Piece(1.0))
    added = wp.cw_mul(covered, nearer * target.if_nearer + Piece(target.always))
    target.count_piece[at] = target.count_piece[at] + added * weight


@wp.func
def count_wide(
    target: CountTarget,
    corners: wp.array(dtype=int),
    corner_pitch: int,
    vertex: wp.array(dtype=wp.int64),
    key: wp.array(dtype=float),
    t: int,
    box: wp.vec4i,
    front_weight: float,
    back_weight: float,
    steps: Piece,
):
    """Counts a triangle of any size within ``box`` (x0, y0, x1, y1), row by row between its exact borders."""
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
    weight = back_weight
    if area < wp.int64(0):
        weight = front_weight
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
    if area == wp.int64(0) or weight == 0.0:
        return
    low_piece = Piece(float(wp.min(wp.min(key_a, key_b), key_c)))
    high_piece = Piece(float(wp.max(wp.max(key_a, key_b), key_c)))
    over_area = wp.float64(1.0) / wp.float64(area)
    step_a = by - cy
    step_b = cy - ay
    step_c = ay - by
    slope = (
        (wp.float64(step_a) * key_a + wp.float64(step_b) * key_b + wp.float64(step_c) * key_c) * over_area * PIXEL_64
    )
    rise = steps * float(slope)
    zero = Piece(0.0)
    one = Piece(1.0)
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
        value = (wp.float64(e_a) * key_a + wp.float64(e_b) * key_b + wp.float64(e_c) * key_c) * over_area
        value += wp.float64(span[0]) * slope
        at = y_px * target.pitch + box[0] + span[0]
        for begin in range(span[0], span[1] + 1, PIECE):
            covered = wp.min(wp.max(Piece(float(span[1] + 1 - begin)) - steps, zero), one)
            near = wp.min(wp.max(rise + Piece(float(value)), low_piece), high_piece)
            count_piece(target, at, covered, near, weight)
            value += PIECE_64 * slope
            at += PIECE


@wp.kernel
def count_band(
    first: int,
    corners: wp.array(dtype=int),
    corner_pitch: int,
    vertex: wp.array(dtype=wp.int64),
    key: wp.array(dtype=float),
    band_begin: wp.array(dtype=int),
    band_list: wp.array(dtype=Ints),  # a run of triangles from every entry on
    band_rows: int,
    height: int,
    perspective: int,
    test: int,
    limit: float,
    front_weight: float,
    back_weight: float,
    steps: Piece,
    target: CountTarget,
    depth: wp.array2d(dtype=float),
    depth_piece: wp.array(dtype=Piece),
    count_out_piece: wp.array(dtype=IntPiece),
    count_out: wp.array2d(dtype=int),
):
    """Clears one band of rows, turns the depths that are seen into keys, and counts the band's triangles."""
    band = first + wp.tid()
    pitch = target.pitch
    width = target.width
    top = band * band_rows
    bottom = wp.min(top + band_rows, height) - 1
    zero = Piece(0.0)
    one = Piece(1.0)
    for at in range(top * pitch, (bottom + 1) * pitch, PIECE):
        target.count_piece[at] = zero
        target.seen_piece[at] = zero
    if test != COUNT_ALL:
        for y in range(top, bottom + 1):
            for x in range(0, width - PIECE + 1, PIECE):
                seen = depth_piece[y * width + x] * limit
                if perspective == 1:
                    seen = wp.cw_div(one, zero - seen)
                target.seen_piece[y * pitch + x] = seen
            for x in range(width - width % PIECE, width):
                seen_x = depth[y, x] * limit
                target.seen[y * pitch + x] = wp.where(perspective == 1, -1.0 / seen_x, seen_x)
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
    by_a = Floats(0.0)
    by_b = Floats(0.0)
    by_c = Floats(0.0)
    lowest = Floats(0.0)
    highest = Floats(0.0)
    front = Ints(0)
    wide = Ints(0)
    x0 = Ints(0)
    y0 = Ints(0)
    x1 = Ints(0)
    y1 = Ints(0)
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
            over_area = 1.0 / float(wp.max(wp.abs(area), 1))
            key_0[k] = (
                float(f_a - 256 * g_a) * key_a + float(f_b - 256 * g_b) * key_b + float(f_c - 256 * g_c) * key_c
            ) * over_area
            by_a[k] = key_a * (over_area * float(SUBPIXELS))
            by_b[k] = key_b * (over_area * float(SUBPIXELS))
            by_c[k] = key_c * (over_area * float(SUBPIXELS))
            lowest[k] = wp.min(wp.min(key_a, key_b), key_c)
            highest[k] = wp.max(wp.max(key_a, key_b), key_c)
            front[k] = swap
            wide[k] = wp.where(wp.max(high_x - low_x, high_y - low_y) > SMALL, 1, 0)
            x0[k] = left
            y0[k] = upper
            x1[k] = wp.min(last_centre(high_x), width - 1)
            y1[k] = wp.min(last_centre(high_y), bottom)
        for k in range(wp.min(BAND_LANES, list_end - i0)):
            if wide[k] != 0:
                box = wp.vec4i(x0[k], y0[k], x1[k], y1[k])
                count_wide(target, corners, corner_pitch, vertex, key, listed[k], box, front_weight, back_weight, steps)
            else:
                weight = wp.where(front[k] == 1, front_weight, back_weight)
                low_piece = Piece(lowest[k])
                high_piece = Piece(highest[k])
                rest = Piece(key_0[k])
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
                        # whole numbers: at least 0 inside, at most -1 outside
                        covered = wp.min(wp.max(wp.min(wp.min(in_a, in_b), in_c) + one, zero), one)
                        near = in_a * by_a[k] + in_b * by_b[k] + in_c * by_c[k] + rest
                        near = wp.min(wp.max(near, low_piece), high_piece)
                        count_piece(target, at, covered, near, weight)
                        in_a += down_a
                        in_b += down_b
                        in_c += down_c
                        at += pitch
    for y in range(top, bottom + 1):
        for x in range(0, width - PIECE + 1, PIECE):
            count_out_piece[y * width + x] = IntPiece(target.count_piece[y * pitch + x])
        for x in range(width - width % PIECE, width):
            count_out[y, x] = int(target.count[y * pitch + x])


class LaneCounter(LaneLists):
    """Counts the coverage of perspective and orthographic views on the CPU."""

    def count(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        key: DepthKey,
        counted: Counted,
        count_out: wp.array,
        cull: int,
    ) -> None:
        """``Rasteriser.count`` for views that are not warped; ``key`` is ``depth_key(view)``."""
        self._corners_of = None  # volumes are written anew into the same arrays
        lists = self.list(points_ws, indices, view, key.perspective, cull)
        pitch = -(-(view.width + PIECE) // PIECE) * PIECE  # a piece may begin at the last pixel of a row
        size, pixels = pitch * lists.bands * lists.band_rows + 2 * PIECE, view.width * view.height
        target = CountTarget()
        target.seen = self._scratch.array("seen keys", (size,), float)
        target.count = self._scratch.array("target count", (size,), float)
        target.seen_piece, target.count_piece = (pieces(a.ptr, size, Piece) for a in (target.seen, target.count))
        target.pitch, target.width = pitch, view.width
        target.always, target.if_nearer = ALWAYS[counted.test], IF_NEARER[counted.test]
        inputs: list[Any] = [lists.corners, lists.corner_pitch, lists.vertex, lists.key, lists.begin, lists.listed]
        inputs += [lists.band_rows, view.height, key.perspective, counted.test]
        inputs += [counted.limit, float(counted.front), float(counted.back), _STEPS, target]
        inputs += [counted.depth, pieces(counted.depth.ptr, pixels, Piece)]
        outputs = [pieces(count_out.ptr, pixels, IntPiece), count_out]
        self._scratch.launch(count_band, lists.bands, inputs, outputs, tile=1)
