"""One style for all plots: colours, markers, axes, and how figures are written."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

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
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#8c6bb1", "#b8860b", "#2f4b7c")
# The same hues on a dark page, in the same order.
DARK_COLORS = (
    "#4aa3e6", "#f2874b", "#2fc49b", "#e6a3c8", "#8fd3f7", "#f2bb49", "#a9adb5", "#b7a1ec", "#d8ac4a", "#86a2e0",
)  # fmt: skip
assert len(DARK_COLORS) == len(COLORS)
_MARKERS = "osD^vPX<>h*"
_DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))


def styled() -> AbstractContextManager[None]:
    """A context in which matplotlib has the style."""
    style: Any = _STYLE  # matplotlib's type of this argument lists every key by name
    return rc_context(style)


class Look:
    """Colour, marker and dash of each label, the same in all plots of a report."""

    def __init__(self, labels: Sequence[str]) -> None:
        self._index = {label: i for i, label in enumerate(labels)}

    def index(self, label: str) -> int:
        """Place of the label, from which its looks follow."""
        return self._index[label]

    def color(self, label: str) -> str:
        """Hex colour."""
        return COLORS[self._index[label] % len(COLORS)]

    def marker(self, label: str) -> str:
        """Matplotlib marker."""
        return _MARKERS[self._index[label] % len(_MARKERS)]

    def dash(self, label: str) -> Any:
        """Matplotlib line style; changes when the colours start again."""
        return _DASHES[self._index[label] // len(COLORS) % len(_DASHES)]


def save(figure: Figure, path: Path, suffixes: Sequence[str]) -> None:
    """Writes ``path`` with each suffix; dates are left out so that the same data gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    dates: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with styled():
        for suffix in suffixes:
            metadata: Any = dates.get(suffix, {})
            figure.savefig(
                path.with_suffix(f".{suffix}"), dpi=160, facecolor="white", bbox_inches="tight", metadata=metadata
            )


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of so many inches with one pair of axes."""
    figure = Figure(figsize=(width, height), dpi=100)
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def log_axis(axes: Axes, which: str, values: Sequence[Any]) -> None:
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
