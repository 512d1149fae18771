"""The header of a PLY file (Turk 1994): which elements there are, and how their properties are stored."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from experiments.scenes.meshes.reading import MeshError, integer_of, shown

_TYPES = {
    **{b"char": "i1", b"uchar": "u1", b"short": "i2", b"ushort": "u2", b"int": "i4", b"uint": "u4"},
    **{b"float": "f4", b"double": "f8", b"int8": "i1", b"uint8": "u1", b"int16": "i2", b"uint16": "u2"},
    **{b"int32": "i4", b"uint32": "u4", b"float32": "f4", b"float64": "f8", b"int64": "i8", b"uint64": "u8"},
}
_FORMATS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """One value of an element, or a list of them where ``count`` has a type."""

    name: str
    kind: np.dtype
    count: np.dtype | None = None


@dataclass
class Element:
    """A kind of element, how many of it follow, and its properties in order."""

    name: str
    size: int
    line: int
    properties: list[Property] = field(default_factory=list)


@dataclass(frozen=True)
class Header:
    """What follows: ``order`` is ``<`` or ``>`` of binary files, empty for text; ``length`` bytes and ``lines``."""

    order: str
    elements: list[Element]
    length: int
    lines: int


def read_header(data: bytes) -> Header:
    """The header at the beginning of a file; lines may end in LF, CR LF or CR. Raises MeshError."""
    first = data[:8].lstrip(b"\xef\xbb\xbf")
    if not first.startswith(b"ply"):
        raise MeshError(f"begins with {shown(first)}, not with ply.", 1)
    ending = b"\n" if b"\n" in data[:6] and b"\r" not in data[:6] else b"\r\n" if b"\r\n" in data[:8] else b"\r"
    order: str | None = None
    elements: list[Element] = []
    at, number = 0, 0
    while True:
        end = data.find(ending, at)
        line = data[at : end if end >= 0 else len(data)]
        words, number, at = line.split(), number + 1, end + len(ending)
        key = words[0] if words else b""
        if key == b"end_header":
            at = len(data) if end < 0 else at
            break
        if end < 0:
            raise MeshError("has no end_header.")
        if key == b"format":
            if len(words) < 2 or words[1] not in _FORMATS:
                raise MeshError(f"{shown(b' '.join(words[1:]))} is no format of a PLY file.", number)
            order = _FORMATS[words[1]]
        elif key == b"element":
            if len(words) != 3:
                raise MeshError("an element needs a name and a number.", number)
            name = words[1].decode("latin-1")
            if any(name == element.name for element in elements):
                raise MeshError(f"has the element {name!r} twice.", number)
            elements.append(Element(name, integer_of(words[2], number), number))
            if elements[-1].size < 0:
                raise MeshError(f"there cannot be {elements[-1].size} of an element.", number)
        elif key == b"property":
            if not elements:
                raise MeshError("a property stands before any element.", number)
            prop = _property(words[1:], order or "", number)
            if any(prop.name == other.name for other in elements[-1].properties):
                raise MeshError(f"an element has the property {prop.name!r} twice.", number)
            elements[-1].properties.append(prop)
        elif key not in (b"", b"comment", b"obj_info") and number > 1:
            raise MeshError(f"{shown(key)} is no word of a PLY header.", number)
    if order is None:
        raise MeshError("has no format in its header.")
    return Header(order, elements, at, number)


def _property(words: list[bytes], order: str, line: int) -> Property:
    listed = words[:1] == [b"list"]
    types, name = (words[1:3], words[3:]) if listed else (words[:1], words[1:])
    if len(name) != 1:
        raise MeshError("a property needs a type and a name, a list the types of its length and its values.", line)
    for word in types:
        if word not in _TYPES:
            raise MeshError(f"{shown(word)} is no type of a property.", line)
    kinds = [np.dtype((order or "<") + _TYPES[word]) for word in types]
    if listed and kinds[0].kind == "f":
        raise MeshError("the length of a list must be a whole number.", line)
    return Property(name[0].decode("latin-1"), kinds[-1], kinds[0] if listed else None)
