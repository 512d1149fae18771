"""The small form of ``kind: convergence``: psi, variance and standard error of shadow tests that are written down.

Computed by the funcs that the kernels of temporal and sampling techniques use (Scherzer et al. 2009, Table 1).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.kinds.convergence.config import Estimates
from experiments.results.environment import describe_identity, describe_machine
from experiments.results.result_tables import refusing
from experiments.results.store import Store
from experiments.results.tables import table_text, write_text
from wkernels.analysis.estimate_series import estimates_of

COLUMNS = ("n", "tau", "psi", "variance", "standard_error")
_SHOWN = 40  # rows printed; the file has them all


def estimate_rows(estimates: Estimates) -> list[dict[str, Any]]:
    """A row per test, as columns of estimates.csv; variance and standard error of the first are None: 0 / 0."""
    psi, variance, error = (values[0] for values in estimates_of(np.array([estimates.tests], np.float32)))
    return [
        {
            "n": i + 1,
            "tau": tau,
            "psi": float(psi[i]),
            "variance": float(variance[i]) if i else None,
            "standard_error": float(error[i]) if i else None,
        }
        for i, tau in enumerate(estimates.tests)
    ]


def run_estimates(estimates: Estimates, out: str | Path) -> Path:
    """Writes estimates.csv and returns its path.

    Raises:
        InputError: The folder cannot be written or holds something else.
    """
    out = Path(out)
    environment = {
        "identity": describe_identity(estimates.to_yaml(), None),
        "run": {"name": estimates.name, "kind": "convergence", "tests": len(estimates.tests)},
        "environment": describe_machine("cpu", 1),
        "metrics": {},
    }
    Store.open(out, estimates.to_yaml(), environment, resume=False)
    with refusing(out):
        write_text(out / "estimates.csv", table_text(COLUMNS, estimate_rows(estimates)))
    return out / "estimates.csv"


def estimates_text(estimates: Estimates) -> str:
    """The table for people."""
    lines = [f"{'n':>5} {'tau':>4} {'psi':>8} {'variance':>10} {'s':>8}"]
    rows = estimate_rows(estimates)
    for row in rows[:_SHOWN]:
        lines.append(
            f"{row['n']:>5} {row['tau']:>4} {row['psi']:>8.4f} " + _cells(row["variance"], row["standard_error"])
        )
    if len(rows) > _SHOWN:
        lines.append(f"and {len(rows) - _SHOWN} more")
    return "\n".join([*lines, "n = 1: variance and s are 0 / 0, undefined; the kernels take 1 for s."])


def _cells(variance: float | None, error: float | None) -> str:
    return f"{'undefined':>19}" if variance is None or error is None else f"{variance:>10.4f} {error:>8.4f}"
