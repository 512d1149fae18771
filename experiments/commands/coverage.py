"""Tables of docs/standard_error.md from convergence runs: ``python -m experiments.commands.coverage DIR...``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from experiments.kinds.convergence.report import load_convergence_rows
from experiments.kinds.convergence.store import ConvergenceStore

COLUMNS = ("coverage_2se", "penumbra_standard_error", "penumbra_rmse", "zero_standard_error")


def coverage_table(runs: Mapping[str, pd.DataFrame], step: int) -> str:
    """Markdown: per label (rows) and run (columns) what a technique's standard error is worth after ``step`` steps.

    A cell holds the share of penumbra pixels whose true error lies within two standard errors and, behind it, that of
    those whose standard error is not 0 and how many times the root mean square error the standard error is. Techniques
    that take no steps are shown as they are; labels without a standard error are left out.

    Args:
        runs: convergence.csv as ``load_convergence_rows`` gives it, by name of the column.
        step: Frames or samples.
    """
    cells: dict[str, dict[str, str]] = {}
    for name, table in runs.items():
        own = table[((table["step"] == step) | (table["over"] == "")) & table["coverage_2se"].notna()]
        for label, coverage, error, rmse, zero in zip(own["label"], *(own[column] for column in COLUMNS), strict=True):
            times = f"{error / rmse:.1f}" if rmse > 0.0 else "no error"
            # where all tests agreed it is 0, which covers nothing within a penumbra
            doubting = f"{100.0 * min(coverage / (1.0 - zero), 1.0):.1f}" if zero < 1.0 else "none"
            cells.setdefault(str(label), {})[name] = f"{100.0 * coverage:.1f} ({doubting}; {times})"
    lines = [f"| n = {step} | " + " | ".join(runs) + " |", "|---" * (len(runs) + 1) + "|"]
    for label, found in cells.items():
        lines.append(f"| {label} | " + " | ".join(found.get(name, "") for name in runs) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="result folders of kind: convergence")
    parser.add_argument("--steps", nargs="+", type=int, default=[16, 64])
    options = parser.parse_args(arguments)
    runs = {folder.name: load_convergence_rows(ConvergenceStore.existing(folder)) for folder in options.folders}
    print("\n\n".join(coverage_table(runs, step) for step in options.steps))


if __name__ == "__main__":
    main()
