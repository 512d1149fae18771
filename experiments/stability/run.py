"""``run_stability``: the result folder of ``kind: stability``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from algorithms.technique import Technique
from experiments.engine import check_device
from experiments.environment import describe_machine
from experiments.report.stability import write_stability_report
from experiments.stability.cases import CASES
from experiments.stability.heat_map import draw_heat_map
from experiments.stability.table import COLUMNS, breaking_points, concerned, examine
from experiments.store import Store
from experiments.tables import Row, Table, read_table, table_text, write_text
from wkernels import __version__
from wkernels.launch import default_threads

if TYPE_CHECKING:
    from experiments.config.stability import Stability
    from experiments.runner import Progress


def run_stability(
    stability: Stability,
    out: str | Path,
    plugins: Mapping[str, type[Technique]],
    *,
    device: str = "cpu",
    threads: int | None = None,
    resume: bool = False,
    skips: bool = True,
    progress: Progress | None = None,
) -> Path:
    """Renders every technique on every level of every case; writes stability.csv as it goes, a heat map and the report.

    Args:
        stability: The resolved experiment.
        out: Result folder; created where missing.
        plugins: Technique classes by name.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; None for all.
        skips: Whether work that a scene cannot need may be left out.
        resume: Keep the cases that an interrupted run of the same experiment has completed.
        progress: Is told what happens; counts cases.

    Returns:
        stability.csv.

    Raises:
        InputError: The folder cannot be written, or holds something else; no such device.
    """
    check_device(device)
    out = Path(out)
    environment = {
        "identity": {"wkernels": __version__, "device": device},
        "run": {"name": stability.name, "kind": "stability", "labels": list(stability.techniques)},
        "environment": describe_machine(device, threads or default_threads()),
        "metrics": {},
    }
    techniques = {name: plugins[name] for name in stability.techniques}
    kept = _kept(out, stability, techniques) if resume else []
    Store.open(out, stability.to_yaml(), environment, resume=False)
    path = out / "stability.csv"
    write_text(path, table_text(COLUMNS, kept))
    done = {row["case"] for row in kept}
    table = Table(path, COLUMNS)
    try:
        for i, case in enumerate(stability.cases):
            if progress:
                progress(i, len(stability.cases), case)
            if case not in done:
                for row in examine(techniques, [case], device=device, threads=threads, skips=skips):
                    table.append([row])
    finally:
        table.close()
    if progress:
        progress(len(stability.cases), len(stability.cases), "done")
    rows = read_table(path)
    draw_heat_map(breaking_points(rows), stability.techniques, stability.cases, out / "plots" / "stability")
    if rows:
        write_stability_report(out)
    return path


def _kept(out: Path, stability: Stability, techniques: Mapping[str, type[Technique]]) -> list[dict[str, str]]:
    """Rows of the cases that are complete, if the folder holds an earlier run of the same experiment."""
    config = out / "config.yaml"
    if not config.is_file() or config.read_text(encoding="utf-8") != stability.to_yaml():
        return []
    rows = read_table(out / "stability.csv")
    kept: list[dict[str, str]] = []
    for name, group in itertools.groupby(rows, key=lambda row: row["case"]):
        own = list(group)
        if len(own) == _expected(name, techniques):
            kept += own
    return kept


def _expected(case: str, techniques: Mapping[str, type[Technique]]) -> int:
    count = sum(concerned(technique, CASES[case]) for technique in techniques.values())
    return count * len(CASES[case].levels)


def explain_stability(stability: Stability, plugins: Mapping[str, type[Technique]]) -> str:
    """What ``run_stability`` will do, for people."""
    width = max(len(name) for name in stability.cases)
    lines = [
        f"Experiment {stability.name} (stability)",
        "",
        f"Techniques: {', '.join(stability.techniques)}",
        "",
        "Cases",
    ]
    for name in stability.cases:
        case = CASES[name]
        levels = ", ".join(level if isinstance(level, str) else f"{level:g}" for level in case.levels)
        lines.append(f"  {name:<{width}}  {case.source}: {case.title}: {levels}")
    declared = [
        f"  {technique}, {case}: {reason}"
        for technique in stability.techniques
        for case, reason in plugins[technique].stability_limits.items()
        if case in stability.cases
    ]
    return "\n".join([*lines, "", "Declared limits", *(declared or ["  none"])])


def summary_text(rows: Sequence[Row]) -> str:
    """How many pictures there are of each status, and every broken one."""
    counts = {status: sum(row["status"] == status for row in rows) for status in ("ok", "declared", "broken")}
    lines = [f"{len(rows)} pictures: " + ", ".join(f"{count} {status}" for status, count in counts.items())]
    broken = [row for row in rows if row["status"] == "broken"]
    lines += [f"  broken: {row['technique']}, {row['case']} = {row['level']}: {row['detail']}" for row in broken]
    return "\n".join(lines)
