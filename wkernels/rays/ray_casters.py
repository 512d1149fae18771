"""What single rays meet: the casters as a ``wp.Mesh``, and those that are cut out.

A ray asks the texture of every cut triangle that it meets, and goes on where that is out. These triangles have a tree
of boxes of their own, of which Warp gives all that a ray touches, in no order: nothing is stepped over, however close
two cards are to each other.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.scene.cutouts import Cutouts, cut_triangles, is_cut_out, no_cutouts


@wp.struct
class RayCasters:
    """The casting triangles."""

    mesh: wp.uint64  # a wp.Mesh of those that are whole; 0 where there are none
    cut: wp.uint64  # a wp.Bvh of the boxes of those that are cut out; 0 where there are none
    points_ws: wp.array(dtype=wp.vec3)
    indices: wp.array(dtype=int)  # of cut triangles
    cutouts: Cutouts


@wp.kernel
def bound_cut_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    low_out: wp.array(dtype=wp.vec3),
    high_out: wp.array(dtype=wp.vec3),
):
    """The box of a triangle."""
    t = first + wp.tid()
    a = points_ws[indices[3 * t]]
    b = points_ws[indices[3 * t + 1]]
    c = points_ws[indices[3 * t + 2]]
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    slack = wp.vec3(1.0, 1.0, 1.0) * (1.0e-6 * (wp.length(low) + wp.length(high)))  # boxes of flat cards have no depth
    low_out[t] = low - slack
    high_out[t] = high + slack


@wp.func
def is_cut_hidden(casters: RayCasters, origin_ws: wp.vec3, direction: wp.vec3, end: float):
    """Whether a cut-out caster is there on a ray, up to a distance; ``direction`` has length 1."""
    hidden = bool(False)
    if casters.cut != wp.uint64(0):
        query = wp.bvh_query_ray(casters.cut, origin_ws, direction)
        t = int(0)
        while wp.bvh_query_next(query, t):
            i = casters.indices[3 * t]
            j = casters.indices[3 * t + 1]
            k = casters.indices[3 * t + 2]
            a = casters.points_ws[i] - origin_ws
            b = casters.points_ws[j] - origin_ws
            c = casters.points_ws[k] - origin_ws
            w_a = wp.dot(wp.cross(b, c), direction)
            w_b = wp.dot(wp.cross(c, a), direction)
            w_c = wp.dot(wp.cross(a, b), direction)
            total = w_a + w_b + w_c
            inside = wp.min(wp.min(w_a, w_b), w_c) >= 0.0 or wp.max(wp.max(w_a, w_b), w_c) <= 0.0
            if inside and total != 0.0:
                distance = wp.dot(a * w_a + b * w_b + c * w_c, direction) / total
                if distance > 0.0 and distance < end:
                    if not is_cut_out(casters.cutouts, i, j, k, w_a, w_b, w_c):
                        hidden = True
                        break
    return hidden


class RayCasterBuilder:
    """Builds what rays meet of some triangles and keeps it up to date with their vertices.

    Args:
        points_ws: vec3 (V,), which may move.
        indices: int32 (3 T,), which stay.
        cutouts: Of the vertices.
        device: Warp device.
        threads: CPU threads; None for all.
    """

    def __init__(
        self, points_ws: wp.array, indices: wp.array, cutouts: Cutouts, device: str, threads: int | None
    ) -> None:
        self._points, self._device, self._threads = points_ws, device, threads
        self._mesh: wp.Mesh | None = None
        self._bvh: wp.Bvh | None = None
        cut = cut_triangles(indices, cutouts)
        self.casters = no_ray_casters(device)
        if not cut.any():
            self._mesh = wp.Mesh(points=points_ws, indices=indices)
        else:
            corners = indices.numpy().reshape(-1, 3)
            if not cut.all():
                self._mesh = wp.Mesh(points=points_ws, indices=self._upload(corners[~cut]))
            self.casters.points_ws, self.casters.indices = points_ws, self._upload(corners[cut])
            self.casters.cutouts = cutouts
            self._low, self._high = (wp.zeros(int(cut.sum()), dtype=wp.vec3, device=device) for _ in range(2))
            self._bound()
            self._bvh = wp.Bvh(self._low, self._high)
            self.casters.cut = self._bvh.id
        if self._mesh is not None:
            self.casters.mesh = self._mesh.id

    def refit(self) -> None:
        """Moves the structures to where the vertices are now."""
        if self._mesh is not None:
            self._mesh.refit()
        if self._bvh is not None:
            self._bound()
            self._bvh.refit()

    def _bound(self) -> None:
        inputs, outputs = [self._points, self.casters.indices], [self._low, self._high]
        launch(bound_cut_triangles, len(self._low), inputs, outputs, device=self._device, threads=self._threads)

    def _upload(self, corners: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(corners.ravel(), np.int32), dtype=int, device=self._device)


def no_ray_casters(device: str = "cpu") -> RayCasters:
    """What rays meet where nothing casts."""
    out = RayCasters()
    out.points_ws, out.indices = wp.zeros(1, dtype=wp.vec3, device=device), wp.zeros(1, dtype=int, device=device)
    out.cutouts = no_cutouts(device)
    return out
