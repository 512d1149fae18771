"""Passes 1 and 2 of the lane rasteriser for many views at once, as geometry cloning has it (Zhang, Sun and Nyman 2007).

*Cloned*: one work item per run of vertices or chunk of triangles, with a loop over the views that need it.
*Instanced*: one per run or chunk and view. Both leave out the same pairs, and write what single views write:
``project_run`` and ``cull_run`` are the bodies of ``project_lanes`` and ``cull_lanes``, which stay in one piece: as
calls of these they are slower on single views.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.blocks import needs
from wkernels.raster.lane_culling import (
    MESH_LANES,
    OUTSIDE,
    SMALL,
    Floats,
    Ints,
    Longs,
    Points,
    chunk_start,
    column_of,
    edge_32,
    first_centre,
    last_centre,
    pack,
    row_of,
)
from wkernels.raster.triangles import CULL_BACK, CULL_NONE, GUARD_PIXELS, SUBPIXELS
from wkernels.scene.views import View

MAX_SPLITS = wp.constant(32)
States = wp.types.matrix(shape=(MAX_SPLITS, 4), dtype=wp.int32)


@wp.struct
class CullShape:
    """What survivors of the culling must cover, and how they are told apart."""

    width: int
    height: int
    band_shift: int  # a band has 1 << this rows
    cull: int


@wp.struct
class Splits:
    """The views that are drawn, and where what belongs to them lies."""

    views: wp.array(dtype=View)
    perspective: wp.array(dtype=int)
    first: int  # of the views whose bits are in the masks
    count: int
    vertex_runs: int  # room for each view's vertices, in runs
    triangles: int  # room for each view's survivors
    bands: int
    chunks: int


@wp.func
def project_run(
    points: Points,
    view: View,
    perspective: int,
    run: int,
    vertex_out: wp.array(dtype=Longs),
    key_out: wp.array(dtype=Floats),
):
    """Snapped screen position and depth key of a run of vertices, into run ``run`` of the outputs."""
    m = view.ws_to_ss
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
    near = view.near
    width = float(view.width)
    height = float(view.height)
    vertices = Longs()
    keys = Floats(0.0)
    for k in range(MESH_LANES):
        x = points[3 * k]
        y = points[3 * k + 1]
        z = points[3 * k + 2]
        w = m30 * x + m31 * y + m32 * z + m33
        depth = m20 * x + m21 * y + m22 * z + m23
        x_h = 0.5 * ((m00 * x + m01 * y + m02 * z + m03) + w) * width
        y_h = 0.5 * (w - (m10 * x + m11 * y + m12 * z + m13)) * height
        guard = GUARD_PIXELS * w
        behind = wp.where(depth >= near, 0, 1) | wp.where(w > 0.0, 0, 32)  # two planes where the projection is warped
        beside = wp.where(x_h < -guard, 2, wp.where(x_h > guard, 4, 0))
        above = wp.where(y_h < -guard, 8, wp.where(y_h > guard, 16, 0))
        planes = behind | beside | above
        inside = wp.where(planes == 0, 1, 0)
        over_w = 1.0 / wp.where(inside == 1, w, 1.0)
        column = wp.where(
            inside == 1, int(wp.floor(wp.where(inside == 1, x_h, 0.0) * over_w * float(SUBPIXELS) + 0.5)), OUTSIDE
        )
        snapped_y = int(wp.floor(wp.where(inside == 1, y_h, 0.0) * over_w * float(SUBPIXELS) + 0.5))
        vertices[k] = pack(column, wp.where(inside == 1, snapped_y, planes))
        keys[k] = wp.where(perspective == 1, -over_w, depth * over_w)
    vertex_out[run] = vertices
    key_out[run] = keys


@wp.func
def cull_run(
    corners: wp.array(dtype=Ints),
    pitch: int,
    vertex: wp.array(dtype=wp.int64),
    vertex_begin: int,
    t0: int,
    t_end: int,
    shape: CullShape,
    state: wp.vec4i,
    column: int,
    row_0: int,
    survivor_out: wp.array(dtype=int),
    span_out: wp.array(dtype=int),
    clipped_out: wp.array(dtype=int),
    counts_out: wp.array2d(dtype=int),
):
    """Culls the triangles of a run from ``t0`` on, whose vertices begin at ``vertex_begin``, for one view.

    Args, those that are not ``cull_lanes``'s:
        state: Next places of survivors and clipped triangles, the last span, and how many have had it since it came:
            neighbouring triangles mostly lie in the same band, and are counted when another one comes.
        column, row_0: Of ``counts_out``: the chunk's, and that of the first band.

    Returns:
        The next state.
    """
    width = shape.width
    height = shape.height
    band_shift = shape.band_shift
    cull = shape.cull
    keep = Ints()
    outside = Ints()
    spans = Ints()
    kept = Ints()
    survivors = state[0]
    clipped = state[1]
    last_span = state[2]
    alike = state[3]
    corners_a = corners[t0 / MESH_LANES]
    corners_b = corners[pitch + t0 / MESH_LANES]
    corners_c = corners[2 * pitch + t0 / MESH_LANES]
    for k in range(MESH_LANES):
        a = vertex[vertex_begin + corners_a[k]]
        b = vertex[vertex_begin + corners_b[k]]
        c = vertex[vertex_begin + corners_c[k]]
        ax = column_of(a)
        bx = column_of(b)
        cx = column_of(c)
        ay = row_of(a)
        by = row_of(b)
        cy = row_of(c)
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
        spans[k] = (top >> band_shift) | ((bottom >> band_shift) << 16)
    n = int(0)
    crossing = int(0)
    for k in range(wp.min(MESH_LANES, t_end - t0)):
        kept[n] = k
        n += keep[k]
        crossing += outside[k]
    for i in range(n):
        k = kept[i]
        span = spans[k]
        survivor_out[survivors] = t0 + k
        span_out[survivors] = span
        survivors += 1
        if span != last_span:
            for band in range(last_span & 65535, (last_span >> 16) + 1):
                counts_out[row_0 + band, column] += alike
            last_span = span
            alike = 0
        alike += 1
    if crossing > 0:
        for k in range(wp.min(MESH_LANES, t_end - t0)):
            if outside[k] != 0:
                clipped_out[clipped] = t0 + k
                clipped += 1
    return wp.vec4i(survivors, clipped, last_span, alike)


@wp.func
def points_of_run(points_ws: wp.array(dtype=Points), last_points_ws: wp.array2d(dtype=Points), run: int):
    """128 points."""
    points = last_points_ws[0, 0]
    if run < points_ws.shape[0]:
        points = points_ws[run]
    return points


@wp.kernel
def project_instanced(
    first: int,
    points_ws: wp.array(dtype=Points),
    last_points_ws: wp.array2d(dtype=Points),
    splits: Splits,
    run_mask: wp.array(dtype=int),
    vertex_out: wp.array(dtype=Longs),
    key_out: wp.array(dtype=Floats),
):
    """``project_lanes`` of a run and a view."""
    row, i = wp.tid()
    run = first + row
    view = splits.first + i
    if needs(run_mask[run], view):
        points = points_of_run(points_ws, last_points_ws, run)
        at = i * splits.vertex_runs + run
        project_run(points, splits.views[view], splits.perspective[view], at, vertex_out, key_out)


@wp.kernel
def project_cloned(
    first: int,
    points_ws: wp.array(dtype=Points),
    last_points_ws: wp.array2d(dtype=Points),
    splits: Splits,
    run_mask: wp.array(dtype=int),
    vertex_out: wp.array(dtype=Longs),
    key_out: wp.array(dtype=Floats),
):
    """``project_lanes`` of a run, for each view that needs it."""
    run = first + wp.tid()
    points = points_of_run(points_ws, last_points_ws, run)
    for i in range(splits.count):
        view = splits.first + i
        if needs(run_mask[run], view):
            at = i * splits.vertex_runs + run
            project_run(points, splits.views[view], splits.perspective[view], at, vertex_out, key_out)


@wp.kernel
def cull_instanced(
    first: int,
    corners: wp.array(dtype=Ints),
    pitch: int,
    vertex: wp.array(dtype=wp.int64),
    end: int,
    shape: CullShape,
    splits: Splits,
    block_mask: wp.array(dtype=int),
    survivor_out: wp.array(dtype=int),
    span_out: wp.array(dtype=int),
    clipped_out: wp.array(dtype=int),
    found_out: wp.array2d(dtype=int),  # (2 views, chunks)
    counts_out: wp.array2d(dtype=int),  # (views bands, chunks)
):
    """``cull_lanes`` of a chunk and a view."""
    row, i = wp.tid()
    part = first + row
    view = splits.first + i
    t_begin = chunk_start(0, end, part, splits.chunks)
    t_end = chunk_start(0, end, part + 1, splits.chunks)
    row_0 = i * splits.bands
    own = i * splits.triangles + t_begin
    for band in range(splits.bands):
        counts_out[row_0 + band, part] = 0
    state = wp.vec4i(own, own, 0, 0)
    for t0 in range(t_begin, t_end, MESH_LANES):
        if needs(block_mask[t0 / MESH_LANES], view):
            state = cull_run(
                corners,
                pitch,
                vertex,
                i * splits.vertex_runs * MESH_LANES,
                t0,
                t_end,
                shape,
                state,
                part,
                row_0,
                survivor_out,
                span_out,
                clipped_out,
                counts_out,
            )
    for band in range(state[2] & 65535, (state[2] >> 16) + 1):
        counts_out[row_0 + band, part] += state[3]
    found_out[2 * i, part] = state[0] - own
    found_out[2 * i + 1, part] = state[1] - own


@wp.kernel
def cull_cloned(
    first: int,
    corners: wp.array(dtype=Ints),
    pitch: int,
    vertex: wp.array(dtype=wp.int64),
    end: int,
    shape: CullShape,
    splits: Splits,
    block_mask: wp.array(dtype=int),
    survivor_out: wp.array(dtype=int),
    span_out: wp.array(dtype=int),
    clipped_out: wp.array(dtype=int),
    found_out: wp.array2d(dtype=int),
    counts_out: wp.array2d(dtype=int),
):
    """``cull_lanes`` of a chunk, each block for all views that need it."""
    part = first + wp.tid()
    t_begin = chunk_start(0, end, part, splits.chunks)
    t_end = chunk_start(0, end, part + 1, splits.chunks)
    states = States()
    for i in range(splits.count):
        own = i * splits.triangles + t_begin
        states[i, 0] = own
        states[i, 1] = own
        for band in range(splits.bands):
            counts_out[i * splits.bands + band, part] = 0
    for t0 in range(t_begin, t_end, MESH_LANES):
        mask = block_mask[t0 / MESH_LANES]
        for i in range(splits.count):
            if needs(mask, splits.first + i):
                state = cull_run(
                    corners,
                    pitch,
                    vertex,
                    i * splits.vertex_runs * MESH_LANES,
                    t0,
                    t_end,
                    shape,
                    wp.vec4i(states[i, 0], states[i, 1], states[i, 2], states[i, 3]),
                    part,
                    i * splits.bands,
                    survivor_out,
                    span_out,
                    clipped_out,
                    counts_out,
                )
                states[i, 0] = state[0]
                states[i, 1] = state[1]
                states[i, 2] = state[2]
                states[i, 3] = state[3]
    for i in range(splits.count):
        own = i * splits.triangles + t_begin
        span = states[i, 2]
        for band in range(span & 65535, (span >> 16) + 1):
            counts_out[i * splits.bands + band, part] += states[i, 3]
        found_out[2 * i, part] = states[i, 0] - own
        found_out[2 * i + 1, part] = states[i, 1] - own
