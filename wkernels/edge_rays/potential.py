"""Edges that some receiver may see as a silhouette before the light, in a tree; and triangles that pierce the light.

An edge stands for the two faces at it; one with more faces is several, one with an odd number has a last one with one
face. What an edge adds to the depth complexity beyond it is the sum over its faces (Laine et al. 2005, section 3), so
that open, branching, flipped and doubled surfaces need no care. Triangles that reach into the light are no surface
here: receivers test them one by one, and the edges around them are open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.casters.edges import Adjacency
from wkernels.casters.pulls import pull_edges
from wkernels.casters.silhouettes import facing_of, potential_edges
from wkernels.edge_rays.light_plane import hull_for_paths, touching
from wkernels.rays.caster_tree import CasterTree, CasterTreeBuilder
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light
from wkernels.workspace.workspace import Workspace

MOST_PIERCING = 64
"""Triangles in the light that receivers still test one by one; with more, all of them take rays."""


@wp.struct
class PotentialEdges:
    """Edges in the order of their tree: eight to a leaf."""

    a_ws: wp.array(dtype=wp.vec3)
    b_ws: wp.array(dtype=wp.vec3)
    first_plane: wp.array(dtype=wp.vec4)  # n and n . a of a face
    second_plane: wp.array(dtype=wp.vec4)
    turns: wp.array(dtype=wp.vec2)  # 1 where a face's border runs from a to b, -1 from b to a, 0 no face
    count: int


@dataclass(frozen=True, eq=False)
class EdgeSet:
    """What is known of edges while light and casters stand still.

    Attributes:
        edges: The potential silhouettes.
        tree: Their boxes.
        piercing_ws: vec3 (3 n,), corners of the triangles that reach into the light.
        too_many: Whether there are more than ``MOST_PIERCING`` of those.
    """

    edges: PotentialEdges
    tree: CasterTree
    piercing_ws: wp.array
    too_many: bool


def pull_edge_set(work: Workspace, geometry: Geometry, light: Light, tree: CasterTree) -> EdgeSet:
    """``find_edge_set``, anew where the light or a caster has moved; ``tree`` is that of the casters."""
    adjacency = pull_edges(work, geometry)

    def build(old: EdgeSet | None) -> EdgeSet:
        return find_edge_set(work, geometry.points_ws, adjacency, light, tree.order.numpy())

    inputs = (adjacency, geometry.version, light.kind, hull_for_paths(light).tobytes())
    out: EdgeSet = work.product("potential silhouettes", "potential silhouettes", inputs, build)
    return out


def find_edge_set(
    work: Workspace, points_ws: wp.array, adjacency: Adjacency, light: Light, order_of_faces: np.ndarray
) -> EdgeSet:
    """The edges of some casters as a light with an area needs them.

    Args:
        work: Where to run.
        points_ws: vec3 (V,), rebased world.
        adjacency: Of the casters.
        light: Rebased world.
        order_of_faces: int32 (T,), of the casters' own tree.
    """
    points, device = points_ws.numpy(), work.device
    faces = adjacency.faces
    piercing = touching(light, points[faces])
    corners = hull_for_paths(light)
    indices = wp.array(np.ascontiguousarray(faces.ravel()), dtype=int, device=device)
    kept = potential_edges(adjacency, [facing_of(work, points_ws, indices, corner) for corner in corners])
    if piercing.any():
        at_piercing = adjacency.sum_at_edges(piercing[adjacency.edge_faces]) > 0
        kept = np.union1d(kept, np.flatnonzero(at_piercing))
    edge, side = _entries(adjacency, kept)
    planes = _planes(points, faces)
    held = (side >= 0) & ~piercing[adjacency.edge_faces[side]]
    face = np.where(held, adjacency.edge_faces[side], -1)
    turns = np.where(held, adjacency.edge_turns[side], 0).astype(np.float32)
    ends = adjacency.edges[edge]
    rank = np.empty(len(faces), np.int64)
    rank[order_of_faces] = np.arange(len(faces))
    # edges are as near to each other as their first faces
    order = np.argsort(rank[adjacency.edge_faces[side[:, 0]]], kind="stable").astype(np.int32)
    corners_of_edges = wp.array(np.ascontiguousarray(ends[:, [0, 1, 1]], np.int32).ravel(), dtype=int, device=device)
    tree = CasterTreeBuilder(points_ws, corners_of_edges, len(ends), device, work.threads, order=order).tree
    sorted_faces = face[order]
    out = PotentialEdges()
    out.a_ws, out.b_ws = (wp.array(points[ends[order, i]].reshape(-1, 3), dtype=wp.vec3, device=device) for i in (0, 1))
    zero = np.zeros((1, 4), np.float32)
    with_none = np.concatenate([planes, zero])
    out.first_plane, out.second_plane = (
        wp.array(with_none[sorted_faces[:, i]], dtype=wp.vec4, device=device) for i in (0, 1)
    )
    out.turns = wp.array(turns[order], dtype=wp.vec2, device=device)
    out.count = len(ends)
    pierced = points[faces[piercing]].reshape(-1, 3)
    return EdgeSet(out, tree, wp.array(pierced, dtype=wp.vec3, device=device), int(piercing.sum()) > MOST_PIERCING)


def _entries(adjacency: Adjacency, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces: the edge of each (n,), and the places of its faces in ``edge_sides`` (n, 2), -1 for none."""
    begin, end = adjacency.edge_begin[edges], adjacency.edge_begin[edges + 1]
    pairs = (end - begin + 1) // 2
    edge = np.repeat(edges, pairs)
    nth = np.arange(len(edge)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    first = np.repeat(begin, pairs) + 2 * nth
    second = np.where(first + 1 < np.repeat(end, pairs), first + 1, -1)
    return edge, np.stack([first, second], axis=1).reshape(-1, 2)


def _planes(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """n, n . a of each face, float32 (T, 4): one number decides for all of a face's edges on which side a point is."""
    with np.errstate(invalid="ignore", over="ignore"):
        a, b, c = (points[faces[:, i]].astype(np.float64) for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        return np.concatenate([normal, (normal * a).sum(axis=1, keepdims=True)], axis=1).astype(np.float32)
