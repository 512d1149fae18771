"""Passes 1 and 2 of the lane rasteriser for many views at once, as geometry cloning has it (Zhang, Sun and Nyman 2007).

*Cloned*: one work item per run of vertices or chunk of triangles, with a loop over the views that need it.
*Instanced*: one per run or chunk and view. Both leave out the same pairs, and write what single views write.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.blocks import needs
from wkernels.raster.lane_culling import (
    LANES,
    CullShape,
    Floats,
    Ints,
    Longs,
    Points,
    chunk_start,
    cull_run,
    project_run,
)
from wkernels.views import View

MAX_SPLITS = wp.constant(32)
States = wp.types.matrix(shape=(MAX_SPLITS, 4), dtype=wp.int32)


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
    for t0 in range(t_begin, t_end, LANES):
        if needs(block_mask[t0 / LANES], view):
            state = cull_run(
                corners,
                pitch,
                vertex,
                i * splits.vertex_runs * LANES,
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
    for t0 in range(t_begin, t_end, LANES):
        mask = block_mask[t0 / LANES]
        for i in range(splits.count):
            if needs(mask, splits.first + i):
                state = cull_run(
                    corners,
                    pitch,
                    vertex,
                    i * splits.vertex_runs * LANES,
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
