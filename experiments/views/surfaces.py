"""Pictures of surfaces, in the eye's view and from anywhere else: texels, splits, sampling rate, difference, waste."""

from __future__ import annotations

import numpy as np

from experiments.results.images import ERROR_SCALE, NO_RECEIVER, error_colors, error_view, shaded_view
from experiments.views.bodies import edges
from experiments.views.lines import draw_lines
from experiments.views.sheet import Bar, Chips, Panel, Sheet
from experiments.views.subject import Shot, Subject
from experiments.views.texels import (
    MAJOR,
    STOPS,
    grid_lines,
    grid_step,
    jacobians,
    map_positions,
    rate_colors,
    sampling_rate,
)

SPLIT_COLORS = ((0.92, 0.16, 0.13), (0.96, 0.84, 0.10), (0.16, 0.74, 0.24), (0.18, 0.38, 0.96))
"""Red, yellow, green, blue, and again (Stingl 2011, equation 5.1)."""
READ, UNREAD, WASTED = (0.16, 0.74, 0.24), (0.62, 0.66, 0.72), (0.90, 0.22, 0.16)
FRUSTUM = (0.05, 0.06, 0.10)
_FAINT = 0.35  # strength of a colour on surfaces that the eye cannot see


def split_color(index: int) -> tuple[float, float, float]:
    """Colour of split or layer ``index``."""
    return SPLIT_COLORS[index % len(SPLIT_COLORS)]


def base(shot: Shot) -> np.ndarray:
    """The shaded picture in display colours, float (H, W, 3)."""
    out: np.ndarray = shaded_view(shot.color) / 255.0
    return out


def tinted(image: np.ndarray, color: np.ndarray, strength: np.ndarray | float) -> np.ndarray:
    """Lays colours over a picture so that its shading stays: dark pixels stay darker."""
    tone = image.mean(axis=-1, keepdims=True)
    weight = np.broadcast_to(np.asarray(strength, float), image.shape[:2])[..., None]
    out: np.ndarray = image * (1.0 - weight) + color * (0.45 + 0.55 * tone) * weight
    return out


def draw_frustum(image: np.ndarray, subject: Subject, shot: Shot) -> None:
    """The eye's frustum, split by split, over a third-person picture."""
    for body in subject.frusta:
        draw_lines(image, shot.view, edges(body), FRUSTUM, depth=shot.depth, width=1.2, hidden=0.45)


def layer_chips(subject: Subject) -> Chips:
    """The layers' colours, with the depths of splits."""
    unit = "depth " if subject.is_split else ""
    items = []
    for i, (near, far) in enumerate(subject.ranges):
        text = f"{unit}{near:.4g} to {far:.4g}" if subject.is_split else "the only map" if i == 0 else ""
        name = f"{i}: {text}" if len(subject.views) == 1 or subject.is_split else f"layer {i}"
        items.append((split_color(i), name))
    return Chips(items)


def texel_borders(subject: Subject, place: str) -> Sheet:
    """The map's grid on what reads it; every ``MAJOR``-th line is bold and is seen farther."""
    shot = subject.shot(place)
    image = base(shot)
    jacobian = jacobians(subject, shot, shot.view, shot.layer >= 0)
    step = subject.options.texels or grid_step(jacobian)
    position = map_positions(subject, shot)
    fine = grid_lines(position, jacobian, step, 1.0) * 0.75
    coarse = grid_lines(position, jacobian, MAJOR * step, 2.0)
    ink = np.maximum(fine, coarse)[..., None]
    for i in range(len(subject.views)):
        mine = shot.layer == i
        image[mine] = tinted(image[None, mine], np.array(split_color(i)), 0.22)[0]
    image = image * (1.0 - ink)
    if place == "third":
        draw_frustum(image, subject, shot)
    cell = "texel" if step == 1 else f"{step} x {step} texels"
    rate = sampling_rate(jacobian, "det")
    notes = [
        f"Fine cells: 1 {cell}; bold cells: {MAJOR * step} x {MAJOR * step}."
        if step == 1
        else f"Fine cells: {cell}; bold cells: {MAJOR * step} x {MAJOR * step}.",
        f"Grids finer than 4 pixels fade. Median texel size here: {_number(1.0 / np.nanmedian(rate))} pixels."
        if np.isfinite(rate).any()
        else "Nothing here reads the map.",
    ]
    return Sheet([Panel(image)], [layer_chips(subject)], [" ".join(notes)])


def split_colours(subject: Subject, place: str) -> Sheet:
    """Which layer is read where."""
    shot = subject.shot(place)
    image = base(shot)
    for i in range(len(subject.views)):
        image = tinted(image, np.array(split_color(i)), np.where(shot.layer == i, 0.72, 0.0))
    if place == "third":
        draw_frustum(image, subject, shot)
    held = shot.layer >= 0
    shares = [f"{i}: {100.0 * float((shot.layer[held] == i).mean()):.1f} %" for i in range(len(subject.views))]
    note = f"Share of the receivers in the picture: {', '.join(shares)}." if held.any() else "No receiver reads a map."
    return Sheet(
        [Panel(image)], [layer_chips(subject)], [note, "Not coloured: what no map covers, or does not receive."]
    )


def sampling_frequency(subject: Subject, place: str, mode: str) -> Sheet:
    """The eye's sampling rate; from elsewhere still the eye's, because it belongs to the point of the surface."""
    shot = subject.shot(place)
    image = base(shot)
    read = (shot.layer >= 0) & ~subject.is_back_lit(shot)
    seen = read
    if place == "third":
        inside, seen = subject.in_eye_view(shot.position)
        read, seen = read & inside, seen & read & inside
    rate = sampling_rate(jacobians(subject, shot, subject.eye, read), mode)
    read &= np.isfinite(rate)
    image = tinted(image, rate_colors(rate), np.where(read & seen, 0.85, np.where(read, _FAINT, 0.0)))
    if place == "third":
        draw_frustum(image, subject, shot)
    values = rate[read & seen]
    whose = "Seen by the eye" if place == "eye" else "Pixels of this picture that the eye sees too"
    notes = ["Not coloured: nothing reads the map there (no receiver, or it is turned away from the light)."]
    if len(values):
        low, middle, high = np.percentile(values, [5, 50, 95])
        under = 100.0 * float((values < 0.5).mean())
        notes.insert(
            0,
            f"{whose}: median {_number(middle)}, 5 to 95 % of the pixels {_number(low)} to {_number(high)}; "
            f"{under:.0f} % have less than half a texel per pixel.",
        )
    if place == "third":
        notes.append("Faint: in the frustum, but hidden from the eye.")
    name = {"det": "root of the texels in a pixel's area", "x": "map's x direction", "y": "map's y direction"}[mode]
    return Sheet([Panel(image)], [rate_bar(f"shadow-map texels per pixel of the eye ({name})")], notes)


def rate_bar(label: str) -> Bar:
    """The colour scale of sampling rates; stops are evenly spaced on it."""
    places = np.linspace(0.0, 1.0, len(STOPS))
    texts = ("0", "1/7.75", "1/3.25", "1", "3.25", "7.75", "10 and more")
    ticks = list(zip(places.tolist(), texts, strict=True))
    return Bar(label, lambda place: rate_colors(np.interp(place, places, STOPS)), ticks)


def difference(subject: Subject, place: str) -> Sheet:
    """Where the technique is wrong."""
    shot = subject.shot(place)
    truth = subject.truth(place)
    error = shot.visibility - truth
    image = error_view(shot.visibility, truth) / 255.0
    # the shading keeps surfaces apart: without it an error has no place in space
    image = np.where(np.isfinite(error)[..., None], image, base(shot) * 0.35 + np.array(NO_RECEIVER) / 255.0 * 0.65)
    known = np.isfinite(error)
    where = "of this picture"
    if place == "third":
        shape = base(shot)
        image = np.where(known[..., None], np.clip(image + 0.28 * shape.mean(axis=-1, keepdims=True), 0.0, 1.0), image)
        inside, _ = subject.in_eye_view(shot.position)
        # elsewhere nobody asked for a shadow: the error is shown, but faintly
        image = np.where((known & ~inside)[..., None], 0.3 * image + 0.5 * shape, image)
        known &= inside
        where = "in the eye's frustum"
        draw_frustum(image, subject, shot)
    values = error[known].astype(float)
    notes = [f"Against {subject.truth_in_words}. Slate: no receiver."]
    if place == "third":
        notes[0] += " Faint and grey: outside the frustum, where no map has to hold anything."
    if len(values):
        wrong = 100.0 * float((np.abs(values) > 0.5).mean())
        rmse, mean = float(np.sqrt(np.mean(values**2))), float(values.mean())
        notes.append(
            f"Receivers {where}: RMSE {_number(rmse)}, mean {_number(mean)}, {wrong:.2f} % wrong by over a half."
        )
    ticks = [-1.0, -0.5, -0.1, 0.0, 0.1, 0.5, 1.0]
    places = [(0.5 + 0.5 * np.sign(tick) * np.sqrt(abs(tick)), f"{tick:+g}" if tick else "0") for tick in ticks]

    def colors(place: np.ndarray) -> np.ndarray:
        signed = 2.0 * place - 1.0
        out: np.ndarray = error_colors(np.sign(signed) * signed**2) / 255.0
        return out

    label = f"visibility minus truth; {ERROR_SCALE}"
    return Sheet([Panel(image)], [Bar(label, colors, places)], notes)


def wasted_surfaces(subject: Subject) -> Sheet:
    """What the maps cover, as seen from outside: for the eye, or for nobody."""
    shot = subject.shot("third")
    image = base(shot)
    held = shot.layer >= 0
    inside, seen = subject.in_eye_view(shot.position)
    for mask, color in ((held & seen, READ), (held & inside & ~seen, UNREAD), (held & ~inside, WASTED)):
        image = tinted(image, np.array(color), np.where(mask, 0.7, 0.0))
    draw_frustum(image, subject, shot)
    legend = Chips(
        [(READ, "seen by the eye"), (UNREAD, "in the frustum, hidden"), (WASTED, "in a map, outside the frustum")]
    )
    return Sheet([Panel(image)], [legend], ["Not coloured: in no map, or does not receive."])


def _number(value: float) -> str:
    return f"{value:.3g}"
