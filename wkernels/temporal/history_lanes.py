"""History of a run of pixels: ``shadow_buffer.fetch_record``, 16 at a time (``docs/lanes.md``)."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.receiver_lanes import LaneViews
from wkernels.scene.geometry import MOVES, RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.shadow_buffer.record import EDGE_ON


@wp.struct
class PointRun:
    """What a run's pixels see; zeros where nothing receives."""

    receives: Ints
    moves: Ints  # 1: the surface itself does
    x: Floats
    y: Floats
    z: Floats
    normal_x: Floats
    normal_y: Floats
    normal_z: Floats
    depth: Floats  # linear eye depth


@wp.struct
class HistoryRun:
    """``ShadowRecord`` of each lane, but for its depth; n = 0 where the pixel is new.

    Where ``of_mover`` is 1 a texel holds a moving caster's shadow, and the sums are no use: they mix it with others.
    """

    rho: Floats
    n: Floats
    blocker_rise: Floats
    of_mover: Ints
    spread: Floats


@wp.struct
class PlaceRun:
    """Where each lane's point was in an earlier view: between which four texels, and how deep."""

    inside: Ints  # 1: on the image, and wanted
    column: Ints  # the upper left of the four
    row: Ints
    share_x: Floats  # weight of the right column, 0 to below 1
    share_y: Floats  # weight of the lower row
    depth: Floats  # linear, from the earlier eye


@wp.func
def points_of_run(views: LaneViews, eye_depth: wp.array(dtype=Floats), x0: int, y: int):
    """The points of pixels x0, x0 + 1, ... of row y; ``eye_depth`` is the G-buffer's, in runs."""
    out = PointRun()
    begin = y * views.width + x0
    flags = views.flags[begin]
    position = views.position_ws[3 * begin]
    normal = views.normal_ws[3 * begin]
    eye_depths = eye_depth[begin]
    receives = Ints(0)
    moves = Ints(0)
    px = Floats(0.0)
    py = Floats(0.0)
    pz = Floats(0.0)
    nx = Floats(0.0)
    ny = Floats(0.0)
    nz = Floats(0.0)
    depth = Floats(0.0)
    for k in range(LANES):
        receives[k] = wp.where((flags[k] & RECEIVES) != 0, 1, 0)
        moves[k] = wp.where((flags[k] & MOVES) != 0, receives[k], 0)
        px[k] = position[3 * k]
        py[k] = position[3 * k + 1]
        pz[k] = position[3 * k + 2]
        nx[k] = normal[3 * k]
        ny[k] = normal[3 * k + 1]
        nz[k] = normal[3 * k + 2]
        depth[k] = wp.where(receives[k] != 0, eye_depths[k], 0.0)
    out.receives = receives
    out.moves = moves
    out.x = px
    out.y = py
    out.z = pz
    out.normal_x = nx
    out.normal_y = ny
    out.normal_z = nz
    out.depth = depth
    return out


@wp.func
def place_run(view: View, points: PointRun, wanted: Ints, texel_steps: float):
    """Where an earlier ``view`` saw the lanes that are wanted (1), as ``fetch_record`` finds them."""
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
    columns = Ints(0)
    rows = Ints(0)
    share_x = Floats(0.0)
    share_y = Floats(0.0)
    own_depth = Floats(0.0)
    inside = Ints(0)
    for k in range(LANES):
        w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
        over_w = 1.0 / wp.where(w > 0.0, w, 1.0)
        at_x = (0.5 + 0.5 * ((m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03) * over_w)) * float(width)
        at_y = (0.5 - 0.5 * ((m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13) * over_w)) * float(height)
        in_x = wp.where(at_x >= 0.0, wp.where(at_x < float(width), 1, 0), 0)
        in_y = wp.where(at_y >= 0.0, wp.where(at_y < float(height), 1, 0), 0)
        here = wp.where(w > 0.0, in_x & in_y & wanted[k], 0)
        # rounds halves up where ``round`` takes them away from 0: texels left of or above the first do not exist
        x = wp.floor((wp.where(here != 0, at_x, 0.5) - 0.5) * texel_steps + 0.5) / texel_steps
        y = wp.floor((wp.where(here != 0, at_y, 0.5) - 0.5) * texel_steps + 0.5) / texel_steps
        columns[k] = int(wp.floor(x))
        rows[k] = int(wp.floor(y))
        share_x[k] = x - wp.floor(x)
        share_y[k] = y - wp.floor(y)
        own_depth[k] = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
        inside[k] = here
    out = PlaceRun()
    out.inside = inside
    out.column = columns
    out.row = rows
    out.share_x = share_x
    out.share_y = share_y
    out.depth = own_depth
    return out


@wp.func
def fetch_run(
    previous: wp.array(dtype=float),  # flat (4 H W,)
    view: View,
    points: PointRun,
    places: PlaceRun,
    epsilon: float,
    relative: float,
):
    """``fetch_record`` at the places of ``place_run``."""
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
    width = view.width
    height = view.height
    far = view.far
    inside = places.inside
    columns = places.column
    rows = places.row
    share_x = places.share_x
    share_y = places.share_y
    own_depth = places.depth
    total = Floats(0.0)
    known = Floats(0.0)
    rho = Floats(0.0)
    n = Floats(0.0)
    rise = Floats(0.0)
    mean = Floats(0.0)
    spread = Floats(0.0)
    of_mover = Ints(0)
    for dy in range(2):
        for dx in range(2):
            for k in range(LANES):
                along_row = wp.where(dx == 1, share_x[k], 1.0 - share_x[k])
                share = along_row * wp.where(dy == 1, share_y[k], 1.0 - share_y[k])
                column = columns[k] + dx
                row = rows[k] + dy
                in_row = wp.where(column >= 0, wp.where(column < width, inside[k], 0), 0)
                on_image = wp.where(row >= 0, wp.where(row < height, in_row, 0), 0)
                at = 4 * wp.where(on_image != 0, row * width + column, 0)
                held_rho = previous[at]
                held_n = previous[at + 1]
                tagged_depth = previous[at + 2] * far
                held_depth = wp.abs(tagged_depth)
                held_rise = previous[at + 3]
                x_px = float(column) + 0.5
                y_px = float(row) + 0.5
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
                expected = wp.where(seen, on_plane, own_depth[k])
                close = wp.abs(held_depth - expected) < epsilon + relative * held_depth
                counts = wp.where(share > 0.0, wp.where(held_n > 0.0, wp.where(held_depth > 0.0, on_image, 0), 0), 0)
                taken = wp.where(close, wp.where(counts != 0, share, 0.0), 0.0)
                total[k] = total[k] + taken
                rho[k] = rho[k] + taken * held_rho
                n[k] = n[k] + taken * held_n
                held_psi = held_rho / wp.where(held_n > 0.0, held_n, 1.0)
                mean[k] = mean[k] + taken * held_psi
                spread[k] = spread[k] + taken * held_psi * held_psi
                met = wp.where(held_rise > 0.0, taken, 0.0)
                known[k] = known[k] + met
                rise[k] = rise[k] + met * held_rise
                of_mover[k] = wp.where(tagged_depth < 0.0, wp.where(taken > 0.0, 1, of_mover[k]), of_mover[k])
    out = HistoryRun()
    for k in range(LANES):
        whole = wp.where(total[k] > 0.0, total[k], 1.0)
        rho[k] = wp.where(total[k] > 0.0, rho[k] / whole, 0.0)
        n[k] = wp.where(total[k] > 0.0, n[k] / whole, 0.0)
        rise[k] = rise[k] / wp.max(known[k], 1.0e-6)
        middle = mean[k] / whole
        spread[k] = wp.max(spread[k] / whole - middle * middle, 0.0)
    out.rho = rho
    out.n = n
    out.blocker_rise = rise
    out.of_mover = of_mover
    out.spread = spread
    return out
