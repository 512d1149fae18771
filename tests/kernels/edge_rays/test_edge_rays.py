"""Silhouette edges against rays to the same samples, and against brute force: all lights, whole and broken casters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import caster_meshes
import numpy as np
import pytest
import small_scenes as small
import warp as wp
from sessions import open_session

from experiments.scenes.loader import load_scene
from wkernels.edge_rays import tracing
from wkernels.edge_rays.light_plane import touching
from wkernels.edge_rays.potential import MOST_PIERCING, pull_edge_set
from wkernels.edge_rays.tracing import trace_silhouettes
from wkernels.frame.session import Session
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.lights import Light, RectangleLight
from wkernels.scene.model import Scene

pytestmark = pytest.mark.usefixtures("cpu_only")
SCENES = Path(__file__).parents[3] / "configs" / "scenes"
AREA_LIGHTS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")
SHARE = 1e-4  # of samples: those on an edge within rounding


@pytest.fixture(name="cpu_only")
def _cpu_only(device: str) -> None:
    if device != "cpu":
        pytest.skip("rays go one by one on CUDA")


def both_ways(session: Session, count: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Visibility of the receivers by edges and by rays, and how many of the former took rays."""
    gbuffer, hull, samples = session.gbuffer(), session.light_hull(), session.light_samples(count)
    known = pull_edge_set(session, session.geometry, session.light, session.caster_tree())
    tree, shape = session.caster_tree(), gbuffer.flags.shape
    edges, rays = (wp.zeros(shape, dtype=float, device="cpu") for _ in range(2))
    by_rays = trace_silhouettes(
        session, gbuffer, known, tree, session.caster_mesh(), samples, session.light, hull, edges
    )
    proof = wp.zeros(shape, dtype=int, device="cpu")
    session.launch(trace_shafts, shape, [gbuffer, tree, samples.batches, hull, 1], [rays, proof])
    receives = (gbuffer.flags.numpy() & int(RECEIVES)) != 0
    assert (edges.numpy()[~receives] == 1.0).all()
    return edges.numpy()[receives], rays.numpy()[receives], by_rays


def assert_same(edges: np.ndarray, rays: np.ndarray, count: int, penumbra: float = 0.02) -> None:
    """No receiver is off by more than one sample, and few by that; and there is a penumbra to be wrong in."""
    assert np.mean((rays > 0.0) & (rays < 1.0)) >= penumbra
    off = np.abs(edges - rays) * count
    assert off.max() < 1.5, f"{(off > 1.5).sum()} of {len(off)} receivers are off by up to {off.max():.0f} samples"
    assert off.sum() <= max(1.5, SHARE * count * len(off))


def in_the_way(shape: small.Triangles, lamp: Light, scale: float = 1.2, y: float = 2.0) -> Scene:
    """A mesh that casts and receives, over ground that does."""
    vertices = scale * shape[0] + np.array((0.2, y, -0.1))
    meshes = [small.mesh("ground", small.plane(12.0)), small.mesh("caster", (vertices, shape[1]))]
    return small.scene(meshes, lamp)


@pytest.mark.parametrize("kind", AREA_LIGHTS)
@pytest.mark.parametrize("samples", [5, 64, 300])
def test_all_lights(kind: str, samples: int, device: str) -> None:
    scene = small.cluttered(small.light(kind, (2.0, 8.0, -1.0)))
    edges, rays, by_rays = both_ways(open_session(scene, device), samples)
    assert_same(edges, rays, samples)
    assert by_rays <= 0.002 * len(edges)


@pytest.mark.parametrize("name", [*caster_meshes.whole(), *caster_meshes.broken()])
def test_whole_and_broken_meshes(name: str, device: str) -> None:
    shape = {**caster_meshes.whole(), **caster_meshes.broken()}[name]
    scene = in_the_way(shape, small.light("rectangle", (1.0, 9.0, 2.0), 2.5))
    edges, rays, _ = both_ways(open_session(scene, device), 64)
    assert_same(edges, rays, 64, penumbra=0.005 if len(shape[1]) and np.isfinite(shape[0]).all() else 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_random_soups(seed: int, device: str) -> None:
    rng = np.random.default_rng(seed)
    lamp = small.light(AREA_LIGHTS[seed % len(AREA_LIGHTS)], tuple(rng.uniform((-3, 6, -3), (3, 9, 3))), 2.0)
    scene = in_the_way(caster_meshes.soup(seed), lamp, 1.0, 1.0)
    edges, rays, _ = both_ways(open_session(scene, device), 64)
    assert_same(edges, rays, 64, penumbra=0.0)
    triangles = np.random.default_rng(seed).uniform((-3.0, 0.5, -3.0), (3.0, 4.0, 3.0), (40, 1, 3))
    triangles = triangles + np.random.default_rng(seed + 9).normal(0.0, 0.8, (40, 3, 3))  # they cross one another
    scene = small.scene(
        [
            small.mesh("ground", small.plane(12.0)),
            small.mesh(
                "soup", caster_meshes.apart((triangles.reshape(-1, 3), np.arange(120, dtype=np.int32).reshape(-1, 3)))
            ),
        ],
        lamp,
    )
    edges, rays, _ = both_ways(open_session(scene, device), 64)
    assert_same(edges, rays, 64)


def test_brute_force(device: str) -> None:
    """Every sample of every receiver, in double."""
    lamp = small.light("rectangle", (1.0, 8.0, 1.0), 2.0)
    session = open_session(in_the_way(small.sphere((0.0, 0.0, 0.0), 1.0), lamp), device, size=(32, 24))
    edges, _, _ = both_ways(session, 32)
    gbuffer, geometry = session.gbuffer(), session.geometry
    keep = ((gbuffer.flags.numpy() & int(RECEIVES)) != 0).ravel()
    position = gbuffer.position_ws.numpy().reshape(-1, 3)[keep].astype(float)
    normal = gbuffer.normal_ws.numpy().reshape(-1, 3)[keep].astype(float)
    own = gbuffer.triangle.numpy().ravel()[keep]
    corners = geometry.points_ws.numpy().astype(float)[geometry.caster_indices.numpy().reshape(-1, 3)]
    seen = np.zeros(len(position))
    doubtful = np.zeros(len(position))
    for sample in session.light_samples(32).host:
        way = sample[:3] - position
        t, least = small.ray_hits(position, way, corners)
        t[np.arange(len(own)), own] = np.inf
        seen += (np.einsum("ij,ij->i", normal, way) > 0.0) & ~((t > 0.0) & (t < 1.0)).any(axis=1)
        doubtful += ((np.abs(least) < 1e-3) & (np.arange(len(corners)) != own[:, None])).any(axis=1)
    assert np.all(np.abs(edges * 32 - seen) <= doubtful + 1e-3)
    assert np.mean(doubtful == 0) > 0.5


@pytest.mark.parametrize("kind", ["rectangle", "disc", "polygon", "sphere", "linear"])
def test_casters_that_pierce_the_light(kind: str, device: str) -> None:
    """Through the middle of the light, over its rim, close before and behind its plane, beside it, and far behind it."""
    lamp = small.light(kind, (0.0, 5.0, 0.0), 2.0)
    bodies = [
        small.box((0.2, 5.0, 0.1), (0.5, 2.0, 0.4)),
        small.box((-1.0, 5.1, 0.9), (0.8, 0.9, 0.9)),
        small.plane(0.5, 4.999, (0.6, -0.6)),
        small.plane(0.5, 4.99, (0.6, 0.6)),
        small.plane(0.5, 5.001, (-0.6, -0.6)),
        small.box((3.0, 5.0, 3.0), (1.0, 3.0, 1.0)),
        small.box((0.0, 8.0, 0.0), (4.0, 1.0, 4.0)),
        small.box((0.5, 2.0, -0.8), (1.0, 1.0, 1.0)),
    ]
    meshes = [small.mesh("ground", small.plane(12.0))]
    meshes += [small.mesh(f"body {i}", body) for i, body in enumerate(bodies)]
    session = open_session(small.scene(meshes, lamp), device)
    known = pull_edge_set(session, session.geometry, session.light, session.caster_tree())
    assert 0 < len(known.piercing_ws) // 3 <= MOST_PIERCING
    edges, rays, _ = both_ways(session, 64)
    assert_same(edges, rays, 64)


def test_many_piercing_triangles_take_rays(device: str) -> None:
    lamp = small.light("sphere", (0.0, 4.0, 0.0), 2.0)
    session = open_session(in_the_way(small.sphere((0.0, 0.0, 0.0), 1.0, 200), lamp, y=4.0), device)
    edges, rays, by_rays = both_ways(session, 16)
    assert by_rays == len(edges)
    np.testing.assert_array_equal(edges, rays)


def test_receivers_in_the_plane_of_the_light(device: str) -> None:
    """A vertical light that stands on the ground: near it, receivers see it flat."""
    lamp = RectangleLight(
        center=np.array((0.0, 1.0, 0.0)), edge_u=np.array((2.0, 0.0, 0.0)), edge_v=np.array((0.0, 2.0, 0.0))
    )
    walls = [small.mesh("ground", small.plane(12.0)), small.mesh("box", small.box((0.5, 0.7, 1.5), (0.6, 1.4, 0.4)))]
    wall = (np.array([(-5.0, 0.0, -0.002), (-2.0, 0.0, -0.002), (-2.0, 3.0, -0.002)]), np.array([(0, 1, 2)], np.int32))
    session = open_session(small.scene([*walls, small.mesh("wall", wall)], lamp), device)
    edges, rays, by_rays = both_ways(session, 64)
    assert_same(edges, rays, 64)
    assert 0 < by_rays < 0.2 * len(edges)


def test_thin_lights(device: str) -> None:
    for edge_v in (1e-6, 0.0):
        lamp = RectangleLight(
            center=np.array((1.0, 8.0, 1.0)), edge_u=np.array((3.0, 0.0, 0.0)), edge_v=np.array((0.0, 0.0, edge_v))
        )
        edges, rays, _ = both_ways(open_session(small.cluttered(lamp), device), 32)
        assert_same(edges, rays, 32)


def test_textured_lights_weigh_samples(device: str) -> None:
    texture = np.random.default_rng(2).uniform(0.0, 3.0, (4, 5)) * (np.arange(5) > 1)
    lamp = replace(small.light("rectangle", (2.0, 8.0, -1.0), 2.0), texture=texture)
    edges, rays, _ = both_ways(open_session(small.cluttered(lamp), device), 128)
    np.testing.assert_allclose(edges, rays, atol=4.0 / 128)
    assert np.mean(np.abs(edges - rays) > 1e-5) < 0.01


@pytest.mark.parametrize(
    "name",
    [
        "a1_half_plane",
        "a2_half_plane_disc",
        "a3_coaxial_discs",
        "a4_rectangle",
        "a5_two_occluders",
        "a7_full_occluder",
        "overlap",
        "bunny",
        "big_penumbra",
        "light_close_to_blocker",
        "paris",
        "winter",
    ],
)
def test_scenes_of_experiments(name: str, device: str) -> None:
    session = open_session(load_scene(SCENES / f"{name}.yaml"), device, size=(80, 45))
    session.begin(0)
    if not session.light.has_area:
        pytest.skip("a light without area needs one ray")
    edges, rays, _ = both_ways(session, 64)
    assert_same(edges, rays, 64, penumbra=0.0)


def test_a_face_through_the_receiver_sends_it_to_rays(device: str) -> None:
    """In a corner of paris a single ray meets the neighbouring face where it begins; the shafts' rays do not."""
    session = open_session(load_scene(SCENES / "paris.yaml"), device, size=(640, 360))
    edges, rays, by_rays = both_ways(session, 64)
    assert_same(edges, rays, 64)
    assert 0 < by_rays < 1e-3 * len(edges)


def test_bands_and_threads_change_no_bit(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = small.cluttered(small.light("disc", (2.0, 8.0, -1.0)))
    first = both_ways(open_session(scene, device, threads=1), 64)[0]
    np.testing.assert_array_equal(first, both_ways(open_session(scene, device, threads=2), 64)[0])
    monkeypatch.setattr(tracing, "BLOCKS_AT_ONCE", 40)
    np.testing.assert_array_equal(first, both_ways(open_session(scene, device), 64)[0])


def test_edges_are_kept_while_nothing_moves(device: str) -> None:
    still = small.cluttered(small.light("disc", (2.0, 8.0, -1.0)))
    session = open_session(still, device)
    known = pull_edge_set(session, session.geometry, session.light, session.caster_tree())
    session.begin(1)
    assert pull_edge_set(session, session.geometry, session.light, session.caster_tree()) is known
    session = open_session(small.moved(still, 1, lambda frame: 0.2 * frame), device)
    for frame in range(3):
        session.begin(frame)
        moving = pull_edge_set(session, session.geometry, session.light, session.caster_tree())
        assert moving is not known
        known = moving
        edges, rays, _ = both_ways(session, 64)
        assert_same(edges, rays, 64)


def test_what_reaches_into_a_flat_light() -> None:
    lamp = small.light("rectangle", (0.0, 5.0, 0.0), 2.0)

    def triangle(*corners: tuple[float, float, float]) -> bool:
        return bool(touching(lamp, np.array([corners]))[0])

    assert triangle((0.0, 4.0, 0.0), (0.1, 6.0, 0.0), (0.0, 6.0, 0.1))
    assert triangle((-9.0, 5.0, -9.0), (9.0, 5.0, -9.0), (0.0, 5.0, 9.0))
    assert not triangle((0.0, 4.0, 0.0), (0.1, 4.9, 0.0), (0.0, 4.9, 0.1))
    assert not triangle((3.0, 4.0, 0.0), (3.1, 6.0, 0.0), (3.0, 6.0, 0.1))
    assert not triangle((-9.0, 4.0, 0.0), (9.0, 9.0, 0.0), (9.0, 9.5, 0.0))  # crosses the plane beside the light
