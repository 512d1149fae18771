"""Wavefront OBJ: vertices and polygons ("The Advanced Visualizer", appendix B1, and what writers make of it).

Read here because a face has to be refused with its line, and because indices that count backwards mean the vertices
so far: a reader that collects all vertices first resolves them wrongly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.scenes.meshes.polygons import triangulate
from experiments.scenes.meshes.reading import MeshError, Tell, check_indices, integer_of, position_of, word_lines
from experiments.scenes.primitives import Triangles

_SURFACES = {b"curv", b"curv2", b"surf", b"cstype", b"bsp", b"bzp", b"cdc", b"cdp", b"res"}
_WITHOUT_GEOMETRY = {
    *(b"vt", b"vn", b"vp", b"g", b"o", b"s", b"mg", b"usemtl", b"mtllib", b"usemap", b"maplib", b"bevel", b"c_interp"),
    *(b"d_interp", b"lod", b"shadow_obj", b"trace_obj", b"deg", b"bmat", b"step", b"parm", b"trim", b"hole", b"scrv"),
    *(b"sp", b"end", b"con", b"ctech", b"stech"),
}


def read(path: Path, tell: Tell) -> Triangles:
    """All faces of all groups and objects."""
    points: list[tuple[float, float, float]] = []
    counts: list[int] = []
    indices: list[int] = []
    face_lines: list[int] = []
    dropped: dict[str, int] = {}
    for line, words in word_lines(path.read_bytes(), continued=True):
        key = words[0]
        if key == b"v":
            points.append(position_of(words[1:], line))
        elif key in (b"f", b"fo"):  # fo: an old name
            corners = [_vertex(word, len(points), line) for word in words[1:]]
            if len(corners) < 3:
                dropped["faces of fewer than three corners"] = dropped.get("faces of fewer than three corners", 0) + 1
                continue
            counts.append(len(corners))
            indices += corners
            face_lines.append(line)
        elif key not in _WITHOUT_GEOMETRY:
            what = _name(key)
            dropped[what] = dropped.get(what, 0) + 1
    if dropped:
        tell("left out: " + ", ".join(f"{count} {what}" for what, count in dropped.items()) + ".")
    vertices = np.array(points, np.float64).reshape(-1, 3)
    corners_of, flat = np.array(counts, np.int64), np.array(indices, np.int64)
    check_indices(flat, len(vertices), np.repeat(np.array(face_lines, np.int64), corners_of), base=1)
    return vertices, triangulate(vertices, corners_of, flat)


def _vertex(word: bytes, so_far: int, line: int) -> int:
    """The vertex, counted from 0, of a corner ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``."""
    index = integer_of(word.partition(b"/")[0], line)
    if index > 0:
        return index - 1
    if index == 0 or -index > so_far:
        raise MeshError(
            "a face uses vertex 0, but they count from 1."
            if index == 0
            else f"a face uses vertex {index}, but there are only {so_far} before it.",
            line,
        )
    return so_far + index


def _name(key: bytes) -> str:
    if key == b"l":
        return "lines"
    if key == b"p":
        return "points"
    if key in _SURFACES:
        return "statements of curved surfaces"
    return f"statements of an unknown kind {key[:20].decode('latin-1')!r}"
