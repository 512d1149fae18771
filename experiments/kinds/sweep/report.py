"""The page over all scenes of a sweep: error against time, who is best at equal time and at equal error, and advice."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.metrics.registry import outdated
from experiments.report.data import chart_data, column_title, parameters, thumbs, with_summary
from experiments.report.page import write_page
from experiments.results.store import Store
from experiments.results.tables import read_table
from wkernels.errors import InputError

PARETO_TEXTS = {"scene", "technique", "label", "error_to_reference", "on_front", "dominated_by"}
OVERALL = "all"  # scene of the rows over all scenes: numbers there are relative to the baseline's
_YES = {"yes", "true", "1"}


def write_sweep_report(folder: Path) -> Path:
    """Writes report.html of a sweep's folder: one file that needs no other, with links to the scenes' own reports.

    Reads pareto.csv and, where they are there, equal_time.csv, equal_error.csv, recommendation.csv, failures.csv,
    config.yaml, environment.json, and SCENE/ for pictures and parameters; renders nothing.

    Returns:
        Its path.

    Raises:
        InputError: ``folder`` has no pareto.csv with rows, or cannot be written.
    """
    folder = Path(folder)
    rows = read_table(folder / "pareto.csv")
    if not rows:
        raise InputError("has no rows; there is nothing to report.", file=folder / "pareto.csv")
    table = _numeric(rows)
    names = [name for name in dict.fromkeys(table["scene"]) if name != OVERALL]
    record = _record(folder)
    run = {"name": folder.resolve().name, "baseline": "", **record.get("run", {})}
    config = folder / "config.yaml"
    tables = {name: read_table(folder / f"{name}.csv") for name in ("equal_time", "equal_error", "recommendation")}
    return write_page(
        folder,
        Path(__file__).with_name("page.html"),
        run=run,
        environment=record.get("environment", {}),
        identity=record.get("identity", {}),
        metric_versions=record.get("metrics", {}),
        outdated=outdated(record.get("metrics", {})),
        scenes=[_scene(folder, name, table[table["scene"] == name], tables, run["baseline"]) for name in names],
        overall=_over_scenes(table, names),
        overall_chart=_overall_chart(table[table["scene"] == OVERALL], run["baseline"]),
        overall_plot=_plot(folder, OVERALL),
        overall_advice=[row for row in tables["recommendation"] if row["scene"] == OVERALL],
        points=int((table["scene"] != OVERALL).sum()),
        techniques=table["technique"].nunique(),
        failures=read_table(folder / "failures.csv"),
        config=config.read_text(encoding="utf-8") if config.is_file() else "",
    )


def _numeric(rows: Sequence[Mapping[str, str]]) -> pd.DataFrame:
    table = pd.DataFrame(list(rows))
    for name in table.columns:
        if name not in PARETO_TEXTS:
            table[name] = pd.to_numeric(table[name], errors="coerce").astype(float)
    return table


def _record(folder: Path) -> dict[str, Any]:
    path = folder / "environment.json"
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except ValueError as error:
        raise InputError(f"cannot be read ({error}).", file=path) from error


def _scene(
    folder: Path, name: str, table: pd.DataFrame, tables: Mapping[str, list[dict[str, str]]], baseline: str
) -> dict[str, Any]:
    store = Store(folder / name)
    labels = [str(label) for label in table["label"]]
    known = (store.out / "config.yaml").is_file()
    own = {key: [row for row in rows if row.get("scene") == name] for key, rows in tables.items()}
    return {
        "name": name,
        "chart": chart_data(
            with_summary(table, store.out),
            details=parameters(store.config()) if known else {},
            thumbs=thumbs(store, labels),
            baseline=baseline,
            by="technique",
            front=[_yes(value) for value in table["on_front"]],
        ),
        "plot": _plot(folder, name),
        "link": f"{name}/report.html" if (store.out / "report.html").is_file() else "",
        "rows": [{**row, "front": _yes(row.get("on_front"))} for row in table.to_dict("records")],
        "recommended": own["recommendation"],
        "equal_time": _places(own["equal_time"], "budget_label", "budget_ms"),
        "equal_error": _places(own["equal_error"], "target_label", "target_rmse"),
    }


def _plot(folder: Path, name: str) -> str:
    """The sweep's own plot of a scene, for readers without scripts, as a data URL; empty where there is none."""
    path = folder / "plots" / f"pareto_{name}.png"
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii") if path.is_file() else ""


def _yes(value: Any) -> bool:
    return str(value).strip().lower() in _YES


def _places(rows: Sequence[Mapping[str, str]], label: str, value: str) -> list[dict[str, Any]]:
    """Rows of an equal-time or equal-error table by what they compare at, the best first."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        numbers = {name: _number(row.get(name, "")) for name in ("place", "frame_ms", "rmse")}
        groups.setdefault((row[label], row[value]), []).append({"label": row["label"], **numbers})
    return [
        {"label": key[0], "value": _number(key[1]), "rows": sorted(own, key=lambda row: row["place"])}
        for key, own in groups.items()
    ]


def _number(text: str) -> float:
    return float(text) if text else float("nan")


def _over_scenes(table: pd.DataFrame, scenes: Sequence[str]) -> list[dict[str, Any]]:
    """Per label: on which scenes it is on the front, and means over scenes: the sweep's own, or geometric ones."""
    out = []
    for label, own in table.groupby("label", sort=False):
        single, mean = own[own["scene"] != OVERALL], own[own["scene"] == OVERALL]
        front = [str(row["scene"]) for row in single.to_dict("records") if _yes(row["on_front"])]
        row: dict[str, Any] = {"label": label, "technique": own["technique"].iloc[0], "front": front}
        for name in ("ratio", "rmse"):
            row[name] = float(mean[name].iloc[0]) if len(mean) else _geometric_mean(single[name], len(scenes))
        out.append(row)
    return sorted(out, key=lambda row: -len(row["front"]))


def _overall_chart(table: pd.DataFrame, baseline: str) -> dict[str, Any] | None:
    if table.empty:
        return None
    chart = chart_data(table, baseline=baseline, by="technique", front=[_yes(value) for value in table["on_front"]])
    if "rmse" in chart["columns"]:
        chart["columns"]["rmse"] = column_title("rmse") | {
            "title": f"RMSE, × {baseline or 'baseline'}, mean over scenes"
        }
    return chart


def _geometric_mean(values: pd.Series, wanted: int) -> float:
    """NaN where a scene is missing, because means over different scenes cannot be compared, or a value is not > 0."""
    numbers = values.to_numpy(float)
    known = len(numbers) == wanted and bool(np.all(np.isfinite(numbers) & (numbers > 0.0)))
    return float(np.exp(np.mean(np.log(numbers)))) if known else float("nan")
