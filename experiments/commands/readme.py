"""The table of techniques in README.md: ``python -m experiments.commands.readme`` brings it up to date."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from algorithms.plugins import file_of, load_all
from algorithms.technique import Technique
from experiments.commands.listing import by_family, needs_text, summary
from experiments.commands.markdown import ROOT, bring_up_to_date, table, with_block

BEGIN = "<!-- techniques: written by `make table` -->"
END = "<!-- end of techniques -->"
_OPPOSITE = {"darker": "lighter", "lighter": "darker"}


def technique_table(techniques: Mapping[str, type[Technique]]) -> str:
    """The table as Markdown, one row per technique, by family and name."""
    rows = []
    for technique in by_family(techniques):
        path = file_of(technique).resolve()
        link = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name
        signs = {"darker": "too dark", "lighter": "too light", "none": "either way"}
        bias = signs[technique.bias_sign]
        if technique.bias_turns:
            bias += f"; {signs[_OPPOSITE[technique.bias_sign]]} where {technique.bias_turns}"
        paper, what = ", ".join(technique.paper), summary(technique).rstrip(".")
        rows.append((f"[`{technique.name}`]({link})", technique.family, what, paper, needs_text(technique), bias))
    return table(("technique", "family", "what it is", "paper", "needs", "error"), rows)


def with_table(readme: str, techniques: str) -> str:
    """The README's text with the table between its two markers; InputError where one is missing."""
    return with_block(readme, BEGIN, END, techniques, file="README.md")


def main(arguments: Sequence[str] | None = None) -> int:
    """Brings README.md up to date; with ``--check`` only says whether it is (status 1 if not)."""

    def renew(page: str) -> str:
        return with_table(page, technique_table(load_all()))

    return bring_up_to_date("README.md", renew, arguments, about=__doc__, command="make table")


if __name__ == "__main__":
    sys.exit(main())
