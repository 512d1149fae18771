"""Tables, plots and page over all scenes, from the scenes' folders alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.sweep.equal import equal_error, equal_time
from experiments.kinds.sweep.overall import overall_rows
from experiments.kinds.sweep.pareto import SceneResults, load_results, scene_rows
from experiments.kinds.sweep.recommend import recommend, recommend_overall
from experiments.kinds.sweep.store import SweepStore
from experiments.results.store import Store
from experiments.results.summary import recompute_metrics
from experiments.results.tables import Row, read_table, table_text, write_text
from wkernels.errors import InputError


def write_tables(store: SweepStore, scene_failures: Sequence[Row] = ()) -> list[SceneResults]:
    """Writes every table over the scenes that have results.

    Args:
        store: The sweep's folder.
        scene_failures: Rows of failures.csv about whole scenes.

    Returns:
        The results of these scenes.
    """
    run = store.environment()["run"]
    found = [load_results(store.scene(name), name) for name in store.scene_names()]
    scenes = [results for results in found if results is not None]
    rows: dict[str, list[Any]] = {
        "pareto": [row for scene in scenes for row in scene_rows(scene)],
        "equal_time": [row for scene in scenes for row in equal_time(scene, run["budgets"])],
        "equal_error": [row for scene in scenes for row in equal_error(scene, run["budgets"])],
        "recommendation": [recommend(scene) for scene in scenes],
        "failures": [*_failures(store), *scene_failures],
    }
    if len(scenes) > 1:
        rows["pareto"] += overall_rows(scenes)
        overall = recommend_overall(scenes)
        rows["recommendation"] += [overall] if overall else []
    for name, columns in store.tables.items():
        write_text(store.out / f"{name}.csv", table_text(columns, rows[name]))
    return scenes


def _failures(store: SweepStore) -> list[dict[str, str]]:
    return [
        {"scene": name, **row} for name in store.scene_names() for row in read_table(store.scene(name) / "failures.csv")
    ]


def recompute_sweep(out: str | Path) -> int:
    """Computes all metrics again from the scenes' raw images, and writes their reports again; how many rows."""
    from experiments.kinds.walkthrough.report import write_report

    store, count = SweepStore(Path(out)), 0
    store.check()
    for name in store.scene_names():
        if not store.scene(name).is_dir():
            continue
        scene = Store.existing(store.scene(name))
        if scene.rows("frames"):
            count += recompute_metrics(scene.out)
            write_report(scene.out)
            store.update_environment(metrics=scene.environment()["metrics"])
    return count


def write_sweep(out: str | Path, *, scene_failures: Sequence[Row] | None = None) -> Path:
    """Writes tables, plots and page of a sweep's folder again; renders nothing.

    Args:
        out: The folder.
        scene_failures: Rows of failures.csv about whole scenes; None keeps those that are there.

    Returns:
        Path of report.html.

    Raises:
        InputError: ``out`` is no folder of a sweep, has no rows yet, or cannot be written.
    """
    from experiments.kinds.sweep.plots import write_plots
    from experiments.kinds.sweep.report import write_sweep_report
    from experiments.report.page import writing_report

    store = SweepStore(Path(out))
    store.check()
    if scene_failures is None:
        scene_failures = [row for row in store.rows("failures") if row["what"] == "scene"]
    with writing_report(store.out):
        scenes = write_tables(store, scene_failures)
        if not scenes:
            raise InputError("has no rows yet; there is nothing to report.", file=store.out)
        noise = {scene.name: scene.noise for scene in scenes}
        write_plots(store.out, store.rows("pareto"), noise, store.environment()["run"]["baseline"])
        return write_sweep_report(store.out)
