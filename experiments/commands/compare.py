"""``wkernels compare``: two result folders, and a gate on error for continuous integration."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.compare import COLUMNS, compare, rows_for_people
from experiments.tables import table_text, write_text
from wkernels.errors import InputError


def compare_folders(a: Path, b: Path, *, as_json: bool, out: Path | None, gate: float | None) -> bool:
    """Prints how B differs from A.

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
    found = compare(a, b)
    regressions = [] if gate is None else found.regressions(gate)
    if out is not None:
        try:
            write_text(out, table_text(COLUMNS, found.rows))
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror or error}).", file=out) from error
    if as_json:
        lost = {"only_a": found.only_a, "only_b": found.only_b}
        print(json.dumps({"rows": found.rows, **lost, "notes": found.notes, "regressions": regressions}, indent=2))
        return not regressions
    print(f"A = {a}\nB = {b}")
    for note in found.notes:
        print(f"  {note}")
    lines = rows_for_people(found.rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    print()
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    for name, labels in (("A", found.only_a), ("B", found.only_b)):
        if labels:
            print(f"only in {name}: {', '.join(labels)}")
    if gate is not None:
        print(f"\nGate at {gate:g} %: {'open' if not regressions else 'CLOSED'}")
        for reason in regressions:
            print(f"  {reason}")
    return not regressions
