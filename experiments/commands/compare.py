"""``wkernels compare``: two result folders, and a gate on error for continuous integration."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from experiments.results.compare import COLUMNS, Comparison, compare, rows_for_people
from experiments.results.tables import table_text, write_text
from wkernels.errors import InputError


def compare_folders(a: Path, b: Path, *, as_json: bool, out: Path | None, gate: float | None) -> bool:
    """Prints how B differs from A; of two sweeps, how far they agree and then each scene.

    Args:
        a, b: Result folders.
        as_json: Print JSON instead of a table.
        out: CSV file to write as well.
        gate: Largest growth of a label's RMSE in percent; None for no gate.

    Returns:
        False where the gate is closed: an error grew beyond it, or a label is missing in B.

    Raises:
        InputError: The folders cannot be compared, or ``out`` cannot be written.
    """
    from experiments.kinds.sweep.store import is_sweep

    if is_sweep(a) and is_sweep(b):
        return _compare_sweeps(a, b, as_json=as_json, out=out, gate=gate)
    found = compare(a, b)
    regressions = [] if gate is None else found.regressions(gate)
    _write(out, table_text(COLUMNS, found.rows))
    if as_json:
        print(json.dumps({**_as_json(found), "regressions": regressions}, indent=2))
        return not regressions
    print(f"A = {a}\nB = {b}")
    _print_comparison(found)
    _print_gate(gate, regressions)
    return not regressions


def _compare_sweeps(a: Path, b: Path, *, as_json: bool, out: Path | None, gate: float | None) -> bool:
    from experiments.kinds.sweep import agreement

    agreements = agreement.agree(a, b)
    scenes = agreement.compare_scenes(a, b)
    regressions = []
    if gate is not None:
        regressions = [f"{name}: {reason}" for name, found in scenes.items() for reason in found.regressions(gate)]
    rows = [{"scene": name, **row} for name, found in scenes.items() for row in found.rows]
    _write(out, table_text(("scene", *COLUMNS), rows))
    if as_json:
        parts = {"agreement": [entry.row() for entry in agreements]}
        compared = {name: _as_json(found) for name, found in scenes.items()}
        print(json.dumps({**parts, "scenes": compared, "regressions": regressions}, indent=2))
        return not regressions
    print(f"A = {a}\nB = {b}\n\nRank correlations (Spearman) and Pareto fronts")
    _print_table(agreement.rows_for_people(agreements))
    for name, found in scenes.items():
        print(f"\n==== {name}")
        _print_comparison(found)
    _print_gate(gate, regressions)
    return not regressions


def _as_json(found: Comparison) -> dict[str, object]:
    return {"rows": found.rows, "only_a": found.only_a, "only_b": found.only_b, "notes": found.notes}


def _write(out: Path | None, text: str) -> None:
    if out is None:
        return
    try:
        write_text(out, text)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror or error}).", file=out) from error


def _print_comparison(found: Comparison) -> None:
    for note in found.notes:
        print(f"  {note}")
    print()
    _print_table(rows_for_people(found.rows))
    for name, labels in (("A", found.only_a), ("B", found.only_b)):
        if labels:
            print(f"only in {name}: {', '.join(labels)}")


def _print_table(lines: list[list[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _print_gate(gate: float | None, regressions: Sequence[str]) -> None:
    if gate is not None:
        print(f"\nGate at {gate:g} %: {'open' if not regressions else 'CLOSED'}")
        for reason in regressions:
            print(f"  {reason}")
