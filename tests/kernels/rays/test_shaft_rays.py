"""All rays of a receiver at once against its twin, one ray after the other through Warp's own mesh."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp

from wkernels.frame.session import Session
from wkernels.rays.shaft_rays import BATCH, GROUP_LANES, sample_batches, trace_shafts
from wkernels.rays.single_rays import PROVEN_LIT, trace_light
from wkernels.scene.geometry import RECEIVES, Geometry
from wkernels.scene.model import Scene

WIDTH, HEIGHT = 64, 48
AREA_LIGHTS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")


def both(scene: Scene, samples: int, threads: int = 2, prove: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hidden samples of each receiver, by the shaft and by rays, and how the first were found."""
    session = Session(Geometry(scene, "cpu"), width=WIDTH, height=HEIGHT, device="cpu", threads=threads)
    gbuffer, lit = session.gbuffer(), session.light_samples(samples)
    out = []
    shafts = [gbuffer, session.caster_tree(), lit.batches, session.light_hull(), prove]
    rays = [gbuffer, session.caster_mesh(), lit.points_ws, lit.weights, session.light_hull(), 0]
    for kernel, inputs in ((trace_shafts, shafts), (trace_light, rays)):
        visibility = wp.zeros((HEIGHT, WIDTH), dtype=float, device="cpu")
        proof = wp.zeros((HEIGHT, WIDTH), dtype=int, device="cpu")
        session.launch(kernel, visibility.shape, inputs, [visibility, proof])
        out.append((visibility.numpy(), proof.numpy()))
    receives = (gbuffer.flags.numpy() & RECEIVES) != 0
    assert (out[0][0][~receives] == 1.0).all()
    return out[0][0][receives] * samples, out[1][0][receives] * samples, out[0][1][receives]


def assert_same_samples(shafts: np.ndarray, rays: np.ndarray) -> None:
    """Rays that graze an edge may fall to either side of it; they are few, and as many fall to one side as the other."""
    difference = shafts - rays
    assert (np.abs(difference) > 0.01).mean() <= 0.01
    assert np.abs(difference).max() <= 2.01
    assert abs(difference.mean()) <= 2e-3


@pytest.mark.parametrize("kind", AREA_LIGHTS)
@pytest.mark.parametrize("where", [(3.0, 8.0, -2.0), (9.0, 2.0, 3.0), (0.5, 2.0, 0.5)])
def test_it_counts_the_samples_that_rays_count(kind: str, where: tuple[float, float, float]) -> None:
    for size in (0.4, 2.5):
        shafts, rays, proof = both(small_scenes.cluttered(small_scenes.light(kind, where, size)), 96)
        assert_same_samples(shafts, rays)
        assert 0.02 < (rays > 0).mean() < 1.0
        assert (shafts[proof == PROVEN_LIT] == 96).all()


@pytest.mark.parametrize("samples", [1, 2, int(GROUP_LANES), int(GROUP_LANES) + 1, BATCH - 1, BATCH, BATCH + 1, 1000])
def test_any_number_of_samples(samples: int) -> None:
    scene = small_scenes.cluttered(small_scenes.light("rectangle", (3.0, 8.0, -2.0), 2.0))
    shafts, rays, _ = both(scene, samples)
    difference = shafts - rays
    assert (np.abs(difference) > 0.01).mean() <= max(0.01, 2e-5 * samples) and np.abs(difference).max() <= 3.01


def test_same_bits_for_any_number_of_threads_and_without_proofs() -> None:
    scene = small_scenes.cluttered(small_scenes.light("disc", (3.0, 8.0, -2.0), 2.0))
    images = [both(scene, 100, threads, prove)[0] for threads, prove in ((1, 1), (3, 1), (2, 0))]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_no_ray_slips_through_a_shared_edge() -> None:
    """A roof of 20 000 jittered triangles hides the whole light from everything below it."""
    rng = np.random.default_rng(4)
    cells = 100
    line = np.linspace(-40.0, 40.0, cells + 1)
    x, z = np.meshgrid(line, line)
    points = np.stack([x, np.full_like(x, 3.0), z], axis=-1)
    points[1:-1, 1:-1] += rng.uniform(-0.35, 0.35, (cells - 1, cells - 1, 3))
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    meshes = [
        small_scenes.mesh("ground", small_scenes.plane(20.0), casts=False),
        small_scenes.mesh("roof", (points.reshape(-1, 3), faces.astype(np.int32)), receives=False),
    ]
    below = small_scenes.camera((0.0, 2.0, 6.0), (0.0, 0.0, 0.0))
    for kind in ("directional", "rectangle"):
        scene = small_scenes.scene(meshes, small_scenes.light(kind, (0.5, 9.0, -0.5), 1.5), below)
        shafts, _, _ = both(scene, 256)
        assert len(shafts) > 1000 and not shafts.any()


def test_degenerate_casters_hide_nothing_and_break_nothing() -> None:
    lamp = small_scenes.light("rectangle", (1.0, 9.0, -2.0), 2.0)
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0), casts=False)
    corners = np.array(
        [[0, 2, 0], [0, 2, 0], [0, 2, 0], [0, 2, 0], [1, 2, 1], [2, 2, 2], [np.nan, 2, 0], [1, 2, 0], [0, 2, 1]], float
    )
    broken = small_scenes.mesh("broken", (corners, np.arange(9, dtype=np.int32).reshape(3, 3)), receives=False)
    shafts, _, _ = both(small_scenes.scene([ground, broken], lamp), 80)
    assert len(shafts) > 1000 and (shafts == 80).all()


def test_groups_of_samples_are_compact() -> None:
    rng = np.random.default_rng(1)
    samples = np.concatenate([rng.uniform(-1.0, 1.0, (512, 2)), np.zeros((512, 1)), np.ones((512, 1))], axis=1)
    out = sample_batches(samples, np.ones(512))
    assert out.groups == 512 // int(GROUP_LANES)
    area = np.prod((out.high.numpy() - out.low.numpy())[:, :2], axis=1)
    assert area.mean() < 4.0 / out.groups * 1.3
    held = np.stack([a.numpy().ravel() for a in (out.x, out.y)], axis=1)
    np.testing.assert_array_equal(np.sort(held, axis=0), np.sort(samples[:, :2].astype(np.float32), axis=0))
