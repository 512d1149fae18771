"""The plots of a result folder, as matplotlib figures in one style."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from experiments.report.labels import place_labels
from experiments.report.style import COLORS, INK, Look, log_axis, new_figure, styled

_FAINT = 0.45
_SMALL = 0.01


def inline_svg(figure: Figure) -> str:
    """The figure as an SVG element whose ink and colours of labels follow the page's, light or dark."""
    text = io.StringIO()
    with styled():
        figure.savefig(text, format="svg", transparent=True, bbox_inches="tight", metadata={"Date": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    for i, color in enumerate(COLORS):
        svg = svg.replace(color, f"var(--c{i})")
    return svg


def error_vs_time(
    summary: pd.DataFrame,
    look: Look,
    *,
    errors: str = "rmse",
    title: str = "RMSE of visibility",
    time: str = "frame time [ms]",
    spread: str = "median and quartiles over frames",
) -> Figure:
    """Median error against median frame time, quartile bars over frames, Pareto front drawn, dominated points faint.

    Args:
        summary: As ``experiments.results.summary.summarise`` gives it.
        look: Looks of the labels.
        errors: Error column.
        title: Name of the error on its axis.
        time: Name of the time on its axis.
        spread: What points and bars are.
    """
    known = summary[np.isfinite(summary["frame_ms"]) & np.isfinite(summary[errors])]
    with styled():
        figure, axes = new_figure(8.0, 5.2)
        axes.set_xlabel(f"{time} ({spread})")
        axes.set_ylabel(f"{title} ({spread})")
        if known.empty:
            return _empty(figure, axes, "no reference frames, so no errors")
        front = known[known["pareto"]].sort_values("frame_ms")
        # labels that cannot be told apart may share a front; the staircase runs below them
        front = front[front[errors] <= front[errors].cummin()]
        for row in known.to_dict("records"):
            x, y = row["frame_ms"], row[errors]
            axes.errorbar(
                x,
                y,
                # a mean over few scenes may lie outside their quartiles
                xerr=[[max(x - row["frame_ms_q1"], 0.0)], [max(row["frame_ms_q3"] - x, 0.0)]],
                yerr=[[max(y - row[f"{errors}_q1"], 0.0)], [max(row[f"{errors}_q3"] - y, 0.0)]],
                fmt=look.marker(row["label"]),
                color=look.color(row["label"]),
                markersize=7,
                elinewidth=1.2,
                capsize=2.5,
                alpha=1.0 if row["pareto"] else _FAINT,
                zorder=4 if row["pareto"] else 3,
            )
        log_axis(axes, "x", [known["frame_ms_q1"], known["frame_ms_q3"]])
        log_axis(axes, "y", [known[errors], known[f"{errors}_q1"], known[f"{errors}_q3"]])
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
    """One column of frames.csv over the frame number, a line per label; below them what each frame uncovered.

    Args:
        frames: As ``experiments.results.summary.load_frames`` gives it.
        look: Looks of the labels.
        column: Column to draw; empty cells are left out.
        title: Name of the axis, with unit.
        log: Logarithmic axis.
        sparse: Mark each value, because few frames have one.
    """
    with styled():
        figure, axes = new_figure(8.0, 4.0)
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
            log_axis(axes, "y", [known[column]])
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=9)
        _disocclusion_below(figure, axes, frames)
        return figure


def _disocclusion_below(figure: Figure, axes: Axes, frames: pd.DataFrame) -> None:
    """A panel under the curves: the percentage of receiver pixels that the frame before did not see, if any."""
    share = (
        frames.groupby("frame")["disoccluded"].mean().dropna() if "disoccluded" in frames else pd.Series(dtype=float)
    )
    if not len(share) or not share.max() > 0.0:
        return
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 1.3)
    grid = figure.add_gridspec(2, 1, height_ratios=(3.2, 1.0), hspace=0.08)
    axes.set_subplotspec(grid[0])
    below = figure.add_subplot(grid[1], sharex=axes)
    below.fill_between(share.index, 100.0 * share, step="mid", color="#8a93a6", alpha=0.6, lw=0)
    below.set_ylim(0.0, 105.0 * float(share.max()))
    below.set_ylabel("disoccluded\n[%]")
    below.set_xlabel(axes.get_xlabel())
    axes.set_xlabel("")
    axes.tick_params(labelbottom=False)


def frame_times(frames: pd.DataFrame, look: Look) -> Figure:
    """Distribution of frame times over frames, a box per label (median, quartiles, range)."""
    labels = list(dict.fromkeys(frames["label"]))
    with styled():
        figure, axes = new_figure(8.0, 0.9 + 0.36 * len(labels))
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
        log_axis(axes, "x", [np.concatenate(values)])
        axes.set_xlabel("frame time [ms]: median, quartiles, range over frames")
        axes.invert_yaxis()
        return figure


def pass_times(passes: pd.DataFrame, labels: Sequence[str]) -> Figure:
    """Each pass's share of the frame time, one stacked bar per label, with its mean milliseconds at the end.

    Shares, because one slow label would leave nothing to see of the others; passes below ``_SMALL`` everywhere are one.
    """
    with styled():
        table = passes.groupby(["label", "pass"], sort=False)["ms"].sum().unstack(fill_value=0.0)
        table = table.reindex([label for label in labels if label in table.index])
        totals = table.sum(axis=1)
        share = table.div(totals.where(totals > 0.0, 1.0), axis=0)
        order = [name for name in dict.fromkeys(passes["pass"]) if share[name].max() >= _SMALL]
        rest = share.drop(columns=order).sum(axis=1)
        shares = [(name, share[name].to_numpy(float)) for name in order]
        if rest.max() > 0.0:
            shares.append((f"others, each below {_SMALL:.0%}", rest.to_numpy(float)))
        figure, axes = new_figure(8.0, 1.2 + 0.36 * len(table))
        left, rows = np.zeros(len(table)), np.arange(len(table))
        for i, (name, width) in enumerate(shares):
            hatch = ("", "///", "...")[i // len(COLORS) % 3]
            axes.barh(rows, width, 0.62, left, color=COLORS[i % len(COLORS)], hatch=hatch, label=name, alpha=0.9)
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


def _empty(figure: Figure, axes: Axes, why: str) -> Figure:
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes, alpha=0.7)
    axes.set_xticks([])
    axes.set_yticks([])
    return figure
