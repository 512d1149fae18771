"""``reprojection`` of a run of pixels, 16 at a time; ``docs/lanes.md`` says how such code is written."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.point_lanes import PointRun
from wkernels.scene.views import View
from wkernels.temporal.reprojection import EDGE_ON


@wp.struct
class ScreenRun:
    """Where each lane's point is in another view."""

    inside: Ints  # 1: on the image, and wanted; else the place is of no use
    x: Floats  # pixels, y down
    y: Floats
    depth: Floats  # linear, from that view's eye


@wp.func
def reproject_run(view: View, points: PointRun, wanted: Ints):
    """``reproject`` and ``is_inside`` of the lanes that are wanted (1)."""
    px = points.x
    py = points.y
    pz = points.z
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    width = view.width
    height = view.height
    xs = Floats(0.0)
    ys = Floats(0.0)
    depth = Floats(0.0)
    inside = Ints(0)
    for k in range(LANES):
        w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
        over_w = 1.0 / wp.where(w > 0.0, w, 1.0)
        x = (0.5 + 0.5 * ((m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03) * over_w)) * float(width)
        y = (0.5 - 0.5 * ((m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13) * over_w)) * float(height)
        in_x = wp.where(x >= 0.0, wp.where(x < float(width), 1, 0), 0)
        in_y = wp.where(y >= 0.0, wp.where(y < float(height), 1, 0), 0)
        inside[k] = wp.where(w > 0.0, in_x & in_y & wanted[k], 0)
        xs[k] = x
        ys[k] = y
        depth[k] = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
    out = ScreenRun()
    out.inside = inside
    out.x = xs
    out.y = ys
    out.depth = depth
    return out


@wp.func
def depths_on_planes(view: View, points: PointRun, columns: Ints, rows: Ints, right: int, down: int, otherwise: Floats):
    """``depth_on_plane`` of each lane's point at the centre of a texel, so far right of and below one of its own."""
    px = points.x
    py = points.y
    pz = points.z
    nx = points.normal_x
    ny = points.normal_y
    nz = points.normal_z
    base = view.origin_ws
    b_x, b_y, b_z = base[0], base[1], base[2]
    bx_x, bx_y, bx_z = view.base_dx_ws[0], view.base_dx_ws[1], view.base_dx_ws[2]
    by_x, by_y, by_z = view.base_dy_ws[0], view.base_dy_ws[1], view.base_dy_ws[2]
    a_x, a_y, a_z = view.along_ws[0], view.along_ws[1], view.along_ws[2]
    ax_x, ax_y, ax_z = view.along_dx_ws[0], view.along_dx_ws[1], view.along_dx_ws[2]
    ay_x, ay_y, ay_z = view.along_dy_ws[0], view.along_dy_ws[1], view.along_dy_ws[2]
    out = Floats(0.0)
    for k in range(LANES):
        x_px = float(columns[k] + right) + 0.5
        y_px = float(rows[k] + down) + 0.5
        along_x = a_x + x_px * ax_x + y_px * ay_x
        along_y = a_y + x_px * ax_y + y_px * ay_y
        along_z = a_z + x_px * ax_z + y_px * ay_z
        slope = nx[k] * along_x + ny[k] * along_y + nz[k] * along_z
        length = wp.sqrt(along_x * along_x + along_y * along_y + along_z * along_z)
        seen = wp.abs(slope) > EDGE_ON * length
        from_x = px[k] - (b_x + x_px * bx_x + y_px * by_x)
        from_y = py[k] - (b_y + x_px * bx_y + y_px * by_y)
        from_z = pz[k] - (b_z + x_px * bx_z + y_px * by_z)
        on_plane = (nx[k] * from_x + ny[k] * from_y + nz[k] * from_z) / wp.where(seen, slope, 1.0)
        out[k] = wp.where(seen, on_plane, otherwise[k])
    return out
