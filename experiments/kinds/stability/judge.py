"""What one picture of a stiff case says: whether it is finite, in range, and how its error grew from the easy level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wkernels.frame.session import FrameResult

GROWTH, LEAST_GROWTH = 0.3, 0.03
"""Largest growth of the root mean square error over the easy level's: as a share of what the best picture without any
shadow edge is off by (the standard deviation of the truth), and where there is next to no shadow to lose."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What a picture may show.

    Attributes:
        hard, soft: Visibility of the light's centre, and of its whole area, (H, W), NaN where nothing receives.
    """

    hard: np.ndarray
    soft: np.ndarray


@dataclass(frozen=True)
class Verdict:
    """About one picture.

    Attributes:
        broken: Whether anything is wrong.
        detail: What, or the error, in words.
        rmse: Error against the nearer truth; None where nothing receives or the picture is not comparable.
    """

    broken: bool
    detail: str
    rmse: float | None


def judge(result: FrameResult, truth: Truth, easy: float | None, judged: bool) -> Verdict:
    """Looks at a picture.

    A technique is held against whichever truth it is nearer to, since some show the light's centre and some its area.

    Args:
        result: The picture.
        truth: Of the same size.
        easy: Error at the case's first level; None at that level itself.
        judged: Whether growth of the error counts.
    """
    receives = np.isfinite(truth.hard)
    if result.visibility.shape != receives.shape:
        return Verdict(True, f"has the size {result.visibility.shape}, not {receives.shape}", None)
    finite = np.isfinite(result.visibility)
    if missing := int((receives & ~finite).sum()):
        return Verdict(True, f"not finite in {missing} of {int(receives.sum())} receiver pixels", None)
    if extra := int((finite & ~receives).sum()):
        return Verdict(True, f"visibility in {extra} pixels without a receiver", None)
    seen = result.visibility[receives]
    if not receives.any():
        return Verdict(False, "nothing receives", None)
    if seen.min() < 0.0 or seen.max() > 1.0:
        return Verdict(True, f"visibility from {seen.min():.4g} to {seen.max():.4g}", None)
    error = result.standard_error
    if error is not None and not (np.isfinite(error[receives]).all() and (error[receives] >= 0.0).all()):
        return Verdict(True, "the standard error is not finite, or negative", None)
    rmse = min(_rmse(seen, image[receives]) for image in (truth.hard, truth.soft))
    if easy is None or not judged:
        return Verdict(False, f"rmse {rmse:.4f}", rmse)
    spread = max(float(image[receives].std()) for image in (truth.hard, truth.soft))
    limit = easy + max(GROWTH * spread, LEAST_GROWTH)
    return Verdict(rmse > limit, f"rmse {rmse:.4f}, easy {easy:.4f}, limit {limit:.4f}", rmse)


def _rmse(seen: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean((seen.astype(float) - expected) ** 2)))
