"""Scores that tell a shadow's errors apart: by class of the reference, and acne, leaks and penumbra width.

Acne is counted where the reference is lit all around, leaks where it is umbra all around, widths in what is left, so
that one error is not counted as another (``shadow_classes`` draws the borders).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from experiments.metrics.measured import Measured, Metric
from experiments.metrics.shadow_classes import ShadowClasses, classes_of

SEEN = 0.1
"""Errors up to this are no acne and no leak: 25 of 255 grey levels, and less than one map in eight being wrong."""

FEWEST = 50
"""Pixels below which a share, or a width, is that of one spot: what says nothing of a picture stays empty."""


def _rmse_in(which: Callable[[ShadowClasses], np.ndarray]) -> Callable[[Measured], float | None]:
    def evaluate(m: Measured) -> float | None:
        error = _errors(m, which)
        return None if error is None else float(np.sqrt(np.mean(np.square(error))))

    return evaluate


def _share_in(which: Callable[[ShadowClasses], np.ndarray], sign: float) -> Callable[[Measured], float | None]:
    def evaluate(m: Measured) -> float | None:
        error = _errors(m, which)
        return None if error is None or len(error) < FEWEST else float(np.mean(sign * error > SEEN))

    return evaluate


def _errors(m: Measured, which: Callable[[ShadowClasses], np.ndarray]) -> np.ndarray | None:
    """Visibility minus reference at the receiver pixels of a mask, float64 (N,); None without any."""
    classes = classes_of(m)
    if classes is None or m.reference is None:
        return None
    where = which(classes) & np.isfinite(m.visibility)
    if not where.any():
        return None
    return m.visibility[where].astype(np.float64) - m.reference[where]


def _penumbra_width_error(m: Measured) -> float | None:
    """Sum of v (1 - v) at the reference's edges over that of r (1 - r), minus 1.

    Across a penumbra of width w whose visibility is f(x / w), v (1 - v) adds up to w times the integral of f (1 - f),
    which is 1/6 for a straight ramp: it is proportional to the width, needs no threshold and does not care where the
    edge lies. A mean of n samples loses the share 1/n of it: 8 maps make penumbrae of the right extent an eighth too
    hard, in steps as they are. The reference is given back its own, which is its squared standard error.
    """
    classes = classes_of(m)
    if classes is None or m.reference is None:
        return None
    where = classes.edge & np.isfinite(m.visibility)
    if np.count_nonzero(where & classes.penumbra) < FEWEST:
        return None
    true = _mixed(m.reference[where])
    if m.reference_standard_error is not None:
        true += float(np.nansum(np.square(m.reference_standard_error[where].astype(np.float64))))
    return _mixed(m.visibility[where]) / true - 1.0 if true > 0.0 else None


def _mixed(visibility: np.ndarray) -> float:
    v = np.clip(visibility.astype(np.float64), 0.0, 1.0)
    return float(np.sum(v * (1.0 - v)))


SCORE_DESCRIPTORS = (
    Metric(
        "rmse_umbra",
        "RMSE, umbra",
        "RMSE over the pixels whose reference sees nothing of the light.",
        "visibility",
        _rmse_in(lambda classes: classes.umbra),
    ),
    Metric(
        "rmse_penumbra",
        "RMSE, penumbra",
        "RMSE over the pixels whose reference sees some of the light.",
        "visibility",
        _rmse_in(lambda classes: classes.penumbra),
    ),
    Metric(
        "rmse_lit",
        "RMSE, lit",
        "RMSE over the pixels whose reference sees all of the light.",
        "visibility",
        _rmse_in(lambda classes: classes.lit),
    ),
    Metric(
        "acne",
        "acne",
        f"Share of the pixels amid lit ones that are darker than the reference by more than {SEEN:g}: surfaces that "
        "shadow themselves, or blur that reaches further than a penumbra is wide.",
        "share",
        _share_in(lambda classes: classes.deep_lit, -1.0),
    ),
    Metric(
        "leak",
        "leak",
        f"Share of the pixels amid umbra that are lighter than the reference by more than {SEEN:g}: light that passes "
        "through casters or under them.",
        "share",
        _share_in(lambda classes: classes.deep_umbra, 1.0),
    ),
    Metric(
        "penumbra_width_error",
        "penumbra width",
        "How much too wide penumbrae are, as a share of their width; negative = too hard, -1 = no penumbra at all.",
        "share",
        _penumbra_width_error,
        worst=float("inf"),
    ),
)
SCORES = tuple(metric.name for metric in SCORE_DESCRIPTORS)
