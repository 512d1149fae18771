"""The plots of a convergence report: errors over steps, coverage over steps, pictures side by side."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from experiments.report.style import Look, log_axis, new_figure, styled

CELL = 2.5  # inches of a picture's width on a sheet


def log_log_plot(table: pd.DataFrame, summary: pd.DataFrame, look: Look, *, still: bool) -> Figure:
    """RMSE (solid) and own standard error (dashed) over steps, slopes in the legend, the reference's error as floor.

    Args:
        table: As ``load_convergence_rows`` gives it.
        summary: As ``summarise_convergence`` gives it.
        look: Looks of the labels.
        still: Whether the camera stood; along a path steps are on a linear axis.
    """
    with styled():
        figure, axes = new_figure(8.6, 5.4)
        axes.set_ylabel("visibility, root mean square over receivers")
        slopes = summary.set_index("label")
        last = int(table["step"].max())
        values: list[np.ndarray] = []
        for label in dict.fromkeys(table["label"]):
            own = table[table["label"] == label].sort_values("step")
            row = slopes.loc[label]
            rmse, error = own["rmse"].to_numpy(float), own["standard_error"].to_numpy(float)
            values += [rmse, error[error > 0.0]]
            color = look.color(label)
            if len(own) == 1 and last > 1:
                axes.axhline(rmse[0], color=color, lw=1.4, ls=(0, (1, 1.5)), label=label)
                continue
            marker = look.marker(label) if len(own) <= 40 else None
            axes.plot(
                own["step"], rmse, color=color, marker=marker, ms=4, lw=1.5, label=_named(label, "", row["rmse_slope"])
            )
            if np.isfinite(error).any():
                text = _named(label, ": own standard error", row["standard_error_slope"])
                axes.plot(own["step"], error, color=color, lw=1.1, ls=(0, (5, 2)), label=text)
        _step_axis(axes, last, still)
        floor = float(table["reference_standard_error"].median())
        if np.isfinite(floor) and floor > 0.0:
            values.append(np.array([floor]))
        log_axis(axes, "y", values)
        low, high = axes.get_ylim()
        if np.isfinite(floor) and floor > low:
            axes.axhspan(low, floor, color="#8a93a6", alpha=0.18, lw=0, zorder=0)
            axes.set_ylim(low, high)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=8.5)
        return figure


def coverage_plot(table: pd.DataFrame, look: Look, *, still: bool) -> Figure:
    """Share of penumbra pixels within two standard errors over steps; the band is 90 to 99.9 %."""
    with styled():
        figure, axes = new_figure(8.6, 3.6)
        known = table[table["coverage_2se"].notna()]
        axes.axhspan(0.9, 0.999, color="#009e73", alpha=0.12, lw=0, zorder=0)
        for label in dict.fromkeys(known["label"]):
            own = known[known["label"] == label].sort_values("step")
            marker = look.marker(label) if len(own) <= 40 else None
            axes.plot(
                own["step"], own["coverage_2se"], color=look.color(label), marker=marker, ms=4, lw=1.4, label=label
            )
        _step_axis(axes, int(known["step"].max()), still)
        axes.set_ylim(min(0.5, float(known["coverage_2se"].min())), 1.01)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel("penumbra pixels within 2 s")
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=9)
        return figure


def picture_sheet(rows: Mapping[str, Sequence[np.ndarray | None]], heads: Sequence[str]) -> Figure:
    """Pictures in a grid.

    Args:
        rows: By label, one uint8 (H, W, 3) for each head; None leaves a place empty.
        heads: Texts above the columns.
    """
    sizes = [image.shape for images in rows.values() for image in images if image is not None]
    height, width = sizes[0][:2] if sizes else (1, 1)
    cell = CELL * height / width
    with styled():
        figure = Figure(figsize=(CELL * len(heads) + 0.4, cell * len(rows) + 0.4), dpi=100)
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(rows), len(heads), squeeze=False, gridspec_kw={"wspace": 0.03, "hspace": 0.03})
        for line, (label, images) in zip(grid, rows.items(), strict=True):
            for axes, image in zip(line, images, strict=True):
                axes.grid(False)
                axes.set_xticks([])
                axes.set_yticks([])
                for spine in axes.spines.values():  # lit pictures are as white as the page
                    spine.set(visible=image is not None, color="#8a93a6", linewidth=0.6)
                if image is not None:
                    axes.imshow(image, interpolation="nearest", aspect="equal")
            name = "\n".join(
                textwrap.wrap(label, max(8, int(13.0 * cell)), break_long_words=True)
            )  # about 13 letters an inch
            line[0].text(
                -0.03, 0.5, name, rotation=90, ha="right", va="center", fontsize=8, transform=line[0].transAxes
            )
        for axes, head in zip(grid[0], heads, strict=True):
            axes.set_title(head, fontsize=10)
        return figure


def _named(label: str, what: str, slope: float) -> str:
    return f"{label}{what}, slope {slope:.2f}" if np.isfinite(slope) else f"{label}{what}"


def _step_axis(axes: Axes, last: int, still: bool) -> None:
    if not still:
        axes.set_xlabel("frame of the path")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return
    axes.set_xlabel("step: frames or light samples")
    axes.set_xscale("log", base=2)
    axes.set_xlim(0.92, 1.09 * last)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
