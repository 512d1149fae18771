"""The three tiers of tolerance: a kernel against its twin, an image against an image, an estimate against its own error."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

EDGE = 0.02  # neighbours that differ by more than this make a shadow edge


def assert_twin(actual: np.ndarray, expected: np.ndarray, *, rtol: float = 1e-5, atol: float = 0.0) -> None:
    """A kernel against its NumPy twin: float32 rounding and nothing else."""
    np.testing.assert_allclose(np.asarray(actual, float), np.asarray(expected, float), rtol=rtol, atol=atol)


def rmse(actual: np.ndarray, expected: np.ndarray) -> float:
    """Root mean square difference of two images over the pixels that both have (NaN: no receiver)."""
    return float(np.sqrt(np.nanmean((actual - expected) ** 2)))


def edge_band(image: np.ndarray, width: int = 1) -> np.ndarray:
    """Pixels within ``width`` of a place where the image changes by more than ``EDGE``, or starts or ends; bool (H, W)."""
    filled = np.nan_to_num(image, nan=-1.0)
    low, high = filled.copy(), filled.copy()
    for _ in range(width):
        for axis in (0, 1):
            for pick, out in ((np.minimum, low), (np.maximum, high)):
                before = out.copy()
                head = [slice(None), slice(None)]
                tail = [slice(None), slice(None)]
                head[axis], tail[axis] = slice(1, None), slice(None, -1)
                out[tuple(head)] = pick(out[tuple(head)], before[tuple(tail)])
                out[tuple(tail)] = pick(out[tuple(tail)], before[tuple(head)])
    return high - low > EDGE


def assert_same_image(
    actual: np.ndarray,
    expected: np.ndarray,
    *,
    tolerance: float = 1e-5,
    flips: float = 0.0,
    band: int = 1,
    biased: bool = False,
) -> None:
    """Two visibility images: tight inside, few and unbiased differences in a band along the edges of either.

    Args:
        actual: (H, W), NaN where there is no receiver.
        expected: (H, W).
        tolerance: Largest difference off the edges.
        flips: Share of receiver pixels that may differ by more, along edges.
        band: Width of that band in pixels.
        biased: Whether the flips may all go the same way.
    """
    assert actual.shape == expected.shape
    receivers = np.isfinite(expected)
    assert receivers.any(), "an image without receivers compares nothing"
    nan_differs = np.count_nonzero(np.isfinite(actual) != receivers)
    both = np.isfinite(actual) & receivers
    difference = np.where(both, np.nan_to_num(actual) - np.nan_to_num(expected), 0.0)
    wrong = np.abs(difference) > tolerance
    interior = ~(edge_band(expected, band) | edge_band(actual, band))
    inside = wrong & interior
    worst = np.unravel_index(np.argmax(np.abs(difference) * inside), difference.shape)
    assert not inside.any(), (
        f"{inside.sum()} pixels away from edges differ by more than {tolerance}: "
        f"worst at (row, column) {tuple(int(i) for i in worst)} by {difference[worst]:+.3g}"
    )
    count = np.count_nonzero(receivers)
    allowed = flips * count
    differing = np.count_nonzero(wrong) + nan_differs
    assert differing <= allowed, (
        f"{differing} of {count} pixels differ by more than {tolerance} along edges, {allowed:.1f} may"
    )
    if not biased and differing >= 12:
        # flips that take sides are an offset of the edge, not noise; a fair coin goes this far once in 10^5
        sign = np.sign(difference[wrong])
        assert abs(sign.sum()) <= 4.4 * np.sqrt(len(sign)), f"the flips take sides: {sign.sum():+.0f} of {len(sign)}"


def z_test(actual: np.ndarray, expected: np.ndarray, standard_error: np.ndarray, *, share: float = 0.9975) -> None:
    """An estimate against the truth, in units of its standard error, corrected for the number of pixels (Sidak).

    Args:
        actual, expected: Any shape, finite.
        standard_error: The same shape; at zeros the two must agree to 1e-6.
        share: Part of the values that must pass.
    """
    difference = np.abs(np.asarray(actual, float) - np.asarray(expected, float))
    significance = 1.0 - (1.0 - 0.01) ** (1.0 / max(difference.size, 1))
    limit = norm.isf(0.5 * significance)
    passed = difference <= limit * standard_error + 1e-6
    assert passed.mean() >= share, (
        f"only {passed.mean():.4%} of {passed.size} values lie within {limit:.2f} standard errors"
    )


def assert_within_standard_errors(
    actual: np.ndarray, expected: np.ndarray, samples: int, *, errors: float = 3.0, share: float = 0.997
) -> None:
    """Visibility from ``samples`` light samples against the true share: |difference| <= ``errors`` binomial standard errors.

    The standard error is taken at the *true* visibility, so it is zero only where every sample must agree.
    """
    truth = np.asarray(expected, float)
    standard_error = np.sqrt(np.clip(truth * (1.0 - truth), 0.0, None) / (samples - 1))
    passed = np.abs(actual - truth) <= errors * standard_error + 1e-5
    assert passed.mean() >= share, (
        f"only {passed.mean():.4%} of {passed.size} values lie within {errors} standard errors"
    )
