"""Plots of the scaling cases, in the style of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from experiments.bench.rows import Row
from experiments.report.style import INK, Look, log_axis, new_figure, save, styled

_OURS = "ours"
_PEERS_ONLY = ("embreex",)  # series that repeat our times beside another peer
_SERIES = {"rasteriser": "depth pass", "gbuffer": "depth and triangle pass", "pcss": "pixel pass of pcss"}


@dataclass(frozen=True)
class Plot:
    """One plot of a case.

    Attributes:
        case: Name of the case; rows are ``case.size`` or ``case.series.size``.
        x: Key of the figures that is drawn along the horizontal axis.
        x_label: Its label.
        y_label: Label of the vertical axis.
        per: Key of the figures that the time is divided by, if any, and the factor of the unit.
    """

    case: str
    x: str
    x_label: str
    y_label: str = "time [ms]"
    per: tuple[str, float] | None = None


PLOTS = {
    "scale_threads": Plot("scale_threads", "threads", "CPU threads", "speed-up over 1 thread"),
    "scale_triangles": Plot("scale_triangles", "triangles", "triangles"),
    "scale_triangles_each": Plot(
        "scale_triangles", "triangles", "triangles", "time per triangle [ns]", ("triangles", 1e6)
    ),
    "scale_map": Plot("scale_map", "map_side", "map side [texels]"),
    "scale_image": Plot("scale_image", "pixels", "pixels"),
    "scale_image_each": Plot("scale_image", "pixels", "pixels", "time per pixel [ns]", ("pixels", 1e6)),
    "scale_rays": Plot("scale_rays", "samples", "light samples", "shadow rays of a frame [ms]"),
    "scale_samples": Plot("scale_samples", "samples", "light samples per frame", "frame time [ms]"),
}
"""The plots by file name."""


def write_plots(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Writes a PNG of every plot whose case was run.

    Returns:
        The files.
    """
    written = []
    for name, plot in PLOTS.items():
        held = [row for row in rows if row.name.startswith(f"{plot.case}.") and row.ours_ms is not None]
        if held:
            save(draw(plot, held), folder / f"{name}.png", ["png"])
            written.append(folder / f"{name}.png")
    return written


def draw(plot: Plot, rows: Sequence[Row]) -> Figure:
    """One plot of one case's rows, both axes logarithmic; peers are dashed."""
    lines = _lines(plot, rows)
    look = Look(list(dict.fromkeys(series for series, _ in lines)))
    with styled():
        figure, axes = new_figure(7.0, 4.4)
        for (series, peer), points in lines.items():
            axes.plot(
                *zip(*points, strict=True),
                color=look.color(series),
                marker=look.marker(series),
                markersize=6,
                lw=1.6,
                ls="-" if peer is None else (0, (5, 2)),
                markerfacecolor=look.color(series) if peer is None else "white",
                label=peer or _SERIES.get(series, series),
            )
        every = [point for points in lines.values() for point in points]
        if plot.case == "scale_threads":
            most = max(x for x, _ in every)
            axes.plot([1.0, most], [1.0, most], color=INK, lw=1.0, ls=(0, (1, 1.5)), label="ideal")
            every.append((most, most))
        log_axis(axes, "x", [[x for x, _ in every]])
        log_axis(axes, "y", [[y for _, y in every]])
        if plot.case == "scale_threads":
            few = max(x for x, _ in every) <= 4.0
            axes.yaxis.set_major_locator(LogLocator(base=2.0, subs=(1.0, 1.25, 1.5, 1.75) if few else (1.0,)))
            axes.yaxis.set_minor_locator(NullLocator())
            axes.set_ylim(bottom=0.95)
        _mark_sizes(axes, plot, sorted({x for x, _ in every}))
        axes.set_xlabel(plot.x_label)
        axes.set_ylabel(plot.y_label)
        axes.legend(loc="best")
        return figure


def _lines(plot: Plot, rows: Sequence[Row]) -> dict[tuple[str, str | None], list[tuple[float, float]]]:
    """Points by (series, peer); ours have no peer."""
    lines: dict[tuple[str, str | None], list[tuple[float, float]]] = {}
    for row in rows:
        series = row.name.removeprefix(f"{plot.case}.").rpartition(".")[0]
        x = _number(row, plot.x)
        scale = 1.0 if plot.per is None else plot.per[1] / _number(row, plot.per[0])
        if plot.case == "scale_threads":
            lines.setdefault((series, None), []).append((x, row.ratio or 1.0))
            continue
        assert row.ours_ms is not None
        if series not in _PEERS_ONLY:
            lines.setdefault((series or _OURS, None), []).append((x, row.ours_ms * scale))
        if row.peer is not None and row.peer_ms is not None:
            lines.setdefault((series or _OURS, row.peer), []).append((x, row.peer_ms * scale))
    return lines


def _mark_sizes(axes: Axes, plot: Plot, sizes: Sequence[float]) -> None:
    """Ticks at the measured sizes where these are round numbers, which powers of two are to the reader."""
    if plot.x in ("threads", "map_side", "samples"):
        axes.xaxis.set_major_locator(FixedLocator(list(sizes)))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    elif plot.x in ("triangles", "pixels"):
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _thousands(value)))
        axes.xaxis.set_minor_formatter(NullFormatter())


def _thousands(value: float) -> str:
    return f"{value / 1e6:g} M" if value >= 1e6 else f"{value / 1e3:g} k"


def _number(row: Row, key: str) -> float:
    value = row.figures[key]
    assert isinstance(value, int | float)
    return float(value)
