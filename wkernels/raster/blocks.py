"""Blocks of triangles and the views that may see them: what the drawing of many views leaves out.

A block is 128 triangles of a mesh in a row, which mostly lie together. Where its box lies beside a view no pixel of
that view can be covered, and the block is not drawn there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.raster.lane_culling import MESH_LANES
from wkernels.raster.triangles import is_finite_position
from wkernels.scene.views import View

MAX_VIEWS = 32
"""Views that one mask tells apart."""
BESIDE = wp.constant(1.0e-5)  # relative: more than float32 loses in a box's or a vertex's place
ALL_VIEWS = -1


@wp.kernel
def bound_blocks(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    triangles: int,
    begin: int,
    low_out: wp.array(dtype=wp.vec3),
    high_out: wp.array(dtype=wp.vec3),
):
    """The box of one block from the ``begin``-th on; without bounds where a vertex is not finite."""
    block = begin + first + wp.tid()
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = wp.vec3(-wp.inf, -wp.inf, -wp.inf)
    broken = int(0)
    for i in range(3 * MESH_LANES * block, 3 * wp.min(MESH_LANES * (block + 1), triangles)):
        p = points_ws[indices[i]]
        if not is_finite_position(p):
            broken = 1
        low = wp.min(low, p)
        high = wp.max(high, p)
    if broken != 0:
        low = wp.vec3(-wp.inf, -wp.inf, -wp.inf)
        high = wp.vec3(wp.inf, wp.inf, wp.inf)
    low_out[block] = low
    high_out[block] = high


@wp.func
def is_beside(x: wp.vec4, w: wp.vec4, middle: wp.vec3, half: wp.vec3):
    """Whether ``x`` + ``w`` of a view's rows is negative all over a box: then the box lies beyond that side.

    Where w is not positive nothing is drawn, and it may have any value there.
    """
    greatest = x[3] + w[3]
    size = wp.abs(x[3]) + wp.abs(w[3])
    for k in range(3):
        greatest += (x[k] + w[k]) * middle[k] + wp.abs(x[k] + w[k]) * half[k]
        size += (wp.abs(x[k]) + wp.abs(w[k])) * (wp.abs(middle[k]) + half[k])
    return greatest < -BESIDE * size


@wp.kernel
def find_views(
    first: int,
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    ws_to_ss: wp.array(dtype=wp.mat44),
    mask_out: wp.array(dtype=int),
):
    """A bit for each view that a block does not lie beside of."""
    block = first + wp.tid()
    middle = 0.5 * (low[block] + high[block])
    half = 0.5 * (high[block] - low[block])
    mask = int(0)
    for i in range(ws_to_ss.shape[0]):
        m = ws_to_ss[i]
        x = m[0]
        y = m[1]
        w = m[3]
        beside = is_beside(x, w, middle, half) or is_beside(-x, w, middle, half)
        if not (beside or is_beside(y, w, middle, half) or is_beside(-y, w, middle, half)):
            mask |= 1 << i
    mask_out[block] = mask


@wp.func
def needs(mask: int, view: int):
    """Whether a view's bit is set."""
    return ((mask >> view) & 1) != 0


@wp.kernel
def close_gaps(first: int, views: int, mask: wp.array(dtype=int)):
    """Adds the bits between the first and the last of each mask: a range of splits, as instances are numbered."""
    i = first + wp.tid()
    held = mask[i]
    begin = int(-1)
    end = int(-1)
    for view in range(views):
        if needs(held, view):
            if begin < 0:
                begin = view
            end = view
    closed = int(0)
    for view in range(views):
        if begin >= 0 and view >= begin and view <= end:
            closed |= 1 << view
    mask[i] = closed


@wp.kernel
def join_masks(
    first: int,
    block_mask: wp.array(dtype=int),
    begin: wp.array(dtype=int),  # (runs + 1,) of each run of vertices in ``block``
    block: wp.array(dtype=int),
    mask_out: wp.array(dtype=int),
):
    """A bit for each view that any block needs a run of vertices for."""
    run = first + wp.tid()
    mask = int(0)
    for i in range(begin[run], begin[run + 1]):
        mask |= block_mask[block[i]]
    mask_out[run] = mask


@dataclass
class BlockViews:
    """Which views blocks of triangles and runs of vertices are needed in, a bit each.

    Attributes:
        block: int32 (blocks,).
        run: int32 (runs,), of 128 vertices.
        pairs: Blocks times views.
        beside: How many of these pairs are left out.
    """

    block: wp.array
    run: wp.array
    pairs: int
    beside: int


class TriangleBlocks:
    """The blocks of a mesh with their boxes.

    Args:
        points_ws: vec3 (V,).
        indices: int32 (3 T,), T at least 1; they stay as they are.
        device: Warp device.
        threads: CPU threads; None for all.
    """

    def __init__(self, points_ws: wp.array, indices: wp.array, device: str = "cpu", threads: int | None = None) -> None:
        self.points_ws, self.indices, self.device, self.threads = points_ws, indices, device, threads
        self.triangles = len(indices) // 3
        lanes = int(MESH_LANES)
        self.blocks, self.runs = -(-self.triangles // lanes), -(-len(points_ws) // lanes)
        corners = indices.numpy()[: 3 * self.triangles].astype(np.int64) // lanes
        own = np.repeat(np.arange(self.triangles) // lanes, 3)
        pairs = np.unique(corners * self.blocks + own)  # in the order of the runs
        begin = np.searchsorted(pairs // self.blocks, np.arange(self.runs + 1)).astype(np.int32)
        self._begin = wp.array(begin, dtype=int, device=device)
        self._block = wp.array((pairs % self.blocks).astype(np.int32), dtype=int, device=device)
        self._low, self._high = (wp.empty(self.blocks, dtype=wp.vec3, device=device) for _ in range(2))
        self._masks = [wp.empty(n, dtype=int, device=device) for n in (self.blocks, self.runs)]
        self.update([(0, self.triangles)])

    def update(self, moved: Sequence[tuple[int, int]]) -> None:
        """Finds the boxes anew where vertices have moved: ranges of triangles, begin and end."""
        lanes = int(MESH_LANES)
        for begin, end in moved:
            first, last = begin // lanes, -(-min(end, self.triangles) // lanes)
            if last > first:
                inputs = [self.points_ws, self.indices, self.triangles, first]
                self._launch(bound_blocks, last - first, inputs, [self._low, self._high])

    def seen_by(self, views: Sequence[View], ranges: bool = False, everything: bool = False) -> BlockViews:
        """Which of at most MAX_VIEWS views need which blocks; valid until the next call.

        Args:
            views: The views.
            ranges: Whether a block that two views need is drawn in all between them too.
            everything: Whether all of them need all of them.
        """
        block, run = self._masks
        pairs = self.blocks * len(views)
        if everything:
            block.fill_(ALL_VIEWS)
            run.fill_(ALL_VIEWS)
            return BlockViews(block, run, pairs, 0)
        matrices = np.stack([np.array(view.ws_to_ss, dtype=np.float32).reshape(4, 4) for view in views])
        rows = wp.array(matrices, dtype=wp.mat44, device=self.device)
        self._launch(find_views, self.blocks, [self._low, self._high, rows], [block])
        if ranges:
            self._launch(close_gaps, self.blocks, [len(views)], [block])
        self._launch(join_masks, self.runs, [block, self._begin, self._block], [run])
        kept = int(np.unpackbits(block.numpy().view(np.uint8)).sum())
        return BlockViews(block, run, pairs, pairs - kept)

    def _launch(self, kernel: wp.Kernel, dim: int, inputs: list, outputs: list) -> None:
        launch(kernel, dim, inputs, outputs, device=self.device, threads=self.threads)
