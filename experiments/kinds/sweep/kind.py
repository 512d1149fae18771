"""Kind ``sweep``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.kinds.kind import Kind, Progress
from experiments.kinds.sweep.config import SweepFile, load_sweep
from experiments.results.tables import read_table

if TYPE_CHECKING:
    from experiments.results.compare import Compared


class SweepKind(Kind):
    """Every technique on several scenes, and who is worth the time."""

    name = "sweep"
    schemas = (SweepFile,)

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_sweep(path, overrides, plugins)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        from experiments.kinds.sweep.run import run_sweep

        run_sweep(experiment, out, plugins=plugins, progress=progress, **options)
        advice = [f"{row['scene']}: {row['reason']}" for row in read_table(out / "recommendation.csv")]
        return "\n".join([*advice, f"Report: {out / 'report.html'}"])

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.kinds.sweep.store import SweepStore

        return {f"{name}.csv": columns for name, columns in SweepStore.tables.items() if name != "failures"}

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        from experiments.kinds.sweep.explain import explain_sweep

        return explain_sweep(experiment, plugins)

    def write_report(self, out: Path) -> Path:
        from experiments.kinds.sweep.write import write_sweep

        return write_sweep(out)

    def recompute(self, out: Path) -> int:
        from experiments.kinds.sweep.write import recompute_sweep

        return recompute_sweep(out)

    def compare(self, a: Path, b: Path) -> Compared:
        from experiments.kinds.sweep.agreement import compare_sweeps

        return compare_sweeps(a, b)
