"""Lit faces, silhouettes and loops against exact integers, chains in dictionaries and a walk edge by edge."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest
import small_scenes
from caster_meshes import all_meshes, facing, fan, silhouettes, soup, whole

from wkernels.casters.edges import find_edges
from wkernels.casters.pulls import pull_loops, pull_silhouettes
from wkernels.casters.silhouettes import (
    Loops,
    Silhouettes,
    counted_faces,
    find_loops,
    potential_edges,
)
from wkernels.scene.geometry import Geometry
from wkernels.workspace.workspace import Workspace

MESHES = all_meshes()
LIGHTS = [(0.3, 5.0, 0.7, 1.0), (-1.3, 0.2, 0.4, 1.0), (0.2, 0.9, -0.4, 0.0)]
WAYS = ("lit", "unlit", "both")


@pytest.mark.parametrize("w", [0, 1])
def test_facing_is_exact(w: int, device: str) -> None:
    """Python's integers; coordinates up to 2^12 at 2^20, where many a light lies in a face's plane."""
    rng = np.random.default_rng(w)
    vertices = rng.integers(-4, 5, (3000, 3)) * 1024 + 2**20 * rng.integers(0, 2)
    faces = rng.integers(0, len(vertices), (2000, 3))
    faces[-30:, 2] = faces[-30:, 0]
    light = np.array([*(rng.integers(-4, 5, 3) * 1024 + w * 2**20), w])
    want = []
    for face in faces:
        a, b, c = (np.array(vertices[v].tolist(), dtype=object) for v in face)
        u, v, way = b - a, c - a, np.array(light[:3].tolist(), dtype=object) - a * w
        normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        want.append(sum(n * x for n, x in zip(normal, way, strict=True)))
    assert want.count(0) > 50 and sum(x > 0 for x in want) > 500
    got = facing(vertices, faces, tuple(light.astype(float)), device)
    np.testing.assert_array_equal(got, np.where(np.array(want, dtype=object) > 0, 1, -1))


def test_facing_keeps_its_sign_far_from_the_origin() -> None:
    """A sphere whose vertices are float32 numbers at 1e6, and the same one where they are exact."""
    vertices, faces = small_scenes.sphere((0.0, 0.0, 0.0), 1000.0)
    far = (vertices + 1e6).astype(np.float32).astype(float)
    light = np.array([300.0, 5000.0, 700.0])
    want = facing(far - 1e6, faces, (*light, 1.0))
    np.testing.assert_array_equal(facing(far, faces, (*(light + 1e6), 1.0)), want)
    assert 0.2 < (want > 0).mean() < 0.8


def border(faces: np.ndarray) -> Counter[tuple[int, int]]:
    """How many faces run along each edge one way less those that run the other way, where that is not 0."""
    chain: Counter[tuple[int, int]] = Counter()
    for face in faces.tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            chain[a, b] += 1
            chain[b, a] -= 1
    return Counter({edge: n for edge, n in chain.items() if n > 0})


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("closed", WAYS)
def test_a_silhouette_is_the_border_of_the_faces_that_count(name: str, light: tuple[float, ...], closed: str) -> None:
    vertices, faces = MESHES[name]
    adjacency, got = silhouettes(vertices, faces, light, closed)
    lit = facing(vertices, faces, light)
    counted = []
    for face, corners in enumerate(adjacency.faces.tolist()):
        component = adjacency.component[face]
        if component >= 0 and (
            closed == "both" or not adjacency.component_closed[component] or (lit[face] > 0) == (closed == "lit")
        ):
            counted.append(corners if lit[face] > 0 else corners[::-1])
    np.testing.assert_array_equal(counted_faces(adjacency, got), np.array(counted, int).reshape(-1, 3))
    weights = {(a, b): n for (a, b), n in zip(got.ends.tolist(), got.weight.tolist(), strict=True)}
    assert weights == border(np.array(counted, int).reshape(-1, 3))
    assert len(weights) == len(got.edge) and (np.diff(got.edge) > 0).all()
    assert (np.sort(got.ends, axis=1) == adjacency.edges[got.edge]).all()
    of_edge = adjacency.component[adjacency.edge_faces[adjacency.edge_begin[:-1]]]
    np.testing.assert_array_equal(got.component, of_edge[got.edge])


def test_lit_and_unlit_faces_have_one_silhouette_and_both_have_it_twice() -> None:
    for name, mesh in whole().items():
        lit, unlit, both = (silhouettes(*mesh, LIGHTS[0], closed)[1] for closed in WAYS)
        np.testing.assert_array_equal(lit.ends, unlit.ends)
        np.testing.assert_array_equal(lit.ends, both.ends)
        assert (lit.weight == 1).all() and (unlit.weight == 1).all() and (both.weight == 2).all() and len(lit.edge), (
            name
        )


def test_open_edges_always_count_and_many_faces_add_up() -> None:
    vertices, faces = small_scenes.plane(2.0, cells=4)
    for light in ((0.1, 3.0, 0.2, 1.0), (0.1, -3.0, 0.2, 1.0), (1.0, 0.0, 0.0, 0.0)):  # above, below, in its plane
        adjacency, got = silhouettes(vertices, faces, light)
        assert set(got.edge) == set(np.flatnonzero(np.diff(adjacency.edge_begin) == 1)) and (got.weight == 1).all()
        assert len(got.edge) == adjacency.counts.open_edges == 16
    for blades in (1, 2, 3, 4, 5):
        for light in LIGHTS:
            adjacency, got = silhouettes(*fan(blades), light)
            lit = facing(*fan(blades), light)
            spine = got.weight[got.edge == 0]  # all faces run along it the same way
            assert spine.sum() == abs(int(lit.sum())) and blades % 2 <= len(spine)
            assert len(got.edge) - len(spine) == 2 * blades  # the edges of the blades are open
    orientations = [silhouettes(*flip(fan(4), k), LIGHTS[0])[1] for k in range(5)]
    for got in orientations[1:]:  # which way faces are wound says nothing
        np.testing.assert_array_equal(got.ends, orientations[0].ends)
        np.testing.assert_array_equal(got.weight, orientations[0].weight)


def flip(mesh: tuple[np.ndarray, np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    return mesh[0], np.concatenate([mesh[1][:count, ::-1], mesh[1][count:]])


def test_faces_in_the_lights_plane_belong_to_the_dark_side() -> None:
    """A cube's sides seen edge-on: the silhouette is the square that is lit, whole and nothing else."""
    vertices, faces = small_scenes.box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0))
    for light in ((0.0, 1.0, 0.0, 0.0), (0.0, 9.0, 0.0, 1.0), (1.0, 9.0, 0.0, 1.0), (1.0, 9.0, 1.0, 1.0)):
        adjacency, got = silhouettes(vertices, faces, light)
        assert len(got.edge) == 4 and (vertices[got.ends][..., 1] == 1.0).all()
        assert find_loops(got).closed.tolist() == [True]
        assert len(counted_faces(adjacency, got)) == 2


def test_outlines_run_counter_clockwise_seen_from_the_light() -> None:
    for mesh in whole().values():
        _, got = silhouettes(*mesh, (0.0, 1.0, 0.0, 0.0))
        loops = find_loops(got)
        assert loops.closed.all()
        # looking down y, counter-clockwise in (z, x)
        z, x = (mesh[0][got.ends][..., axis] for axis in (2, 0))
        assert 0.5 * (z[:, 0] * x[:, 1] - z[:, 1] * x[:, 0]).sum() > 0.0


def twin_loops(got: Silhouettes, weighted: bool) -> list[tuple[list[int], bool]]:
    """Walks edge by edge: the n-th to arrive at a vertex goes on along the n-th to leave, among one caster's."""
    units = [i for i, w in enumerate(got.weight) for _ in range(int(w) if weighted else 1)]
    arriving, leaving = defaultdict(list), defaultdict(list)
    for u, i in enumerate(units):
        leaving[got.component[i], got.ends[i, 0]].append(u)
        arriving[got.component[i], got.ends[i, 1]].append(u)
    after = {a: b for place, into in arriving.items() for a, b in zip(into, leaving[place], strict=False)}
    before = {b: a for a, b in after.items()}
    chains, seen = [], set()
    for u in range(len(units)):
        if u in seen:
            continue
        start = u
        while start in before and before[start] != u:
            start = before[start]
        closed = start in before
        start = u if closed else start
        chain = [start]
        while chain[-1] in after and after[chain[-1]] != start:
            chain.append(after[chain[-1]])
        seen |= set(chain)
        chains.append(([units[c] for c in chain], closed))
    return chains


def chains_of(loops: Loops) -> list[tuple[list[int], bool]]:
    parts = zip(loops.begin[:-1], loops.begin[1:], loops.closed, strict=True)
    return [(loops.member[a:b].tolist(), bool(closed)) for a, b, closed in parts]


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("weighted", [True, False])
def test_loops_are_the_twins_and_cover_every_edge(name: str, weighted: bool) -> None:
    for light in LIGHTS:
        for closed in WAYS:
            _, got = silhouettes(*MESHES[name], light, closed)
            loops = find_loops(got, weighted=weighted)
            assert chains_of(loops) == twin_loops(got, weighted)
            covered = np.bincount(loops.member, minlength=len(got.edge))
            np.testing.assert_array_equal(covered, got.weight if weighted else 1)
            assert loops.closed.all() or not weighted
            for chain, is_loop in chains_of(loops):
                heads, tails = got.ends[chain, 1], got.ends[chain, 0]
                assert (heads[:-1] == tails[1:]).all() and (not is_loop or heads[-1] == tails[0])
                assert len(set(got.component[chain])) == 1


def test_loops_of_well_known_shapes() -> None:
    cube = silhouettes(*whole()["cube"], (3.0, 7.0, 5.0, 0.0))[1]
    assert np.diff(find_loops(cube).begin).tolist() == [6]  # a hexagon
    along_the_axis = silhouettes(*whole()["torus"], (0.01, 0.02, 1.0, 0.0))[1]
    assert len(find_loops(along_the_axis).closed) == 2  # the rim and the hole
    apart = silhouettes(*MESHES["two that touch at a corner"], (0.3, 0.2, 9.0, 1.0))[1]
    loops = find_loops(apart)
    assert len(loops.closed) == 2 == len(set(apart.component))
    shared = np.bincount(apart.ends.ravel())
    assert shared.max() == 4  # both pass the corner, and neither leaves its own caster there
    folded = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1), (0.5, 1, 0), (0.5, 1, 1)], float)
    fold = silhouettes(folded, np.array([(0, 4, 5), (0, 5, 3), (4, 1, 2), (4, 2, 5)]), (9.0, 0.2, 0.5, 1.0))[1]
    assert sorted(fold.weight) == [1] * 6 + [2]
    assert not find_loops(fold, weighted=False).closed.all() and find_loops(fold).closed.all()


def test_potential_edges_hold_every_silhouette_of_a_light() -> None:
    """From random points of the hull, for whole and broken meshes; and they are few where the light is small."""
    rng = np.random.default_rng(4)
    shares = []
    for mesh in [*MESHES.values(), *(soup(seed) for seed in range(20, 40))]:
        centre, half = rng.uniform(-4, 4, 3), rng.uniform(0.0, 1.0)
        corners = centre + half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        adjacency = find_edges(mesh[0].astype(np.float32), mesh[1])
        got = potential_edges(adjacency, [facing(*mesh, (*corner, 1.0)) for corner in corners])
        assert (np.diff(got) > 0).all()
        inside = corners.min(axis=0) + rng.random((20, 3)) * (corners.max(axis=0) - corners.min(axis=0))
        seen = set()
        for point in [*corners, *inside]:
            seen |= set(silhouettes(*mesh, (*point, 1.0), "both")[1].edge)
        assert seen <= set(got.tolist())
        shares.append(len(seen) / max(1, len(got)))
    assert np.mean(shares) > 0.8
    sphere = find_edges(*whole()["sphere"])
    sides = [facing(*whole()["sphere"], (x, 9.0, z, 1.0)) for x in (-0.1, 0.1) for z in (-0.1, 0.1)]
    assert 0 < len(potential_edges(sphere, sides)) < 0.3 * len(sphere.edges)


def test_frames_keep_silhouettes_while_nothing_moves() -> None:
    shape = whole()["torus"]
    still = small_scenes.scene([small_scenes.mesh("torus", shape)], small_scenes.light("point"))
    geometry = Geometry(small_scenes.moved(still, 0, lambda frame: 0.0 if frame < 2 else 3.0), "cpu", 2)
    work, light = Workspace("cpu", 2), np.array([0.5, 5.0, 1.0, 1.0])
    first = pull_silhouettes(work, geometry, light)
    loops = pull_loops(work, first)
    geometry.set_frame(1)
    assert pull_silhouettes(work, geometry, light) is first and pull_loops(work, first) is loops
    assert pull_silhouettes(work, geometry, light, slot="other") is not first
    geometry.set_frame(2)
    moved = pull_silhouettes(work, geometry, light)
    assert moved is not first and not np.array_equal(moved.turns, first.turns)
    assert pull_loops(work, moved) is not loops
    points = geometry.points_ws.numpy()
    np.testing.assert_array_equal(moved.turns > 0, facing(points, shape[1], tuple(light)) > 0)
    assert pull_silhouettes(work, geometry, light + 1.0) is not moved
