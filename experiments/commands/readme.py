"""The table of techniques in README.md: ``python -m experiments.commands.readme`` brings it up to date."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from algorithms.plugins import file_of, load_all
from algorithms.technique import Technique
from experiments.commands.listing import by_family, needs_text, summary
from wkernels.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
BEGIN = "<!-- techniques: written by `make table` -->"
END = "<!-- end of techniques -->"


def technique_table(techniques: Mapping[str, type[Technique]]) -> str:
    """The table as Markdown, one row per technique, by family and name."""
    lines = ["| technique | family | what it is | paper | needs | error |", "|---|---|---|---|---|---|"]
    for technique in by_family(techniques):
        path = file_of(technique).resolve()
        link = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
        bias = {"darker": "too dark", "lighter": "too light", "none": "either way"}[technique.bias_sign]
        cells = (
            f"[`{technique.name}`]({link})",
            technique.family,
            summary(technique).rstrip(".").replace("|", "\\|"),
            ", ".join(technique.paper),
            needs_text(technique),
            bias,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def with_table(readme: str, table: str) -> str:
    """The README's text with ``table`` between the two markers.

    Raises:
        InputError: A marker is missing.
    """
    head, begin, rest = readme.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise InputError(f"the lines {BEGIN!r} and {END!r} are missing.", file="README.md")
    return f"{head}{BEGIN}\n{table}\n{END}{tail}"


def main(arguments: list[str] | None = None) -> int:
    """Brings README.md up to date; with ``--check`` only says whether it is (status 1 if not)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; status 1 if the table is out of date")
    check = parser.parse_args(arguments).check
    path = ROOT / "README.md"
    old = path.read_text(encoding="utf-8")
    new = with_table(old, technique_table(load_all()))
    if new == old:
        print("README.md is up to date.")
        return 0
    if check:
        print("README.md is out of date: run `make table`.")
        return 1
    path.write_text(new, encoding="utf-8")
    print("README.md written.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
