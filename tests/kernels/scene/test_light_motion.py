"""Lights that move: their poses, what a session keeps of them, and the mean over time that forgets (``age_sums``)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from algorithms.plugins import find
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.sampling.estimators import add_test, age_sums, standard_error
from wkernels.scene.geometry import Geometry
from wkernels.scene.light_motion import BALANCE, ageing_window, displacement, light_at, transformed
from wkernels.scene.lights import LIGHT_KINDS, PointLight
from wkernels.scene.model import Scene

KINDS = sorted(LIGHT_KINDS)
CENTRE, SIZE = (1.0, 8.0, -2.0), 1.6
U = np.random.default_rng(1).random((2000, 3))


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


def rigid(scale: float = 1.0) -> np.ndarray:
    out = shift(3.0, -1.0, 2.0)
    out[:3, :3] = scale * Rotation.from_euler("xyz", [20.0, 70.0, -40.0], degrees=True).as_matrix()
    return out


# ---- poses --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_transformed_light_is_made_of_the_transformed_points(kind: str) -> None:
    """Where a light's own axes say which sample goes where, point by point; else by the mean and the second moments."""
    lamp, matrix = small.light(kind, CENTRE, SIZE), rigid(1.0 if kind == "directional" else 1.5)
    expected = lamp.sample(U) @ matrix.T
    found = transformed(lamp, matrix).sample(U)
    np.testing.assert_array_equal(found[:, 3], lamp.sample(U)[:, 3])
    if kind in ("disc", "sphere", "directional"):  # another turn about the same axis
        bound = 0.12 * SIZE / (10.0 if kind == "directional" else 1.0)
        np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), atol=bound)
        covariances = [np.cov(points[:, :3].T) for points in (found, expected)]
        np.testing.assert_allclose(*covariances, atol=0.12 * np.abs(covariances[1]).max())
    else:
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_light_without_motion_stands_and_one_with_motion_is_where_it_says() -> None:
    lamp = small.light("disc", CENTRE, SIZE)
    assert light_at(lamp, 7) is lamp
    moving = replace(lamp, motion=lambda frame: shift(x=0.5 * frame))
    np.testing.assert_array_equal(light_at(moving, 4).centre[:3], [3.0, 8.0, -2.0])
    assert light_at(moving, 4).motion is None
    of = small.scene([], moving)
    np.testing.assert_array_equal(of.light(0, 4).centre[:3], [3.0, 8.0, -2.0])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "point"])
def test_displacement_is_in_sizes_of_the_light(kind: str) -> None:
    lamp = small.light(kind, CENTRE, SIZE)
    assert displacement(lamp, lamp) == 0.0
    if kind == "directional":
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler("z", 0.1 * lamp.size).as_matrix()
        # the corners of its square are at up to sqrt(2) of its radius from the axis, and those far from it move less
        assert displacement(transformed(lamp, turn), lamp) == pytest.approx(0.1, rel=0.35)
        return
    for step in ((0.3, 0.0, 0.0), (0.0, -0.4, 0.3)):
        far = lamp.moved(np.array(step))
        assert displacement(far, lamp) == pytest.approx(np.linalg.norm(step) / lamp.size)
    double = shift()
    double[:3, :3] *= 2.0
    middle = shift(*CENTRE) @ double @ shift(*(-np.array(CENTRE)))
    assert displacement(transformed(lamp, middle), lamp) > 0.2, "a light that grows has moved too"


def test_a_point_that_moves_has_gone_infinitely_many_of_its_sizes() -> None:
    lamp = PointLight(position=np.array(CENTRE))
    assert displacement(lamp, lamp) == 0.0 and displacement(lamp.moved(np.ones(3)), lamp) == np.inf
    assert all(1.0 < ageing_window(np.inf, name, 0.9, 0.2) < 20.0 for name in ("frames", "displacement", "balanced"))


def test_windows_of_the_ways_to_age() -> None:
    for name in ("none", "frames", "displacement", "balanced"):
        assert ageing_window(0.0, name, 0.9, 0.2) == 0.0, "nothing ages while the light stands"
    assert ageing_window(0.1, "none", 0.9, 0.2) == 0.0
    assert ageing_window(0.1, "frames", 0.9, 0.2) == pytest.approx(10.0)
    assert ageing_window(0.1, "displacement", 0.9, 0.2) == pytest.approx(1.0 / (1.0 - np.exp(-0.5)))
    assert ageing_window(0.001, "balanced", 0.9, 0.2) == pytest.approx(50.0)


@pytest.mark.parametrize("d", [0.001, 0.01, 0.05])
def test_the_balanced_window_is_near_the_optimum_that_it_is_derived_from(d: float) -> None:
    """Lag d N and variance (1/6) / (2 N), of independent tests: 0.35 d^(-2/3); low-discrepancy ones allow for more."""
    best = minimize_scalar(lambda log_n: (d * np.exp(log_n)) ** 2 + np.exp(-log_n) / 12.0, bounds=(-2.0, 8.0)).x
    assert np.exp(best) == pytest.approx(0.347 * d ** (-2.0 / 3.0), rel=1e-2)
    assert ageing_window(d, "balanced", 0.9, 0.2) == pytest.approx(BALANCE / 0.347 * np.exp(best), rel=1e-2)


# ---- a session ----------------------------------------------------------------------------------------------------------


def swinging(x: tuple[float, ...], kind: str = "rectangle") -> Scene:
    """The light at these places, frame by frame; it stays at the last."""
    lamp = small.light(kind, (0.0, 8.0, 1.0), 1.5)
    if kind == "directional":
        turns = [np.eye(4) for _ in x]
        for turn, angle in zip(turns, x, strict=True):
            turn[:3, :3] = Rotation.from_euler("z", 4.0 * angle, degrees=True).as_matrix()
        return small.cluttered(replace(lamp, motion=lambda frame: turns[min(frame, len(x) - 1)]))
    return small.cluttered(replace(lamp, motion=lambda frame: shift(x[min(frame, len(x) - 1)])))


@pytest.mark.parametrize("kind", ["rectangle", "directional"])
@pytest.mark.parametrize("name", ["multi_shadow_map", "pcss", "reference_multisample", "shadow_map"])
def test_every_frame_sees_the_light_where_it_is(name: str, kind: str, device: str) -> None:
    """After a walk a frame has the bits that a scene has whose light stands there: no product outlives its light."""
    of = swinging((0.0, 3.0, 3.0, -4.0), kind)
    plugin: Any = find(name)
    made = plugin(plugin.Params(**({"samples": 4} if "samples" in plugin.Params.model_fields else {})))
    walked = Session(Geometry(of, device), width=48, height=36, device=device)
    images = []
    for frame in range(4):
        walked.begin(frame)
        images.append(walked.render(made))
        walked.advance()
        fixed = replace(of, lights=(of.light(0, frame),))
        alone = Session(Geometry(fixed, device), width=48, height=36, device=device).render(made)
        np.testing.assert_array_equal(images[frame].visibility, alone.visibility)
        np.testing.assert_array_equal(images[frame].color, alone.color)
    assert np.nanmean(np.abs(images[1].visibility - images[0].visibility)) > 0.01
    if name != "reference_multisample":
        unchanged = {what for what, reason, _ in images[2].left_out if "not changed" in reason}
        assert "light depth map" in unchanged, "a light that pauses has its maps drawn once"
        assert "light depth map" not in {what for what, *_ in images[3].left_out}


# ---- means that forget --------------------------------------------------------------------------------------------------


@wp.kernel
def sum_up(
    first: int, tau: wp.array2d(dtype=float), weight: wp.array(dtype=float), window: wp.array(dtype=float),
    psi_out: wp.array2d(dtype=float), n_out: wp.array2d(dtype=float), error_out: wp.array2d(dtype=float),
):  # fmt: skip
    i = first + wp.tid()
    sums = wp.vec2(0.0, 0.0)
    for k in range(tau.shape[1]):
        sums = age_sums(sums[0], sums[1], tau[i, k], weight[k], window[k])
        sums = add_test(sums[0], sums[1], tau[i, k], weight[k], 1.0e6)
        psi_out[i, k] = sums[0] / sums[1]
        n_out[i, k] = sums[1]
        error_out[i, k] = standard_error(wp.clamp(sums[0] / sums[1], 0.0, 1.0), sums[1])


def summed(tau: np.ndarray, weight: np.ndarray, window: np.ndarray, device: str) -> list[np.ndarray]:
    """psi, n and standard error after each of the tests (series, tests)."""
    inputs = [wp.array(a.astype(np.float32), dtype=float, device=device) for a in (tau, weight, window)]
    out = [wp.empty(tau.shape, dtype=float, device=device) for _ in range(3)]
    launch(sum_up, len(tau), inputs, out, device=device)
    return [array.numpy() for array in out]


def weights_of_tests(weight: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Brute force: row k has what each test weighs in the mean after k + 1 of them, in float64."""
    out = np.zeros((len(weight), len(weight)))
    held, n = np.zeros(len(weight)), 0.0
    for k, (w, size) in enumerate(zip(weight, window, strict=True)):
        room = max(size - w, 0.0)
        share = w / (w + (min(n, room) if size > 0.0 else n)) if n > 0.0 else 1.0
        held = (1.0 - share) * held
        held[k] = share
        # sum of weights squared over the sum of squares; a test of weight w counts as w tests
        n = held.sum() ** 2 / (held**2 / weight).sum()
        out[k] = held
    return out


@pytest.mark.parametrize("textured", [False, True])
def test_effective_n_is_the_weights_squared_over_the_sum_of_squares(textured: bool, device: str) -> None:
    """Through stretches of rest, slow, fast and slow motion again."""
    rng = np.random.default_rng(3)
    window = np.repeat([0.0, 30.0, 4.0, 0.0, 12.0], 24)
    weight = rng.uniform(0.5, 1.5, len(window)) if textured else np.ones(len(window))
    tau = rng.integers(0, 2, (5, len(window))).astype(float)
    psi, n, _ = summed(tau, weight, window, device)
    weights = weights_of_tests(weight, window)
    np.testing.assert_allclose(psi, tau @ weights.T, atol=1e-5)  # float32 against float64 over 120 steps
    effective = weights.sum(axis=1) ** 2 / (weights**2 / weight).sum(axis=1)
    np.testing.assert_allclose(n, np.tile(effective, (5, 1)), rtol=1e-5)


@pytest.mark.parametrize("window", [2.0, 5.0, 20.0])
def test_a_steady_motion_is_the_exponential_mean_of_the_age_factor(window: float, device: str) -> None:
    """rho and n times a before every test (Scherzer et al. 2009, section 5): the weights of old tests fall by a, and
    n_eff = W^2 / Q = (1 + a) / (1 - a)."""
    a, count = 1.0 - 1.0 / window, int(20 * window)
    rng = np.random.default_rng(4)
    tau = rng.integers(0, 2, (50, count)).astype(float)
    psi, n, _ = summed(tau, np.ones(count), np.full(count, window), device)
    rho, total, squares = np.zeros(50), 0.0, 0.0
    for k in range(count):
        rho, total, squares = a * rho + tau[:, k], a * total + 1.0, a * a * squares + 1.0
    np.testing.assert_allclose(psi[:, -1], rho / total, atol=1e-4)
    assert n[0, -1] == pytest.approx(total**2 / squares, rel=1e-4) == pytest.approx((1.0 + a) / (1.0 - a), rel=1e-4)
    assert total == pytest.approx(window, rel=1e-4)


@pytest.mark.parametrize("truth", [0.1, 0.3, 0.5])
def test_the_standard_error_is_that_of_weighted_bernoulli_tests(truth: float, device: str) -> None:
    """20 000 series of independent tests: the mean of the squared standard errors is the variance of psi."""
    window = np.repeat([0.0, 8.0, 0.0], [12, 20, 6])
    tau = (np.random.default_rng(5).random((20000, len(window))) < truth).astype(float)
    psi, n, error = summed(tau, np.ones(len(window)), window, device)
    for k in (11, 14, 31, 37):
        # an unbiased variance: (n - 1) / n of psi (1 - psi) is lost to the mean's own spread
        assert float((error[:, k].astype(float) ** 2).mean()) == pytest.approx(psi[:, k].var(), rel=0.05), k
    assert n[0, 31] == pytest.approx(15.0, rel=0.1) and n[0, 37] == pytest.approx(n[0, 31] + 6.0, rel=1e-4)


def test_sums_that_do_not_age_are_not_touched(device: str) -> None:
    tau = np.random.default_rng(6).integers(0, 2, (20, 40)).astype(float)
    ones = np.ones(40)
    plain = summed(tau, ones, np.zeros(40), device)
    for got, expected in zip(plain, summed(tau, ones, np.full(40, 41.0), device), strict=True):
        np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(plain[1][0], np.arange(1.0, 41.0))


def test_after_a_long_rest_it_forgets_sooner_than_sums_times_the_age_factor(device: str) -> None:
    """A hundred tests of a shadow that then leaves: rho and n times a keep it for as long as there is to forget."""
    window, rest, after = 5.0, 100, 6
    tau = np.repeat([[1.0, 0.0]], [rest, after], axis=1)
    psi = summed(tau, np.ones(rest + after), np.repeat([0.0, window], [rest, after]), device)[0][0, -1]
    rho = n = float(rest)
    for _ in range(after):
        rho, n = (1.0 - 1.0 / window) * rho, (1.0 - 1.0 / window) * n + 1.0
    assert psi == pytest.approx((1.0 - 1.0 / window) ** after, rel=1e-3) and psi < 0.3 < 0.85 < rho / n
