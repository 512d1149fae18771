"""The plots of a result folder, as matplotlib figures in one style."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, PercentFormatter

from experiments.report.labels import place_labels

INK = "#1f2430"  # text and lines; the page replaces it by its own text colour
_STYLE: dict[str, Any] = {
    "font.size": 10.0,
    "font.family": "DejaVu Sans",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#8a93a6",
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.hashsalt": "wkernels",  # same data, same file
    "svg.fonttype": "path",
}
# Okabe and Ito's colours, readable with every colour vision, in an order that also keeps neighbours apart in grey.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#8c6bb1", "#b8860b", "#2f4b7c")
_MARKERS = "osD^vPX<>h*"
_DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))
_FAINT = 0.45
_SMALL = 0.01


def _styled() -> AbstractContextManager[None]:
    style: Any = _STYLE  # matplotlib's type of this argument lists every key by name
    return rc_context(style)


class Look:
    """Colour, marker and dash of each label, the same in all plots of a report."""

    def __init__(self, labels: Sequence[str]) -> None:
        self._index = {label: i for i, label in enumerate(labels)}

    def color(self, label: str) -> str:
        """Hex colour."""
        return _COLORS[self._index[label] % len(_COLORS)]

    def marker(self, label: str) -> str:
        """Matplotlib marker."""
        return _MARKERS[self._index[label] % len(_MARKERS)]

    def dash(self, label: str) -> Any:
        """Matplotlib line style; changes when the colours start again."""
        return _DASHES[self._index[label] // len(_COLORS) % len(_DASHES)]


def save(figure: Figure, path: Path, suffixes: Sequence[str]) -> None:
    """Writes ``path`` with each suffix; dates are left out so that the same data gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    dates: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with _styled():
        for suffix in suffixes:
            metadata: Any = dates.get(suffix, {})
            figure.savefig(
                path.with_suffix(f".{suffix}"), dpi=160, facecolor="white", bbox_inches="tight", metadata=metadata
            )


def inline_svg(figure: Figure) -> str:
    """The figure as an SVG element whose ink follows the page's text colour."""
    text = io.StringIO()
    with _styled():
        figure.savefig(text, format="svg", transparent=True, bbox_inches="tight", metadata={"Date": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :].replace(INK, "currentColor")


def error_vs_time(
    summary: pd.DataFrame, look: Look, *, errors: str = "rmse", title: str = "RMSE of visibility"
) -> Figure:
    """Median error against median frame time, quartile bars over frames, Pareto front drawn, dominated points faint.

    Args:
        summary: As ``experiments.summary.summarise`` gives it.
        look: Looks of the labels.
        errors: Error column.
        title: Name of the error on its axis.
    """
    known = summary[np.isfinite(summary["frame_ms"]) & np.isfinite(summary[errors])]
    with _styled():
        figure, axes = _figure(8.0, 5.2)
        axes.set_xlabel("frame time [ms] (median and quartiles over frames)")
        axes.set_ylabel(f"{title} (median and quartiles)")
        if known.empty:
            return _empty(figure, axes, "no reference frames, so no errors")
        front = known[known["pareto"]].sort_values("frame_ms")
        for row in known.to_dict("records"):
            x, y = row["frame_ms"], row[errors]
            axes.errorbar(
                x,
                y,
                xerr=[[x - row["frame_ms_q1"]], [row["frame_ms_q3"] - x]],
                yerr=[[y - row[f"{errors}_q1"]], [row[f"{errors}_q3"] - y]],
                fmt=look.marker(row["label"]),
                color=look.color(row["label"]),
                markersize=7,
                elinewidth=1.2,
                capsize=2.5,
                alpha=1.0 if row["pareto"] else _FAINT,
                zorder=4 if row["pareto"] else 3,
            )
        _log_axis(axes, "x", [known["frame_ms_q1"], known["frame_ms_q3"]])
        _log_axis(axes, "y", [known[errors], known[f"{errors}_q1"], known[f"{errors}_q3"]])
        strokes = _draw_front(axes, front["frame_ms"].to_numpy(float), front[errors].to_numpy(float))
        limit = 2.0 * float(known["reference_standard_error"].median())
        low, high = axes.get_ylim()
        if np.isfinite(limit) and limit > low and errors == "rmse":
            axes.axhspan(low, min(limit, high), color="#8a93a6", alpha=0.15, lw=0, zorder=0)
            where: dict[str, Any] = {
                "ha": "right",
                "va": "bottom",
                "fontsize": 8,
                "alpha": 0.8,
                "transform": axes.get_yaxis_transform(),
            }
            axes.text(0.995, low, "within 2 standard errors of the reference", **where)
            axes.set_ylim(low, high)
        labels = list(known["label"])
        colors = [INK if p else "#7d8597" for p in known["pareto"]]
        points = list(zip(known["frame_ms"], known[errors], strict=True))
        for row in known.to_dict("records"):
            x, y = row["frame_ms"], row[errors]
            strokes += [
                (row["frame_ms_q1"], y, row["frame_ms_q3"], y),
                (x, row[f"{errors}_q1"], x, row[f"{errors}_q3"]),
            ]
        place_labels(axes, points, labels, colors, 9.0, strokes)
        return figure


def _draw_front(axes: Axes, x: np.ndarray, y: np.ndarray) -> list[tuple[float, float, float, float]]:
    """The staircase of what is reachable: at each time, the least error that some label gives by then; its segments."""
    if not len(x):
        return []
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    corners_x = np.concatenate([np.repeat(x, 2), [right]])
    corners_y = np.concatenate([[top], np.repeat(y, 2)])
    axes.plot(corners_x, corners_y, color=INK, lw=1.1, ls=(0, (4, 2)), alpha=0.7, zorder=2)
    axes.set_xlim(right=right)
    axes.set_ylim(top=top)
    return list(zip(corners_x[:-1], corners_y[:-1], corners_x[1:], corners_y[1:], strict=True))


def per_frame(frames: pd.DataFrame, look: Look, column: str, title: str, *, log: bool, sparse: bool = False) -> Figure:
    """One column of frames.csv over the frame number, a line per label.

    Args:
        frames: As ``experiments.summary.load_frames`` gives it.
        look: Looks of the labels.
        column: Column to draw; empty cells are left out.
        title: Name of the axis, with unit.
        log: Logarithmic axis.
        sparse: Mark each value, because few frames have one.
    """
    with _styled():
        figure, axes = _figure(8.0, 4.0)
        axes.set_xlabel("frame")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel(title)
        known = frames[np.isfinite(frames[column])]
        if known.empty:
            return _empty(figure, axes, "not measured")
        for label in known["label"].unique():
            own = known[known["label"] == label].sort_values("frame")
            marker = look.marker(label) if sparse or len(own) == 1 else None
            axes.plot(
                own["frame"],
                own[column],
                color=look.color(label),
                ls=look.dash(label),
                marker=marker,
                markersize=4.5,
                lw=1.4,
                label=label,
            )
        if log:
            _log_axis(axes, "y", [known[column]])
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=9)
        return figure


def frame_times(frames: pd.DataFrame, look: Look) -> Figure:
    """Distribution of frame times over frames, a box per label (median, quartiles, range)."""
    labels = list(dict.fromkeys(frames["label"]))
    with _styled():
        figure, axes = _figure(8.0, 0.9 + 0.36 * len(labels))
        values = [frames.loc[frames["label"] == label, "frame_ms"].to_numpy(float) for label in labels]
        boxes = axes.boxplot(
            values,
            orientation="horizontal",
            whis=(0, 100),
            widths=0.55,
            patch_artist=True,
            tick_labels=labels,
            medianprops={"color": INK, "lw": 1.6},
            whiskerprops={"color": INK, "lw": 1.0},
            capprops={"color": INK, "lw": 1.0},
        )
        for box, label in zip(boxes["boxes"], labels, strict=True):
            box.set(facecolor=look.color(label), alpha=0.75, edgecolor=INK)
        _log_axis(axes, "x", [np.concatenate(values)])
        axes.set_xlabel("frame time [ms]: median, quartiles, range over frames")
        axes.invert_yaxis()
        return figure


def pass_times(passes: pd.DataFrame, labels: Sequence[str]) -> Figure:
    """Each pass's share of the frame time, one stacked bar per label, with its mean milliseconds at the end.

    Shares, because one slow label would leave nothing to see of the others; passes below ``_SMALL`` everywhere are one.
    """
    with _styled():
        table = passes.groupby(["label", "pass"], sort=False)["ms"].sum().unstack(fill_value=0.0)
        table = table.reindex([label for label in labels if label in table.index])
        totals = table.sum(axis=1)
        share = table.div(totals.where(totals > 0.0, 1.0), axis=0)
        order = [name for name in dict.fromkeys(passes["pass"]) if share[name].max() >= _SMALL]
        rest = share.drop(columns=order).sum(axis=1)
        shares = [(name, share[name].to_numpy(float)) for name in order]
        if rest.max() > 0.0:
            shares.append((f"others, each below {_SMALL:.0%}", rest.to_numpy(float)))
        figure, axes = _figure(8.0, 1.2 + 0.36 * len(table))
        left, rows = np.zeros(len(table)), np.arange(len(table))
        for i, (name, width) in enumerate(shares):
            hatch = ("", "///", "...")[i // len(_COLORS) % 3]
            axes.barh(rows, width, 0.62, left, color=_COLORS[i % len(_COLORS)], hatch=hatch, label=name, alpha=0.9)
            left += width
        per_frame_ms = totals / passes.groupby("label")["frame"].nunique().reindex(table.index)
        for row, ms in zip(rows, per_frame_ms, strict=True):
            axes.text(1.01, float(row), f"{ms:.3g} ms" if ms < 1000.0 else f"{ms:.0f} ms", va="center", fontsize=9)
        axes.set_xlim(0.0, 1.0)
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_yticks(rows, list(table.index))
        axes.invert_yaxis()
        axes.set_xlabel("share of the frame time; right: mean per frame")
        axes.legend(loc="center left", bbox_to_anchor=(1.13, 0.5), fontsize=9)
        return figure


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), dpi=100)
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _empty(figure: Figure, axes: Axes, why: str) -> Figure:
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes, alpha=0.7)
    axes.set_xticks([])
    axes.set_yticks([])
    return figure


def _log_axis(axes: Axes, which: str, values: Sequence[Any]) -> None:
    """A logarithmic axis around the values with plain numbers; symmetric around 0 below the least positive value."""
    every = np.concatenate([np.asarray(part, dtype=float).ravel() for part in values])
    every = every[np.isfinite(every)]
    positive = every[every > 0.0]
    set_scale, set_limits = getattr(axes, f"set_{which}scale"), getattr(axes, f"set_{which}lim")
    axis = getattr(axes, f"{which}axis")
    if not len(positive):
        return
    low, high = float(positive.min()), float(positive.max())
    if len(positive) < len(every):  # exact zeros (a technique that equals the reference) must stay visible
        set_scale("symlog", linthresh=low)
        set_limits(-0.2 * low, high * 1.5)
    else:
        set_scale("log")
        room = max((high / low) ** 0.12, 1.25)
        set_limits(low / room, high * room)
        axis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)))
        axis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
