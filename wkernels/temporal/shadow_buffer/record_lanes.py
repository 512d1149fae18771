"""History of a run of pixels: ``record.fetch_record``, 16 at a time (``docs/lanes.md``)."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.point_lanes import PointRun
from wkernels.scene.views import View
from wkernels.temporal.reprojection_lanes import depths_on_planes, reproject_run


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
def place_run(view: View, points: PointRun, wanted: Ints, texel_steps: float):
    """Where an earlier ``view`` saw the lanes that are wanted (1), as ``fetch_record`` finds them."""
    seen = reproject_run(view, points, wanted)
    inside = seen.inside
    at_x = seen.x
    at_y = seen.y
    columns = Ints(0)
    rows = Ints(0)
    share_x = Floats(0.0)
    share_y = Floats(0.0)
    for k in range(LANES):
        # rounds halves up where ``round`` takes them away from 0: texels left of or above the first do not exist
        x = wp.floor((wp.where(inside[k] != 0, at_x[k], 0.5) - 0.5) * texel_steps + 0.5) / texel_steps
        y = wp.floor((wp.where(inside[k] != 0, at_y[k], 0.5) - 0.5) * texel_steps + 0.5) / texel_steps
        columns[k] = int(wp.floor(x))
        rows[k] = int(wp.floor(y))
        share_x[k] = x - wp.floor(x)
        share_y[k] = y - wp.floor(y)
    out = PlaceRun()
    out.inside = inside
    out.column = columns
    out.row = rows
    out.share_x = share_x
    out.share_y = share_y
    out.depth = seen.depth
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
    width = view.width
    height = view.height
    far = view.far
    inside = places.inside
    columns = places.column
    rows = places.row
    share_x = places.share_x
    share_y = places.share_y
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
            expected = depths_on_planes(view, points, columns, rows, dx, dy, places.depth)
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
                close = wp.abs(held_depth - expected[k]) < epsilon + relative * held_depth
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
