"""Rooms of the three packages: which may import which, as docs/architecture.md lists their floors, and what lies in them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from source_tree import LAYERS, ROOT, imports_of, package_of, project_files, sources

ARCHITECTURE = ROOT / "docs" / "architecture.md"
LOOSE = {"wkernels": 3, "algorithms": 4, "experiments": 3}
"""Most modules that a package's root may hold, ``__init__`` aside."""
MOST_ARROWS = 60
# written in pieces, so that this file does not contain what it looks for
ABSENT = ("CATA" + "LOGUE", "DES" + "IGN", "HO" + "USE", ".." + "/shared")
"""Documents that were never in the repository."""

Arrows = dict[tuple[str, str], list[str]]


def floors(package: str, text: str) -> list[set[str]]:
    """The package's rooms, floor by floor from the ground up, as the list under "Floors" has them."""
    found = re.search(r"^## Floors\n.*?^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found, "no list of floors"
    lines = (line.partition(":") for line in found.group(1).splitlines())
    return [set(rooms.split()) for name, _, rooms in lines if name == package]


def rooms(package: str) -> set[str]:
    """Folders of a package that hold Python files."""
    return {path.relative_to(ROOT).parts[1] for path in sources(package) if len(path.relative_to(ROOT).parts) > 2}


def arrows(package: str) -> Arrows:
    """Pairs (room, room that it imports), with the files and modules that make them."""
    inside, out = rooms(package), {}
    for path in sources(package):
        parts = path.relative_to(ROOT).parts
        for name in imports_of(path.read_text(encoding="utf-8"), package_of(path)):
            head, _, rest = name.partition(".")
            room = rest.partition(".")[0]
            if len(parts) > 2 and head == package and room in inside - {parts[1]}:
                out.setdefault((parts[1], room), []).append(f"{path.relative_to(ROOT)} imports {name}")
    return out


def not_downward(found: Arrows, levels: list[set[str]]) -> list[str]:
    """Imports that do not lead to a lower floor."""
    floor = {room: level for level, names in enumerate(levels) for room in names}
    return [use for (above, below), uses in found.items() if floor[above] <= floor[below] for use in uses]


@pytest.mark.parametrize("package", LAYERS)
def test_every_room_has_one_floor(package: str) -> None:
    listed = [room for level in floors(package, ARCHITECTURE.read_text(encoding="utf-8")) for room in level]
    assert sorted(listed) == sorted(rooms(package))


@pytest.mark.parametrize("package", LAYERS)
def test_rooms_import_only_rooms_of_lower_floors(package: str) -> None:
    """Then there is no circle either."""
    found = arrows(package)
    wrong = not_downward(found, floors(package, ARCHITECTURE.read_text(encoding="utf-8")))
    assert found and not wrong, wrong


def test_arrows_between_rooms_stay_few() -> None:
    assert len(arrows("wkernels")) <= MOST_ARROWS


def test_the_walk_finds_what_it_looks_for() -> None:
    text = (
        "# A\n\n## Floors\n\nOne line is a floor.\n\n```\nwkernels: device sampling\nwkernels: scene\nother: x\n```\n"
    )
    assert floors("wkernels", text) == [{"device", "sampling"}, {"scene"}]
    found = {("scene", "device"): ["down"], ("device", "scene"): ["up"], ("device", "sampling"): ["across"]}
    assert not_downward(found, floors("wkernels", text)) == ["up", "across"]
    assert ("frame", "workspace") in arrows("wkernels") and ("workspace", "frame") not in arrows("wkernels")


@pytest.mark.parametrize("package", LAYERS)
def test_few_modules_lie_loose(package: str) -> None:
    loose = [path.stem for path in (ROOT / package).glob("*.py") if path.stem != "__init__"]
    assert len(loose) <= LOOSE[package], loose


@pytest.mark.parametrize("package", LAYERS)
def test_rooms_say_what_lives_in_them(package: str) -> None:
    """In the docstring of their ``__init__``: a sentence, and more below it."""
    silent = [
        room
        for room in sorted(rooms(package))
        if len(docstring(ROOT / package / room / "__init__.py").strip().splitlines()) < 3
    ]
    assert not silent, silent


def docstring(path: Path) -> str:
    """That of a module, empty where there is none."""
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" if path.is_file() else ""


def test_no_file_refers_to_documents_that_are_not_here() -> None:
    wrong = []
    for path in project_files():
        text = path.read_bytes().decode("utf-8", errors="ignore")
        wrong += [f"{path.relative_to(ROOT)}: {name}" for name in ABSENT if name in text]
        for named in re.findall(r"(?<![\w./-])docs/[\w/.-]+\.md\b", text):
            wrong += [f"{path.relative_to(ROOT)}: {named}"] if not (ROOT / named).is_file() else []
    assert not wrong, wrong
