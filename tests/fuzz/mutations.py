"""Files and data made wrong: bytes, words, JSON and XML trees, each from a ``random.Random``, so that a seed repeats it.

Everything here takes something healthy and gives it back with one to four faults, as disks, networks, editors and other
people's writers make them: cut off, doubled, swapped, out of range, of another type.
"""

from __future__ import annotations

import copy
import json
import re
import struct
from collections.abc import Callable, Sequence
from random import Random
from typing import Any
from xml.etree import ElementTree

NUMBERS = (
    *(b"0", b"-1", b"1", b"2", b"3", b"-2", b"255", b"65536", b"16777217", b"2147483647", b"-2147483649"),
    *(b"4294967295", b"9223372036854775807", b"-9223372036854775809", b"99999999999999999999999", b"1000000000"),
    *(
        b"0.5",
        b"1e-3",
        b"-0",
        b"1e-45",
        b"1e-320",
        b"1e12",
        b"1.1e12",
        b"1e38",
        b"3.5e38",
        b"1e200",
        b"1e308",
        b"1e309",
    ),
    *(b"nan", b"inf", b"-inf", b"NaN", b"1.0.0", b"1,5", b"0x10", b"1_0", b"+5", b"5.", b"", b"one", b"1e", b"--1"),
)
"""What stands where a number stood."""
WORDS = (
    b"#",
    b"\\",
    b"\0",
    b'"',
    b"<",
    b"&amp;",
    b"{",
    b"]",
    b"\xff\xfe",
    b"\xc3\xa9",
    b"\x85",
    b"\r",
    b"\n",
    b"/",
    b"../..",
)
BYTES = (0x00, 0x01, 0x0A, 0x0D, 0x20, 0x22, 0x2D, 0x7F, 0x80, 0xFF)
INTEGERS = (0, 1, 2, 3, 0x7F, 0xFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF)
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-40, 1e12, 2e12, 3e38, float("inf"), float("-inf"), float("nan"))
VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        2,
        3,
        255,
        1 << 31,
        1 << 32,
        1 << 63,
        -(1 << 63),
        10**25,
        0.5,
        -0.5,
        1e-40,
        1e12,
        1e13,
    ),
    *(1e39, 1e308, float("nan"), float("inf"), "", "x", "0", "é\0", "../../x", "a" * 300, [], [0], [[]], [1, 2, 3], {}),
    *({"a": 1}, [None], ["x"], [0.0] * 16, [1e308, 1e308, 1e308], [-1, 0, 0, 0]),
)
"""What stands where a value of JSON or YAML stood."""
LARGEST = 1 << 20
"""Bytes of what is made: faults that double things must not double each other without end."""

_WORD = re.compile(rb"[^\s,;:(){}\[\]<>=\"/]+")


def mutated_bytes(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Bytes changed, cut, doubled, moved, or taken from another file of the format."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(out) + 1)
        length = min(len(out) - at, rng.choice((1, 1, 2, 4, 12, 50, rng.randrange(len(out) + 1))))
        kind = rng.randrange(9)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(out):
            out[at] = rng.choice(BYTES)
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[at:at] = out[at : at + length] * rng.choice((1, 1, 2, 20))
            del out[LARGEST:]
        elif kind == 4:
            out[at:at] = rng.choice(WORDS)
        elif kind == 5:
            del out[at:]
        elif kind == 6:
            packed = struct.pack(rng.choice(("<I", ">I")), rng.choice(INTEGERS))
            out[at : at + 4] = packed if rng.random() < 0.6 else struct.pack("<f", rng.choice(FLOATS))
        elif kind == 7 and others:
            other = rng.choice(others)
            begin = rng.randrange(len(other) + 1)
            out[at : at + length] = other[begin : begin + rng.randrange(1, 200)]
        else:
            for i in range(at, at + length):
                out[i] = rng.randrange(256)
    return bytes(out)


def mutated_text(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Words replaced or swapped, lines dropped, doubled or moved, another encoding."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind = rng.randrange(10)
        words = list(_WORD.finditer(data))
        if kind < 4 and words:
            word = rng.choice(words)
            data = data[: word.start()] + rng.choice(NUMBERS) + data[word.end() :]
        elif kind == 4 and words:
            word, other = rng.choice(words), rng.choice(words)
            data = data[: word.start()] + other[0] + data[word.end() :]
        elif kind == 5 and words:
            word = rng.choice(words)
            data = data[: word.start()] + rng.choice(WORDS) + data[word.end() :]
        elif kind == 6 and others:
            lines, more = data.splitlines(keepends=True), rng.choice(others).splitlines(keepends=True)
            lines.insert(rng.randrange(len(lines) + 1), rng.choice(more) if more else b"")
            data = b"".join(lines)
        elif kind == 7:
            data = rng.choice(_ENCODINGS)(data)
        else:
            lines = data.splitlines(keepends=True)
            if lines:
                at = rng.randrange(len(lines))
                held = lines.pop(at)
                back = rng.choice((0, 1, 1, 2, 2, 500))
                lines[at:at] = [held] * back if back != 1 else []
                if back == 1:
                    lines.insert(rng.randrange(len(lines) + 1), held)
            data = b"".join(lines)[:LARGEST]
    return data


_ENCODINGS: tuple[Callable[[bytes], bytes], ...] = (
    lambda data: data.replace(b"\n", b"\r\n"),
    lambda data: data.replace(b"\n", b"\r"),
    lambda data: b"\xef\xbb\xbf" + data,
    lambda data: data.decode("latin-1").encode("utf-16"),
    lambda data: data.replace(b"e", "é".encode("latin-1"), 1),
    lambda data: data.replace(b" ", b"\t"),
    lambda data: data.replace(b"\n", b" "),
)


def mutated_tree(rng: Random, tree: Any) -> Any:
    """JSON or YAML data with values replaced, keys and items dropped, doubled, swapped or misspelt."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = _places(tree)
        if not places:
            return rng.choice(VALUES)
        holder, key = rng.choice(places)
        kind = rng.randrange(8)
        if kind < 3:
            holder[key] = copy.deepcopy(rng.choice(VALUES))
        elif kind == 3:
            holder[key] = copy.deepcopy(_at(rng.choice(places)))
        elif kind == 4:
            del holder[key]
        elif kind == 5 and isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        elif kind == 5:
            holder[f"{key}{rng.choice('sx_')}"] = holder.pop(key)
        elif kind == 6 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
            change = rng.choice((lambda x: x + 1, lambda x: -x, lambda x: x * 1000, lambda x: x / 2, float, str))
            try:
                holder[key] = change(holder[key])
            except OverflowError:
                holder[key] = 0
        else:
            holder[key] = [holder[key]] if rng.random() < 0.5 else {"x": holder[key]}
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every place below the root, as holder and key."""
    out: list[tuple[Any, Any]] = []
    waiting = [tree]
    while waiting:
        holder = waiting.pop()
        if isinstance(holder, dict | list):
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            out += [(holder, key) for key in keys]
            waiting += [holder[key] for key in keys]
    return out


def _at(place: tuple[Any, Any]) -> Any:
    return place[0][place[1]]


def mutated_gltf(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """The JSON of a glTF or GLB changed, its bytes kept; a GLB's lengths are right again."""
    text, rest = unpacked(data)
    try:
        tree = mutated_tree(rng, json.loads(text))
    except (ValueError, RecursionError):
        return mutated_bytes(rng, data, others)
    changed = json.dumps(tree).encode()
    return changed if rest is None else packed(changed, rest)


def unpacked(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON of a glTF file and what follows it in a GLB; None of a .gltf."""
    if not data.startswith(b"glTF"):
        return data, None
    size = int.from_bytes(data[12:16], "little")
    return data[20 : 20 + size], data[20 + size :]


def packed(text: bytes, rest: bytes) -> bytes:
    """A GLB of JSON and further chunks."""
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def mutated_xml(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Elements dropped, doubled, moved, renamed or nested; attributes and texts changed."""
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError:
        return mutated_bytes(rng, data, others)
    if root.tag.startswith("{"):
        ElementTree.register_namespace("", root.tag[1:].partition("}")[0])
    for _ in range(rng.choice((1, 1, 2, 3))):
        parents = [element for element in root.iter() if len(element)]
        if not parents:
            break
        parent = rng.choice(parents)
        child = rng.choice(list(parent))
        kind = rng.randrange(9)
        if kind == 0:
            parent.remove(child)
        elif kind == 1:
            parent.append(copy.deepcopy(child))
        elif kind == 2:
            target = rng.choice(list(root.iter()))
            target.append(copy.deepcopy(child))
        elif kind == 3:
            child.tag = rng.choice(list(root.iter())).tag
        elif kind < 7 and child.attrib:
            key = rng.choice(sorted(child.attrib))
            if rng.random() < 0.2:
                del child.attrib[key]
            else:
                child.attrib[key] = _changed_words(rng, child.attrib[key])
        else:
            element = rng.choice([e for e in root.iter() if e.text and e.text.strip()] or [child])
            element.text = _changed_words(rng, element.text or "")
    return ElementTree.tostring(root)


def _changed_words(rng: Random, text: str) -> str:
    words = text.split() or [""]
    kind = rng.randrange(4)
    at = rng.randrange(len(words))
    if kind == 0:
        words.pop(at)
    elif kind == 1:
        words.insert(at, words[at])
    else:
        words[at] = rng.choice(NUMBERS).decode()
    return " ".join(words)
