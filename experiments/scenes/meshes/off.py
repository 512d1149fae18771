"""Object file format (Geomview's OFF, text form): with normals, colours, texture coordinates or weights per vertex."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from experiments.scenes.meshes.polygons import triangulate
from experiments.scenes.meshes.reading import (
    MeshError,
    Tell,
    check_indices,
    integer_of,
    number_of,
    position_of,
    shown,
    word_lines,
)
from experiments.scenes.primitives import Triangles

_HEADER = re.compile(rb"(ST)?(C)?(N)?(4)?(n)?OFF")


def read(path: Path, tell: Tell) -> Triangles:
    """All polygons; what a vertex or face has besides its positions or vertices is not read."""
    lines = list(word_lines(path.read_bytes()))
    if not lines:
        raise MeshError("is empty.")
    number, words = lines[0]
    header = _HEADER.fullmatch(words[0])
    homogeneous = False
    if header is not None:  # the word itself may be left out
        if header[5]:
            raise MeshError("is of any number of dimensions (nOFF), not of three.", number)
        homogeneous = header[4] is not None
        if words[1:2] == [b"BINARY"]:
            raise MeshError("is binary OFF, of which only the text form is read.", number)
        lines[0] = (number, words[1:])
        lines = lines if words[1:] else lines[1:]
    elif not re.fullmatch(rb"\d+", words[0]):
        raise MeshError(f"begins with {shown(words[0])}, not with OFF.", number)
    if not lines or len(lines[0][1]) < 2:
        raise MeshError("the numbers of vertices and faces are missing.", lines[0][0] if lines else number)
    sizes = [integer_of(word, lines[0][0]) for word in lines[0][1][:2]]
    if min(sizes) < 0 or sum(sizes) > len(lines) - 1:
        raise MeshError(f"{sizes[0]} vertices and {sizes[1]} faces are announced, but {len(lines) - 1} lines follow.")
    body, rest = lines[1 : 1 + sum(sizes)], lines[1 + sum(sizes) :]
    if rest:
        tell(f"left out: {len(rest)} lines behind the last face.")
    vertices = np.array([position_of(words, line) for line, words in body[: sizes[0]]], np.float64).reshape(-1, 3)
    if homogeneous:
        weights = [number_of(words[3], line) if len(words) > 3 else 1.0 for line, words in body[: sizes[0]]]
        with np.errstate(divide="ignore", invalid="ignore"):
            vertices = vertices / np.array(weights).reshape(-1, 1)
    counts, indices, of_line = [], [], []
    for line, words in body[sizes[0] :]:
        count = integer_of(words[0], line)
        if count < 0 or len(words) <= count:
            raise MeshError(f"a face of {count} corners has {len(words) - 1} numbers.", line)
        counts.append(count)
        indices += [integer_of(word, line) for word in words[1 : count + 1]]
        of_line += [line] * count
    flat = np.array(indices, np.int64)
    check_indices(flat, len(vertices), np.array(of_line, np.int64))
    return vertices, triangulate(vertices, np.array(counts, np.int64), flat)
