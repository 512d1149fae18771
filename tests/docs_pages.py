"""What README, CONTRIBUTING, CHANGELOG and the pages of docs hold: fenced blocks, code spans, links, commands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAMS = ("wkernels ", "make ", "pip ", "python -m ")


@dataclass(frozen=True)
class Piece:
    """A fenced block, or a code span.

    Attributes:
        page: Where it stands.
        line: Of its beginning.
        language: Of a block; empty without one.
        text: What it holds.
    """

    page: Path
    line: int
    language: str
    text: str

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.page.relative_to(ROOT).as_posix()}:{self.line}"


def blocks(page: Path, *languages: str) -> Iterator[Piece]:
    """The fenced blocks of a page in some languages."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        if found[1] in languages:
            yield Piece(page, text[: found.start()].count("\n") + 1, found[1], found[2])


def prose(page: Path) -> str:
    """A page without its fenced blocks; lines keep their numbers."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r"^```.*?^```$", lambda m: "\n" * m[0].count("\n"), text, flags=re.MULTILINE | re.DOTALL)


def spans(page: Path) -> Iterator[Piece]:
    """The code spans of a page."""
    text = prose(page)
    for found in re.finditer(r"`([^`]+)`", text):
        yield Piece(page, text[: found.start()].count("\n") + 1, "", re.sub(r"\s+", " ", found[1]))


def commands(text: str) -> list[list[str]]:
    """The command lines of a text, loops over words unrolled; what stands behind two blanks is a remark."""
    out: list[list[str]] = []
    name, values = "$", [""]
    for line in text.splitlines():
        if found := re.fullmatch(r"for (\w+) in (.*); do", line):
            name, values = f"${found[1]}", found[2].split()
        elif line == "done":
            name, values = "$", [""]
        elif line.strip().startswith(PROGRAMS):
            shown = re.split(r"\s{2,}", line.strip())[0]
            out += [shlex.split(shown.replace(name, value)) for value in values]
    return out


def anchors(page: Path) -> set[str]:
    """What GitHub calls the headings of a page."""
    out: set[str] = set()
    for heading in re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        out.add(next(n for i in range(100) if (n := f"{name}-{i}" if i else name) not in out))
    return out


def dead_links(page: Path, text: str) -> list[str]:
    """Targets of links in a text of a page that are no file, or no heading, of the repository."""
    out = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        file, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", file):
            continue
        path = (page.parent / file).resolve() if file else page
        if not path.exists() or (anchor and (path.suffix != ".md" or anchor not in anchors(path))):
            out.append(target)
    return out
