"""``wkernels compare``: two result folders, and a gate on error for continuous integration."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.kinds.kind import PLAIN, find, kind_of_folder
from experiments.results.tables import table_text, write_text
from wkernels.errors import InputError


def compare_folders(a: Path, b: Path, *, as_json: bool, out: Path | None, gate: float | None) -> bool:
    """Prints how B differs from A, as their kind compares them.

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
    kinds = {kind_of_folder(folder).name for folder in (a, b)}
    found = find(kinds.pop() if len(kinds) == 1 else PLAIN).compare(a, b)
    regressions = [] if gate is None else found.regressions(gate)
    if out is not None:
        try:
            write_text(out, table_text(found.columns, found.rows))
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror or error}).", file=out) from error
    if as_json:
        print(json.dumps({**found.as_json(), "regressions": regressions}, indent=2))
        return not regressions
    print(f"A = {a}\nB = {b}\n{found.text()}")
    if gate is not None:
        state = "open" if not regressions else "CLOSED"
        print("\n".join([f"\nGate at {gate:g} %: {state}", *(f"  {reason}" for reason in regressions)]))
    return not regressions
