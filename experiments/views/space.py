"""Pictures from the free camera: frusta, intersection bodies, and the eye in its place."""

from __future__ import annotations

import numpy as np

from experiments.views.bodies import box_of, edges, fill, frustum_between
from experiments.views.lines import draw_lines, project, to_pixels
from experiments.views.sheet import Chips, Panel, Sheet
from experiments.views.subject import Shot, Subject
from experiments.views.surfaces import FRUSTUM, base, layer_chips, split_color

LIGHT, VIEW_VECTOR, EYE = (0.0, 0.0, 0.0), (0.12, 0.30, 0.95), (0.95, 0.35, 0.05)
FRUSTUM_BODY = (0.92, 0.16, 0.13)
INSET = 0.34  # width of the minimap's inset, share of the picture


def frusta(subject: Subject) -> Sheet:
    """The view frustum as glass, its splits as wires, and the way to the light (Stingl 2011, figure 5.1)."""
    shot = subject.shot("third")
    image = base(shot)
    near, far = subject.depths
    fill(image, shot.view, frustum_between(subject.eye, near, far), FRUSTUM_BODY, shot.depth, 0.16)
    split = len(subject.frusta) > 1
    for i, body in enumerate(subject.frusta):
        color = split_color(i) if split else FRUSTUM_BODY
        draw_lines(image, shot.view, edges(body), color, depth=shot.depth, width=2.0, hidden=0.7)
    _draw_view_vector(image, subject, shot)
    _draw_light(image, subject, shot)
    legend = [Chips([(LIGHT, "way to the light"), (VIEW_VECTOR, "view vector"), (FRUSTUM_BODY, "view frustum")])]
    if split:
        legend.insert(0, layer_chips(subject))
    notes = [f"Depths {near:.4g} to {far:.4g}; the eye's own range is {subject.eye.near:.4g} to {subject.eye.far:.4g}."]
    return Sheet([Panel(image)], legend, [*notes, "Dashed: behind a surface."])


def intersection_bodies(subject: Subject) -> Sheet:
    """B of every split with its axis-aligned box, over the scene (Stingl 2011, figure 5.2)."""
    shot = subject.shot("third")
    image = base(shot)
    bodies = [(i, body) for i, body in enumerate(subject.light_bodies) if not body.is_empty]
    for i, body in reversed(bodies):  # the farthest split first: the near ones lie within its light rays
        fill(image, shot.view, body, split_color(i), shot.depth, 0.20)
    for i, body in bodies:
        pale = tuple(0.45 + 0.4 * value for value in split_color(i))
        box = edges(box_of(body))
        draw_lines(image, shot.view, box, pale, depth=shot.depth, width=1.0, hidden=0.35, halo=False)
    for i, body in bodies:
        dark = tuple(0.72 * value for value in split_color(i))
        draw_lines(image, shot.view, edges(body), dark, depth=shot.depth, width=1.8, hidden=0.55)
    for body in subject.frusta:
        draw_lines(image, shot.view, edges(body), FRUSTUM, depth=shot.depth, width=1.0, hidden=0.4)
    _draw_light(image, subject, shot)
    scene = float(np.prod(np.maximum(subject.scene_box.high - subject.scene_box.low, 1e-30)))
    volumes = [f"{i}: {100.0 * body.volume / scene:.3g} %" for i, body in bodies]
    notes = [f"Volume of B, share of the scene's box: {', '.join(volumes)}." if volumes else "B is empty."]
    notes.append("Bold wires: B; thin pale ones: its axis-aligned box; black: view frustum. Dashed: behind a surface.")
    return Sheet([Panel(image)], [layer_chips(subject)], notes)


def minimap(subject: Subject) -> Sheet:
    """The free camera's picture with what the eye sees in its corner."""
    shot = subject.shot("third")
    image = base(shot)
    near, far = subject.depths
    frustum = frustum_between(subject.eye, near, far)
    draw_lines(image, shot.view, edges(frustum), FRUSTUM, depth=shot.depth, width=1.3, hidden=0.45)
    _draw_view_vector(image, subject, shot)
    _draw_light(image, subject, shot)
    _draw_marker(image, subject, shot)
    inset = _smaller(base(subject.shot("eye")), int(INSET * image.shape[1]), int(0.45 * image.shape[0]))
    rows, columns = inset.shape[:2]
    if rows + 8 <= image.shape[0] and columns + 8 <= image.shape[1]:
        bottom, left = _free_corner(image, subject, shot, rows, columns)
        image[bottom - rows - 3 : bottom + 3, left - 3 : left + columns + 3] = 1.0
        image[bottom - rows - 1 : bottom + 1, left - 1 : left + columns + 1] = 0.0
        image[bottom - rows : bottom, left : left + columns] = inset
    position = subject.eye.eye_ws + subject.geometry.origin_ws
    legend = [Chips([(EYE, "the eye"), (VIEW_VECTOR, "view vector"), (LIGHT, "way to the light")])]
    place = ", ".join(f"{value:.4g}" for value in position)
    return Sheet([Panel(image)], legend, [f"The eye is at ({place}); the inset is what it sees."])


def _free_corner(image: np.ndarray, subject: Subject, shot: Shot, rows: int, columns: int) -> tuple[int, int]:
    """Bottom and left of an inset that does not hide the eye: lower left, or else the next corner."""
    height, width = image.shape[:2]
    h = project(shot.view, subject.eye.eye_ws[None])
    x, y = to_pixels(shot.view, h)[0] if h[0, 3] > 0.0 else (-np.inf, -np.inf)
    corners = [(height - 5, 5), (height - 5, width - 5 - columns), (rows + 5, width - 5 - columns), (rows + 5, 5)]
    room = 0.08 * height
    for bottom, left in corners:
        if not (left - room < x < left + columns + room and bottom - rows - room < y < bottom + room):
            return bottom, left
    return corners[0]


def _draw_view_vector(image: np.ndarray, subject: Subject, shot: Shot) -> None:
    eye = subject.eye
    end = eye.eye_ws + subject.depths[1] * eye.forward_ws
    draw_lines(image, shot.view, np.array([[eye.eye_ws, end]]), VIEW_VECTOR, depth=shot.depth, width=1.8, hidden=0.7)


def _draw_light(image: np.ndarray, subject: Subject, shot: Shot) -> None:
    """From the middle of what the eye sees towards the light, with an arrow head."""
    whole = subject.whole
    start = subject.eye.eye_ws if whole.is_empty else whole.vertices.mean(axis=0)
    way = subject.to_light(start)
    length = 0.45 * float(np.linalg.norm(np.ptp(np.vstack([start[None], whole.vertices]), axis=0))) or 1.0
    if subject.light_ws[3] != 0.0:
        length = float(np.linalg.norm(subject.light_ws[:3] - start))
    end = start + length * way
    across = np.cross(way, shot.view.forward_ws)
    across /= max(float(np.linalg.norm(across)), 1e-12)
    head = 0.07 * length
    wings = [[end, end - head * way + sign * 0.45 * head * across] for sign in (-1.0, 1.0)]
    draw_lines(image, shot.view, np.array([[start, end], *wings]), LIGHT, depth=shot.depth, width=2.0, hidden=0.8)


def _draw_marker(image: np.ndarray, subject: Subject, shot: Shot) -> None:
    """A small pyramid in the eye's place, of the same size on any screen."""
    eye = subject.eye
    away = max(float((eye.eye_ws - shot.view.eye_ws) @ shot.view.forward_ws), 1e-9)
    size = 0.10 * away * (shot.view.window[3] - shot.view.window[2]) / 2.0
    left, right, bottom, top = eye.window
    scale = size / max(right, top)
    # an orthographic eye has no place where its lines of sight meet: a pyramid shows which way it looks
    corners = [
        eye.eye_ws + size * eye.forward_ws + scale * (x * eye.right_ws + y * eye.up_ws)
        for x, y in ((left, bottom), (right, bottom), (right, top), (left, top))
    ]
    rays = [[eye.eye_ws, corner] for corner in corners]
    rim = [[corners[i - 1], corners[i]] for i in range(4)]
    draw_lines(image, shot.view, np.array([*rays, *rim]), EYE, width=2.4)


def _smaller(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """An image shrunk to fit, by means over areas; its own size where it fits already."""
    factor = min(width / image.shape[1], height / image.shape[0], 1.0)
    rows, columns = max(1, int(image.shape[0] * factor)), max(1, int(image.shape[1] * factor))
    out = image
    for axis, count in ((0, rows), (1, columns)):
        # a running sum gives the mean between any two places along an axis
        total = np.concatenate([np.zeros_like(np.take(out, [0], axis)), np.cumsum(out, axis=axis)], axis=axis)
        place = np.linspace(0.0, out.shape[axis], count + 1)
        low = np.minimum(np.floor(place).astype(int), out.shape[axis] - 1)
        share = (place - low).reshape([-1 if i == axis else 1 for i in range(3)])
        at = np.take(total, low, axis) * (1.0 - share) + np.take(total, low + 1, axis) * share
        out = np.diff(at, axis=axis) / (out.shape[axis] / count)
    return out
