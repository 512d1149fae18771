"""Does the analysis predict the picture? Predicted sampling errors beside the measured error of the same frames.

One point per label and frame on which both are known. The link is judged by Spearman's rank correlation, because theory
promises an order and no more: an error grows with the texels' size, by a factor that depends on the shadows in view.
The last two predictors know where the reference's edges are: they tell whether the texels explain the error, and what
is missing from the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.results.tables import table_text, write_text

PREDICTORS = ("m_x_max", "m_z_max", "m_pixel_median", "m_pixel_p99", "undersampled", "m_edge", "rmse_predicted")
MEASURED = "rmse"
PREDICTION_COLUMNS = ("label", "predictor", "n", "spearman")
PREDICTION_FILE = "prediction.csv"
LEAST_POINTS = 3  # two always lie in one order or the other
ALL, WITHIN_FRAMES = "(all labels)", "(labels of one frame)"


@dataclass(frozen=True)
class Correlation:
    """Rank correlation of one predictor with the measured error.

    Attributes:
        label: A label, ``ALL`` for all points at once, or ``WITHIN_FRAMES`` for the median over frames of the
            correlation between the labels of a frame: whether the predictor puts the projections into the right order.
        predictor: One of ``PREDICTORS``.
        n: Points, or frames.
        spearman: -1 to 1; NaN where it is not defined: all values are the same, or fewer than ``LEAST_POINTS``.
    """

    label: str
    predictor: str
    n: int
    spearman: float


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's rank correlation of two samples (n,) without NaN, ties at their mean rank; NaN where undefined."""
    if len(a) < LEAST_POINTS:
        return float("nan")
    ranks = [pd.Series(values).rank().to_numpy(float) for values in (a, b)]
    ranks = [values - values.mean() for values in ranks]
    size = float(np.sqrt((ranks[0] @ ranks[0]) * (ranks[1] @ ranks[1])))
    return float(ranks[0] @ ranks[1]) / size if size > 0.0 else float("nan")


def points_of(frames: pd.DataFrame, predictor: str) -> pd.DataFrame:
    """Rows of ``frames`` on which the predictor and the error are known; columns label, frame, predicted, measured."""
    known = frames[np.isfinite(frames[predictor]) & np.isfinite(frames[MEASURED])]
    out = known[["label", "frame", predictor, MEASURED]]
    return out.rename(columns={predictor: "predicted", MEASURED: "measured"})


def correlations(frames: pd.DataFrame) -> list[Correlation]:
    """Of every predictor that was measured: each label's, in order of appearance, then ``ALL`` and ``WITHIN_FRAMES``.

    Args:
        frames: As ``experiments.results.summary.load_frames`` gives it.
    """
    out: list[Correlation] = []
    for predictor in PREDICTORS:
        points = points_of(frames, predictor)
        if len(points) < LEAST_POINTS:
            continue
        groups = [(str(label), own) for label, own in points.groupby("label", sort=False)]
        for label, own in [*groups, (ALL, points)]:
            out.append(Correlation(label, predictor, len(own), _of(own)))
        if len(groups) >= LEAST_POINTS:
            each = np.array([_of(own) for _, own in points.groupby("frame")])
            each = each[np.isfinite(each)]
            middle = float(np.median(each)) if len(each) else float("nan")
            out.append(Correlation(WITHIN_FRAMES, predictor, len(each), middle))
    return out


def _of(points: pd.DataFrame) -> float:
    return spearman(points["predicted"].to_numpy(float), points["measured"].to_numpy(float))


def write_prediction(out: Path, frames: pd.DataFrame) -> list[Correlation]:
    """Writes prediction.csv into a result folder, or removes it where there is nothing to compare."""
    rows = correlations(frames)
    if rows:
        write_text(out / PREDICTION_FILE, table_text(PREDICTION_COLUMNS, [vars(row) for row in rows]))
    else:
        (out / PREDICTION_FILE).unlink(missing_ok=True)
    return rows
