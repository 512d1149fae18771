"""Text beside points of a scatter plot so that no two texts overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

_DIRECTIONS = tuple(
    (np.cos(angle), np.sin(angle))
    for angle in np.radians([0, 180, 45, -45, 135, -135, 90, -90, 22, -22, 158, -158, 68, -68])
)
_POINT_RADIUS = 5.0  # display points kept free around each marker
_LEADER_FROM = 16.0  # display points from which on a text needs a line to its point


def place_labels(
    axes: Axes,
    points: Sequence[tuple[float, float]],
    texts: Sequence[str],
    colors: Sequence[str],
    size: float,
    strokes: Sequence[tuple[float, float, float, float]] = (),
) -> list[Annotation]:
    """Writes each text near its point, clear of the other texts and, where possible, of all markers and strokes.

    Greedy: each text takes the nearest free place around its point, and gets a thin line to the point if that is far.

    Args:
        axes: The final axes: limits, scales and figure size must not change afterwards.
        points: Data coordinates.
        texts: One per point.
        colors: One per point.
        size: Font size in points.
        strokes: Horizontal and vertical lines of the plot, (x0, y0, x1, y1) in data coordinates.

    Returns:
        The annotations, in order.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    scale = figure.dpi / 72.0
    frame = axes.get_window_extent(renderer)
    places = [np.asarray(axes.transData.transform(point), dtype=float) for point in points]
    markers = [Bbox.from_extents(*(p - _POINT_RADIUS * scale), *(p + _POINT_RADIUS * scale)) for p in places]
    thin = [Bbox(axes.transData.transform([(x0, y0), (x1, y1)])).padded(1.0) for x0, y0, x1, y1 in strokes]
    taken: list[Bbox] = []
    order = np.argsort([place[1] for place in places], kind="stable")
    made: dict[int, Annotation] = {}
    for i in order:
        note = axes.annotate(
            texts[i],
            xy=points[i],
            xytext=(0.0, 0.0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=size,
            color=colors[i],
            zorder=6,
            annotation_clip=False,
        )
        extent = note.get_window_extent(renderer)
        others = [box for j, box in enumerate(markers) if j != i]
        offset, box = _free_place(places[i], extent.width, extent.height, frame, markers[i], others, thin, taken, scale)
        note.set_position((offset[0] / scale, offset[1] / scale))
        taken.append(box)
        gap = np.hypot(*np.maximum(np.abs(offset) - 0.5 * np.array([box.width, box.height]), 0.0)) / scale
        if gap > _LEADER_FROM:
            end = np.clip(places[i], [box.x0, box.y0], [box.x1, box.y1])
            axes.annotate(
                "",
                xy=points[i],
                xytext=tuple((end - places[i]) / scale),
                textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": colors[i], "lw": 0.6, "alpha": 0.7, "shrinkA": 0, "shrinkB": 4},
                annotation_clip=False,
            )
        made[int(i)] = note
    return [made[i] for i in range(len(texts))]


def _free_place(
    place: np.ndarray,
    width: float,
    height: float,
    frame: Bbox,
    own: Bbox,
    markers: list[Bbox],
    strokes: list[Bbox],
    taken: list[Bbox],
    scale: float,
) -> tuple[np.ndarray, Bbox]:
    """Offset from the point, in pixels, of the centre of the first free place outwards, and the place."""
    best: tuple[float, np.ndarray, Bbox] | None = None
    radius = 4.0 * scale
    while radius < 2.0 * np.hypot(frame.width, frame.height):
        for rank, (dx, dy) in enumerate(_DIRECTIONS):
            reach = np.array([0.5 * width + radius, 0.5 * height + radius])
            offset = np.array([dx, dy]) * reach
            centre = place + offset
            box = Bbox.from_bounds(centre[0] - 0.5 * width, centre[1] - 0.5 * height, width, height)
            if _count(box, taken):  # never, whatever the cost
                continue
            outside = max(frame.x0 - box.x0, box.x1 - frame.x1, frame.y0 - box.y0, box.y1 - frame.y1, 0.0)
            crossed = _count(box, markers) + bool(Bbox.intersection(box, own))
            cost = radius + rank * 0.2 + 30.0 * scale * crossed + 50.0 * scale * (outside > 0.0) + outside
            cost += 9.0 * scale * _count(box, strokes)
            if best is None or cost < best[0]:
                best = (cost, offset, box)
        if best is not None and best[0] <= radius:
            break
        radius += 4.0 * scale
    assert best is not None
    return best[1], best[2]


def _count(box: Bbox, others: list[Bbox]) -> int:
    return int(box.count_overlaps(others)) if others else 0
