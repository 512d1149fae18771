"""The exact test on the CPU: 64 triangles are set up in one step, then each meets 16 neighbouring samples at a time.

Samples of one row of cells lie side by side in column order, so the samples in the cells that a triangle touches in a
row are one run of memory. A hidden sample's height becomes HIDDEN: nothing lies above it, and no flag is kept.
"""

from __future__ import annotations

import warp as wp

from wkernels.irregular.casters import NO_ROWS
from wkernels.irregular.grid import ROUNDING, TINY, LightFace
from wkernels.irregular.occlusion import LARGEST, SMALL_SHARE
from wkernels.irregular.samples import HIDDEN, PAD
from wkernels.raster.lane_bands import BAND_LANES, Floats, Ints

PIECE = wp.constant(16)  # samples tested in one step; what is behind a row's end is padding
FLAT = wp.constant(1.0e-6)  # columns per row, inverse: an edge that runs along its row bounds none of its columns
NO_BOUND = wp.constant(1.0e12)  # columns; more than a row's bound can move over all rows
LEEWAY = wp.constant(0.01)  # columns that a row's span is widened by, beside the face's margin
CANCELLED = wp.constant(1.0e-6)  # relative: what adding up in float32 may cost a span

Piece = wp.types.vector(length=PIECE, dtype=wp.float32)


@wp.struct
class SampleRuns:
    """All samples in the order of the cells; the pieces start at every one of them."""

    u: wp.array(dtype=Piece)
    v: wp.array(dtype=Piece)
    h: wp.array(dtype=Piece)
    height: wp.array(dtype=float)  # the memory of h
    pixel: wp.array(dtype=int)
    row_begin: wp.array(dtype=int)  # with PAD samples of padding at each row's end
    cell_begin: wp.array(dtype=int)  # (rows (R + 1),)


@wp.kernel
def test_band(
    first: int,
    points_ws: wp.array(dtype=float),  # (3 V,)
    indices: wp.array(dtype=int),
    face: LightFace,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    band_begin: wp.array(dtype=int),
    band_list: wp.array(dtype=Ints),  # a run of triangles from every entry on
    band_shift: int,
    samples: SampleRuns,
    visibility: wp.array(dtype=float),  # (H W,) set to 0 where a pixel is hidden
):
    """``occlusion.test_pixels`` for the samples of one band of rows."""
    band = first + wp.tid()
    resolution = face.resolution
    top = band << band_shift
    bottom = wp.min(top + (1 << band_shift), resolution) - 1
    begin = samples.row_begin[face.first_row + top]
    end = samples.row_begin[face.first_row + bottom + 1]
    if end - begin == (bottom - top + 1) * PAD:
        return
    origin_x, origin_y, origin_z = face.origin_ws[0], face.origin_ws[1], face.origin_ws[2]
    right_x, right_y, right_z = face.right_ws[0], face.right_ws[1], face.right_ws[2]
    up_x, up_y, up_z = face.up_ws[0], face.up_ws[1], face.up_ws[2]
    forward_x, forward_y, forward_z = face.forward_ws[0], face.forward_ws[1], face.forward_ws[2]
    in_perspective = face.perspective != 0
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    error = face.across_error
    highest = face.highest
    left = face.left
    low = face.low
    per_u = face.columns_per_u
    per_v = face.rows_per_v
    row_height = 1.0 / per_v
    margin = float(face.margin) / 256.0
    a_u = Floats(0.0)
    a_v = Floats(0.0)
    a_1 = Floats(0.0)
    b_u = Floats(0.0)
    b_v = Floats(0.0)
    b_1 = Floats(0.0)
    c_u = Floats(0.0)
    c_v = Floats(0.0)
    c_1 = Floats(0.0)
    p_u = Floats(0.0)
    p_v = Floats(0.0)
    p_h = Floats(0.0)
    p_1 = Floats(0.0)
    begin_u = Floats(0.0)
    begin_v = Floats(0.0)
    box_rows = Ints(0)
    box_columns = Ints(0)
    least_a = Floats(0.0)
    least_b = Floats(0.0)
    least_c = Floats(0.0)
    most_a = Floats(0.0)
    most_b = Floats(0.0)
    most_c = Floats(0.0)
    step_a = Floats(0.0)
    step_b = Floats(0.0)
    step_c = Floats(0.0)
    list_end = band_begin[band + 1]
    for i0 in range(band_begin[band], list_end, BAND_LANES):
        listed = band_list[i0]
        for k in range(BAND_LANES):
            t = listed[k]
            i = 3 * indices[3 * t]
            x = wp.float64(points_ws[i]) - origin_x
            y = wp.float64(points_ws[i + 1]) - origin_y
            z = wp.float64(points_ws[i + 2]) - origin_z
            ax = right_x * x + right_y * y + right_z * z
            ay = up_x * x + up_y * y + up_z * z
            az = forward_x * x + forward_y * y + forward_z * z
            i = 3 * indices[3 * t + 1]
            x = wp.float64(points_ws[i]) - origin_x
            y = wp.float64(points_ws[i + 1]) - origin_y
            z = wp.float64(points_ws[i + 2]) - origin_z
            bx = right_x * x + right_y * y + right_z * z
            by = up_x * x + up_y * y + up_z * z
            bz = forward_x * x + forward_y * y + forward_z * z
            i = 3 * indices[3 * t + 2]
            x = wp.float64(points_ws[i]) - origin_x
            y = wp.float64(points_ws[i + 1]) - origin_y
            z = wp.float64(points_ws[i + 2]) - origin_z
            cx = right_x * x + right_y * y + right_z * z
            cy = up_x * x + up_y * y + up_z * z
            cz = forward_x * x + forward_y * y + forward_z * z
            aw = wp.where(in_perspective, az, one)
            bw = wp.where(in_perspective, bz, one)
            cw = wp.where(in_perspective, cz, one)
            ah = wp.where(in_perspective, one, -az)
            bh = wp.where(in_perspective, one, -bz)
            ch = wp.where(in_perspective, one, -cz)
            column = columns[t]
            row = rows[t]
            u0 = left + float(column & 65535) / per_u
            v0 = low + float(row & 65535) / per_v
            anchor_u = wp.float64(u0)
            anchor_v = wp.float64(v0)

            fau = by * cw - bw * cy
            fav = bw * cx - bx * cw
            faw = bx * cy - by * cx
            fbu = cy * aw - cw * ay
            fbv = cw * ax - cx * aw
            fbw = cx * ay - cy * ax
            fcu = ay * bw - aw * by
            fcv = aw * bx - ax * bw
            fcw = ax * by - ay * bx
            area = ax * fau + ay * fav + aw * faw
            turn = wp.where(area < zero, -one, one)
            area = area * turn
            pu = (fau * ah + fbu * bh + fcu * ch) * turn
            pv = (fav * ah + fbv * bh + fcv * ch) * turn
            pw = (faw * ah + fbw * bh + fcw * ch) * turn
            rest = pu * anchor_u + pv * anchor_v + pw
            nearest = wp.min(wp.min(aw, bw), cw)
            positive = nearest > zero
            top_a = wp.abs(ah / wp.where(positive, aw, one))
            top_b = wp.abs(bh / wp.where(positive, bw, one))
            top_c = wp.abs(ch / wp.where(positive, cw, one))
            top_h = wp.min(wp.where(positive, wp.max(wp.max(top_a, top_b), top_c), highest), highest)
            scale = one / wp.max(wp.max(wp.max(wp.abs(pu), wp.abs(pv)), wp.max(area, SMALL_SHARE * wp.abs(rest))), TINY)
            rest = rest - (wp.abs(pu) + wp.abs(pv)) * error - area * top_h * ROUNDING
            usable = wp.where(area > zero, area < LARGEST, False)
            p_u[k] = float(pu * scale)
            p_v[k] = float(pv * scale)
            p_h[k] = float(-area * scale)
            p_1[k] = float(rest * scale)

            rest_a = (fau * anchor_u + fav * anchor_v + faw) * turn
            rest_b = (fbu * anchor_u + fbv * anchor_v + fbw) * turn
            rest_c = (fcu * anchor_u + fcv * anchor_v + fcw) * turn
            slope_a = wp.max(wp.abs(fau), wp.abs(fav))
            slope_b = wp.max(wp.abs(fbu), wp.abs(fbv))
            slope_c = wp.max(wp.abs(fcu), wp.abs(fcv))
            scale_a = one / wp.max(wp.max(slope_a, SMALL_SHARE * wp.abs(rest_a)), TINY)
            scale_b = one / wp.max(wp.max(slope_b, SMALL_SHARE * wp.abs(rest_b)), TINY)
            scale_c = one / wp.max(wp.max(slope_c, SMALL_SHARE * wp.abs(rest_c)), TINY)
            rest_a = rest_a + (wp.abs(fau) + wp.abs(fav)) * error + wp.abs(rest_a) * ROUNDING
            rest_b = rest_b + (wp.abs(fbu) + wp.abs(fbv)) * error + wp.abs(rest_b) * ROUNDING
            rest_c = rest_c + (wp.abs(fcu) + wp.abs(fcv)) * error + wp.abs(rest_c) * ROUNDING
            a_u[k] = float(fau * turn * scale_a)
            a_v[k] = float(fav * turn * scale_a)
            a_1[k] = float(rest_a * scale_a)
            b_u[k] = float(fbu * turn * scale_b)
            b_v[k] = float(fbv * turn * scale_b)
            b_1[k] = float(rest_b * scale_b)
            c_u[k] = float(fcu * turn * scale_c)
            c_v[k] = float(fcv * turn * scale_c)
            c_1[k] = float(rest_c * scale_c)
            begin_u[k] = u0
            begin_v[k] = v0
            box_columns[k] = column
            box_rows[k] = wp.where(usable, row, NO_ROWS)
        for k in range(BAND_LANES):
            # where each edge crosses the rows, in columns from the box's first: a + step * (row - first row)
            height = float((box_rows[k] >> 16) - (box_rows[k] & 65535) + 1) * row_height
            leans_a = wp.where(wp.abs(a_u[k]) > FLAT * wp.abs(a_v[k]) * row_height * per_u, a_u[k], 0.0)
            over_a = per_u / wp.where(leans_a == 0.0, 1.0, leans_a)
            leans_b = wp.where(wp.abs(b_u[k]) > FLAT * wp.abs(b_v[k]) * row_height * per_u, b_u[k], 0.0)
            over_b = per_u / wp.where(leans_b == 0.0, 1.0, leans_b)
            leans_c = wp.where(wp.abs(c_u[k]) > FLAT * wp.abs(c_v[k]) * row_height * per_u, c_u[k], 0.0)
            over_c = per_u / wp.where(leans_c == 0.0, 1.0, leans_c)
            at_a = -a_1[k] * over_a
            at_b = -b_1[k] * over_b
            at_c = -c_1[k] * over_c
            down_a = wp.where(leans_a == 0.0, 0.0, -a_v[k] * over_a * row_height)
            down_b = wp.where(leans_b == 0.0, 0.0, -b_v[k] * over_b * row_height)
            down_c = wp.where(leans_c == 0.0, 0.0, -c_v[k] * over_c * row_height)
            slack_a = LEEWAY + margin + margin * wp.abs(down_a)
            slack_a += CANCELLED * (wp.abs(a_1[k]) + height * wp.abs(a_v[k])) * wp.abs(over_a)
            step_a[k] = down_a
            slack_b = LEEWAY + margin + margin * wp.abs(down_b)
            slack_b += CANCELLED * (wp.abs(b_1[k]) + height * wp.abs(b_v[k])) * wp.abs(over_b)
            step_b[k] = down_b
            slack_c = LEEWAY + margin + margin * wp.abs(down_c)
            slack_c += CANCELLED * (wp.abs(c_1[k]) + height * wp.abs(c_v[k])) * wp.abs(over_c)
            step_c[k] = down_c
            least_a[k] = wp.where(leans_a > 0.0, at_a + wp.min(down_a, 0.0) - slack_a, -NO_BOUND)
            least_b[k] = wp.where(leans_b > 0.0, at_b + wp.min(down_b, 0.0) - slack_b, -NO_BOUND)
            least_c[k] = wp.where(leans_c > 0.0, at_c + wp.min(down_c, 0.0) - slack_c, -NO_BOUND)
            most_a[k] = wp.where(leans_a < 0.0, at_a + wp.max(down_a, 0.0) + slack_a, NO_BOUND)
            most_b[k] = wp.where(leans_b < 0.0, at_b + wp.max(down_b, 0.0) + slack_b, NO_BOUND)
            most_c[k] = wp.where(leans_c < 0.0, at_c + wp.max(down_c, 0.0) + slack_c, NO_BOUND)
        for k in range(wp.min(BAND_LANES, list_end - i0)):
            x0 = box_columns[k] & 65535
            x1 = box_columns[k] >> 16
            y0 = box_rows[k] & 65535
            across = float(x1 - x0)
            a_dv = a_v[k]
            b_dv = b_v[k]
            c_dv = c_v[k]
            p_dv = p_v[k]
            p_dh = p_h[k]
            a_du = a_u[k]
            b_du = b_u[k]
            c_du = c_u[k]
            p_du = p_u[k]
            u_0 = begin_u[k]
            v_0 = begin_v[k]
            a_0 = a_1[k]
            b_0 = b_1[k]
            c_0 = c_1[k]
            p_0 = p_1[k]
            for line in range(wp.max(y0, top), wp.min(box_rows[k] >> 16, bottom) + 1):
                down = float(line - y0)
                least = wp.max(
                    wp.max(least_a[k] + step_a[k] * down, least_b[k] + step_b[k] * down), least_c[k] + step_c[k] * down
                )
                most = wp.min(
                    wp.min(most_a[k] + step_a[k] * down, most_b[k] + step_b[k] * down), most_c[k] + step_c[k] * down
                )
                column_0 = x0 + int(wp.clamp(least, 0.0, across + 1.0))
                column_1 = x0 + int(wp.clamp(most, -1.0, across))
                cells = (face.first_row + line) * (resolution + 1)
                at = samples.cell_begin[cells + column_0]
                stop = samples.cell_begin[cells + wp.max(column_1, column_0 - 1) + 1]
                while at < stop:
                    u = samples.u[at]
                    v = samples.v[at]
                    h = samples.h[at]
                    for j in range(PIECE):
                        du = u[j] - u_0
                        dv = v[j] - v_0
                        in_a = du * a_du + dv * a_dv + a_0
                        in_b = du * b_du + dv * b_dv + b_0
                        in_c = du * c_du + dv * c_dv + c_0
                        below = du * p_du + dv * p_dv + p_0 + h[j] * p_dh
                        inside = wp.min(wp.min(in_a, in_b), wp.min(in_c, below))
                        h[j] = wp.where(inside > 0.0, HIDDEN, h[j])
                    samples.h[at] = h
                    at += PIECE
    for line in range(top, bottom + 1):
        row_end = samples.row_begin[face.first_row + line + 1] - PAD
        for i in range(samples.row_begin[face.first_row + line], row_end):
            if samples.height[i] >= HIDDEN:
                visibility[samples.pixel[i]] = 0.0
