"""``run_stability``: the result folder of ``kind: stability``."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from algorithms.technique import Technique
from experiments.kinds.stability import cases, shapes, table
from experiments.kinds.stability.cases import CASES
from experiments.kinds.stability.heat_map import draw_heat_map
from experiments.kinds.stability.report import write_stability_report
from experiments.kinds.stability.table import COLUMNS, breaking_points, concerned, examine
from experiments.rendering.engine import check_device
from experiments.results.environment import describe_identity, describe_machine, file_digest, text_digest
from experiments.results.failures import attempt_report, raise_failures
from experiments.results.result_tables import FAILURE_COLUMNS
from experiments.results.sound import RunRecord
from experiments.results.store import Store
from experiments.results.tables import Row
from wkernels.device.launch import default_threads

if TYPE_CHECKING:
    from experiments.kinds.kind import Progress
    from experiments.kinds.stability.config import Stability


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
        TechniquesFailed: At the end, if something could not be written; techniques that fail are rows of the table.
    """
    check_device(device)
    out = Path(out)
    techniques = {name: plugins[name] for name in stability.techniques}
    text = stability.to_yaml()
    environment = {
        "identity": describe_identity(text, _scenes_digest(), techniques, device=device, skips=skips),
        "run": {
            "name": stability.name,
            "kind": "stability",
            "labels": list(stability.techniques),
            "expected": {name: _expected(name, techniques) for name in stability.cases},
        },
        "environment": describe_machine(device, threads or default_threads()),
        "metrics": {},
    }
    store = StabilityStore.open(out, text, environment, resume=resume)
    done = {row["case"] for row in store.rows("stability")}
    with store.writing():
        for i, case in enumerate(stability.cases):
            if progress:
                progress(i, len(stability.cases), case)
            if case not in done:
                for row in examine(techniques, [case], device=device, threads=threads, skips=skips):
                    store.append("stability", [row])
        if progress:
            progress(len(stability.cases), len(stability.cases), "done")
        points = breaking_points(store.rows("stability"))
        picture = out / "plots" / "stability"
        attempt_report(store, lambda _: draw_heat_map(points, stability.techniques, stability.cases, picture))
        if store.rows("stability"):
            attempt_report(store, write_stability_report)
    raise_failures(store)
    return out / "stability.csv"


class StabilityStore(Store):
    """The folder of a run of ``kind: stability``; a case is complete with as many rows as it has pictures."""

    tables: Mapping[str, tuple[str, ...]] = MappingProxyType({"stability": COLUMNS, "failures": FAILURE_COLUMNS})
    main = "stability"
    place = "case"
    record = RunRecord
    unique = ()

    def recover(self) -> None:
        rows = self.rows("stability")
        count = Counter(row["case"] for row in rows)
        expected = self.environment()["run"]["expected"]
        self._write_rows("stability", [row for row in rows if count[row["case"]] == expected.get(row["case"])])
        self._write_rows("failures", [])


def _scenes_digest() -> str:
    """The scenes are code."""
    return text_digest("".join(file_digest(inspect.getfile(module)) for module in (cases, shapes, table)))


def _expected(case: str, techniques: Mapping[str, type[Technique]]) -> int:
    count = sum(concerned(technique, CASES[case]) for technique in techniques.values())
    return count * len(CASES[case].levels)


def summary_text(rows: Sequence[Row]) -> str:
    """How many pictures there are of each status, and every broken one."""
    counts = {status: sum(row["status"] == status for row in rows) for status in ("ok", "declared", "broken")}
    lines = [f"{len(rows)} pictures: " + ", ".join(f"{count} {status}" for status, count in counts.items())]
    broken = [row for row in rows if row["status"] == "broken"]
    lines += [f"  broken: {row['technique']}, {row['case']} = {row['level']}: {row['detail']}" for row in broken]
    return "\n".join(lines)
