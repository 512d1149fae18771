"""``write_sweep_report``: the page over all scenes of a sweep, from its tables and plots."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from experiments.metrics import outdated
from experiments.sweep.store import SweepStore
from experiments.tables import write_text

_TABLES = (
    ("recommendation", "Recommendation"),
    ("pareto", "Error and time"),
    ("equal_time", "At equal time"),
    ("equal_error", "At equal error"),
    ("failures", "Failures"),
)


def write_sweep_report(folder: Path) -> Path:
    """Writes report.html of a sweep's folder, one file that needs no other but links to the scenes' reports.

    Returns:
        Its path.

    Raises:
        InputError: ``folder`` is no folder of a sweep.
    """
    store = SweepStore.existing(folder)
    told = store.environment()
    tables: list[dict[str, Any]] = []
    for name, title in _TABLES:
        rows = store.rows(name)
        if rows:
            tables.append({"name": name, "title": title, "columns": store.tables[name], "rows": rows})
    page = Environment(
        loader=PackageLoader("experiments.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page.filters["cell"] = _cell
    text = page.get_template("sweep.html").render(
        run=told["run"],
        environment=told["environment"],
        plots=[(path.stem.removeprefix("pareto_"), _data_url(path)) for path in _plots(store)],
        scenes=[name for name in store.scene_names() if (store.scene(name) / "report.html").is_file()],
        tables=tables,
        outdated=outdated(told["metrics"]),
        config=(store.out / "config.yaml").read_text(encoding="utf-8"),
    )
    write_text(store.out / "report.html", text)
    return store.out / "report.html"


def _plots(store: SweepStore) -> list[Path]:
    scenes = dict.fromkeys(row["scene"] for row in store.rows("pareto"))
    paths = [store.out / "plots" / f"pareto_{name}.png" for name in scenes]
    return [path for path in paths if path.is_file()]


def _data_url(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def _cell(text: str) -> str:
    """Numbers with three digits, everything else as it is."""
    try:
        return format(float(text), ".3g")
    except ValueError:
        return text
