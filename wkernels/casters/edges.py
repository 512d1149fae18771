"""Edges of the casters' triangles and the faces that meet there, once vertices at one position are merged.

No mesh is refused. Where one is open, branches, is doubled or flipped, that is kept and counted: what reads the edges
(``silhouettes``) is made for all of it. Adjacency is topology: it is built once and holds while vertices move.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wkernels.scene.geometry import Geometry

NO_COMPONENT = -1
"""Of a face that has no edges."""


def _counted(sentence: str) -> int:
    return field(default=0, metadata={"sentence": sentence})


@dataclass(frozen=True)
class EdgeCounts:
    """How many of what a mesh should not have; each with its sentence."""

    open_edges: int = _counted("edges have one face only: the surface ends there")
    nonmanifold_edges: int = _counted("edges have three faces or more")
    flipped_edges: int = _counted("edges have two faces that disagree on which side is outside")
    flipped_faces: int = _counted("faces would have to be flipped for their components to agree on the outside")
    unorientable_components: int = _counted("components have no outside, as a Moebius strip has none")
    duplicate_faces: int = _counted("faces have the corners of an earlier one, in whatever order")
    degenerate_faces: int = _counted("faces have two corners at one position, and no edges here")
    nonfinite_faces: int = _counted("faces have a corner that is no finite position, and no edges here")

    @property
    def sentences(self) -> list[str]:
        """One for each count that is not 0."""
        return [f"{n} {f.metadata['sentence']}." for f in fields(self) if (n := getattr(self, f.name))]


@dataclass(frozen=True, eq=False)
class Adjacency:
    """Faces, the edges between them, and their connected components.

    A *side* is one of the three borders of a face: side ``3 f + k`` runs from corner k of face f to the next. All sides
    between the same two positions are one edge.

    Attributes:
        faces: int32 (T, 3), of each corner the first vertex at its position; face f is triangle f.
        edges: int32 (E, 2), the ends of each edge, the lower vertex first; ascending.
        edge_begin: int32 (E + 1,), where each edge's part of ``edge_sides`` begins: one side where the surface ends,
            two within it, more where it branches.
        edge_sides: int32 (S,), ascending for each edge. Faces without an area to speak of have no side here.
        side_edge: int32 (3 T,), the edge of each side; -1 where it has none.
        component: int32 (T,), numbers faces that hang together by edges, in the order of their first faces;
            NO_COMPONENT for faces without edges.
        component_closed: bool (C,): exactly two faces at every edge, which agree on the outside.
        counts: What is not as it should be.
    """

    faces: np.ndarray
    edges: np.ndarray
    edge_begin: np.ndarray
    edge_sides: np.ndarray
    side_edge: np.ndarray
    component: np.ndarray
    component_closed: np.ndarray
    counts: EdgeCounts

    @cached_property
    def edge_faces(self) -> np.ndarray:
        """int32 (S,), the face of each of ``edge_sides``."""
        return self.edge_sides // 3

    @cached_property
    def edge_turns(self) -> np.ndarray:
        """int8 (S,): 1 where the side runs from the edge's first end to its second, else -1."""
        corners = self.faces.ravel()
        return np.where(corners[self.edge_sides] < corners[_next(self.edge_sides)], 1, -1).astype(np.int8)

    @cached_property
    def edge_apexes(self) -> np.ndarray:
        """int32 (S,), the corner of the face that is not on the edge."""
        return self.faces.ravel()[_next(_next(self.edge_sides))]

    @cached_property
    def edge_component(self) -> np.ndarray:
        """int32 (E,)."""
        return self.component[self.edge_faces[self.edge_begin[:-1]]]

    @cached_property
    def component_face(self) -> np.ndarray:
        """int32 (C,), the first face of each component; all are of its mesh."""
        first = np.unique(self.component, return_index=True)[1].astype(np.int32)
        return first[len(first) - len(self.component_closed) :]

    @cached_property
    def faces_by_component(self) -> tuple[np.ndarray, np.ndarray]:
        """Faces with a component, int32 (n,), one component after the other, and where each begins, (C + 1,)."""
        order = np.argsort(self.component, kind="stable").astype(np.int32)
        begin = np.searchsorted(self.component[order], np.arange(len(self.component_closed) + 1))
        return order[begin[0] :], (begin - begin[0]).astype(np.int32)

    @cached_property
    def vertices_by_component(self) -> tuple[np.ndarray, np.ndarray]:
        """The same of the vertices of these faces, each once for each component that it is in."""
        faces, _ = self.faces_by_component
        key = np.unique(np.repeat(self.component[faces].astype(np.int64), 3) << 32 | self.faces[faces].ravel())
        begin = np.searchsorted(key >> 32, np.arange(len(self.component_closed) + 1))
        return (key & 0xFFFFFFFF).astype(np.int32), begin.astype(np.int32)

    def sum_at_edges(self, values: np.ndarray) -> np.ndarray:
        """Sums over the faces of each edge, (E,), of ``values`` (S,)."""
        return np.add.reduceat(values, self.edge_begin[:-1], dtype=np.int32) if len(self.edges) else np.zeros(0, int)

    @property
    def is_closed(self) -> bool:
        """Whether there is a face, and no component is open or flipped."""
        return len(self.edges) > 0 and bool(self.component_closed.all())


def weld(points: np.ndarray, groups: np.ndarray | None = None, tolerance: float = 0.0) -> np.ndarray:
    """The first vertex at the position of each, int32 (V,).

    Args:
        points: (V, 3), of any float type.
        groups: int (V,), vertices of different groups are never merged.
        tolerance: 0 merges positions that are equal in that type. Else those no farther apart, scene units, and so on
            from each of them: a chain of close vertices becomes one.
    """
    groups = np.zeros(len(points), np.int32) if groups is None else groups
    if tolerance > 0.0:
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        pairs = finite[cKDTree(points[finite]).query_pairs(tolerance, output_type="ndarray").reshape(-1, 2)]
        label = connected(len(points), pairs[groups[pairs[:, 0]] == groups[pairs[:, 1]]])
        keys = (label,)
    else:
        keys = (*np.asarray(points).T, groups)
    order = np.lexsort(keys)  # stable: the first of equals is the lowest vertex
    new = np.ones(len(order), bool)
    if len(order):
        new[1:] = np.logical_or.reduce([key[order][1:] != key[order][:-1] for key in keys])
    first = np.empty(len(order), np.int32)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def find_edges(
    points: np.ndarray, faces: np.ndarray, groups: np.ndarray | None = None, tolerance: float = 0.0
) -> Adjacency:
    """The adjacency of some triangles.

    Args:
        points: (V, 3), of any float type; see ``weld`` for it and the next two.
        faces: int (T, 3), vertex indices.
        groups: int (V,).
        tolerance: Scene units.
    """
    welded = weld(points, groups, tolerance)[faces].reshape(-1, 3).astype(np.int32)
    nonfinite = ~np.isfinite(points).all(axis=1)[faces].all(axis=1).reshape(-1)
    a, b, c = welded.T
    degenerate = ~nonfinite & ((a == b) | (b == c) | (c == a))
    sides = np.arange(3 * len(welded), dtype=np.int32).reshape(-1, 3)[~nonfinite & ~degenerate].ravel()
    tail, head = welded.ravel()[sides], welded.ravel()[_next(sides)]
    key = np.minimum(tail, head).astype(np.int64) << 32 | np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    key, sides = key[order], sides[order]
    begin = np.flatnonzero(np.append(key[:-1] != key[1:], True)) + 1 if len(key) else np.zeros(0, int)
    begin = np.concatenate([[0], begin]).astype(np.int32)
    lows = key[begin[:-1]]
    edges = np.stack([lows >> 32, lows & 0xFFFFFFFF], axis=1).astype(np.int32)
    side_edge = np.full(3 * len(welded), -1, np.int32)
    side_edge[sides] = np.repeat(np.arange(len(edges), dtype=np.int32), np.diff(begin))

    same = side_edge[sides[1:]] == side_edge[sides[:-1]]
    component = connected(len(welded), np.stack([sides[:-1][same], sides[1:][same]], axis=1) // 3)
    used, component = np.unique(np.where(nonfinite | degenerate, NO_COMPONENT, component), return_inverse=True)
    component = (component.reshape(-1) - (NO_COMPONENT in used)).astype(np.int32)
    out = Adjacency(welded, edges, begin, sides, side_edge, component, np.zeros(0, bool), EdgeCounts())
    at_edge = np.diff(begin)
    two, net = at_edge == 2, out.sum_at_edges(out.edge_turns)
    bad = out.edge_component[~two | (net != 0)]
    closed = np.bincount(bad, minlength=len(used) - (NO_COMPONENT in used)) == 0
    flipped_faces, unorientable = _count_flipped(out, np.flatnonzero(two))
    counts = EdgeCounts(
        open_edges=int((at_edge == 1).sum()),
        nonmanifold_edges=int((at_edge > 2).sum()),
        flipped_edges=int((two & (net != 0)).sum()),
        flipped_faces=flipped_faces,
        unorientable_components=unorientable,
        duplicate_faces=_count_duplicates(welded[~nonfinite & ~degenerate]),
        degenerate_faces=int(degenerate.sum()),
        nonfinite_faces=int(nonfinite.sum()),
    )
    return Adjacency(welded, edges, begin, sides, side_edge, component, closed, counts)


def caster_edges(geometry: Geometry, tolerance: float = 0.0) -> Adjacency:
    """The adjacency of all casting triangles; its vertices are those of ``geometry.points_ws``.

    Vertices are merged within a mesh, by their float32 positions in the mesh's own space about its middle. These do not
    move, so that the result is the same at any frame, and it holds at all of them.

    Args:
        geometry: Gives the meshes; those that cast come first.
        tolerance: Of ``weld``, units of the meshes' own spaces.
    """
    points, faces, groups, start = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.int32)], [], 0
    for i, mesh in enumerate(geometry.meshes):
        if not mesh.casts:
            break
        finite = mesh.vertices[np.isfinite(mesh.vertices).all(axis=1)]
        middle = 0.5 * (finite.min(axis=0) + finite.max(axis=0)) if len(finite) else np.zeros(3)
        points.append((mesh.vertices - middle).astype(np.float32).reshape(-1, 3))
        faces.append(mesh.faces.reshape(-1, 3) + start)
        groups.append(np.full(len(mesh.vertices), i, np.int32))
        start += len(mesh.vertices)
    joined = np.concatenate(groups) if groups else np.zeros(0, np.int32)
    return find_edges(np.concatenate(points), np.concatenate(faces), joined, tolerance)


def _next(sides: np.ndarray) -> np.ndarray:
    """The following side of the same face."""
    return np.where(sides % 3 == 2, sides - 2, sides + 1)


def connected(nodes: int, pairs: np.ndarray) -> np.ndarray:
    """A number for each node; the same where pairs (n, 2) connect them, ascending by their first nodes."""
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(nodes, nodes))
    label = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[inverse.reshape(-1)]


def _count_duplicates(faces: np.ndarray) -> int:
    """How many of faces (n, 3) have the corners of an earlier one."""
    corners = np.sort(faces, axis=1)
    key = corners[:, 0].astype(np.int64) << 32 | corners[:, 1]
    order = np.lexsort((corners[:, 2], key))
    return int(((np.diff(key[order]) == 0) & (np.diff(corners[order, 2]) == 0)).sum())


def _count_flipped(adjacency: Adjacency, two: np.ndarray) -> tuple[int, int]:
    """Faces that are flipped against the greater part of their component, by its edges ``two`` with two faces.

    Returns:
        How many, and in how many components there is no such thing, as a way round leads back to the other side.
    """
    at = adjacency.edge_begin[two]
    flipped = adjacency.edge_turns[at] == adjacency.edge_turns[at + 1]
    if not flipped.any():
        return 0, 0
    # every face is two nodes, for its two orientations; edges connect those that agree
    count, (a, b) = len(adjacency.faces), (adjacency.edge_faces[at], adjacency.edge_faces[at + 1])
    other = flipped * count
    pairs = np.concatenate([np.stack([a, b + other], 1), np.stack([a + count, b + count - other], 1)])
    label = connected(2 * count, pairs)
    as_is, over = label[:count], label[count:]
    has = adjacency.component != NO_COMPONENT
    sizes = np.bincount(as_is[has], minlength=2 * count)
    part = np.minimum(as_is, over)  # faces of one part agree, once some are flipped
    first = np.unique(part[has & (as_is != over)], return_index=False)
    partner = np.full(2 * count, -1)
    partner[as_is], partner[over] = over, as_is
    flipped_faces = int(np.minimum(sizes[first], sizes[partner[first]]).sum())
    return flipped_faces, len(np.unique(part[has & (as_is == over)]))
