"""The page of a stability table: techniques by cases, with the level at which a technique breaks and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.report.page import record, write_page
from experiments.results.sound import RunRecord, check_environment, check_table
from experiments.results.store import Store
from experiments.results.tables import read_table
from wkernels.errors import InputError

PAGE = Path(__file__).with_name("page.html")
STATUSES = ("ok", "declared", "broken")
FILE = "stability.csv"


def stability_values(folder: Path) -> dict[str, Any] | None:
    """What the page's heat map shows of a folder's stability.csv; None where it has none."""
    from experiments.kinds.stability.table import COLUMNS

    rows = read_table(folder / FILE)
    check_table("stability", rows, COLUMNS, folder / FILE)
    return _values(rows) if rows else None


def _values(rows: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    from experiments.kinds.stability.cases import CASES
    from experiments.kinds.stability.table import breaking_points

    techniques = list(dict.fromkeys(row["technique"] for row in rows))
    names = list(dict.fromkeys(row["case"] for row in rows))
    cases = {name: f"{CASES[name].source}: {CASES[name].title}" if name in CASES else name for name in names}
    found: dict[str, dict[str, list[tuple[str, str, str]]]] = {}
    for row in rows:
        levels = found.setdefault(row["technique"], {}).setdefault(row["case"], [])
        levels.append((_short(row["level"]), row["status"], row["detail"]))
    worst = breaking_points(rows)
    return {
        "techniques": techniques,
        "cases": cases,
        "cells": {t: {case: _cell(worst.get((t, case))) for case in names} for t in techniques},
        "counts": {status: sum(row["status"] == status for row in rows) for status in STATUSES},
        "total": len(rows),
        "data": {"found": found, "cases": cases},
    }


def _cell(worst: tuple[str, str] | None) -> dict[str, str]:
    if worst is None:
        return {"status": "none", "level": "", "text": "not concerned"}
    status, level = worst
    return {"status": status, "level": _short(level), "text": f"{status} at {level}" if level else status}


def _short(level: str) -> str:
    """A level as briefly as its number can be written."""
    try:
        value = float(level)
    except ValueError:
        return level
    short = f"{value:.0e}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    return short if len(short) < len(level) and float(short) == value else level


def write_stability_report(out: str | Path) -> Path:
    """Writes report.html of a folder of ``kind: stability`` from stability.csv; renders nothing.

    Raises:
        InputError: ``out`` has no rows, or cannot be written.
    """
    store = Store(Path(out))
    check_environment(store.environment(), RunRecord, store.out / "environment.json")
    values = stability_values(store.out)
    if values is None:
        raise InputError("has no rows yet; there is nothing to report.", file=store.out / FILE)
    rows = read_table(store.out / FILE)
    broken, declared = ([row for row in rows if row["status"] == status] for status in ("broken", "declared"))
    return write_page(store.out, PAGE, **record(store), stability=values, broken=broken, declared=declared)
