"""Kind ``convergence``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.convergence.config import ConvergenceFile, Estimates, EstimatesFile, load_convergence
from experiments.kinds.kind import Kind, Progress


class ConvergenceKind(Kind):
    """Error over the frames of a still camera, or over light samples."""

    name = "convergence"
    schemas = (ConvergenceFile, EstimatesFile)

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_convergence(path, overrides, plugins)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        if isinstance(experiment, Estimates):
            from experiments.kinds.convergence.estimates import estimates_text, run_estimates

            return f"{estimates_text(experiment)}\nTable: {run_estimates(experiment, out)}"
        from experiments.kinds.convergence.run import run_convergence

        run_convergence(experiment, out, plugins=plugins, progress=progress, **options)
        return f"Report: {out / 'report.html'}"

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.kinds.convergence import estimates, report
        from experiments.kinds.convergence.store import CONVERGENCE_COLUMNS

        return {
            "convergence.csv": CONVERGENCE_COLUMNS,
            "convergence summary.csv": report.SUMMARY_COLUMNS,
            "estimates.csv": estimates.COLUMNS,
        }

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        if isinstance(experiment, Estimates):
            return f"Experiment {experiment.name} (convergence): estimates from {len(experiment.tests)} shadow tests"
        from experiments.kinds.convergence.explain import explain_convergence

        return explain_convergence(experiment, plugins)

    def write_report(self, out: Path) -> Path:
        from experiments.kinds.convergence.report import write_convergence_report

        return write_convergence_report(out)
