"""The volumes that lie behind casters as seen from a light point, as homogeneous triangles: they reach to infinity.

Each is closed: sides along the silhouette, a cap at the caster, and one infinitely far away, where positions p become
directions p - l (Everitt and Kilgard 2002). Seen from outside all triangles are counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.casters.edges import Adjacency
from wkernels.casters.silhouettes import Silhouettes, counted_faces
from wkernels.workspace.workspace import Workspace


@wp.kernel
def extrude(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    used: wp.array(dtype=int),
    light_ws: wp.vec4,
    extruded_out: wp.array(dtype=wp.vec4),
):
    """A vertex, and behind all of these the direction in which it is carried away from the light."""
    i = first + wp.tid()
    p = points_ws[used[i]]
    way = p * light_ws[3] - wp.vec3(light_ws[0], light_ws[1], light_ws[2])
    extruded_out[i] = wp.vec4(p[0], p[1], p[2], 1.0)
    extruded_out[used.shape[0] + i] = wp.vec4(way[0], way[1], way[2], 0.0)


@dataclass(frozen=True, eq=False)
class Volumes:
    """Triangles for ``Rasteriser.count``, on the device.

    Attributes:
        points_ws: vec4, homogeneous.
        sides: int32 (3 n,), a quad of two for each silhouette edge, or one where the light is a direction; as often as
            the edge counts.
        near_caps: int32 (3 n,), the faces that the silhouette is the border of.
        far_caps: int32 (3 n,); none where the light is a direction, as all lie in one point.
        side_component: int32, to which caster each triangle of ``sides`` belongs, by the adjacency's numbers.
        cap_component: int32, likewise of ``near_caps``, and of ``far_caps`` where there are any.
    """

    points_ws: wp.array
    sides: wp.array
    near_caps: wp.array
    far_caps: wp.array
    side_component: np.ndarray
    cap_component: np.ndarray

    def sides_of(self, chosen: np.ndarray) -> wp.array:
        """``sides`` of the casters that are chosen, bool (C,)."""
        return _picked(self.sides, chosen[self.side_component])

    def caps_of(self, chosen: np.ndarray) -> wp.array:
        """``near_caps``, and then ``far_caps``, of the casters that are chosen, bool (C,)."""
        kept = chosen[self.cap_component]
        parts = [_picked(caps, kept).numpy() for caps in (self.near_caps, self.far_caps) if len(caps)]
        indices = np.concatenate(parts) if parts else np.zeros(0, np.int32)
        return wp.array(indices, dtype=int, device=self.sides.device)


def _picked(triangles: wp.array, kept: np.ndarray) -> wp.array:
    """Those of triangles (3 n,) that are kept, bool (n,)."""
    if kept.all():
        return triangles
    indices = np.ascontiguousarray(triangles.numpy().reshape(-1, 3)[kept].ravel())
    return wp.array(indices, dtype=int, device=triangles.device)


def sweep_volumes(
    work: Workspace, points_ws: wp.array, adjacency: Adjacency, silhouettes: Silhouettes, light_ws: np.ndarray
) -> Volumes:
    """Sweeps the faces that a silhouette is the border of away from the light.

    Args:
        work: Where to run.
        points_ws: vec3, shape (V,), the casters' vertices.
        adjacency: Of the casters.
        silhouettes: From the light point.
        light_ws: Light point (4,), w = 1, or 0 for a direction.
    """
    caps = counted_faces(adjacency, silhouettes)
    is_used = np.zeros(len(points_ws), bool)
    is_used[caps] = True  # the silhouette's vertices are among them
    used, local = np.flatnonzero(is_used).astype(np.int32), np.cumsum(is_used, dtype=np.int32) - 1
    a, b = np.repeat(local[silhouettes.ends], silhouettes.weight, axis=0).T
    caps, away = local[caps], len(used)
    at_infinity = light_ws[3] > 0.0
    quads = [(b, a, a + away), (b, a + away, b + away)]
    sides = [np.stack(corners, axis=1) for corners in quads[: 2 if at_infinity else 1]]

    def upload(triangles: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(triangles.ravel(), dtype=np.int32), dtype=int, device=work.device)

    extruded = wp.empty(2 * away, dtype=wp.vec4, device=work.device)
    inputs = [points_ws, wp.array(used, dtype=int, device=work.device), wp.vec4(*light_ws)]
    work.launch(extrude, away, inputs, [extruded])
    far = caps[:, ::-1] + away if at_infinity else caps[:0]
    side_component = np.tile(np.repeat(silhouettes.component, silhouettes.weight), len(sides))
    cap_component = adjacency.component[np.flatnonzero(silhouettes.turns)]
    return Volumes(extruded, upload(np.concatenate(sides)), upload(caps), upload(far), side_component, cap_component)
