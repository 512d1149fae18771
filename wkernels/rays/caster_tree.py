"""The casters' triangles as a tree of boxes, eight children a node, laid out so that one step tests all eight at once.

Triangles are ordered in space, once; eight neighbours are a leaf, eight leaves a node, and so on to a single root. When
vertices move only the boxes change. Warp's own meshes answer one ray at a time; a pyramid of rays from a receiver to a
light (``shaft_rays``) needs the boxes themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.scene.cutouts import Cutouts, no_cutouts

WIDTH = wp.constant(8)
Eight = wp.types.vector(length=WIDTH, dtype=wp.float32)
HUGE_COORDINATE = wp.constant(3.0e38)


@wp.struct
class CasterTree:
    """Boxes and triangles, in spatial order.

    Node i of level l > 0 stands at ``level_begin[l] + i`` and holds the boxes of its children, nodes 8 i to 8 i + 7 of
    level l - 1; node i of level 0 is a leaf and holds eight triangles at i.
    """

    low_x: wp.array(dtype=Eight)
    low_y: wp.array(dtype=Eight)
    low_z: wp.array(dtype=Eight)
    high_x: wp.array(dtype=Eight)
    high_y: wp.array(dtype=Eight)
    high_z: wp.array(dtype=Eight)
    triangle: wp.array2d(dtype=Eight)  # (leaves, 9): x, y, z of the first corner, of the second, of the third
    level_begin: wp.array(dtype=int)
    level_size: wp.array(dtype=int)
    levels: int  # 0 where there is no triangle
    order: wp.array(dtype=int)  # triangle of each slot of the leaves
    indices: wp.array(dtype=int)  # vertices of triangles
    cutouts: Cutouts


@wp.kernel
def gather_leaves(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    order: wp.array(dtype=int),
    triangle_out: wp.array2d(dtype=Eight),
):
    """Eight triangles of one leaf; one that is not finite, or none, becomes a point, which nothing can hit."""
    leaf = first + wp.tid()
    for k in range(WIDTH):
        slot = leaf * WIDTH + k
        a = wp.vec3()
        b = wp.vec3()
        c = wp.vec3()
        if slot < order.shape[0]:
            t = 3 * order[slot]
            a = points_ws[indices[t]]
            b = points_ws[indices[t + 1]]
            c = points_ws[indices[t + 2]]
            if not (wp.length(a) + wp.length(b) + wp.length(c) < HUGE_COORDINATE):  # nor is a sum with a NaN
                a = wp.vec3()
                b = a
                c = a
        for i in range(3):
            triangle_out[leaf, i][k] = a[i]
            triangle_out[leaf, 3 + i][k] = b[i]
            triangle_out[leaf, 6 + i][k] = c[i]


@wp.func
def lowest(values: Eight, count: int):
    """Least of the first ``count`` of eight numbers."""
    out = values[0]
    for k in range(1, count):
        out = wp.min(out, values[k])
    return out


@wp.func
def highest(values: Eight, count: int):
    """Greatest of the first ``count`` of eight numbers."""
    out = values[0]
    for k in range(1, count):
        out = wp.max(out, values[k])
    return out


@wp.kernel
def bound_children(
    first: int,
    triangle: wp.array2d(dtype=Eight),
    triangles: int,
    begin: int,  # where the level's nodes are
    child_begin: int,  # where its children are; -1 if they are leaves
    children: int,
    low_x: wp.array(dtype=Eight),
    low_y: wp.array(dtype=Eight),
    low_z: wp.array(dtype=Eight),
    high_x: wp.array(dtype=Eight),
    high_y: wp.array(dtype=Eight),
    high_z: wp.array(dtype=Eight),
):
    """The boxes of one node's children; of one that does not exist, an empty box."""
    node = first + wp.tid()
    for k in range(WIDTH):
        child = node * WIDTH + k
        low = wp.vec3(1.0e30, 1.0e30, 1.0e30)
        high = -low
        if child < children and child_begin < 0:
            held = wp.min(WIDTH, triangles - child * WIDTH)
            for corner in range(0, 9, 3):
                x = triangle[child, corner]
                y = triangle[child, corner + 1]
                z = triangle[child, corner + 2]
                low = wp.min(low, wp.vec3(lowest(x, held), lowest(y, held), lowest(z, held)))
                high = wp.max(high, wp.vec3(highest(x, held), highest(y, held), highest(z, held)))
        if child < children and child_begin >= 0:
            at = child_begin + child
            low = wp.vec3(lowest(low_x[at], WIDTH), lowest(low_y[at], WIDTH), lowest(low_z[at], WIDTH))
            high = wp.vec3(highest(high_x[at], WIDTH), highest(high_y[at], WIDTH), highest(high_z[at], WIDTH))
        low_x[begin + node][k] = low[0]
        low_y[begin + node][k] = low[1]
        low_z[begin + node][k] = low[2]
        high_x[begin + node][k] = high[0]
        high_y[begin + node][k] = high[1]
        high_z[begin + node][k] = high[2]


def spatial_order(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangles such that any aligned run of 8^k of them is compact: halved along the longest extent of their middles.

    Args:
        points: (V, 3); what is not finite counts as 0.
        faces: int (T, 3).

    Returns:
        int32 (T,).
    """
    middle = np.nan_to_num(points[faces].mean(axis=1, dtype=np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    order = np.arange(len(faces))
    capacity = 8
    while capacity < len(faces):
        capacity *= 8
    waiting = [(0, len(faces), capacity)]
    while waiting:
        begin, end, capacity = waiting.pop()
        if end - begin <= 8:
            continue
        half = capacity // 2
        part = order[begin:end]
        if end - begin > half:
            own = middle[part]
            axis = int(np.argmax(np.ptp(own, axis=0)))
            order[begin:end] = part[np.argpartition(own[:, axis], half, kind="introselect")]
            waiting.append((begin + half, end, half))
        waiting.append((begin, min(begin + half, end), half))
    return order.astype(np.int32)


class CasterTreeBuilder:
    """Builds the tree of some triangles and keeps it up to date with their vertices.

    Args:
        points_ws: vec3 (V,), which may move.
        indices: int32, which stay.
        triangles: How many of their triangles count, from the first on.
        device: Warp device.
        threads: CPU threads; None for all. The tree does not depend on it.
        cutouts: Where triangles are not there; everywhere they are unless given.
        order: int32 (triangles,), such that runs of 8^k are compact; ``spatial_order`` unless given.
    """

    def __init__(
        self,
        points_ws: wp.array,
        indices: wp.array,
        triangles: int,
        device: str = "cpu",
        threads: int | None = None,
        cutouts: Cutouts | None = None,
        order: np.ndarray | None = None,
    ) -> None:
        self._points, self._indices, self._device, self._threads = points_ws, indices, device, threads
        self._triangles = triangles
        if order is None:
            order = spatial_order(points_ws.numpy(), indices.numpy()[: 3 * triangles].reshape(-1, 3))
        self._order = wp.array(order, dtype=int, device=device)
        sizes = [-(-self._triangles // 8)] if self._triangles else []
        while sizes and (len(sizes) == 1 or sizes[-1] > 1):
            sizes.append(-(-sizes[-1] // 8))
        begins = np.cumsum([0, 0, *sizes[1:]])[: len(sizes)]
        self._sizes, self._begins = sizes, begins
        tree = self.tree = CasterTree()
        nodes = max(1, sum(sizes[1:]))
        for name in ("low_x", "low_y", "low_z", "high_x", "high_y", "high_z"):
            setattr(tree, name, wp.zeros(nodes, dtype=Eight, device=device))
        tree.triangle = wp.zeros((max(1, sizes[0] if sizes else 0), 9), dtype=Eight, device=device)
        tree.level_begin = wp.array(np.array([*begins, 0], dtype=np.int32), dtype=int, device=device)
        tree.level_size = wp.array(np.array([*sizes, 0], dtype=np.int32), dtype=int, device=device)
        tree.levels = len(sizes)
        tree.order, tree.indices, tree.cutouts = self._order, indices, cutouts or no_cutouts(device)
        self.refit()

    def refit(self) -> None:
        """Moves leaves and boxes to where the vertices are now."""
        if not self._triangles:
            return
        tree = self.tree
        inputs: list[Any] = [self._points, self._indices, self._order]
        self._launch(gather_leaves, self._sizes[0], inputs, [tree.triangle])
        boxes = [tree.low_x, tree.low_y, tree.low_z, tree.high_x, tree.high_y, tree.high_z]
        for level in range(1, len(self._sizes)):
            child_begin = -1 if level == 1 else int(self._begins[level - 1])
            inputs = [tree.triangle, self._triangles, int(self._begins[level]), child_begin, self._sizes[level - 1]]
            self._launch(bound_children, self._sizes[level], inputs, boxes)

    def _launch(self, kernel: wp.Kernel, cells: int, inputs: list, outputs: list) -> None:
        launch(kernel, cells, inputs, outputs, device=self._device, threads=self._threads)
