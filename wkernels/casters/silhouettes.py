"""Where casters turn away from one point of a light: lit faces, silhouette edges with how often they count, and loops.

The faces that count are turned to the light; the silhouette is their border as a chain: an edge's weight is how many of
them run along it one way less how many run the other way. A border has no end, so that every volume that is swept
from it closes, whatever the mesh: at open edges, where three faces meet, and where faces are turned over or repeated
(Kim, Kim and Turk 2008). Of closed components only lit faces count, which gives weight 1; of others both sides do, so
that open edges always belong to it and folds have weight 2. It is the depth complexity that changes by the weight
across the edge (Laine et al. 2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp

from wkernels.casters.edges import NO_COMPONENT, Adjacency, connected
from wkernels.workspace.workspace import Workspace

ZERO = wp.constant(wp.float64(0.0))


@wp.kernel
def find_facing(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    light_ws: wp.vec4d,
    facing_out: wp.array(dtype=wp.int8),
):
    """1 where a face's counter-clockwise side faces the light, else -1: also where the light lies in its plane.

    In double, where the determinant of float32 positions is right but for the last bits. In lanes it takes half as long
    again: three gathered corners are most of it.
    """
    f = first + wp.tid()
    a = wp.vec3d(points_ws[indices[3 * f]])
    normal = wp.cross(wp.vec3d(points_ws[indices[3 * f + 1]]) - a, wp.vec3d(points_ws[indices[3 * f + 2]]) - a)
    way = wp.vec3d(light_ws[0], light_ws[1], light_ws[2]) - a * light_ws[3]
    facing = wp.int8(-1)
    if wp.dot(normal, way) > ZERO:
        facing = wp.int8(1)
    facing_out[f] = facing


def facing_of(work: Workspace, points_ws: wp.array, indices: wp.array, light_ws: np.ndarray) -> np.ndarray:
    """Which faces are lit: int8 (T,), 1 or -1, ``find_facing``.

    Args:
        work: Where to run.
        points_ws: vec3, shape (V,).
        indices: int32, shape (3 T,).
        light_ws: Light point (4,): a position with w = 1, or the direction to the light with w = 0.
    """
    facing = wp.empty(len(indices) // 3, dtype=wp.int8, device=work.device)
    work.launch(find_facing, len(facing), [points_ws, indices, wp.vec4d(*light_ws)], [facing])
    return np.asarray(facing.numpy())


def counted_turns(
    adjacency: Adjacency, facing: np.ndarray, closed: Literal["lit", "unlit", "both"] | np.ndarray = "lit"
) -> np.ndarray:
    """How each face counts, int8 (T,): 1 as it is, -1 turned over, 0 not at all.

    Args:
        adjacency: Of the casters.
        facing: int8 (T,), of ``facing_of``.
        closed: Which faces of closed components count; of others all do. ``unlit`` ones have the border of the ``lit``,
            and a volume that begins at them leaves the lit surface out. ``both`` count every body twice. Or, for each
            component, whether it is the lit ones, bool (C,).
    """
    counts = adjacency.component != NO_COMPONENT
    if not (isinstance(closed, str) and closed == "both") and len(adjacency.component_closed):
        lit = closed == "lit" if isinstance(closed, str) else closed[adjacency.component]
        counts &= ~adjacency.component_closed[adjacency.component] | ((facing > 0) == lit)
    return np.where(counts, facing, 0).astype(np.int8)


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """The silhouette of all casters from one light point.

    Attributes:
        turns: int8 (T,), the faces that it is the border of, ``counted_turns``.
        ends: int32 (n, 2), vertices of the casters; the lit face lies on the left of the way from the first to the
            second, seen from the light, where outlines run counter-clockwise. The side of a volume that faces outwards
            is then (second, first, first carried away, second carried away).
        weight: int32 (n,), at least 1.
        edge: int32 (n,), ascending: which of the adjacency's edges.
        component: int32 (n,), to which caster it belongs, by the adjacency's numbers.
    """

    turns: np.ndarray
    ends: np.ndarray
    weight: np.ndarray
    edge: np.ndarray
    component: np.ndarray


def find_silhouettes(adjacency: Adjacency, turns: np.ndarray) -> Silhouettes:
    """The border of the faces that ``turns`` (T,) counts, ``counted_turns``; 0 for all of a caster's leaves it out."""
    net = adjacency.sum_at_edges(adjacency.edge_turns * turns[adjacency.edge_faces])
    edge = np.flatnonzero(net).astype(np.int32)
    net, ends = net[edge], adjacency.edges[edge]
    ends = np.where(net[:, None] > 0, ends, ends[:, ::-1])
    return Silhouettes(turns, ends, np.abs(net).astype(np.int32), edge, adjacency.edge_component[edge])


def counted_faces(adjacency: Adjacency, silhouettes: Silhouettes) -> np.ndarray:
    """The faces that a silhouette is the border of, int32 (n, 3), counter-clockwise seen from the light.

    They are a volume's cap at the caster; carried away from the light and reversed, the one at its other end.
    """
    used = np.flatnonzero(silhouettes.turns)
    faces = adjacency.faces[used]
    return np.where(silhouettes.turns[used, None] > 0, faces, faces[:, ::-1])


def potential_edges(adjacency: Adjacency, facings: Sequence[np.ndarray]) -> np.ndarray:
    """Edges that are a silhouette from some point of a light, int32 (n,), ascending (Laine et al. 2005, section 3).

    Such an edge has weight towards some corner of the light's hull, both sides counting, or has a face that turns away
    within it. No other is one from any point of the hull, as a face's side is linear in the point.

    Args:
        adjacency: Of the casters.
        facings: ``facing_of`` each corner of the light's convex hull.
    """
    seen = np.stack([counted_turns(adjacency, facing, "both") for facing in facings])
    turning = adjacency.sum_at_edges((seen.min(axis=0) != seen.max(axis=0))[adjacency.edge_faces])
    net = adjacency.sum_at_edges(adjacency.edge_turns * seen[0][adjacency.edge_faces])
    return np.flatnonzero((turning != 0) | (net != 0)).astype(np.int32)


@dataclass(frozen=True, eq=False)
class Loops:
    """Silhouette edges in the order in which one leads to the next.

    Attributes:
        begin: int32 (L + 1,), where each loop's part of ``member`` begins.
        member: int32 (m,), silhouette edges; each as often in all as it counts.
        closed: bool (L,), whether the last edge leads to the first; of a whole silhouette all are.
    """

    begin: np.ndarray
    member: np.ndarray
    closed: np.ndarray


def find_loops(silhouettes: Silhouettes, *, weighted: bool = True) -> Loops:
    """Chains the edges into loops.

    Where several edges leave a vertex, the first to arrive there, in the silhouette's order, goes on along the first to
    leave, the second along the second; those of one caster among themselves. A loop may pass a vertex more than once.

    Args:
        silhouettes: Edges and their weights.
        weighted: Whether an edge counts as often as its weight says; all loops are closed then. Else every edge counts
            once, and where weights differ there are chains with two ends.
    """
    unit = np.repeat(np.arange(len(silhouettes.edge), dtype=np.int32), silhouettes.weight if weighted else 1)
    key = silhouettes.component[unit].astype(np.int64) << 32
    tail, head = key | silhouettes.ends[unit, 0], key | silhouettes.ends[unit, 1]
    leaving, arriving = np.argsort(tail, kind="stable"), np.argsort(head, kind="stable")
    sorted_tail, sorted_head = tail[leaving], head[arriving]
    rank = np.arange(len(unit)) - np.searchsorted(sorted_head, sorted_head)
    at = np.searchsorted(sorted_tail, sorted_head) + rank
    goes_on = at < np.searchsorted(sorted_tail, sorted_head, "right")
    after = np.full(len(unit), -1)
    after[arriving[goes_on]] = leaving[at[goes_on]]

    label = connected(len(unit), np.stack([arriving[goes_on], leaving[at[goes_on]]], axis=1))
    count = int(label.max()) + 1 if len(label) else 0
    closed = np.bincount(label[after < 0], minlength=count) == 0
    first = np.unique(label, return_index=True)[1]
    after[np.isin(after, first[closed])] = -1  # closed ones begin with their first edge
    left = (after >= 0).astype(np.int64)  # edges still to come, doubling the known way each time
    while (far := np.flatnonzero(after >= 0)).size:
        left[far] += left[after[far]]
        after[far] = after[after[far]]
    order = np.lexsort((-left, label))
    begin = np.concatenate([[0], np.cumsum(np.bincount(label, minlength=count))]).astype(np.int32)
    return Loops(begin, unit[order], closed)
