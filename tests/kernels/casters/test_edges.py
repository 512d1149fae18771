"""Edge adjacency against a slow twin in dictionaries, on whole meshes and on everything that a mesh should not be."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
import pytest
import small_scenes
from caster_meshes import all_meshes, apart, broken, fan, soup, torus, whole

from wkernels.casters.closed import is_closed
from wkernels.casters.edges import NO_COMPONENT, Adjacency, EdgeCounts, caster_edges, find_edges, weld
from wkernels.casters.pulls import pull_edges
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Mesh
from wkernels.workspace.workspace import Workspace

MESHES = all_meshes()


def twin(vertices: np.ndarray, faces: np.ndarray) -> dict[tuple[int, int], list[int]]:
    """The sides at each edge, by the first vertices at the positions of its ends, lower first."""
    first: dict[tuple[float, ...], int] = {}
    welded = [first.setdefault(tuple(v + 0.0), i) for i, v in enumerate(vertices)]
    edges: dict[tuple[int, int], list[int]] = defaultdict(list)
    for f, face in enumerate(faces):
        corners = [welded[v] for v in face]
        if len(set(corners)) == 3 and np.isfinite(vertices[face]).all():
            for k in range(3):
                a, b = corners[k], corners[(k + 1) % 3]
                edges[min(a, b), max(a, b)].append(3 * f + k)
    return dict(sorted(edges.items()))


def twin_components(edges: dict[tuple[int, int], list[int]], faces: int) -> list[int]:
    """Flood fill over edges, from the lowest face on."""
    neighbours = defaultdict(set)
    for sides in edges.values():
        for side in sides:
            neighbours[side // 3] |= {other // 3 for other in sides}
    out, count = [NO_COMPONENT] * faces, 0
    for start in sorted(neighbours):
        if out[start] == NO_COMPONENT:
            todo = [start]
            while todo:
                face = todo.pop()
                if out[face] == NO_COMPONENT:
                    out[face] = count
                    todo += neighbours[face]
            count += 1
    return out


@pytest.mark.parametrize("name", MESHES)
def test_edges_sides_and_components_are_the_twins(name: str) -> None:
    vertices, faces = MESHES[name]
    got = find_edges(vertices.astype(np.float32), faces)
    want = twin(vertices, faces)
    assert [tuple(edge) for edge in got.edges.tolist()] == list(want)
    parts = zip(got.edge_begin[:-1], got.edge_begin[1:], strict=True)
    assert [got.edge_sides[a:b].tolist() for a, b in parts] == list(want.values())
    assert got.component.tolist() == twin_components(want, len(faces))
    firsts = [got.component.tolist().index(c) for c in range(len(got.component_closed))]
    assert got.component_face.tolist() == firsts and got.component.max(initial=-1) == len(firsts) - 1
    corners = got.faces
    for edge, (ends, sides) in enumerate(want.items()):
        at = got.edge_begin[edge]
        for i, side in enumerate(sides):
            face, k = divmod(side, 3)
            tail, head, apex = (int(corners[face, (k + j) % 3]) for j in range(3))
            assert got.edge_faces[at + i] == face and got.side_edge[side] == edge
            assert (tail, head) == (ends if got.edge_turns[at + i] == 1 else ends[::-1])
            assert got.edge_apexes[at + i] == apex
    used = [side for sides in want.values() for side in sides]
    assert set(np.flatnonzero(got.side_edge < 0)) == set(range(3 * len(faces))) - set(used)


@pytest.mark.parametrize("name", MESHES)
def test_counts_are_the_twins(name: str) -> None:
    vertices, faces = MESHES[name]
    got = find_edges(vertices.astype(np.float32), faces)
    corners = got.faces.tolist()
    want = twin(vertices, faces)
    turn = {s: 1 if corners[s // 3][s % 3] < corners[s // 3][(s + 1) % 3] else -1 for v in want.values() for s in v}
    sums = [sum(turn[side] for side in sides) for sides in want.values()]
    sizes = [len(sides) for sides in want.values()]
    finite = [bool(np.isfinite(vertices[face]).all()) for face in faces]
    proper = [frozenset(c) for c, ok in zip(corners, finite, strict=True) if ok and len(set(c)) == 3]
    counts = got.counts
    assert counts.open_edges == sizes.count(1)
    assert counts.nonmanifold_edges == sum(size > 2 for size in sizes)
    assert counts.flipped_edges == sum(size == 2 and net != 0 for size, net in zip(sizes, sums, strict=True))
    assert counts.duplicate_faces == len(proper) - len(set(proper))
    assert counts.degenerate_faces == sum(ok and len(set(c)) < 3 for c, ok in zip(corners, finite, strict=True))
    assert counts.nonfinite_faces == finite.count(False)
    bad = {
        got.component[sides[0] // 3] for sides, net in zip(want.values(), sums, strict=True) if len(sides) != 2 or net
    }
    assert got.component_closed.tolist() == [c not in bad for c in range(len(got.component_closed))]


def test_the_broken_meshes_show_every_count() -> None:
    counts = [find_edges(v.astype(np.float32), f).counts for v, f in MESHES.values()]
    counts.append(find_edges(*moebius(9)).counts)
    for name in EdgeCounts.__dataclass_fields__:
        assert any(getattr(each, name) > 0 for each in counts), name


@pytest.mark.parametrize(("name", "holes"), [("cube", 0), ("cube of loose triangles", 0), ("sphere", 0), ("torus", 1)])
def test_whole_meshes_obey_euler(name: str, holes: int) -> None:
    vertices, faces = whole()[name]
    got = find_edges(vertices.astype(np.float32), faces)
    assert got.counts == EdgeCounts() and not got.counts.sentences and got.is_closed
    assert len(np.unique(got.faces)) - len(got.edges) + len(faces) == 2 - 2 * holes
    assert got.component.tolist() == [0] * len(faces)


def moebius(cells: int) -> tuple[np.ndarray, np.ndarray]:
    angle = 2.0 * np.pi * np.arange(cells) / cells
    across = np.stack([np.cos(angle) * np.cos(angle / 2), np.sin(angle) * np.cos(angle / 2), np.sin(angle / 2)], 1)
    ring = 3.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros(cells)], 1)
    faces = []
    for i in range(cells):
        a, b = i, i + cells
        c, d = (i + 1, i + 1 + cells) if i + 1 < cells else (cells, 0)  # the last one is joined upside down
        faces += [(a, c, b), (b, c, d)]
    return np.concatenate([ring + across, ring - across]).astype(np.float32), np.array(faces, np.int32)


def test_flipped_faces_are_the_smaller_part() -> None:
    vertices, faces = small_scenes.sphere((0.0, 0.0, 0.0), 1.0)
    for flipped in (0, 1, 5, len(faces) - 3, len(faces)):
        turned = np.concatenate([faces[:flipped, ::-1], faces[flipped:]])
        counts = find_edges(vertices, turned).counts
        assert counts.flipped_faces == min(flipped, len(faces) - flipped)
        assert (counts.flipped_edges > 0) == (0 < flipped < len(faces)) and counts.unorientable_components == 0
    two = (
        np.concatenate([vertices, vertices + 5.0]),
        np.concatenate([faces[:2, ::-1], faces[2:], faces + len(vertices)]),
    )
    assert find_edges(*two).counts.flipped_faces == 2
    counts = find_edges(*moebius(9)).counts
    assert counts.unorientable_components == 1 and counts.flipped_faces == 0 and counts.flipped_edges > 0
    assert len(counts.sentences) == 3 and counts.sentences[0] == f"{counts.open_edges} edges have one face only: " + (
        "the surface ends there."
    )


def test_welding_takes_the_first_vertex_at_each_position() -> None:
    points = np.array([(1, 2, 3), (0.0, 0, 0), (1, 2, 3), (-0.0, 0, -0.0), (1, 2, 4), (np.nan, 0, 0), (np.nan, 0, 0)])
    assert weld(points).tolist() == [0, 1, 0, 1, 4, 5, 6]
    assert weld(points, np.array([0, 0, 1, 1, 1, 0, 0])).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert weld(points, tolerance=1.5).tolist() == [0, 1, 0, 1, 0, 5, 6]
    assert weld(points, np.array([0, 0, 1, 1, 1, 0, 0]), 1.5).tolist() == [0, 1, 2, 3, 2, 5, 6]
    chain = np.array([(x, 0.0, 0.0) for x in (0.0, 0.9, 1.8, 5.0)])
    assert weld(chain, tolerance=1.0).tolist() == [0, 0, 0, 3]
    close = points + np.array([0, 0, 1e-9, 0, 0, 0, 0])[:, None]
    assert weld(close)[2] == 2 and weld(close.astype(np.float32))[2] == 0
    assert weld(np.zeros((0, 3))).tolist() == [] and weld(np.zeros((0, 3)), tolerance=1.0).tolist() == []


def test_a_tolerance_closes_a_cracked_mesh() -> None:
    vertices, faces = apart(torus())
    cracked = (vertices + np.random.default_rng(1).uniform(-1e-4, 1e-4, vertices.shape)).astype(np.float32)
    loose, mended = find_edges(cracked, faces), find_edges(cracked, faces, tolerance=1e-3)
    assert loose.counts.open_edges == 3 * len(faces) and len(loose.component_closed) == len(faces)
    assert mended.is_closed and mended.counts == EdgeCounts() and len(mended.component_closed) == 1


def placed(meshes: list[Mesh]) -> Geometry:
    return Geometry(small_scenes.scene(meshes, small_scenes.light("point")), "cpu", 2)


def same(a: Adjacency, b: Adjacency) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("faces", "edges", "edge_sides", "component"))


def test_casters_of_a_geometry() -> None:
    """Boxes side by side stay apart; what does not cast has no part; faces are the geometry's triangles."""
    boxes = [small_scenes.box((x, 0.0, 0.0), (1.0, 1.0, 1.0)) for x in (0.0, 1.0)]
    meshes = [small_scenes.mesh("ground", small_scenes.plane(9.0), casts=False)]
    meshes += [small_scenes.mesh(f"box {i}", apart(box)) for i, box in enumerate(boxes)]
    geometry = placed(meshes)
    got = caster_edges(geometry)
    assert len(got.faces) == geometry.caster_triangles == 24 and got.is_closed
    assert got.component.tolist() == [0] * 12 + [1] * 12 and len(got.edges) == 36
    assert geometry.triangle_mesh.numpy()[got.component_face].tolist() == [0, 1]
    points = geometry.points_ws.numpy()
    np.testing.assert_array_equal(points[got.faces.ravel()], points[geometry.caster_indices.numpy()])
    assert len(caster_edges(placed(meshes[:1])).faces) == 0 and not caster_edges(placed(meshes[:1])).is_closed
    assert len(caster_edges(placed([])).edges) == 0


def test_adjacency_is_the_same_wherever_meshes_are() -> None:
    """At any frame, and with vertices 1e7 away in the mesh's own space, where float32 knows whole numbers only."""
    shape = apart(torus())
    far = (shape[0] + np.array([1e7, -1e7, 1e7]), shape[1])

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3] = trimesh_rotation(0.37 * frame)
        out[:3, 3] = (1e6 + frame / 7.0, 0.0, -1e6)
        return out

    still = placed([small_scenes.mesh("torus", shape)])
    want = caster_edges(still)
    assert want.is_closed
    moving = placed([small_scenes.mesh("torus", far, object_to_ws=pose, moving=True)])
    work = Workspace("cpu", 2, skips=True)
    held = pull_edges(work, moving)
    for frame in (0, 1, 5):
        moving.set_frame(frame)
        assert same(caster_edges(moving), want)
        assert pull_edges(work, moving) is held
    assert pull_edges(work, still) is not held


def trimesh_rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


def former_is_closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether each directed edge is there once, and its reverse too."""
    _, merged = np.unique(vertices, axis=0, return_inverse=True)
    faces = merged.reshape(-1)[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    directed = Counter((a, b) for f in faces.tolist() for a, b in zip(f, f[1:] + f[:1], strict=True))
    return bool(directed) and all(n == 1 and directed[b, a] == 1 for (a, b), n in directed.items())


def test_closed_is_closed() -> None:
    answers = Counter()
    meshes = [mesh for name, mesh in MESHES.items() if name != "not finite"] + [soup(seed) for seed in range(400)]
    vertices, faces = small_scenes.sphere((1e6, 0.0, 0.0), 1.0)  # float32 would merge many of its vertices
    meshes += [(vertices, faces), fan(2), (vertices, np.concatenate([faces[:1], faces[:1, ::-1]]))]
    for mesh in meshes:
        answer = is_closed(Mesh("mesh", *mesh))
        assert answer == former_is_closed(*mesh)
        answers[answer] += 1
    assert min(answers.values()) >= 6
    assert not is_closed(Mesh("mesh", *broken()["grid"])) and all(is_closed(Mesh("m", *m)) for m in whole().values())
    hole = np.where(np.arange(len(vertices))[:, None] == 3, np.nan, vertices)
    assert not is_closed(Mesh("mesh", hole, faces))  # what is nowhere closes nothing


def test_the_bunny_is_closed() -> None:
    pytest.importorskip("pxr")
    from experiments.config.source import from_dict
    from experiments.scenes.files import read_triangles
    from experiments.scenes.place import Place

    vertices, faces = read_triangles("warp:bunny.usd", Place(from_dict({}), Path()))
    got = find_edges(vertices.astype(np.float32), faces)
    assert got.is_closed and got.counts == EdgeCounts() and len(got.component_closed) == 1
    assert len(got.edges) * 2 == len(faces) * 3
