"""Importance of the light's strata: densities, the warp and its weights, what n is worth, and the whole in a technique."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from algorithms.plugins import find
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest, locate_receiver
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.sampling.point_sets import light_set
from wkernels.scene.geometry import RECEIVES, Geometry
from wkernels.temporal.light_importance import (
    MEMORY,
    PROBES,
    SIDE,
    LightImportance,
    learn,
    measure_contest,
    pull_importance,
    warp_point,
)


def skewed() -> np.ndarray:
    density = np.random.default_rng(1).uniform(0.2, 2.0, (SIDE, SIDE))
    return density / density.sum()


@pytest.mark.parametrize("kind", ["halton", "r2", "stratified"])
def test_warped_points_follow_the_density_and_weights_undo_it(kind: str) -> None:
    density, u = skewed(), light_set(kind, 4096, 3)
    made = [warp_point(row, density) for row in u]
    points, weights = np.array([p for p, _, _ in made]), np.array([w for _, w, _ in made])
    strata = np.array([s for _, _, s in made])
    np.testing.assert_array_equal(strata, (points[:, :2] * SIDE).astype(int))
    np.testing.assert_array_equal(points[:, 2], u[:, 2])
    assert points.min() >= 0.0 and points.max() < 1.0
    share = np.histogram2d(*points[:, :2].T, bins=SIDE, range=[[0, 1], [0, 1]])[0] / len(points)
    np.testing.assert_allclose(share, density, atol=0.01)
    np.testing.assert_allclose(weights, 1.0 / (SIDE**2 * density[tuple(strata.T)]))
    # unbiased: half planes, whatever the density
    rng = np.random.default_rng(2)
    for normal, offset in zip(rng.normal(size=(20, 2)), rng.uniform(-0.3, 0.3, 20), strict=True):
        tau = (points[:, :2] - 0.5) @ normal > offset
        truth = np.mean((light_set("r2", 200_000, 2) - 0.5) @ normal > offset)
        assert abs(weights @ tau / weights.sum() - truth) < 0.01
    plain, one, _ = warp_point(u[5], np.full((SIDE, SIDE), 1.0 / SIDE**2))
    np.testing.assert_allclose(plain, u[5], atol=1e-15)
    assert one == 1.0


def test_density_is_neyman_allocation_with_a_uniform_share() -> None:
    held = LightImportance()
    np.testing.assert_allclose(held.density(0.5), 1.0 / SIDE**2)
    held.add((0, 1), 0.09)
    held.add((3, 3), 0.01)
    total, visits = 0.09 * MEMORY, MEMORY
    assert held.contest[0][0, 1] == pytest.approx(total) and held.contest[1][0, 1] == pytest.approx(visits)
    asks = np.full((SIDE, SIDE), 0.2)  # what was not visited: the mean of 0.3 and 0.1
    asks[0, 1], asks[3, 3] = 0.3, 0.1
    np.testing.assert_allclose(held.density(0.6), 0.4 / SIDE**2 + 0.6 * asks / asks.sum())
    assert held.density(0.6).min() >= 0.4 / SIDE**2, "no weight above 1 / (1 - share)"
    held.contest[0] = 0.0
    np.testing.assert_allclose(held.density(0.9), 1.0 / SIDE**2, err_msg="nothing is contested")


def test_n_is_worth_less_where_weights_differ() -> None:
    """The variance of a weighted proportion, against many trials."""
    rng, n = np.random.default_rng(3), 50
    w = rng.choice([0.5, 2.0], n)
    held = LightImportance(weights=list(w))
    assert LightImportance(weights=[1.3] * 9).effective_share() == pytest.approx(1.0)
    assert LightImportance().effective_share() == 1.0
    tau = rng.random((20_000, n)) < 0.3
    spread = (tau @ w / w.sum()).std()
    expected = np.sqrt(0.3 * 0.7 / (n * held.effective_share()))
    assert spread == pytest.approx(expected, rel=0.03)  # of 20 000 trials: 0.5 % standard error


@wp.kernel
def hard_tests(first: int, gbuffer: GBuffer, light_map: LightMap, bias: Bias, out: wp.array2d(dtype=float)):
    row, x = wp.tid()
    y = first + row
    out[y, x] = -1.0
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        out[y, x] = 1.0
        if not is_back_lit(gbuffer, y, x, to_light(light_map.light_ws, position_ws)):
            receiver = locate_receiver(light_map, bias, position_ws, gbuffer.normal_ws[y, x])
            out[y, x] = 0.0
            if receiver.layer >= 0:
                out[y, x] = 1.0 - compare_nearest(light_map, receiver)


def test_contest_is_the_squared_difference_of_test_and_psi(device: str) -> None:
    session = Session(Geometry(small.cluttered(small.light("rectangle")), device), width=130, height=75, device=device)
    plugin: Any = find("tc_soft_paper")
    gbuffer, light_map, bias = session.gbuffer(), session.light_map(128).map, plugin.Params().device_bias
    shape = gbuffer.depth.shape
    psi = wp.array(np.random.default_rng(4).random((*shape, 2)).astype(np.float32), dtype=wp.vec2, device=device)
    tau = wp.empty(shape, dtype=float, device=device)
    launch(hard_tests, shape, [gbuffer, light_map, bias], [tau], device=device)
    out = wp.empty((9, 16), dtype=float, device=device)
    launch(measure_contest, (9, 16), [gbuffer, light_map, bias, psi], [out], device=device)
    y, x = (2 * np.arange(9) + 1) * shape[0] // 18, (2 * np.arange(16) + 1) * shape[1] // 32
    told, held = tau.numpy()[np.ix_(y, x)], psi.numpy()[..., 0][np.ix_(y, x)]
    np.testing.assert_allclose(out.numpy(), np.where(told < 0.0, -1.0, (told - held) ** 2), rtol=1e-6)
    assert 0.0 < (told == 1.0).mean() < 1.0

    held_before = pull_importance(session)
    learn(session, gbuffer, light_map, bias, psi)
    assert not held_before.contest.any(), "nothing to learn without a stratum"
    held_before.stratum, held_before.learnt = (1, 2), -1
    learn(session, gbuffer, light_map, bias, psi)
    learn(session, gbuffer, light_map, bias, psi)
    assert held_before.contest[1][1, 2] == 1.0 and PROBES[0] < PROBES[1]


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
def test_weighted_samples_converge_to_the_same_shadows(name: str, device: str) -> None:
    scene = small.cluttered(small.light("rectangle", (2.0, 8.0, 1.0), 2.5))
    pictures = {}
    for importance in (0.0, 0.8):
        session = Session(Geometry(scene, device), width=80, height=60, device=device)
        plugin: Any = find(name)
        technique = plugin(plugin.Params(resolution=512, importance=importance, filter=False))
        for _ in range(192):
            session.begin(0)
            result = session.render(technique)
            session.advance()
        pictures[importance] = result
    plain, weighted = pictures[0.0], pictures[0.8]
    difference = weighted.visibility - plain.visibility
    penumbra = (plain.visibility > 0.02) & (plain.visibility < 0.98)
    assert penumbra.sum() > 300
    # both errors together: 1 / 50 each at 192 low-discrepancy samples
    assert np.sqrt(np.mean(difference[penumbra] ** 2)) < 0.03 and abs(difference[penumbra].mean()) < 0.005
    assert weighted.standard_error is not None and plain.standard_error is not None
    ratio = weighted.standard_error[penumbra].mean() / plain.standard_error[penumbra].mean()
    assert 1.0 < ratio < 1.6, "the standard error must know of the weights"


def test_a_frame_is_the_same_however_often_it_is_rendered(device: str) -> None:
    session = Session(Geometry(small.cluttered(small.light("rectangle")), device), width=80, height=60, device=device)
    plugin: Any = find("tc_soft_paper")
    technique = plugin(plugin.Params(resolution=256, importance=0.8))
    for _ in range(12):
        session.begin(0)
        first = session.render(technique)
        session.begin(0)
        again = session.render(technique)
        np.testing.assert_array_equal(first.visibility, again.visibility)
        session.advance()
    with pytest.raises(ValueError, match="importance is learnt of one light"):
        plugin.Params(importance=0.5, lights="all")
