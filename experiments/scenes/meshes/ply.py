"""Polygon files (Turk 1994), text and binary of both byte orders, with any mixture of polygons, and triangle strips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from experiments.scenes.meshes.ply_header import Element, Property, read_header
from experiments.scenes.meshes.polygons import triangulate
from experiments.scenes.meshes.reading import MeshError, Tell, check_indices, plain_bytes, shown
from experiments.scenes.meshes.strips import strips_to_triangles
from experiments.scenes.primitives import Triangles

_INDICES = ("vertex_indices", "vertex_index")
_LONGEST = 2**31  # corners of a face


@dataclass(frozen=True, eq=False)
class Lists:
    """A list property of all elements: lengths (N,) and the joined values; the line of each where there are lines."""

    counts: np.ndarray
    values: np.ndarray
    lines: np.ndarray | None


Columns = dict[str, "np.ndarray | Lists"]


class _Body(Protocol):
    def read(self, element: Element) -> Columns: ...


def read(path: Path, tell: Tell) -> Triangles:
    """The elements ``vertex`` (x, y, z), ``face`` and ``tristrips``."""
    data = path.read_bytes()
    header = read_header(data)
    body: _Body
    if header.order:
        body = _Binary(data, header.length)
    else:
        body = _Text(data[header.length :], header.lines)
    columns: dict[str, Columns] = {}
    for element in header.elements:
        columns[element.name] = body.read(element)
    vertices = _positions(columns.get("vertex"))
    parts = []
    for name in ("face", "tristrips"):
        lists = next((columns[name][key] for key in _INDICES if key in columns.get(name, {})), None)
        if not isinstance(lists, Lists):
            if columns.get(name):
                raise MeshError(f"its element {name} has no list {' or '.join(_INDICES)}.")
            continue
        with np.errstate(invalid="ignore"):
            indices = lists.values.astype(np.int64)
        if not np.array_equal(indices, lists.values):
            raise MeshError("a face uses a vertex whose number is not whole.")
        lines = None if lists.lines is None else np.repeat(lists.lines, lists.counts)
        if name == "tristrips":  # -1 begins a new strip
            check_indices(np.maximum(indices, 0), len(vertices), lines, "a strip")
            breaks = np.flatnonzero(indices == -1)
            ends = np.union1d(np.cumsum(lists.counts), breaks)
            for begin, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
                strip = indices[begin:end]
                parts.append(strips_to_triangles(strip[strip >= 0]))
        else:
            check_indices(indices, len(vertices), lines)
            few = int(np.count_nonzero(lists.counts < 3))
            if few:
                tell(f"left out: {few} faces of fewer than three corners.")
            parts.append(triangulate(vertices, lists.counts, indices))
    if not parts and len(vertices):
        raise MeshError("is a cloud of points without faces, which casts no shadow.")
    return vertices, np.concatenate(parts) if parts else np.zeros((0, 3), np.int64)


def _positions(columns: Columns | None) -> np.ndarray:
    if columns is None:
        raise MeshError("has no element vertex.")
    axes = [columns.get(axis) for axis in "xyz"]
    if not all(isinstance(axis, np.ndarray) for axis in axes):
        raise MeshError("its vertices lack x, y or z.")
    return np.stack([np.asarray(axis, np.float64) for axis in axes], axis=1)


class _Text:
    """Numbers in the order of the header; one element per line by custom, but any white space separates them."""

    def __init__(self, data: bytes, lines: int) -> None:
        self._words: list[bytes] = []
        self._lines: list[int] = []
        self._at = 0
        for number, line in enumerate(plain_bytes(data).splitlines(), start=lines + 1):
            words = line.split()
            self._words += words
            self._lines += [number] * len(words)

    def read(self, element: Element) -> Columns:
        lists = any(prop.count is not None for prop in element.properties)
        return self._with_lists(element) if lists else self._table(element)

    def _table(self, element: Element) -> Columns:
        width = len(element.properties)
        table = self._take(element.size * width, element).reshape(element.size, width)
        return {prop.name: table[:, i] for i, prop in enumerate(element.properties)}

    def _with_lists(self, element: Element) -> Columns:
        scalars: dict[str, list[float]] = {p.name: [] for p in element.properties if p.count is None}
        found: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties if p.count is not None}
        lines: list[int] = []
        for _ in range(element.size):
            lines.append(self._lines[min(self._at, len(self._lines) - 1)] if self._lines else 0)
            for prop in element.properties:
                value = self._take(1, element)
                if prop.count is None:
                    scalars[prop.name].append(float(value[0]))
                elif not 0 <= value[0] < _LONGEST or value[0] != int(value[0]):
                    raise MeshError(f"a list has the length {value[0]:g}.", lines[-1])
                else:
                    found[prop.name].append(self._take(int(value[0]), element))
        columns: Columns = {name: np.array(values) for name, values in scalars.items()}
        for name, rows in found.items():
            columns[name] = _joined(rows, np.array(lines, np.int64))
        return columns

    def _take(self, count: int, element: Element) -> np.ndarray:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise MeshError(f"ends within its elements {element.name}, of which {element.size} are announced.")
        self._at += count
        try:
            return np.array([float(word) for word in words])
        except ValueError:
            at, word = next((i, w) for i, w in enumerate(words) if not _is_number(w))
            raise MeshError(f"{shown(word)} is not a number.", self._lines[self._at - count + at]) from None


class _Binary:
    """Values one after the other, without gaps."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data = data
        self._at = at

    def read(self, element: Element) -> Columns:
        if not element.size:
            return {p.name: np.zeros(0) if p.count is None else _joined([], None) for p in element.properties}
        if any(p.count is not None for p in element.properties):
            return self._even(element) or self._uneven(element)
        layout = np.dtype([(p.name, p.kind) for p in element.properties])
        table = self._take(layout, element.size, element)
        return {p.name: table[p.name] for p in element.properties}

    def _even(self, element: Element) -> Columns | None:
        """All lists as long as those of the first element, as in most files; None where they are not."""
        begin, lengths = self._at, {}
        for prop in element.properties:
            if prop.count is not None:
                lengths[prop.name] = self._length(prop, element)
            self._take(prop.kind, lengths.get(prop.name, 1), element)
        self._at = begin
        fields: list[tuple] = []
        for prop in element.properties:
            if prop.count is None:
                fields.append((prop.name, prop.kind))
            else:
                fields += [(f"{prop.name} length", prop.count), (prop.name, prop.kind, (lengths[prop.name],))]
        layout = np.dtype(fields)
        if layout.itemsize * element.size > len(self._data) - begin:
            return None
        table = self._take(layout, element.size, element)
        if any(np.any(table[f"{name} length"] != length) for name, length in lengths.items()):
            self._at = begin
            return None
        columns: Columns = {}
        for prop in element.properties:
            values = table[prop.name]
            if prop.count is None:
                columns[prop.name] = values
            else:
                columns[prop.name] = Lists(np.full(element.size, lengths[prop.name]), values.ravel(), None)
        return columns

    def _uneven(self, element: Element) -> Columns:
        found: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
        for _ in range(element.size):
            for prop in element.properties:
                length = 1 if prop.count is None else self._length(prop, element)
                found[prop.name].append(self._take(prop.kind, length, element))
        columns: Columns = {}
        for prop in element.properties:
            rows = found[prop.name]
            columns[prop.name] = np.concatenate(rows) if prop.count is None else _joined(rows, None)
        return columns

    def _length(self, prop: Property, element: Element) -> int:
        assert prop.count is not None
        length = int(self._take(prop.count, 1, element)[0])
        if length < 0:
            raise MeshError(f"a list of an element {element.name} has the length {length}.")
        return length

    def _take(self, kind: np.dtype, count: int, element: Element) -> np.ndarray:
        if kind.itemsize * count > len(self._data) - self._at:
            raise MeshError(f"ends within its elements {element.name}, of which {element.size} are announced.")
        out = np.frombuffer(self._data, kind, count, self._at)
        self._at += kind.itemsize * count
        return out


def _joined(rows: list[np.ndarray], lines: np.ndarray | None) -> Lists:
    values = np.concatenate(rows) if rows else np.zeros(0)
    return Lists(np.array([len(row) for row in rows], np.int64), values, lines)


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
