"""The comparisons must be able to fail."""

from __future__ import annotations

import numpy as np
import pytest
from compare import assert_same_image, assert_twin, assert_within_standard_errors, edge_band, z_test


@pytest.fixture
def half_dark() -> np.ndarray:
    image = np.ones((40, 60))
    image[:, 30:] = 0.0
    image[:5] = np.nan
    return image


def test_edges_are_found_on_both_sides(half_dark: np.ndarray) -> None:
    band = edge_band(half_dark)
    assert band[10, 29] and band[10, 30] and not band[10, 28] and not band[10, 31]
    assert band[4, 10] and band[5, 10] and not band[6, 10]
    assert edge_band(half_dark, 2)[10, 28]


def test_equal_images_pass_and_interior_differences_do_not(half_dark: np.ndarray) -> None:
    assert_same_image(half_dark, half_dark.copy())
    wrong = half_dark.copy()
    wrong[20, 10] -= 0.01
    with pytest.raises(AssertionError, match=r"away from edges.*\(20, 10\)"):
        assert_same_image(wrong, half_dark, flips=1.0)


def test_edge_flips_are_counted(half_dark: np.ndarray) -> None:
    few = half_dark.copy()
    few[[10, 20], 29] = 0.0
    few[[12, 22], 30] = 1.0
    assert_same_image(few, half_dark, flips=0.002)
    with pytest.raises(AssertionError, match="along edges"):
        assert_same_image(few, half_dark, flips=0.001)


def test_one_sided_flips_are_refused(half_dark: np.ndarray) -> None:
    shifted = half_dark.copy()
    shifted[5:, 29] = 0.0
    with pytest.raises(AssertionError, match="take sides"):
        assert_same_image(shifted, half_dark, flips=0.1)
    assert_same_image(shifted, half_dark, flips=0.1, biased=True)


def test_missing_receivers_count_as_differences(half_dark: np.ndarray) -> None:
    holes = half_dark.copy()
    holes[10, 5] = np.nan
    with pytest.raises(AssertionError):
        assert_same_image(holes, half_dark)
    with pytest.raises(AssertionError, match="compares nothing"):
        assert_same_image(np.full((3, 3), np.nan), np.full((3, 3), np.nan))


def test_twins_are_compared_relatively() -> None:
    assert_twin(np.array([1.0e6, 1.0e-6]), np.array([1.000009e6, 1.000009e-6]))
    with pytest.raises(AssertionError):
        assert_twin(np.array([1.0e-6]), np.array([1.00002e-6]))


def test_z_test_accepts_noise_and_refuses_an_offset() -> None:
    rng = np.random.default_rng(1)
    truth, error = rng.random(5000), np.full(5000, 0.01)
    z_test(truth + error * rng.normal(size=5000), truth, error)
    with pytest.raises(AssertionError, match="standard errors"):
        z_test(truth + 0.05 * (rng.random(5000) < 0.01), truth, error)
    with pytest.raises(AssertionError):
        z_test(truth + 1e-4, truth, np.zeros(5000))


def test_binomial_errors_are_taken_at_the_truth() -> None:
    rng = np.random.default_rng(2)
    truth = rng.random(5000)
    estimate = rng.binomial(256, truth) / 256
    assert_within_standard_errors(estimate, truth, 256, share=0.99)
    with pytest.raises(AssertionError):
        assert_within_standard_errors(estimate + 0.1, truth, 256, share=0.99)
    with pytest.raises(AssertionError):
        assert_within_standard_errors(np.array([0.01]), np.array([0.0]), 256)
