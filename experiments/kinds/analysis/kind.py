"""Kind ``analysis``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.analysis.config import AnalysisFile, load_analysis
from experiments.kinds.kind import Kind, Progress
from experiments.results.published import published_text, read_published


class AnalysisKind(Kind):
    """Aliasing error along the view, from formulas alone."""

    name = "analysis"
    schemas = (AnalysisFile,)
    techniques = False

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_analysis(path, overrides)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        from experiments.kinds.analysis.run import run_analysis

        table = run_analysis(experiment, out)
        published = published_text(read_published(out))
        return (f"{published}\n\n" if published else "") + f"Table: {table}"

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.kinds.analysis import run

        return {"analysis.csv": run.COLUMNS, "factors.csv": run.FACTORS}

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        from experiments.kinds.analysis.explain import explain_analysis

        return explain_analysis(experiment)
