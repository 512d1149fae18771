"""Pages whose tables are written by a command: what lies between two marked lines, and bringing it up to date."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from wkernels.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown; bars in cells are escaped."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows)])


def with_block(page: str, begin: str, end: str, block: str, *, file: str) -> str:
    """The page with ``block`` between the lines ``begin`` and the next ``end``.

    Raises:
        InputError: One of them is missing.
    """
    head, found, rest = page.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise InputError(f"the lines {begin!r} and {end!r} are missing.", file=file)
    return f"{head}{begin}\n{block}\n{end}{tail}"


def bring_up_to_date(
    name: str, renew: Callable[[str], str], arguments: Sequence[str] | None, *, about: str | None, command: str
) -> int:
    """The ``main`` of such a command.

    Args:
        name: File, relative to the repository.
        renew: Its text as it is -> as it should be.
        arguments: Of the command line; None for the process's own. ``--check`` only says whether it is up to date.
        about: What ``--help`` says.
        command: What brings it up to date.

    Returns:
        Exit status: 1 if ``--check`` finds it out of date.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--check", action="store_true", help="change nothing; status 1 if it is out of date")
    check = parser.parse_args(arguments).check
    path = ROOT / name
    old = path.read_text(encoding="utf-8")
    new = renew(old)
    if new == old:
        print(f"{name} is up to date.")
    elif check:
        print(f"{name} is out of date: run `{command}`.")
        return 1
    else:
        path.write_text(new, encoding="utf-8")
        print(f"{name} written.")
    return 0
