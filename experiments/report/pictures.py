"""Pictures of a result folder as data URLs, so that a page needs no other file."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.report.fields import evenly
from experiments.results.images import error_colors, read_png, write_jpeg
from experiments.results.store import Store, ViewKind

MAX_FRAMES = 3  # a page of eight techniques then stays within a few megabytes
MAX_WIDTH = 960  # pixels; larger pictures are shown by every second, third, ... pixel
LEAST_WIDTH = 200
MAX_CHARACTERS = 16_000_000  # of the contact sheet in a page
_KINDS: tuple[ViewKind, ...] = ("shaded", "visibility", "error")


@dataclass(frozen=True)
class PictureRow:
    """One label's pictures of one frame, as data URLs; None where there is none."""

    label: str
    shaded: str | None
    visibility: str | None
    error: str | None


@dataclass(frozen=True)
class PictureFrame:
    """One frame of the walkthrough: the reference first, then every label."""

    frame: int
    rows: list[PictureRow]

    @property
    def characters(self) -> int:
        """Size in a page."""
        urls = [url for row in self.rows for url in (row.shaded, row.visibility, row.error)]
        return sum(len(url) for url in urls if url)


def picture_frames(
    store: Store, labels: Sequence[str], wanted: Sequence[int], most_characters: int = MAX_CHARACTERS
) -> list[PictureFrame]:
    """Up to ``MAX_FRAMES`` of the frames ``wanted``, evenly spread, with whatever pictures the folder has of them.

    Fewer frames where they would make the page too large; where one alone does, with fewer columns.

    Args:
        store: The result folder.
        labels: Labels in order.
        wanted: Frames to choose from.
        most_characters: Size that all together may have in the page.
    """
    with tempfile.TemporaryDirectory(prefix="wkernels-report-") as folder:
        scratch = Path(folder) / "picture.jpg"
        width, out = MAX_WIDTH, [_frame(store, labels, frame, scratch, MAX_WIDTH) for frame in evenly(wanted, 1)]
        while out and out[0].characters > most_characters and width > LEAST_WIDTH:
            width //= 2
            out = [_frame(store, labels, out[0].frame, scratch, width)]
        # Later frames are about as large as the first; a page a little over its size is no harm.
        fit = max(1, most_characters // max(1, out[0].characters)) if out else 0
        return out + [_frame(store, labels, f, scratch, width) for f in evenly(wanted, min(MAX_FRAMES, fit))[1:]]


def _frame(store: Store, labels: Sequence[str], frame: int, scratch: Path, max_width: int) -> PictureFrame:
    rows = []
    for label in (None, *labels):
        urls = {kind: _data_url(store.view(label, kind, frame), scratch, max_width) for kind in _KINDS}
        if any(urls.values()):
            rows.append(PictureRow(label or "reference", urls["shaded"], urls["visibility"], urls["error"]))
    return PictureFrame(frame, rows)


@dataclass(frozen=True)
class ViewFigure:
    """One of the pictures that the key ``views`` asks for, as a data URL, with what it shows."""

    title: str
    caption: str
    url: str


@dataclass(frozen=True)
class ViewGroup:
    """One label's pictures of one frame; ``more`` are the frames whose pictures are only in the folder."""

    label: str
    frame: int
    figures: list[ViewFigure]
    more: list[int]


def view_groups(store: Store, labels: Sequence[str]) -> list[ViewGroup]:
    """Each label's pictures of the first frame that has any, in the order of ``KINDS``."""
    from experiments.schema.view_kinds import KINDS, kind_of

    out = []
    order = list(KINDS)
    with tempfile.TemporaryDirectory(prefix="wkernels-report-") as folder:
        scratch = Path(folder) / "picture.jpg"
        for label in labels:
            found = [(kind_of(name), name, frame) for name, frame in store.pictures(label)]
            known = [(order.index(kind), kind, name, frame) for kind, name, frame in found if kind]
            frames = sorted({frame for *_, frame in known})
            figures = []
            for _, kind, name, frame in sorted(known):
                url = _data_url(store.picture(label, name, frame), scratch, 1400) if frame == frames[0] else None
                if url:
                    figures.append(ViewFigure(name.replace("_", " "), KINDS[kind].caption, url))
            if figures:
                out.append(ViewGroup(label, frames[0], figures, frames[1:]))
    return out


def error_scale_css() -> tuple[str, list[tuple[float, str]]]:
    """The error scale as a CSS gradient, and its ticks as (position in percent, text)."""
    stops = []
    for place in np.linspace(-1.0, 1.0, 33):
        red, green, blue = error_colors(np.sign(place) * place * place)
        stops.append(f"rgb({red} {green} {blue}) {50.0 + 50.0 * place:.3g}%")
    ticks = [-1.0, -0.5, -0.25, -0.1, -0.02, 0.0, 0.02, 0.1, 0.25, 0.5, 1.0]
    places = [
        (50.0 + 50.0 * float(np.sign(tick) * np.sqrt(abs(tick))), f"{tick:+g}" if tick else "0") for tick in ticks
    ]
    return f"linear-gradient(to right, {', '.join(stops)})", places


def jpeg_url(path: Path, max_width: int = MAX_WIDTH) -> str | None:
    """A stored picture as the data URL of a JPEG of at most that many columns; None where there is none."""
    with tempfile.TemporaryDirectory(prefix="wkernels-report-") as folder:
        return _data_url(path, Path(folder) / "picture.jpg", max_width)


def _data_url(path: Path, scratch: Path, max_width: int = MAX_WIDTH) -> str | None:
    if not path.is_file():
        return None
    rgb = read_png(path)
    step = -(-rgb.shape[1] // max_width)
    write_jpeg(scratch, rgb[::step, ::step])
    return "data:image/jpeg;base64," + base64.b64encode(scratch.read_bytes()).decode("ascii")
