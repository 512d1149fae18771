"""What all readers of mesh files share: how they refuse, how they tell, and lines of text with their numbers."""

from __future__ import annotations

import codecs
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from experiments.scenes.primitives import Triangles

Tell = Callable[[str], None]
"""Takes one sentence about what was left out, turned or taken otherwise than the file says."""

Reader = Callable[[Path, Tell], Triangles]
"""Vertices float64 (V, 3) and faces (F, 3) of a file; raises MeshError."""


class MeshError(Exception):
    """A mesh file is wrong: a sentence about what, and the 1-based line where the format has lines."""

    def __init__(self, message: str, line: int | None = None) -> None:
        self.line = line
        super().__init__(message if line is None else f"line {line}: {message}")


class Parts:
    """Collects the pieces of a mesh in one list of vertices."""

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        self._count = 0

    def add(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Appends vertices (V, 3) and faces (F, 3) that count from 0."""
        self._vertices.append(np.asarray(vertices, np.float64).reshape(-1, 3))
        self._faces.append(np.asarray(faces, np.int64).reshape(-1, 3) + self._count)
        self._count += len(self._vertices[-1])

    def add_placed(self, vertices: np.ndarray, faces: np.ndarray, object_to_file: np.ndarray) -> None:
        """The same under a matrix (4, 4); one that mirrors turns the faces, so that outside stays outside."""
        linear = object_to_file[:3, :3]
        self.add(vertices @ linear.T + object_to_file[:3, 3], faces[:, ::-1] if np.linalg.det(linear) < 0.0 else faces)

    def triangles(self) -> Triangles:
        """Vertices float64 (V, 3) and faces int64 (F, 3)."""
        if not self._vertices:
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        return np.concatenate(self._vertices), np.concatenate(self._faces)


def plain_bytes(data: bytes) -> bytes:
    """Text as ASCII-compatible bytes: a byte order mark removed, UTF-16 as UTF-8, any other encoding as it is."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def word_lines(data: bytes, *, comment: bytes = b"#", continued: bool = False) -> Iterator[tuple[int, list[bytes]]]:
    """The words of every line that has any, with its 1-based number; ``comment`` hides the rest of a line.

    Bytes, because comments and names may be in any encoding and numbers are ASCII. With ``continued`` a backslash at
    the end of a line joins the next one to it.
    """
    held: list[bytes] = []
    begin = 0
    for number, line in enumerate(plain_bytes(data).splitlines(), start=1):
        words = line.partition(comment)[0].split()
        begin = begin or number
        if continued and words and words[-1].endswith(b"\\"):
            words[-1] = words[-1][:-1]
            held += [word for word in words if word]
            continue
        held += words
        if held:
            yield begin, held
        held, begin = [], 0
    if held:
        yield begin, held


def number_of(word: bytes, line: int | None) -> float:
    """A word as a number; raises MeshError."""
    try:
        return float(word)
    except ValueError:
        raise MeshError(f"{shown(word)} is not a number.", line) from None


def integer_of(word: bytes, line: int | None) -> int:
    """A word as a whole number; raises MeshError."""
    try:
        value = int(word)
    except ValueError:
        raise MeshError(f"{shown(word)} is not a whole number.", line) from None
    if abs(value) >= 1 << 62:
        raise MeshError(f"{shown(word)} is too large a number.", line)
    return value


def position_of(words: list[bytes], line: int) -> tuple[float, float, float]:
    """The first three words as a position; raises MeshError."""
    if len(words) < 3:
        raise MeshError("a vertex needs three coordinates.", line)
    try:
        return float(words[0]), float(words[1]), float(words[2])
    except ValueError:
        raise MeshError(f"{shown(b' '.join(words[:3]))} is no vertex of three numbers.", line) from None


def check_indices(
    indices: np.ndarray, vertices: int, lines: np.ndarray | None = None, what: str = "a face", base: int = 0
) -> None:
    """Raises MeshError where a vertex index lies outside 0 ... vertices - 1.

    Args:
        indices: Counted from 0.
        vertices: How many there are.
        lines: The line of every index, where the format has lines.
        what: What uses them.
        base: What the format counts from.
    """
    bad = np.flatnonzero((indices < 0) | (indices >= vertices))
    if len(bad):
        line = None if lines is None else int(lines[bad[0]])
        raise MeshError(
            f"{what} uses vertex {indices[bad[0]] + base}, but they run from {base} to {vertices - 1 + base}.", line
        )


def shown(word: bytes) -> str:
    """A word from a file, short and printable, in quotes."""
    return repr(word[:40].decode("latin-1"))
