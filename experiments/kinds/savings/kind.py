"""Kind ``savings``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.kind import Kind, Progress
from experiments.kinds.savings.config import SavingsFile, load_savings
from experiments.results.tables import read_table


class SavingsKind(Kind):
    """What leaving out work saves, rule by rule."""

    name = "savings"
    schemas = (SavingsFile,)

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_savings(path, overrides, plugins)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        from experiments.kinds.savings.report import write_savings_report
        from experiments.kinds.savings.run import run_savings, savings_text

        table = run_savings(experiment, out, plugins, progress=progress, **options)
        return f"{savings_text(read_table(table))}\nTable: {table}\nReport: {write_savings_report(out)}"

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.kinds.savings import run

        return {"savings.csv": run.COLUMNS}

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        from experiments.kinds.savings.explain import explain_savings

        return explain_savings(experiment, plugins)

    def write_report(self, out: Path) -> Path:
        from experiments.kinds.savings.report import write_savings_report

        return write_savings_report(out)
