"""README, CONTRIBUTING, CHANGELOG and docs: links lead somewhere, named files exist, tables are up to date."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from docs_pages import PAGES, ROOT, blocks, dead_links, prose, spans

from experiments.commands import formats, readme

IDS = [page.relative_to(ROOT).as_posix() for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_links_lead_somewhere(page: Path) -> None:
    assert not dead_links(page, prose(page))


def test_a_dead_link_is_found() -> None:
    page = ROOT / "docs" / "formats.md"
    text = "[a](none.md) [b](sweep.md) [c](#scene) [d](#nowhere) [e](glossary.md#time) [f](glossary.md#space)"
    assert dead_links(page, text) == ["none.md", "#nowhere", "glossary.md#space"]


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_files_that_are_named_exist(page: Path) -> None:
    """Paths in code spans. CHANGELOG.md names files as they were called then; FAMILY stands for one."""
    path = r"(?:wkernels|algorithms|experiments|configs|docs|tests)/[\w/.*-]+"
    names = {span.text.rstrip("/") for span in spans(page) if re.fullmatch(path, span.text)}
    named = [name for name in sorted(names) if "FAMILY" not in name and "five_taps" not in name]
    missing = [name for name in named if not list(ROOT.glob(name))]
    assert not missing or page.name == "CHANGELOG.md"


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    missing = [p.name for p in (ROOT / "docs").glob("*.md") if p.name != "README.md" and f"]({p.name})" not in index]
    assert not missing
    assert "(docs/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_errata_are_complete_and_each_has_its_place() -> None:
    page = ROOT / "docs" / "errata.md"
    rows = re.findall(r"^\| (E\d+) \| (.*) \|$", prose(page), re.MULTILINE)
    assert sorted(int(name[1:]) for name, _ in rows) == list(range(1, 51))
    for name, cells in rows:
        where, printed, right, place = cells.split(" | ")
        assert where and printed and right, name
        assert place == "not built yet" or "](../" in place, f"{name} has no place in the code"


def test_the_architecture_page_names_every_room() -> None:
    page = ROOT / "docs" / "architecture.md"
    floors = next(block.text for block in blocks(page, "") if block.text.startswith("wkernels: "))
    drawn = "".join(block.text for block in blocks(page, "mermaid"))
    told = prose(page)
    for package in ("wkernels", "algorithms", "experiments"):
        lines = [line.split() for line in floors.splitlines() if line.startswith(f"{package}: ")]
        rooms = {room for line in lines for room in line[1:]}
        assert rooms == {path.name for path in (ROOT / package).iterdir() if list(path.glob("*.py"))}
        assert not [room for room in rooms if f"| `{room}` |" not in told and package != "algorithms"]
        assert not [room for room in rooms if not re.search(rf"\b{room}\b", drawn)]


def test_the_tables_of_formats_are_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert formats.main(["--check"]) == 0, capsys.readouterr().out


def test_formats_shows_every_table_there_is() -> None:
    page = (ROOT / formats.PAGE).read_text(encoding="utf-8")
    assert sorted(re.findall(r"^<!-- table: (.*) -->$", page, re.MULTILINE)) == sorted(formats.TABLES)
    old = page.replace("| `samples` |", "| `simples` |")
    assert old != page and formats.with_tables(old) == page


def test_the_table_of_techniques_is_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert readme.main(["--check"]) == 0, capsys.readouterr().out
