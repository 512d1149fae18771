"""Few rays of a receiver against their twins: the shafts' rays, to the bit, and one ray after the other."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp

from algorithms.plugins import find
from wkernels.frame.session import Session
from wkernels.rays.few_rays import MOST_HELD, MOST_SAMPLES, few_samples, runs_of_image, trace_few
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.rays.single_rays import PROVEN_DARK, PROVEN_LIT, trace_light
from wkernels.scene.geometry import RECEIVES, Geometry
from wkernels.scene.model import Scene

WIDTH, HEIGHT = 67, 48  # not a whole number of runs
AREA_LIGHTS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")
COUNTS = (1, 2, MOST_SAMPLES, 16, 17, MOST_HELD)


def three(scene: Scene, samples: int, threads: int = 2, prove: int = 1) -> tuple[np.ndarray, ...]:
    """Visibility of each pixel by few rays, by shafts and by single rays, the first's proofs, and who receives."""
    session = Session(Geometry(scene, "cpu"), width=WIDTH, height=HEIGHT, device="cpu", threads=threads)
    gbuffer, lit, hull = session.gbuffer(), session.light_samples(samples), session.light_hull()
    shape = (HEIGHT, WIDTH)
    out, proofs = [], []
    for kernel, grid, inputs in (
        (trace_few, runs_of_image(shape), [gbuffer, session.caster_tree(), lit.few, hull, prove]),
        (trace_shafts, shape, [gbuffer, session.caster_tree(), lit.batches, hull, prove]),
        (trace_light, shape, [gbuffer, session.caster_mesh(), lit.points_ws, lit.weights, hull, 0]),
    ):
        visibility = wp.full(shape, -1.0, dtype=float, device="cpu")
        proof = wp.full(shape, -1, dtype=int, device="cpu")
        session.launch(kernel, grid, inputs, [visibility, proof])
        out.append(visibility.numpy())
        proofs.append(proof.numpy())
    return *out, proofs[0], (gbuffer.flags.numpy() & RECEIVES) != 0


@pytest.mark.parametrize("kind", AREA_LIGHTS)
@pytest.mark.parametrize("where", [(3.0, 8.0, -2.0), (9.0, 2.0, 3.0), (0.5, 2.0, 0.5)])
def test_same_bits_as_the_shafts_rays(kind: str, where: tuple[float, float, float]) -> None:
    for size in (0.4, 2.5):
        few, shafts, rays, proof, receives = three(small_scenes.cluttered(small_scenes.light(kind, where, size)), 11)
        np.testing.assert_array_equal(few, shafts)
        assert (np.abs(few - rays) > 1e-3).mean() <= 0.01  # rays that graze an edge
        assert 0.02 < (few[receives] > 0.0).mean() < 1.0
        assert (few[proof == PROVEN_LIT] == 1.0).all() and (few[proof == PROVEN_DARK] == 0.0).all()


@pytest.mark.parametrize("samples", COUNTS)
def test_any_number_of_few_samples(samples: int) -> None:
    scene = small_scenes.cluttered(small_scenes.light("rectangle", (3.0, 8.0, -2.0), 2.0))
    few, shafts, _, proof, receives = three(scene, samples)
    np.testing.assert_array_equal(few, shafts)
    assert np.ptp(few[receives]) == 1.0 and (proof == PROVEN_LIT).any() and (proof == PROVEN_DARK).any()


def test_same_bits_for_any_number_of_threads_and_without_proofs() -> None:
    scene = small_scenes.cluttered(small_scenes.light("disc", (3.0, 8.0, -2.0), 2.0))
    images = [three(scene, 9, threads, prove)[0] for threads, prove in ((1, 1), (3, 1), (2, 0))]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


@pytest.mark.parametrize("kind", ["directional", "rectangle"])
def test_no_ray_slips_through_many_small_triangles(kind: str) -> None:
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
    few, shafts, *_, receives = three(
        small_scenes.scene(meshes, small_scenes.light(kind, (0.5, 9.0, -0.5), 1.5), below), MOST_SAMPLES
    )
    np.testing.assert_array_equal(few, shafts)
    assert receives.sum() > 1000 and not few[receives].any()


def test_without_casters_only_surfaces_that_turn_away_are_dark() -> None:
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0), casts=False)
    few, *_, proof, receives = three(
        small_scenes.scene([ground], small_scenes.light("rectangle", (1.0, 9.0, -2.0), 2.0)), 8
    )
    assert receives.sum() > 1000 and (few == 1.0).all() and (proof[receives] == PROVEN_LIT).all()


def test_samples_keep_their_order_and_weights() -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (19, 4))
    out = few_samples(points, np.arange(1.0, 20.0))
    held = np.stack([a.numpy().ravel() for a in (out.x, out.y, out.z)], axis=1)
    assert out.count == 19
    np.testing.assert_array_equal(held[:19], points[:, :3].astype(np.float32))
    np.testing.assert_array_equal(out.weight.numpy().ravel(), [*range(1, 20), *[0] * 13])


def test_the_reference_is_the_same_on_both_sides_of_the_rule() -> None:
    """Few rays to either half of some samples make what all of them do, which the shafts cast."""
    scene = small_scenes.cluttered(small_scenes.light("rectangle", (3.0, 8.0, -2.0), 2.0))
    session = Session(Geometry(scene, "cpu"), width=WIDTH, height=HEIGHT, device="cpu")
    technique = find("reference_multisample")
    images = [
        session.render(technique(technique.Params(samples=samples, start=start))).visibility.copy()
        for samples, start in ((MOST_SAMPLES, 0), (MOST_SAMPLES, MOST_SAMPLES), (2 * MOST_SAMPLES, 0))
    ]
    np.testing.assert_allclose((images[0] + images[1]) / 2.0, images[2], atol=1e-6)
    assert np.nanstd(images[0]) > 0.1
