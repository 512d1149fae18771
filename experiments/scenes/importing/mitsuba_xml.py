"""Mitsuba 3 scene files as a tree of elements: defaults, includes and references resolved, every one with its line.

Read with expat alone: nothing is fetched, and a file that declares entities is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from experiments.scenes.meshes.reading import MeshError
from wkernels.errors import nearest

_DEEPEST = 16  # files that include one another
_VARIABLE = re.compile(r"\$([A-Za-z_]\w*)")
_SEPARATOR = re.compile(r"[\s,]+")


@dataclass(eq=False)
class Element:
    """One element.

    Attributes:
        tag: ``shape``, ``float``, ...
        keys: Its attributes, ``$`` names replaced.
        file: Where it stands; file names in it are relative to that.
        line: 1-based.
        children: Elements below it.
    """

    tag: str
    keys: Mapping[str, str]
    file: Path
    line: int
    children: list[Element] = field(default_factory=list)

    @property
    def kind(self) -> str:
        """Its plugin: the attribute ``type``."""
        return self.keys.get("type", "")

    @property
    def name(self) -> str:
        """What it is to its parent."""
        return self.keys.get("name", "")

    def error(self, message: str) -> MeshError:
        """A MeshError about this element, to be raised by the caller."""
        return MeshError(f"{self.file.name}: {message}" if self.line == 0 else message, self.line or None)

    def all(self, *tags: str) -> Iterator[Element]:
        """Children of some tags."""
        return (child for child in self.children if child.tag in tags)

    def named(self, name: str, *tags: str) -> Element | None:
        """The child of a name, if it is of one of the tags (of any, without)."""
        found = [child for child in self.children if child.name == name and (not tags or child.tag in tags)]
        return found[-1] if found else None

    def number(self, name: str, default: float) -> float:
        """A ``float`` or ``integer`` below this element."""
        child = self.named(name, "float", "integer")
        return default if child is None else child.numbers("value", 1)[0]

    def text(self, name: str, default: str) -> str:
        """A ``string`` below this element."""
        child = self.named(name, "string")
        return default if child is None else child.keys.get("value", default)

    def flag(self, name: str, default: bool) -> bool:
        """A ``boolean`` below this element."""
        child = self.named(name, "boolean")
        return default if child is None else child.keys.get("value", "").lower() == "true"

    def vector(self, name: str, default: tuple[float, float, float]) -> np.ndarray:
        """A ``point`` or ``vector`` below this element, given as x, y, z or as one value."""
        child = self.named(name, "point", "vector")
        if child is None:
            return np.array(default)
        if "value" in child.keys:
            return np.array(child.numbers("value", 3))
        return np.array([child.numbers(axis, 1, "0")[0] for axis in "xyz"])

    def color(self, name: str) -> tuple[float, float, float] | None:
        """An ``rgb`` or constant ``spectrum`` below this element; None where there is none, or one of another kind."""
        child = self.named(name, "rgb", "spectrum", "float")
        if child is None or (child.tag == "spectrum" and not _is_number(child.keys.get("value", ""))):
            return None
        text = child.keys.get("value", "")
        if text.startswith("#") and len(text) == 7:
            srgb = np.array([int(text[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
            values = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).tolist()
        else:
            values = child.numbers("value", None)
        if len(values) not in (1, 3):
            raise child.error(f"a colour needs one number or three, not {len(values)}.")
        red, green, blue = values * 3 if len(values) == 1 else values
        return red, green, blue

    def numbers(self, key: str, count: int | None, default: str | None = None) -> list[float]:
        """The finite numbers of an attribute; ``count`` says how many there must be."""
        text = self.keys.get(key, default)
        if text is None:
            raise self.error(f"<{self.tag}> {self.name!r} needs the attribute {key}.")
        try:
            out = [float(word) for word in _SEPARATOR.split(text.strip()) if word]
        except ValueError:
            raise self.error(f"{text[:40]!r} is no number.") from None
        if not np.isfinite(out).all():
            raise self.error(f"{text[:40]!r} is not finite.")
        if count is not None and len(out) != count:
            raise self.error(f"{text[:40]!r} must be {count} number{'s' if count > 1 else ''}.")
        return out


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_xml(path: Path) -> Element:
    """The scene element of a file; raises MeshError."""
    root = _parsed(path, {}, 0)
    if root.tag != "scene":
        raise root.error(f"a Mitsuba scene begins with <scene>, not with <{root.tag}>.")
    version = root.keys.get("version", "")
    if not re.match(r"[2-9]\.", version):  # Mitsuba 3 reads scenes of version 2 as they are
        raise root.error(f"is a scene of version {version or 'unknown'}; those of version 2 and 3 are read.")
    _resolve(root)
    return root


def _parsed(path: Path, variables: dict[str, str], depth: int) -> Element:
    """The root of one file; ``variables`` are those of ``default`` elements so far, and grow."""
    if depth > _DEEPEST:
        raise MeshError(f"{path.name} includes itself.")
    parser = expat.ParserCreate()
    roots: list[Element] = []
    open_elements: list[Element] = []

    def refuse(*_: object) -> None:
        raise MeshError("declares a document type; only plain scenes are read.", parser.CurrentLineNumber)

    def start(tag: str, keys: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        element = Element(tag, {k: _substituted(v, variables, line) for k, v in keys.items()}, path, line)
        if tag == "default":
            variables.setdefault(element.keys.get("name", ""), element.keys.get("value", ""))
        (open_elements[-1].children if open_elements else roots).append(element)
        open_elements.append(element)

    def end(_: str) -> None:
        element = open_elements.pop()
        if element.tag == "include":
            file = path.parent / element.keys.get("filename", "")
            if not file.is_file():
                raise element.error(f"includes '{file}', which is missing.")
            element.children = _parsed(file, variables, depth + 1).children

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise MeshError(f"{path.name} is no XML: {expat.ErrorString(error.code)}.", error.lineno) from None
    return roots[0]


def _substituted(text: str, variables: Mapping[str, str], line: int) -> str:
    def value(match: re.Match[str]) -> str:
        if match[1] not in variables:
            raise MeshError(f"${match[1]} has no default." + nearest(match[1], list(variables)), line)
        return variables[match[1]]

    return _VARIABLE.sub(value, text)


def _resolve(root: Element) -> None:
    """Puts the elements of includes and the targets of references in their places."""
    known: dict[str, Element] = {}
    _collect(root, known)
    _refer(root, known, ())


def _collect(element: Element, known: dict[str, Element]) -> None:
    children: list[Element] = []
    for child in element.children:
        _collect(child, known)
        children += child.children if child.tag == "include" else [child]
        if "id" in child.keys and child.tag not in ("ref", "default"):
            known[child.keys["id"]] = child
        if child.tag == "alias" and child.keys.get("id", "") in known:
            known[child.keys.get("as", "")] = known[child.keys["id"]]
    element.children = children


def _refer(element: Element, known: Mapping[str, Element], above: tuple[int, ...]) -> None:
    for at, child in enumerate(element.children):
        if child.tag != "ref":
            _refer(child, known, above)
            continue
        wanted = child.keys.get("id", "")
        if wanted not in known:
            raise child.error(f"refers to {wanted!r}, which is nowhere." + nearest(wanted, list(known)))
        target = known[wanted]
        element.children[at] = Element(
            target.tag, {**target.keys, "name": child.name or target.name}, target.file, target.line, target.children
        )
