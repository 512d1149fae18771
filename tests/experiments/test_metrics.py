"""Metrics against closed forms and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from fake_engine import HEIGHT, WIDTH, camera, floor_positions, true_visibility

from experiments.metrics.carry_over import carry_over, disoccluded
from experiments.metrics.registry import METRICS, Measured, distinguishable, evaluate, flip_map
from wkernels.analysis.sampling_rate import MapUse, SamplingRate
from wkernels.scene.views import eye_view

EVERY = frozenset(METRICS)


@pytest.fixture
def images() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    return rng.random((20, 30)).astype(np.float32), rng.random((20, 30)).astype(np.float32)


def test_errors_match_their_definitions(images: tuple[np.ndarray, np.ndarray]) -> None:
    visibility, reference = images
    got = evaluate(EVERY, Measured(visibility, reference=reference))
    pixels = [(float(v), float(r)) for v, r in zip(visibility.ravel(), reference.ravel(), strict=True)]
    errors = sorted(abs(v - r) for v, r in pixels)
    assert got["rmse"] == pytest.approx((sum((v - r) ** 2 for v, r in pixels) / len(pixels)) ** 0.5, rel=1e-9)
    assert got["mean_signed_error"] == pytest.approx(sum(v - r for v, r in pixels) / len(pixels), rel=1e-9)
    assert errors[int(0.99 * (len(errors) - 1))] <= got["p99_error"] <= errors[int(0.99 * (len(errors) - 1)) + 1]


def test_darker_is_negative() -> None:
    got = evaluate(EVERY, Measured(np.full((8, 8), 0.25, np.float32), reference=np.full((8, 8), 0.75, np.float32)))
    assert got["mean_signed_error"] == -0.5
    assert got["rmse"] == got["p99_error"] == 0.5


def test_pixels_without_receiver_do_not_count(images: tuple[np.ndarray, np.ndarray]) -> None:
    visibility, reference = (image.copy() for image in images)
    inner = evaluate(EVERY, Measured(visibility[:, 5:25], reference=reference[:, 5:25]))
    visibility[:, :5] = np.nan  # unknown in one image is enough
    reference[:, 25:] = np.nan
    got = evaluate(EVERY - {"flip"}, Measured(visibility, reference=reference))
    for name in ("rmse", "mean_signed_error", "p99_error"):
        assert got[name] == pytest.approx(inner[name], rel=1e-12)


def test_what_cannot_be_measured_is_none_not_zero() -> None:
    visibility = np.full((6, 6), 0.5, np.float32)
    assert set(evaluate(EVERY, Measured(visibility)).values()) == {None}
    nothing_seen = np.full((6, 6), np.nan, np.float32)
    measured = Measured(nothing_seen, nothing_seen, nothing_seen, nothing_seen, nothing_seen)
    assert set(evaluate(EVERY, measured).values()) == {None}


def test_metrics_that_cost_time_are_computed_on_request_only() -> None:
    image = np.full((8, 8), 0.5, np.float32)
    measured = Measured(image, reference=image, previous=image)
    got = evaluate(frozenset(), measured)
    assert got["flip"] is None and got["flicker"] is None and got["rmse"] == 0.0
    assert evaluate(frozenset({"flip", "flicker"}), measured)["flip"] == 0.0


def test_standard_errors_are_root_mean_squares_over_receivers() -> None:
    visibility = np.array([[0.5, 0.5, np.nan]], np.float32)
    standard_error = np.array([[0.3, 0.4, 9.0]], np.float32)
    got = evaluate(frozenset(), Measured(visibility, standard_error, visibility, standard_error))
    assert got["standard_error"] == got["reference_standard_error"] == pytest.approx(np.sqrt(0.125), rel=1e-6)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_flip_of_constant_masks(value: float) -> None:
    """Masks whose median is 0 are what makes exposure-seeking FLIP fail; here they are ordinary."""
    mask, inverse = np.full((24, 32), value, np.float32), np.full((24, 32), 1.0 - value, np.float32)
    assert evaluate(EVERY, Measured(mask, reference=mask))["flip"] == 0.0
    worst = evaluate(EVERY, Measured(inverse, reference=mask))["flip"]
    assert worst is not None and 0.9 < worst <= 1.0


def test_flip_grows_with_the_error_and_ignores_unseen_pixels() -> None:
    ramp = np.tile(np.linspace(0.0, 0.7, 64, dtype=np.float32), (32, 1))
    steps = [evaluate(EVERY, Measured(ramp + np.float32(d), reference=ramp))["flip"] for d in (0.01, 0.05, 0.3)]
    assert None not in steps and 0.0 < steps[0] < steps[1] < steps[2] < 1.0  # type: ignore[operator]
    seen = ramp.copy()
    seen[:, 50:] = np.nan
    elsewhere = ramp.copy()
    elsewhere[:, 50:] = 0.0
    assert flip_map(elsewhere, seen).max() == 0.0


def test_distinguishable() -> None:
    assert distinguishable(0.021, 0.01) is True
    assert distinguishable(-0.021, 0.01) is True
    assert distinguishable(0.019, 0.01) is False
    assert distinguishable(None, 0.01) is None and distinguishable(0.1, float("nan")) is None


def ws_to_ss(frame: int) -> np.ndarray:
    return eye_view(camera(frame), WIDTH, HEIGHT, np.zeros(3)).ws_to_ss


def test_carried_visibility_follows_the_surface() -> None:
    """The floor's visibility is fixed to world points, so after reprojection only interpolation error may remain."""
    carried = carry_over(true_visibility(0), floor_positions(0), ws_to_ss(0), floor_positions(20))
    truth = true_visibility(20)
    known = np.isfinite(carried) & np.isfinite(truth) & (np.abs(floor_positions(20)[..., 2]) < 4.0)
    assert known.sum() > 0.3 * np.isfinite(truth).sum()
    assert np.abs(carried - truth)[known].max() < 0.02
    assert np.abs(true_visibility(0) - truth)[known].max() > 0.08  # what following the surface saved
    flicker = evaluate(EVERY, Measured(truth, previous=carried))["flicker"]
    assert flicker is not None and 0.0 < flicker < 0.02


def test_still_camera_carries_the_same_pixels() -> None:
    carried = carry_over(true_visibility(0), floor_positions(0), ws_to_ss(0), floor_positions(0))
    known = np.isfinite(carried)
    assert known.sum() > 0.8 * np.isfinite(true_visibility(0)).sum()
    np.testing.assert_allclose(carried[known], true_visibility(0)[known], atol=1e-3)


def test_points_that_were_hidden_have_no_previous_value() -> None:
    """A wall stood in the left half of the previous frame; what it hid is unknown, not the wall's value."""
    position, visibility = floor_positions(0), true_visibility(0)
    wall = position.copy()
    half = WIDTH // 2
    eye = camera(0).eye
    wall[:, :half] = eye + 0.4 * (position[:, :half] - eye)
    carried = carry_over(visibility, wall, ws_to_ss(0), floor_positions(0))
    assert np.isnan(carried[:, : half - 1]).all()
    assert np.isfinite(carried[2:-1, half + 1 : -1]).all()


def test_a_still_camera_uncovers_nothing() -> None:
    assert not disoccluded(floor_positions(0), ws_to_ss(0), floor_positions(0)).any()


def test_what_stood_behind_a_wall_is_disoccluded_and_nothing_else() -> None:
    position = floor_positions(0)
    wall, half, eye = position.copy(), WIDTH // 2, camera(0).eye
    wall[:, :half] = eye + 0.4 * (position[:, :half] - eye)
    unseen, floor = disoccluded(wall, ws_to_ss(0), position), np.isfinite(position[..., 0])
    assert not unseen[~floor].any()
    assert unseen[:, : half - 1][floor[:, : half - 1]].all()
    assert not unseen[:, half + 1 :].any()


def test_silhouettes_between_pixels_are_not_disoccluded() -> None:
    """Half a pixel to the side, the four pixels around an edge lie on two surfaces; both were seen."""
    position = floor_positions(0)
    step = 0.5 * (position[:, 2:] - position[:, 1:-1])
    assert not disoccluded(position, ws_to_ss(0), (position[:, 1:-1] + step)[8:-1]).any()
    wall, eye = position.copy(), camera(0).eye
    wall[:, : WIDTH // 2] = eye + 0.4 * (position[:, : WIDTH // 2] - eye)
    between = (eye + 0.4 * (position[:, 1:-1] + step - eye))[8:-1, : WIDTH // 2 - 1]
    assert not disoccluded(wall, ws_to_ss(0), between).any()


def test_what_comes_into_the_picture_is_disoccluded() -> None:
    unseen = disoccluded(floor_positions(0), ws_to_ss(0), floor_positions(60))  # 1.2 to the right
    ss = floor_positions(60).reshape(-1, 3).astype(float) @ ws_to_ss(0)[:, :3].T + ws_to_ss(0)[:, 3]
    outside = (np.abs(ss[:, 0]) > ss[:, 3]).reshape(HEIGHT, WIDTH)
    known = np.isfinite(floor_positions(60)[..., 0]) & (np.arange(HEIGHT)[:, None] > 8)
    assert 0.05 < outside[known].mean() < 0.9
    assert (unseen == outside)[known].mean() > 0.98  # half a pixel at the border may count as seen


def use_of(m: np.ndarray, read: np.ndarray) -> MapUse:
    texel = np.where(read, 0, -1).astype(np.int32)
    return MapUse(SamplingRate(m, m, m, m, m, m, np.zeros(m.shape, np.int32), texel), 0.5, 0.75)


def test_metrics_of_the_map_are_over_receivers_that_look_into_it() -> None:
    rng = np.random.default_rng(11)
    visibility = np.ones((12, 10), np.float32)
    visibility[:3] = np.nan
    m = rng.uniform(0.2, 4.0, (12, 10)).astype(np.float32)
    read = rng.random((12, 10)) < 0.7
    m[0, 0], m[~read] = np.inf, np.nan
    own = m[3:][read[3:]].astype(float)
    got = evaluate(EVERY, Measured(visibility, map_use=use_of(m, read)))
    assert got["m_pixel_median"] == pytest.approx(np.median(own))
    assert got["m_pixel_p99"] == pytest.approx(np.percentile(own, 99.0))
    assert got["undersampled"] == pytest.approx(sum(value > 1.0 for value in own) / len(own))
    assert (got["map_waste"], got["map_unread"]) == (0.5, 0.75)
    assert got["m_edge"] is None and got["rmse_predicted"] is None  # no reference
    nowhere = evaluate(EVERY, Measured(visibility, map_use=use_of(m, np.zeros_like(read))))
    assert nowhere["m_pixel_median"] is None and nowhere["undersampled"] is None


def test_predicted_rmse_counts_the_edges_of_the_reference() -> None:
    """A straight edge of one pixel's length per row, texels of 4 pixels: a quarter of a texel wrong, 1 of 20 pixels."""
    reference = np.where(np.arange(20)[None] < 10, 0.0, 1.0).repeat(6, axis=0).astype(np.float32)
    m = np.full((6, 20), 4.0, np.float32)
    m[:, :5] = 1e9  # far from the edge
    measured = Measured(reference, reference=reference, map_use=use_of(m, np.ones(m.shape, dtype=bool)))
    got = evaluate(EVERY, measured)
    assert got["m_edge"] == 4.0
    assert got["rmse_predicted"] == pytest.approx(np.sqrt(1.0 / 20.0))
    m[:] = 1e9  # grazed by the light: no texel counts for more than ``MOST_PIXELS``
    assert evaluate(EVERY, measured)["m_edge"] == 50.0
    lit = np.ones_like(reference)
    assert evaluate(EVERY, Measured(lit, reference=lit, map_use=measured.map_use))["m_edge"] is None


def test_descriptors_are_complete() -> None:
    for name, metric in METRICS.items():
        assert metric.name == name and metric.version >= 1 and metric.description.endswith(".")
        assert abs(metric.worst) > abs(metric.best)
