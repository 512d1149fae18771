"""The plot of predicted against measured errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.report.style import Look, log_axis, styled
from experiments.results.prediction import ALL, PREDICTORS, WITHIN_FRAMES, Correlation, points_of

TITLES = {
    "m_x_max": "largest m_x along the view",
    "m_z_max": "largest m_z along the view",
    "m_pixel_median": "median m over pixels",
    "m_pixel_p99": "99th percentile of m over pixels",
    "undersampled": "share of undersampled pixels",
    "m_edge": "mean m beside the reference's edges",
    "rmse_predicted": "RMSE predicted from m and edges",
}
_SHORT = {
    "m_x_max": "$m_x$",
    "m_z_max": "$m_z$",
    "m_pixel_median": "$m_{50}$",
    "m_pixel_p99": "$m_{99}$",
    "undersampled": "$u$",
    "m_edge": "$m_e$",
    "rmse_predicted": "$p$",
}
assert set(TITLES) == set(_SHORT) == set(PREDICTORS)
COLUMNS = 3
MOST_IN_LEGEND = 12  # more do not fit beside the panels
MOST_IN_PANEL = 6  # labels whose legend fits into a panel


def scatter(frames: pd.DataFrame, found: list[Correlation], look: Look) -> Figure:
    """A panel per predictor, a point per label and frame; rank correlations in titles and legend.

    Args:
        frames: As ``experiments.results.summary.load_frames`` gives it.
        found: Its ``experiments.results.prediction.correlations``, at least one.
        look: Looks of the labels.
    """
    predictors = list(dict.fromkeys(row.predictor for row in found))
    by = {(row.label, row.predictor): row for row in found}
    labels = [label for label in dict.fromkeys(row.label for row in found) if label not in (ALL, WITHIN_FRAMES)]
    columns = min(COLUMNS, len(predictors) + 1)
    rows = -(-(len(predictors) + 1) // columns)  # and the legend
    with styled():
        figure = Figure(figsize=(4.0 * columns, 3.6 * rows), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        places: list[Axes] = list(np.atleast_1d(figure.subplots(rows, columns)).ravel())
        for axes, predictor in zip(places, predictors, strict=False):
            points = points_of(frames, predictor)
            for label, own in points.groupby("label", sort=False):
                axes.scatter(
                    own["predicted"],
                    own["measured"],
                    s=16,
                    marker=look.marker(str(label)),
                    color=look.color(str(label)),
                    alpha=0.75,
                    linewidths=0.4,
                )
            if predictor != "undersampled":
                log_axis(axes, "x", [points["predicted"]])
            log_axis(axes, "y", [points["measured"]])
            axes.set_xlabel(TITLES[predictor])
            axes.set_ylabel("RMSE of visibility")
            axes.set_title(_title(by, predictor), fontsize=9)
        for axes in places[len(predictors) :]:
            axes.set_axis_off()
        _legend(places[len(predictors)], labels, predictors, by, look)
        return figure


def _title(by: dict[tuple[str, str], Correlation], predictor: str) -> str:
    every, within = by[(ALL, predictor)], by.get((WITHIN_FRAMES, predictor))
    text = f"rank correlation {_number(every.spearman)} (n = {every.n})"
    if within is not None:
        text += f"\nbetween the labels of a frame {_number(within.spearman)} (median of {within.n})"
    return text


def _legend(
    axes: Axes, labels: list[str], predictors: list[str], by: dict[tuple[str, str], Correlation], look: Look
) -> None:
    if len(labels) > MOST_IN_LEGEND:
        axes.text(
            0.0, 0.9, f"{len(labels)} labels: colours and marks as in the other plots,\nnumbers in the table below"
        )
        return
    axes.set_title("rank correlation within each label", fontsize=9)
    for label in labels:
        parts = [f"{_SHORT[p]} {_number(by[(label, p)].spearman)}" for p in predictors if (label, p) in by]
        text = "\n".join([label, "  ".join(parts[:4]), "  ".join(parts[4:])]).rstrip()
        axes.scatter([], [], s=22, marker=look.marker(label), color=look.color(label), label=text)
    where: dict[str, Any] = {"fontsize": 8, "borderaxespad": 0.0, "labelspacing": 0.7}
    if len(labels) <= MOST_IN_PANEL:
        axes.legend(loc="upper left", **where)
    else:  # would leave the panels no height
        axes.set_title("")
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.legend(loc="outside right upper", title="rank correlation within each label", **where)


def _number(value: float) -> str:
    return f"{value:+.2f}" if np.isfinite(value) else "undefined"
