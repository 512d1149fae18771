"""``shadow_buffer_update`` for a run of pixels at a time; see ``receiver_lanes.py`` for how such code is written.

The lanes do what nearly every pixel needs: the hard test, the history's four texels each with its depth test, the
sums, the error and the filter's width. What few pixels need is left to the plain function, one pixel at a time: a start
that searches, the end of a moving caster's shadow, surfaces whose motion is followed.
"""

from __future__ import annotations

import warp as wp

from wkernels.filtering import NEAREST_BLOCKER, LightFootprint
from wkernels.gbuffer import GBuffer
from wkernels.geometry import MOVES, RECEIVES
from wkernels.lanes import LANES, Floats, Ints
from wkernels.light_map import LightMap
from wkernels.receiver_lanes import LaneViews, locate_run, to_layers
from wkernels.shadow_buffer import EDGE_ON
from wkernels.shadow_buffer_update import (
    DISOCCLUDE,
    FULL_WIDTH_ERROR,
    START_SAMPLE,
    UpdateSettings,
    update_pixel,
)
from wkernels.views import View


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
def depth_in_light(light_map: LightMap, points: PointRun):
    """Linear depth from the light of each lane's point, ``locate``'s; 0 where no layer covers it."""
    px = points.x
    py = points.y
    pz = points.z
    layers = to_layers(light_map, points.receives, px, py, pz)
    out = Floats(0.0)
    for layer in range(light_map.layers):
        m = light_map.ws_to_ls[layer]
        m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
        for k in range(LANES):
            z = m20 * px[k] + m21 * py[k] + m22 * pz[k] + m23
            out[k] = wp.where(layers[k] == layer, z, out[k])
    return out


@wp.func
def fetch_run(
    previous: wp.array(dtype=float),  # flat (4 H W,)
    view: View,
    points: PointRun,
    wanted: Ints,
    epsilon: float,
    relative: float,
    texel_steps: float,
):
    """``fetch_record`` of the lanes that are wanted (1)."""
    px = points.x
    py = points.y
    pz = points.z
    nx = points.normal_x
    ny = points.normal_y
    nz = points.normal_z
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
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
    total = Floats(0.0)
    known = Floats(0.0)
    rho = Floats(0.0)
    n = Floats(0.0)
    rise = Floats(0.0)
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
                met = wp.where(held_rise > 0.0, taken, 0.0)
                known[k] = known[k] + met
                rise[k] = rise[k] + met * held_rise
                of_mover[k] = wp.where(tagged_depth < 0.0, wp.where(taken > 0.0, 1, of_mover[k]), of_mover[k])
    out = HistoryRun()
    for k in range(LANES):
        rho[k] = wp.where(total[k] > 0.0, rho[k] / wp.where(total[k] > 0.0, total[k], 1.0), 0.0)
        n[k] = wp.where(total[k] > 0.0, n[k] / wp.where(total[k] > 0.0, total[k], 1.0), 0.0)
        rise[k] = rise[k] / wp.max(known[k], 1.0e-6)
    out.rho = rho
    out.n = n
    out.blocker_rise = rise
    out.of_mover = of_mover
    return out


@wp.kernel
def update_shadow_buffer_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    flat_previous: wp.array(dtype=float),
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    settings: UpdateSettings,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    psi_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """``update_shadow_buffer`` of a run of pixels, for float32 texels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    held = wp.min(LANES, psi_out.shape[1] - x0)
    points = points_of_run(views, eye_depth, x0, y)
    receives = points.receives
    receivers = locate_run(views, light_map, settings.bias, x0, y)
    layers = receivers.layer
    own = receivers.depth
    plane = receivers.rise
    visible = receivers.visible
    xs = receivers.x
    ys = receivers.y

    depth = views.depth
    resolution = light_map.resolution
    tau = Floats(0.0)
    new_rise = Floats(0.0)
    moves = Ints(0)
    wanted = Ints(0)
    for k in range(LANES):
        texel_x = int(wp.floor(xs[k]))
        texel_y = int(wp.floor(ys[k]))
        inside_x = wp.clamp(texel_x, 0, resolution - 1)
        inside_y = wp.clamp(texel_y, 0, resolution - 1)
        beyond = wp.where(inside_x != texel_x, 1, wp.where(inside_y != texel_y, 1, 0))
        tagged = depth[(wp.max(layers[k], 0) * resolution + inside_y) * resolution + inside_x]
        stored = wp.where(beyond != 0, float(wp.inf), wp.abs(tagged))
        hidden = wp.where(layers[k] >= 0, wp.where(own[k] > stored, 1, 0), 0)
        rise = wp.clamp(1.0 - stored / wp.where(hidden != 0, plane[k], 1.0), 0.0, 1.0)
        tau[k] = wp.where(layers[k] >= 0, float(hidden), 1.0 - visible[k])
        new_rise[k] = wp.where(hidden != 0, rise, 0.0)
        moves[k] = wp.where(tagged < 0.0, hidden, 0)
        wanted[k] = wp.where(moves[k] != 0, 0, receives[k])

    history = HistoryRun()
    if settings.has_history != 0:
        history = fetch_run(
            flat_previous,
            previous_view,
            points,
            wanted,
            settings.depth_epsilon,
            settings.relative_epsilon,
            settings.texel_steps,
        )
    rho = history.rho
    n = history.n
    rises = history.blocker_rise
    of_mover = history.of_mover
    on_mover = points.moves
    alone = Ints(0)  # pixels for the plain function
    alone_count = int(0)
    smoothed = int(0)
    psi = Floats(0.0)
    error = Floats(0.0)
    first_blockers = settings.first_blockers
    counts_tests = settings.counts_tests
    weight = settings.weight
    limit = settings.storage.limit
    searches = wp.where(settings.start != START_SAMPLE, 1, 0)
    follows = wp.where(settings.followed_samples > 0.0, 1, 0)
    threshold = wp.where(settings.smooths != 0, settings.error_threshold, 2.0)  # no error is larger than 1
    least_samples = wp.where(settings.smooths != 0, settings.least_samples, 0.0)
    for k in range(LANES):
        start = wp.where(n[k] <= 0.0, receives[k] * searches, 0)
        alone[k] = start | of_mover[k] | (on_mover[k] * follows)
        alone_count += alone[k]
        known = wp.where(counts_tests != 0, n[k], rho[k]) + first_blockers
        refined = wp.where(rises[k] > 0.0, (new_rise[k] + rises[k] * known) / (known + 1.0), new_rise[k])
        rises[k] = wp.where(new_rise[k] > 0.0, refined, rises[k])
        scale = wp.where(n[k] + weight > limit, 0.5, 1.0)
        rho[k] = scale * rho[k] + weight * tau[k]
        n[k] = scale * n[k] + weight
        share = wp.clamp(rho[k] / n[k], 0.0, 1.0)
        variance = wp.max(share * (1.0 - share), 0.0) / wp.max(n[k] - 1.0, 0.5)
        deviation = wp.sqrt(wp.where(n[k] > 1.5, variance, 1.0))
        psi[k] = wp.where(receives[k] != 0, share, 0.0)
        error[k] = wp.where(receives[k] != 0, deviation, 0.0)
        uncertain = wp.where(error[k] > threshold, receives[k], wp.where(n[k] < least_samples, receives[k], 0))
        smoothed += wp.where(rises[k] > 0.0, uncertain, 0)

    half_width = Floats(0.0)
    eye_depths = points.depth
    if smoothed > 0:
        light_depth = depth_in_light(light_map, points)
        base = gbuffer.view.base_dx_ws
        along = gbuffer.view.along_dx_ws
        base_x, base_y, base_z = base[0], base[1], base[2]
        along_x, along_y, along_z = along[0], along[1], along[2]
        is_point = footprint.is_point
        size = settings.half_widths * settings.light_size
        narrows = settings.narrows
        for k in range(LANES):
            blocker = light_depth[k] * (1.0 - rises[k])
            behind = wp.max(light_depth[k] - blocker, 0.0)
            nearest = wp.max(blocker, NEAREST_BLOCKER * light_depth[k])
            ratio = wp.where(is_point > 0.0, behind / wp.where(nearest > 0.0, nearest, 1.0), behind)
            s_x = base_x + eye_depths[k] * along_x
            s_y = base_y + eye_depths[k] * along_y
            s_z = base_z + eye_depths[k] * along_z
            pixels = size * ratio / wp.max(wp.sqrt(s_x * s_x + s_y * s_y + s_z * s_z), 1.0e-30)
            narrow = wp.where(narrows != 0, wp.min(1.0, error[k] / FULL_WIDTH_ERROR), 1.0)
            uncertain = wp.where(error[k] > threshold, receives[k], wp.where(n[k] < least_samples, receives[k], 0))
            asks = wp.where(rises[k] > 0.0, uncertain, 0)
            half_width[k] = wp.where(asks != 0, pixels * narrow, 0.0)

    far = gbuffer.view.far
    drops = wp.where(settings.movers == DISOCCLUDE, 1, 0)
    for k in range(held):
        keeps = wp.where((moves[k] & drops) != 0, 0.0, float(receives[k]))
        tag = wp.where(wp.where(keeps > 0.0, moves[k], 0) != 0, -1.0, 1.0)
        rise = rises[k] * float(receives[k])
        current_out[y, x0 + k] = wp.vec4(rho[k] * keeps, n[k] * keeps, tag * eye_depths[k] / far, rise)
        psi_out[y, x0 + k] = psi[k]
        error_out[y, x0 + k] = error[k]
        half_width_out[y, x0 + k] = half_width[k]
    if alone_count > 0:
        for k in range(held):
            if alone[k] != 0:
                update_pixel(
                    x0 + k,
                    y,
                    gbuffer,
                    light_map,
                    footprint,
                    settings,
                    previous_view,
                    previous,
                    current_out,
                    psi_out,
                    error_out,
                    half_width_out,
                )
