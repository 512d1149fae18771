"""A finished picture: heading, panels pixel for pixel, and below them the scales and what else must be said."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from experiments.report.style import INK, styled

MARGIN, GAP = 14, 12  # pixels
LEAST_WIDTH = 560  # pixels of content: the heading must fit
_TITLE, _TEXT, _SMALL = 11.5, 8.5, 7.5  # points
_DPI = 100
_LINE = 17  # pixels per line of text


@dataclass(frozen=True)
class Bar:
    """A colour scale.

    Attributes:
        label: What it measures, with unit.
        colors: Places 0 to 1 to RGB in [0, 1].
        ticks: (place, text), ascending.
    """

    label: str
    colors: Callable[[np.ndarray], np.ndarray]
    ticks: Sequence[tuple[float, str]]


@dataclass(frozen=True)
class Chips:
    """Colours with names: (RGB in [0, 1], text)."""

    items: Sequence[tuple[Sequence[float], str]]


@dataclass(frozen=True)
class Panel:
    """An image, float (H, W, 3) in display colours, and a line above it."""

    image: np.ndarray
    title: str = ""


@dataclass(frozen=True)
class Sheet:
    """Everything of one picture.

    Attributes:
        panels: In rows of ``columns``.
        legend: Scales below the panels.
        notes: Sentences below the scales: measured numbers, and what is not shown.
        columns: Panels per row.
    """

    panels: Sequence[Panel]
    legend: Sequence[Bar | Chips] = ()
    notes: Sequence[str] = field(default_factory=tuple)
    columns: int = 4


@functools.lru_cache(maxsize=4096)
def _width(text: str, points: float, bold: bool = False) -> float:
    """Pixels that a text is wide."""
    if not text.strip():
        return 0.3 * points * len(text)
    font = FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal", size=points)
    return float(_renderer().get_text_width_height_descent(text, font, ismath=False)[0])


@functools.cache
def _renderer() -> RendererAgg:
    """Measures texts as they will be drawn."""
    return FigureCanvasAgg(Figure(figsize=(1.0, 1.0), dpi=_DPI)).get_renderer()


def wrapped(text: str, width: float, points: float) -> list[str]:
    """The text in lines of at most ``width`` pixels."""
    lines: list[str] = []
    for word in text.split():
        if lines and _width(f"{lines[-1]} {word}", points) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def composed(sheet: Sheet, title: str, words: str) -> np.ndarray:
    """The picture, uint8 (H, W, 3).

    Args:
        sheet: What it shows.
        title: Kind of picture, label and frame.
        words: The projection in words.
    """
    rows = [sheet.panels[i : i + sheet.columns] for i in range(0, len(sheet.panels), sheet.columns)]
    widths = [sum(panel.image.shape[1] for panel in row) + GAP * (len(row) - 1) for row in rows]
    content = max(LEAST_WIDTH, *widths)
    head = wrapped(title, content, _TITLE + 1), wrapped(words, content, _TEXT)
    place = _Writer(content)
    for line in head[0]:
        place.text(line, _TITLE, bold=True, height=_LINE + 3)
    for line in head[1]:
        place.text(line, _TEXT)
    place.y += 5
    for row in rows:
        place.row(row)
    for item in sheet.legend:
        if isinstance(item, Bar):
            place.bar(item)
        else:
            place.chips(item)
    for note in sheet.notes:
        for line in wrapped(note, content, _TEXT):
            place.text(line, _TEXT)
    return place.drawn()


class _Writer:
    """Collects what is drawn where, from the top down, and draws it when the height is known."""

    def __init__(self, content: int) -> None:
        self.content, self.y = content, MARGIN
        self._texts: list[tuple[float, float, str, float, bool, str]] = []
        self._images: list[tuple[int, int, np.ndarray]] = []

    def text(self, text: str, points: float, *, bold: bool = False, height: int = _LINE) -> None:
        """One line from the left."""
        self._texts.append((MARGIN, self.y + 0.5 * height, text, points, bold, "left"))
        self.y += height

    def row(self, panels: Sequence[Panel]) -> None:
        """Panels side by side, their titles above them."""
        x = MARGIN
        titled = any(panel.title for panel in panels)
        for panel in panels:
            if titled:
                self._texts.append((x, self.y + 0.5 * _LINE, panel.title, _TEXT, False, "left"))
            self._images.append((x, self.y + _LINE * titled, to_bytes(panel.image)))
            x += panel.image.shape[1] + GAP
        self.y += _LINE * titled + max(panel.image.shape[0] for panel in panels) + GAP

    def bar(self, bar: Bar) -> None:
        """A colour scale with its ticks below and its name above."""
        for line in wrapped(bar.label, self.content, _TEXT):
            self.text(line, _TEXT)
        width = min(self.content, 640)
        colors = bar.colors((np.arange(width) + 0.5) / width)
        self._images.append((MARGIN, self.y, to_bytes(np.repeat(colors[None], 14, axis=0))))
        end = -np.inf
        for at, text in bar.ticks:
            x = MARGIN + at * width
            half = 0.5 * _width(text, _SMALL)
            shown = min(max(x, MARGIN + half), MARGIN + width - half)
            if shown - half > end + 4.0:
                self._texts.append((shown, self.y + 24, text, _SMALL, False, "center"))
                end = shown + half
            tick = min(max(int(x), MARGIN), MARGIN + width - 1)
            self._images.append((tick, self.y + 11, np.zeros((5, 1, 3), np.uint8)))
        self.y += 38

    def chips(self, chips: Chips) -> None:
        """Coloured squares with names, in as many lines as they need."""
        x = float(MARGIN)
        for color, text in chips.items:
            width = 18 + _width(text, _TEXT) + GAP
            if x > MARGIN and x + width > MARGIN + self.content + GAP:
                x, self.y = float(MARGIN), self.y + _LINE + 3
            square = np.broadcast_to(np.asarray(color, float), (12, 12, 3)).copy()
            square[[0, -1]] = square[:, [0, -1]] = 0.25
            self._images.append((int(x), self.y + 3, to_bytes(square)))
            self._texts.append((int(x) + 18, self.y + 0.5 * _LINE + 1, text, _TEXT, False, "left"))
            x += width
        self.y += _LINE + 5

    def drawn(self) -> np.ndarray:
        """Everything, on white."""
        width, height = self.content + 2 * MARGIN, self.y + MARGIN // 2
        with styled():
            figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
            canvas = FigureCanvasAgg(figure)
            for x, y, text, points, bold, align in self._texts:
                weight = "bold" if bold else "normal"
                figure.text(
                    x / width,
                    1.0 - y / height,
                    text,
                    size=points,
                    weight=weight,
                    ha=align,
                    va="center",
                    color=INK,
                    parse_math=False,
                )
            canvas.draw()
            out: np.ndarray = np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
        for x, y, image in self._images:  # copied, not drawn: no pixel of a picture may be resampled
            rows, columns = image.shape[:2]
            out[y : y + rows, x : x + columns] = image
        return out


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Display colours in [0, 1] as uint8."""
    return np.rint(255.0 * np.clip(np.nan_to_num(image), 0.0, 1.0)).astype(np.uint8)
