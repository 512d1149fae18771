"""The perspective aliasing error along the view vector, from the maps in use (Stingl 2011, section 5.8)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.report.style import INK, log_axis, styled
from experiments.views.sheet import Panel, Sheet
from experiments.views.subject import Subject
from wkernels.analysis.perspective_error import TiltedFrustum
from wkernels.projections.light_views import perspective_aliasing
from wkernels.projections.splits import pseudo_planes

ORANGE, BLUE = "#e8710a", "#1a5fd0"  # m_x and m_z, as in figure 5.8
STEPS = 400  # depths per split
_SIDE = 1e-6  # how far before and behind a border its two sides are
_IN_PLANE = np.sin(np.radians(3.0))  # how far the light may leave the plane of view and up vector
_SIZE = (9.0, 5.2)  # inches
_AXES = (0.085, 0.235, 0.895, 0.72)  # left, bottom, width, height


@dataclass(frozen=True, eq=False)
class Curves:
    """The errors of the maps in use.

    Attributes:
        z: Eye depths, ascending; every split border comes twice, a hair before and behind it.
        m_x, m_z: At these depths; NaN where no map covers the view vector.
        borders: Near plane, split borders, far plane.
    """

    z: np.ndarray
    m_x: np.ndarray
    m_z: np.ndarray
    borders: np.ndarray


def curves(subject: Subject) -> Curves:
    """Evaluates the maps in use along the view vector."""
    ranges = subject.ranges if subject.is_split else [subject.depths]
    parts = []
    for near, far in ranges:
        begin, end = near * (1.0 + _SIDE), far * (1.0 - _SIDE)
        parts.append(
            perspective_aliasing(subject.views, subject.light_ws, replace(subject.eye, near=begin, far=end), STEPS)
        )
    z, m_x, m_z = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return Curves(z, m_x, m_z, np.array([ranges[0][0], *(far for _, far in ranges)]))


def closed_form(subject: Subject, borders: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | str:
    """Depths, m_x and m_z of the closed form, or why it does not hold here.

    It is the error of a map fitted to the whole frustum between two borders, under directional light in the plane of
    view and up vector (``wkernels.analysis.perspective_error.TiltedFrustum``). The scene's box, which cuts the
    frustum, is not in it.
    """
    towards = subject.to_light(np.zeros(3))
    if not subject.eye.perspective:
        return "the eye's view is orthographic"
    if subject.light_ws[3] != 0.0:
        return "the light is a point"
    if not subject.follows_eye:
        return "the maps do not follow the eye"
    if subject.settings.stabilise != "none":
        return "a stabilised map covers more than the frustum"
    if len(subject.views) != len(borders) - 1:
        return "the maps are not one per split"
    if abs(float(towards @ subject.eye.right_ws)) > _IN_PLANE:
        return "the light is not in the plane of view and up vector"
    gamma = float(np.arccos(np.clip(towards @ subject.eye.forward_ws, -1.0, 1.0)))
    if not np.radians(1.0) < gamma < np.radians(179.0):
        return "light and view direction are parallel"
    eye, half_fov = subject.eye, float(np.arctan(subject.eye.window[3]))
    found = []
    for view, (near, far) in zip(subject.views, itertools.pairwise(borders), strict=True):
        strength = float(view.ws_to_ss[3, :3] @ view.up_ws)  # 1 / n' of a directional light's warp
        distance = 1.0 / strength if strength > 1e-12 else np.inf
        z = np.geomspace(near, far, STEPS)
        m_x, m_z = TiltedFrustum(near, far, half_fov, gamma).errors(z, distance)
        found.append((z, eye.width / view.width * m_x, eye.height / view.height * m_z))
    return tuple(np.concatenate([part[k] for part in found]) for k in range(3))  # type: ignore[return-value]


def perspective_error(subject: Subject) -> Sheet:
    """m_x orange and m_z blue over eye depth, with the values on both sides of each border."""
    found = curves(subject)
    known = np.isfinite(found.m_x) & np.isfinite(found.m_z)
    if not known.any():
        return Sheet([Panel(np.ones((60, 400, 3)))], [], ["No map covers the view vector."])
    closed = closed_form(subject, found.borders)
    with styled():
        figure = Figure(figsize=_SIZE, dpi=100, facecolor="white")
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes(_AXES)
        _draw(axes, subject, found, None if isinstance(closed, str) else closed)
        canvas.draw()
        image = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(float) / 255.0
    notes = [
        f"{name}: least {np.nanmin(m):.4g} at depth {found.z[np.nanargmin(m)]:.4g}, "
        f"greatest {np.nanmax(m):.4g} at {found.z[np.nanargmax(m)]:.4g}."
        for name, m in (("m_x", found.m_x), ("m_z", found.m_z))
    ]
    notes = [" ".join(notes)]
    if not known.all():
        notes[0] += " No curve: the view vector leaves what the maps cover."
    if isinstance(closed, str):
        notes.append(f"No closed form: {closed}.")
    else:
        notes.append("Thin dashes: closed form of the whole frustum, which the scene's box does not cut.")
    return Sheet([Panel(image)], [], notes)


def _draw(
    axes: Axes, subject: Subject, found: Curves, closed: tuple[np.ndarray, np.ndarray, np.ndarray] | None
) -> None:
    breaks = np.arange(STEPS, len(found.z), STEPS)
    marks: list[tuple[float, list[float], list[float]]] = []
    for name, m, color, width in (
        ("m_x, across the view", found.m_x, ORANGE, 3.4),  # seen beside m_z where both are equal
        ("m_z, along the view", found.m_z, BLUE, 1.7),
    ):
        axes.plot(np.insert(found.z, breaks, np.nan), np.insert(m, breaks, np.nan), color=color, lw=width, label=name)
        ends = np.sort(np.r_[0, breaks - 1, breaks, len(m) - 1])
        axes.plot(found.z[ends], m[ends], "o", color=color, ms=2.5 + width)
    if closed is not None:
        for m, color in ((closed[1], ORANGE), (closed[2], BLUE)):
            split = np.arange(STEPS, len(closed[0]), STEPS)
            z, values = np.insert(closed[0], split, np.nan), np.insert(m, split, np.nan)
            told = "closed form" if color == ORANGE else None
            axes.plot(z, values, color=color, lw=1.0, ls=(0, (4, 3)), label=told)
    axes.axhline(1.0, color=INK, lw=0.8, alpha=0.6)
    for i, border in enumerate(found.borders):
        sides = [k for k in (i * STEPS - 1, i * STEPS) if 0 <= k < len(found.z)]
        marks.append((float(border), [found.m_x[k] for k in sides], [found.m_z[k] for k in sides]))
        axes.axvline(border, color=INK, lw=0.8, alpha=0.35)
    _set_scales(axes, found, closed)
    _write_borders(axes, marks)
    near, far = float(found.borders[0]), float(found.borders[-1])
    shares = [subject.settings.pseudo_near, subject.settings.pseudo_far]
    where = axes.get_xaxis_transform()
    for share, plane, tag in zip(shares, pseudo_planes(near, far, *shares), ("PN", "PF"), strict=True):
        if share > 0.0:
            axes.axvline(plane, color=INK, lw=1.0, ls=":")
            axes.text(plane, 1.01, f"{tag} {plane:.4g}", transform=where, ha="center", va="bottom", fontsize=8)
    axes.set_ylabel("pixels that a texel spans; above 1 the map is too coarse")
    axes.legend(loc="upper right", fontsize=8.5, frameon=True, framealpha=0.9, edgecolor="none")


def _set_scales(axes: Axes, found: Curves, closed: tuple[np.ndarray, np.ndarray, np.ndarray] | None) -> None:
    """Depth linear or logarithmic, whichever keeps the borders farther apart; errors logarithmic."""
    near, far = float(found.borders[0]), float(found.borders[-1])
    even, log = (found.borders - near) / (far - near), np.log(found.borders / near) / np.log(far / near)
    if len(found.borders) == 2:
        logarithmic = far > 50.0 * near
    else:
        logarithmic = float(np.diff(log).min()) > float(np.diff(even).min())
    if logarithmic:
        axes.set_xscale("log")
        axes.set_xlim(near * (far / near) ** -0.02, far * (far / near) ** 0.02)
    else:
        axes.set_xlim(near - 0.02 * (far - near), far + 0.02 * (far - near))
    values = np.concatenate([found.m_x, found.m_z, [1.0], *(closed or ())[1:]])
    values = values[np.isfinite(values) & (values > 0.0)]
    log_axis(axes, "y", [values])


def _write_borders(axes: Axes, marks: list[tuple[float, list[float], list[float]]]) -> None:
    """Below each border its depth, and the errors before and behind it."""
    axes.set_xticks([border for border, _, _ in marks], labels=[""] * len(marks))
    axes.set_xticks([], minor=True)
    where = axes.get_xaxis_transform()
    end = [-np.inf, -np.inf]  # the places of the last texts of the two rows that texts take turns in
    for i, (border, m_x, m_z) in enumerate(marks):
        name = "n" if i == 0 else "f" if i == len(marks) - 1 else f"{i}"
        place = float(axes.transAxes.inverted().transform(axes.transData.transform((border, 1.0)))[0])
        room = 0.105
        if place - end[0] < room and place - end[1] < room:
            continue
        row = 0 if place - end[0] >= room else 1
        end[row] = place
        align = "left" if place < 0.03 else "right" if place > 0.97 else "center"
        lines = [(f"{name} = {border:.4g}", INK), (_sides(m_x), ORANGE), (_sides(m_z), BLUE)]
        for k, (text, color) in enumerate(lines):
            y = -0.02 - 0.046 * k - 0.155 * row
            axes.text(border, y, text, transform=where, ha=align, va="top", fontsize=7.5, color=color)
    if np.isinf(end[1]):  # one row is enough
        left, bottom, width, height = _AXES
        axes.set_position((left, bottom - 0.11, width, height + 0.11))


def _sides(values: list[float]) -> str:
    return " | ".join("-" if not np.isfinite(value) else f"{value:.3g}" for value in values)
