"""The page of a table of savings: what leaving out saved, all together and rule by rule."""

from __future__ import annotations

from pathlib import Path

from experiments.kinds.savings.run import EVERYTHING
from experiments.report.page import render
from experiments.results.store import Store
from experiments.results.tables import read_table, write_text
from wkernels.errors import InputError

FILE = "savings.csv"


def is_savings(folder: Path) -> bool:
    """Whether a folder is of ``kind: savings``."""
    return (folder / FILE).is_file()


def write_savings_report(out: str | Path) -> Path:
    """Writes report.html of a folder of ``kind: savings`` from savings.csv; renders nothing.

    Raises:
        InputError: ``out`` has no rows, or cannot be written.
    """
    store = Store(Path(out))
    rows = read_table(store.out / FILE)
    if not rows:
        raise InputError("has no rows yet; there is nothing to report.", file=store.out / FILE)
    environment = store.environment()
    page = render(
        "savings.html",
        run=environment["run"],
        environment=environment["environment"],
        identity=environment["identity"],
        totals=[row for row in rows if row["what"] == EVERYTHING],
        rules=[row for row in rows if row["what"] != EVERYTHING],
        failures=read_table(store.out / "failures.csv"),
        config=(store.out / "config.yaml").read_text(encoding="utf-8"),
    )
    try:
        write_text(store.out / "report.html", page)
    except OSError as error:
        raise InputError(f"the report cannot be written ({error.strerror or error}).", file=store.out) from error
    return store.out / "report.html"
