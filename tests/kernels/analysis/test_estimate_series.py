"""Estimates of written-down tests against their formulas in NumPy."""

from __future__ import annotations

import numpy as np

from wkernels.analysis.estimate_series import estimates_of


def test_series_against_the_formulas(device: str) -> None:
    tests = np.random.default_rng(2).integers(0, 2, (5, 300)).astype(np.float32)
    psi, variance, error = estimates_of(tests, device)
    n = np.arange(1, 301)
    expected = np.cumsum(tests, axis=1) / n
    np.testing.assert_allclose(psi, expected, rtol=1e-6)  # float32 sums of whole numbers are exact
    bare = expected[:, 1:] * (1 - expected[:, 1:]) / (n[1:] - 1)
    np.testing.assert_allclose(variance[:, 1:], bare, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(error[:, 1:], np.sqrt(bare), rtol=1e-5, atol=1e-6)
    assert (variance[:, 0] == 1.0).all() and (error[:, 0] == 1.0).all()  # what stands for 0 / 0


def test_an_empty_set_of_series(device: str) -> None:
    assert all(values.shape == (0, 3) for values in estimates_of(np.zeros((0, 3)), device))
