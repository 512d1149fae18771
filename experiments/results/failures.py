"""What failed in a run: the exception at its end, and reports that fail without taking the results with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.results.store import Store

_NAMELESS = {"file": "the reference"}  # whose files have no label


class TechniquesFailed(RuntimeError):
    """Something failed: techniques while rendering, or files that could not be written; all else was run and stored.

    Args:
        out: The result folder.
        rows: Of failures.csv.
        store: Where the results went; names tables that it could not write, and where they are.

    Attributes:
        out: The result folder.
        labels: The labels that failed.
        spare: Folder of tables that could not be written; None where all could.
        unwritten: Whether there are any.
    """

    def __init__(self, out: Path, rows: list[dict[str, str]], store: Store | None = None) -> None:
        self.out = out
        self.labels = tuple(dict.fromkeys(row["label"] for row in rows if row["label"]))
        self.spare = store.spare if store else None
        self.unwritten = bool(store and store.unwritten)
        parts = []
        if rows:
            first = rows[0]
            what = first.get("what") or "technique"
            who = f"'{first['label']}'" if first["label"] else _NAMELESS.get(what, f"the {what}")
            does = "could not be stored" if what == "file" else "failed"
            more = f" ({len(rows) - 1} more in {out / 'failures.csv'})" if len(rows) > 1 else ""
            where = f" on frame {first['frame']}" if first["frame"] else ""
            parts.append(f"{who} {does}{where}: {first['error'].rstrip('.')}{more}.")
            parts.append(f"Tracebacks are in {out / 'failures'}, the other results in {out}.")
            if any(row.get("what", "technique") not in ("", "technique") for row in rows):
                parts.append("--resume makes again what could not be stored.")
        if store and store.unwritten:
            parts.append(store.unwritten_text())
        super().__init__(" ".join(parts))


def attempt_report(store: Store, write: Callable[[Path], Any]) -> None:
    """Writes a report; one that fails is a row of failures.csv, because the results are there."""
    try:
        write(store.out)
    except Exception as error:
        store.record_failure("", "", "", error, "report")


def raise_failures(store: Store) -> None:
    """Raises TechniquesFailed if anything failed."""
    failures = store.rows("failures")
    if failures or store.unwritten:
        raise TechniquesFailed(store.out, failures, store)
