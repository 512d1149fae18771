"""Whether a triangle hides a sample: four linear functions of its light coordinates.

Three are the planes through the light and an edge, the fourth is the triangle's own plane. They are set up in double
from the corners, in homogeneous coordinates, so that a triangle which reaches behind the light needs no clipping, and
are anchored where the triangle begins, so that float32 keeps what a sample's own float32 coordinates hold. Where the
rounding of a sample leaves open on which side of an edge it is, it counts as inside: two triangles leave no crack
between them. Where it leaves open on which side of the plane it is, it counts as being on the lit one.
"""

from __future__ import annotations

import warp as wp

from wkernels.irregular.grid import ROUNDING, TINY, LightFace, column_of, to_face
from wkernels.irregular.samples import NO_ROW, Places

SMALL_SHARE = wp.constant(wp.float64(1.0e-6))
LARGEST = wp.constant(wp.float64(1.0e300))  # beyond are corners that are not finite


@wp.struct
class Occluder:
    """A triangle's linear functions at (u - u0, v - v0, h); a sample is hidden where all four are positive."""

    u0: float
    v0: float
    a: wp.vec3  # edge b c: u, v, constant
    b: wp.vec3
    c: wp.vec3
    plane: wp.vec4  # u, v, h, constant


@wp.func
def scaled_edge(u: wp.float64, v: wp.float64, constant: wp.float64, u0: wp.float64, v0: wp.float64, error: wp.float64):
    """An edge's function from an anchor on, widened by the samples' rounding; its larger slope is 1."""
    rest = u * u0 + v * v0 + constant
    scale = wp.float64(1.0) / wp.max(wp.max(wp.max(wp.abs(u), wp.abs(v)), SMALL_SHARE * wp.abs(rest)), TINY)
    rest = rest + (wp.abs(u) + wp.abs(v)) * error + wp.abs(rest) * ROUNDING
    return wp.vec3(float(u * scale), float(v * scale), float(rest * scale))


@wp.func
def occluder(face: LightFace, a: wp.vec4d, b: wp.vec4d, c: wp.vec4d, u0: float, v0: float):
    """Sets a triangle up from its corners in light coordinates (``to_face``); nothing is hidden by one seen edge-on."""
    zero = wp.float64(0.0)
    anchor_u = wp.float64(u0)
    anchor_v = wp.float64(v0)
    # the edge opposite each corner: the plane through the light and the two others
    au = b[1] * c[2] - b[2] * c[1]
    av = b[2] * c[0] - b[0] * c[2]
    aw = b[0] * c[1] - b[1] * c[0]
    bu = c[1] * a[2] - c[2] * a[1]
    bv = c[2] * a[0] - c[0] * a[2]
    bw = c[0] * a[1] - c[1] * a[0]
    cu = a[1] * b[2] - a[2] * b[1]
    cv = a[2] * b[0] - a[0] * b[2]
    cw = a[0] * b[1] - a[1] * b[0]
    area = a[0] * au + a[1] * av + a[2] * aw
    turn = wp.where(area < zero, wp.float64(-1.0), wp.float64(1.0))
    area = area * turn
    # the height of the plane times the area is the edges' sum, weighted with the corners' heights
    pu = (au * a[3] + bu * b[3] + cu * c[3]) * turn
    pv = (av * a[3] + bv * b[3] + cv * c[3]) * turn
    pw = (aw * a[3] + bw * b[3] + cw * c[3]) * turn
    rest = pu * anchor_u + pv * anchor_v + pw
    top = wp.float64(0.0)
    if a[2] > zero and b[2] > zero and c[2] > zero:
        top = wp.max(wp.max(wp.abs(a[3] / a[2]), wp.abs(b[3] / b[2])), wp.abs(c[3] / c[2]))
    else:
        top = face.highest
    top = wp.min(top, face.highest)
    scale = wp.float64(1.0) / wp.max(
        wp.max(wp.max(wp.abs(pu), wp.abs(pv)), wp.max(area, SMALL_SHARE * wp.abs(rest))), TINY
    )
    rest = rest - (wp.abs(pu) + wp.abs(pv)) * face.across_error - area * top * ROUNDING
    out = Occluder()
    out.u0 = u0
    out.v0 = v0
    out.a = scaled_edge(au * turn, av * turn, aw * turn, anchor_u, anchor_v, face.across_error)
    out.b = scaled_edge(bu * turn, bv * turn, bw * turn, anchor_u, anchor_v, face.across_error)
    out.c = scaled_edge(cu * turn, cv * turn, cw * turn, anchor_u, anchor_v, face.across_error)
    out.plane = wp.vec4(float(pu * scale), float(pv * scale), float(-area * scale), float(rest * scale))
    if not (area > zero and area < LARGEST):
        out.plane = wp.vec4(0.0, 0.0, 0.0, -1.0)
    return out


@wp.func
def hides(o: Occluder, u: float, v: float, h: float):
    """Whether a triangle lies between a sample and the light."""
    du = u - o.u0
    dv = v - o.v0
    in_a = o.a[0] * du + o.a[1] * dv + o.a[2]
    in_b = o.b[0] * du + o.b[1] * dv + o.b[2]
    in_c = o.c[0] * du + o.c[1] * dv + o.c[2]
    above = o.plane[0] * du + o.plane[1] * dv + o.plane[3] + o.plane[2] * h
    return wp.min(wp.min(in_a, in_b), wp.min(in_c, above)) > 0.0


@wp.func
def anchor_u(face: LightFace, column: int):
    """u of a column's begin."""
    return face.left + float(column) / face.columns_per_u


@wp.func
def anchor_v(face: LightFace, row: int):
    """v of a row's begin."""
    return face.low + float(row) / face.rows_per_v


@wp.kernel
def test_pixels(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    face: LightFace,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    band_begin: wp.array(dtype=int),
    band_list: wp.array(dtype=int),
    band_shift: int,
    places: Places,
    row_of_pixel: wp.array2d(dtype=int),
    visibility: wp.array2d(dtype=float),  # set to 0 where a pixel of this face is hidden
):
    """One pixel against all triangles that touch its band of rows, until one hides it."""
    image_row, x = wp.tid()
    y = first + image_row
    row = row_of_pixel[y, x]
    if row == NO_ROW:
        return
    row -= face.first_row
    if row < 0 or row >= face.resolution:
        return
    u = places.u[y, x]
    column = column_of(face, u)
    band = row >> band_shift
    for i in range(band_begin[band], band_begin[band + 1]):
        t = band_list[i]
        y0 = rows[t] & 65535
        x0 = columns[t] & 65535
        in_rows = row >= y0 and row <= (rows[t] >> 16)
        if in_rows and column >= x0 and column <= (columns[t] >> 16):
            a = to_face(face, points_ws[indices[3 * t]])
            b = to_face(face, points_ws[indices[3 * t + 1]])
            c = to_face(face, points_ws[indices[3 * t + 2]])
            o = occluder(face, a, b, c, anchor_u(face, x0), anchor_v(face, y0))
            if hides(o, u, places.v[y, x], places.h[y, x]):
                visibility[y, x] = 0.0
                break
