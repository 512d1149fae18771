"""Stereolithography files (3D Systems, 1989), text and binary: the length says which, the first word does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.scenes.meshes.polygons import triangulate
from experiments.scenes.meshes.reading import MeshError, Tell, number_of, plain_bytes, shown, word_lines
from experiments.scenes.primitives import Triangles

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84


def read(path: Path, tell: Tell) -> Triangles:
    """All facets of all solids; their normals are not read."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else 0
    size = _HEADER + count * _FACET.itemsize
    binary = len(data) >= _HEADER and len(data) == size
    text = plain_bytes(data)
    if not binary and text[:200].lstrip().lower().startswith(b"solid"):  # binary headers begin with the word as well
        return _read_text(text)
    if len(data) < _HEADER or len(data) < size:
        room = max(0, len(data) - _HEADER) // _FACET.itemsize
        raise MeshError(f"is neither text nor whole: it announces {count} facets and holds {room}.")
    if len(data) > size:
        tell(f"left out: {len(data) - size} bytes behind the last facet.")
    corners = np.frombuffer(data, _FACET, count, _HEADER)["corners"].reshape(-1, 3)
    return corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 3)


def _read_text(data: bytes) -> Triangles:
    points: list[list[float]] = []
    counts: list[int] = []
    loop: int | None = None  # corners of the loop that is open
    last = 0
    for line, words in word_lines(data, comment=b"\0"):
        lower = [word.lower() for word in words]
        i = 0
        while i < len(words):
            if lower[i] in (b"solid", b"endsolid"):
                break  # the rest is a name, which may hold any word
            if lower[i] == b"loop":
                loop = 0
            elif lower[i] == b"vertex":
                if loop is None:
                    raise MeshError("a vertex stands outside of any loop.", line)
                if i + 3 >= len(words):
                    raise MeshError("a vertex needs three coordinates.", line)
                points.append([number_of(word, line) for word in words[i + 1 : i + 4]])
                loop += 1
                i += 3
            elif lower[i] == b"endloop":
                if loop is None or loop < 3:
                    raise MeshError(f"a facet has {loop or 0} corners, fewer than three.", line)
                counts.append(loop)
                loop = None
            elif lower[i] == b"normal":
                i += 3
            elif lower[i] not in (b"facet", b"outer", b"endfacet"):
                raise MeshError(f"{shown(words[i])} is no word of an STL file.", line)
            i += 1
        last = line
    if loop is not None:
        raise MeshError("ends within a facet.", last)
    vertices = np.array(points, np.float64).reshape(-1, 3)
    return vertices, triangulate(vertices, np.array(counts, np.int64), np.arange(len(vertices)))
