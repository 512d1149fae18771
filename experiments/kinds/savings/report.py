"""The page of a table of savings: what leaving out saved, all together and rule by rule."""

from __future__ import annotations

from pathlib import Path

from experiments.kinds.savings.run import COLUMNS, EVERYTHING
from experiments.report.page import record, write_page
from experiments.results.sound import WHOLE, RunRecord, check_environment, check_table
from experiments.results.store import Store
from experiments.results.tables import read_table
from wkernels.errors import InputError

PAGE = Path(__file__).with_name("page.html")
FILE = "savings.csv"


def write_savings_report(out: str | Path) -> Path:
    """Writes report.html of a folder of ``kind: savings`` from savings.csv; renders nothing.

    Raises:
        InputError: ``out`` has no rows, or cannot be written.
    """
    store = Store(Path(out))
    check_environment(store.environment(), RunRecord, store.out / "environment.json")
    rows = read_table(store.out / FILE)
    check_table("savings", rows, [name for name in COLUMNS if name not in WHOLE], store.out / FILE)
    if not rows:
        raise InputError("has no rows yet; there is nothing to report.", file=store.out / FILE)
    return write_page(
        store.out,
        PAGE,
        **record(store),
        totals=[row for row in rows if row["what"] == EVERYTHING],
        rules=[row for row in rows if row["what"] != EVERYTHING],
        failures=read_table(store.out / "failures.csv"),
    )
