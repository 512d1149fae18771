"""Scores that tell errors apart: each is what was put into a picture, and the others stay 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.metrics.measured import Measured
from experiments.metrics.registry import METRICS, SCORES, evaluate, outdated
from experiments.metrics.shadow_classes import DEEP_PX, classify
from experiments.scenes import load_scene
from experiments.scenes.analytic import a1_half_plane

ROWS, COLUMNS, EDGE = 60, 300, 150.0
WIDTH = 24
SCENE = Path(__file__).parents[2] / "configs" / "scenes" / "a1_half_plane.yaml"


def ramp(width: float, edge: float = EDGE) -> np.ndarray:
    """Umbra left, lit right, between them a straight penumbra of so many pixels."""
    across = np.clip(0.5 + (np.arange(COLUMNS) + 0.5 - edge) / max(width, 1e-9), 0.0, 1.0)
    return np.tile(across, (ROWS, 1)).astype(np.float32)


def scores(visibility: np.ndarray, reference: np.ndarray, *errors: np.ndarray) -> dict[str, float | None]:
    found = evaluate(frozenset(), Measured(visibility, None, reference, *errors))
    return {name: found[name] for name in SCORES}


TRUE = ramp(WIDTH)


def test_a_perfect_picture_has_no_error_of_any_kind() -> None:
    assert scores(TRUE.copy(), TRUE) == dict.fromkeys(SCORES, 0.0)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0])
def test_a_width_is_what_the_ramp_has_and_is_neither_acne_nor_leak(share: float) -> None:
    found = scores(ramp(share * WIDTH), TRUE)
    # the sum over pixels is a midpoint rule: off by 1 / w^2 of its value
    assert found["penumbra_width_error"] == pytest.approx(share - 1.0, abs=2.0 / (share * WIDTH) ** 2 + 0.01)
    assert found["acne"] == found["leak"] == 0.0


def test_no_penumbra_at_all_is_minus_one() -> None:
    assert scores(ramp(0.0), TRUE)["penumbra_width_error"] == -1.0


def test_the_width_does_not_care_where_the_edge_lies() -> None:
    found = scores(ramp(WIDTH, EDGE + 10.0), TRUE)
    assert found["penumbra_width_error"] == pytest.approx(0.0, abs=1e-6)
    assert found["acne"] == found["leak"] == 0.0 and found["rmse_penumbra"] > 0.2


def test_steps_of_few_samples_are_narrower_by_one_in_n() -> None:
    n = 8
    stepped = np.floor(TRUE * (n + 1)).clip(0, n) / n
    assert scores(stepped.astype(np.float32), TRUE)["penumbra_width_error"] == pytest.approx(-1.0 / n, abs=0.01)


def test_the_references_own_samples_are_given_back() -> None:
    """Means of 16 random samples have 15/16 of the v (1 - v) of their expectation; the reference is no narrower for it."""
    n, rng = 16, np.random.default_rng(2)
    noisy = (rng.binomial(n, TRUE.astype(float)) / n).astype(np.float32)
    error = np.sqrt(noisy * (1.0 - noisy) / (n - 1)).astype(np.float32)
    assert scores(TRUE, noisy, error)["penumbra_width_error"] == pytest.approx(0.0, abs=0.02)
    assert scores(TRUE, noisy)["penumbra_width_error"] == pytest.approx(1.0 / (n - 1), abs=0.02)


@pytest.mark.parametrize(("dark", "counted"), [(0.3, True), (0.05, False)])
def test_acne_is_darkness_amid_light_and_nothing_else(dark: float, counted: bool) -> None:
    picture = TRUE.copy()
    picture[10:20, 240:250] -= dark
    found = scores(picture, TRUE)
    lit = int(np.ceil(COLUMNS - EDGE - WIDTH / 2))  # columns beside the penumbra; those within its width are not deep
    deep = ROWS * (lit - WIDTH)
    assert found["acne"] == pytest.approx(100 / deep if counted else 0.0, rel=0.02)
    assert found["leak"] == found["penumbra_width_error"] == found["rmse_umbra"] == found["rmse_penumbra"] == 0.0
    assert found["rmse_lit"] == pytest.approx(dark * np.sqrt(100 / (ROWS * lit)), rel=1e-4)


def test_a_leak_is_light_amid_umbra_and_nothing_else() -> None:
    picture = TRUE.copy()
    picture[10:20, 40:50] = 0.4
    found = scores(picture, TRUE)
    assert found["leak"] == pytest.approx(100 / (ROWS * (COLUMNS / 2 - WIDTH / 2 - WIDTH)), rel=0.02)
    assert found["acne"] == found["penumbra_width_error"] == found["rmse_lit"] == found["rmse_penumbra"] == 0.0


def test_acne_all_over_is_not_taken_for_a_wide_penumbra() -> None:
    picture = np.where(np.indices(TRUE.shape).sum(axis=0) % 2 == 0, TRUE, np.float32(0.5) * TRUE).astype(np.float32)
    found = scores(picture, TRUE)
    assert found["acne"] == pytest.approx(0.5, abs=0.01) and found["leak"] == 0.0


def test_hard_shadows_have_no_penumbra_to_score() -> None:
    hard = ramp(0.0)
    found = scores(ramp(6.0), hard)  # 3 pixels too soft on either side: less than DEEP_PX
    assert found["rmse_penumbra"] is None and found["penumbra_width_error"] is None
    assert found["acne"] == found["leak"] == 0.0 and found["rmse_umbra"] > 0.0


def test_scores_of_a_handful_of_pixels_stay_empty() -> None:
    found = scores(np.ones((5, 9), np.float32), np.ones((5, 9), np.float32))
    assert found["acne"] is None and found["leak"] is None and found["rmse_lit"] == 0.0


def test_pixels_without_a_receiver_are_of_no_class_and_end_nothing() -> None:
    torn = TRUE.copy()
    torn[::7] = np.nan
    classes, whole = classify(torn), classify(TRUE)
    kept = np.isfinite(torn)
    for name in ("umbra", "penumbra", "lit", "deep_umbra", "deep_lit", "edge"):
        mask = getattr(classes, name)
        assert not mask[~kept].any(), name
        assert (mask[kept] == getattr(whole, name)[kept]).mean() > 0.97, name
    assert scores(torn, torn)["acne"] == 0.0


def test_classes_divide_the_receivers() -> None:
    rng = np.random.default_rng(4)
    image = rng.choice([0.0, 0.3, 1.0, np.nan], (40, 50)).astype(np.float32)
    c = classify(image)
    np.testing.assert_array_equal(c.umbra.astype(int) + c.penumbra + c.lit, np.isfinite(image))
    np.testing.assert_array_equal(c.deep_umbra.astype(int) + c.deep_lit + c.edge, np.isfinite(image))
    assert not (c.deep_umbra & ~c.umbra).any() and not (c.deep_lit & ~c.lit).any()


def test_depth_is_the_distance_to_every_other_class() -> None:
    """Brute force, for a hard edge, where the local width is 1."""
    image = ramp(0.0)[:20, 130:170]
    image[5, 30] = 0.0
    deep = classify(image).deep_lit
    dark = np.argwhere(image == 0.0)
    for y, x in np.argwhere(image == 1.0):
        assert deep[y, x] == (np.hypot(*(dark - (y, x)).T).min() > DEEP_PX)


@pytest.mark.parametrize("n", [4, 16, 256, 4096])
def test_one_sample_of_n_does_not_make_a_penumbra_but_two_do(n: int) -> None:
    value = np.array([[0, 1, 2, n - 2, n - 1, n]], np.float64) / n
    error = np.sqrt(value * (1.0 - value) / (n - 1))
    found = classify(value.astype(np.float32), error.astype(np.float32))
    assert found.umbra.tolist() == [[True, True, False, False, False, False]]
    assert found.lit.tolist() == [[False, False, False, False, True, True]]


@pytest.mark.parametrize("light_size", [1.0, 1.5, 2.0, 3.0, 4.0])
def test_widths_of_the_analytic_half_plane(light_size: float) -> None:
    """A1: the penumbra is as wide as the light is; seen in perspective, in which its width in pixels varies."""
    position = floor_positions()
    true, picture = a1_half_plane(position), a1_half_plane(position, light_size=light_size)
    found = scores(picture.astype(np.float32), true.astype(np.float32))
    # rows whose penumbra leaves the picture lose a part of what is too wide
    assert found["penumbra_width_error"] == pytest.approx(0.5 * light_size - 1.0, abs=0.02)
    assert found["acne"] == found["leak"] == 0.0


def floor_positions(width: int = 240, height: int = 160) -> np.ndarray:
    """World positions of y = 0 under the camera of A1, float64 (H, W, 3)."""
    from wkernels.scene.views import eye_view

    view = eye_view(load_scene(SCENE).camera(0), width, height, np.zeros(3))
    left, right, bottom, top = view.window
    x = left + (np.arange(width) + 0.5) / width * (right - left)
    y = top + (np.arange(height) + 0.5) / height * (bottom - top)
    along = view.forward_ws + x[None, :, None] * view.right_ws + y[:, None, None] * view.up_ws
    return view.eye_ws - view.eye_ws[1] / along[..., 1:2] * along


def test_versions_that_differ_and_scores_that_are_missing_are_told() -> None:
    now = {metric.name: metric.version for metric in METRICS.values()}
    assert outdated(now) == []
    assert outdated({**now, "rmse": 7}) == ["RMSE is that of version 7; this program has version 1."]
    old = {name: version for name, version in now.items() if name not in SCORES}
    assert len(outdated(old)) == 1 and "acne" in outdated(old)[0]
