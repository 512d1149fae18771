"""Kind ``stability``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.kind import Kind, Progress
from experiments.kinds.stability.config import StabilityFile, load_stability
from experiments.results.tables import read_table


class StabilityKind(Kind):
    """Every technique on stiff and extreme cases of rising stiffness, and where it breaks."""

    name = "stability"
    schemas = (StabilityFile,)

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_stability(path, overrides, plugins)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        from experiments.kinds.stability.run import run_stability, summary_text

        table = run_stability(experiment, out, plugins, progress=progress, **options)
        return f"{summary_text(read_table(table))}\nTable: {table}\nReport: {out / 'report.html'}"

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.kinds.stability import table

        return {"stability.csv": table.COLUMNS}

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        from experiments.kinds.stability.explain import explain_stability

        return explain_stability(experiment, plugins)

    def write_report(self, out: Path) -> Path:
        from experiments.kinds.stability.report import write_stability_report

        return write_stability_report(out)
