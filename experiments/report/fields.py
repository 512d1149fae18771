"""Visibility and standard error of stored images inside a page, so exactly that a reader can probe single pixels.

A field is its pixels as little-endian uint16 in rows from the top, deflated (zlib), in base64: value = number / 65534,
and 65535 where no receiver is seen. The page unpacks it with what every browser has (DecompressionStream), so that
no canvas read-back, which some browsers blur on purpose, stands between the stored image and what is read off.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.results.images import error_colors, read_exr
from experiments.results.store import RawKind, Store

LEVELS = 65534
NO_VALUE = 65535
MAX_FRAMES = 6
MAX_CHARACTERS = 16_000_000  # of all fields of a page; browsers open some hundred, mail takes some ten
_KINDS: tuple[RawKind, ...] = ("visibility", "standard_error")
REFERENCE = ""  # the reference's key; no label is empty


@dataclass(frozen=True)
class FieldFrame:
    """One frame's fields.

    Attributes:
        frame: Frame number.
        width, height: Pixels.
        step: Every how many-th pixel of the stored images is there, across and down.
        fields: Encoded fields by label (``REFERENCE`` for the reference) and kind.
    """

    frame: int
    width: int
    height: int
    step: int
    fields: dict[str, dict[str, str]]

    @property
    def characters(self) -> int:
        """Size in a page."""
        return sum(len(text) for kinds in self.fields.values() for text in kinds.values())


def encode(image: np.ndarray) -> str:
    """A field of values in [0, 1], clipped to it, NaN where there is none; float (H, W)."""
    known = np.isfinite(image)
    numbers = np.rint(LEVELS * np.clip(np.where(known, image, 0.0).astype(np.float64), 0.0, 1.0))
    numbers[~known] = NO_VALUE
    return base64.b64encode(zlib.compress(numbers.astype("<u2").tobytes(), 6)).decode("ascii")


def decode(text: str, width: int) -> np.ndarray:
    """The field that ``encode`` made, float64 (H, ``width``)."""
    numbers = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype="<u2").reshape(-1, width)
    return np.where(numbers == NO_VALUE, np.nan, numbers / LEVELS)


def evenly(wanted: Sequence[int], most: int) -> list[int]:
    """Up to ``most`` of the numbers, ascending, evenly spread, first and last among them."""
    wanted = sorted(wanted)
    count = min(most, len(wanted))
    return [wanted[i] for i in np.unique(np.linspace(0, len(wanted) - 1, count).round().astype(int))] if count else []


def field_frames(
    store: Store, labels: Sequence[str], wanted: Sequence[int], most_characters: int = MAX_CHARACTERS
) -> list[FieldFrame]:
    """Fields of up to ``MAX_FRAMES`` of the frames ``wanted``; fewer where they would make the page too large.

    A frame that is too large alone is given with every second, third, ... pixel.

    Args:
        store: The result folder.
        labels: Labels to take.
        wanted: Frames of which there are raw images.
        most_characters: Size that all together may have in the page.
    """
    for step in range(1, 17):
        out = [_field_frame(store, labels, frame, step) for frame in evenly(wanted, 1)]
        size = sum(made.characters for made in out)
        if size <= most_characters:
            break
    else:
        return []
    # Later frames are about as large as the first; a page a little over its size is no harm.
    frames = evenly(wanted, min(MAX_FRAMES, most_characters // size)) if size else []
    out += [_field_frame(store, labels, frame, step) for frame in frames[1:]]
    return [made for made in out if made.fields]


def _field_frame(store: Store, labels: Sequence[str], frame: int, step: int) -> FieldFrame:
    width = height = 0
    fields: dict[str, dict[str, str]] = {}
    for label in (None, *labels):
        found: dict[str, str] = {}
        for kind in _KINDS:
            path: Path = store.raw(label, kind, frame)
            if path.is_file():
                image = read_exr(path)[::step, ::step]
                height, width = image.shape
                found[kind] = encode(image)
        if "visibility" in found:
            fields[label or REFERENCE] = found
    return FieldFrame(frame, width, height, step, fields)


def error_palette(steps: int = 256) -> str:
    """Colours of signed errors as hexadecimal digits: 2 ``steps`` + 1 of them, at sign x sqrt|error| from -1 to 1."""
    place = np.arange(-steps, steps + 1) / steps
    return error_colors(np.sign(place) * place * place).astype(np.uint8).tobytes().hex()
