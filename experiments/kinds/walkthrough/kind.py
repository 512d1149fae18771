"""Kind ``walkthrough``; see ``experiments.kinds.kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.kinds.kind import Kind, Progress
from experiments.kinds.walkthrough.config import WalkthroughFile, load_experiment
from experiments.results.published import published_text, read_published


class WalkthroughKind(Kind):
    """Every listed technique on the frames of a path, compared with a reference."""

    name = "walkthrough"
    schemas = (WalkthroughFile,)

    def load(self, path: Path, overrides: Sequence[str], plugins: Mapping[str, Any]) -> Any:
        return load_experiment(path, overrides, plugins)

    def run(self, experiment: Any, out: Path, plugins: Mapping[str, Any], progress: Progress, **options: Any) -> str:
        from experiments.kinds.walkthrough.run import run

        run(experiment, out, plugins=plugins, progress=progress, **options)
        published = published_text(read_published(out))
        return (f"{published}\n\n" if published else "") + f"Report: {out / 'report.html'}"

    def tables(self) -> Mapping[str, Sequence[str]]:
        from experiments.results import published, store
        from experiments.results.prediction import PREDICTION_COLUMNS
        from experiments.results.summary import SUMMARY_COLUMNS

        return {
            **{f"{name}.csv": columns for name, columns in store.TABLES.items()},
            "summary.csv": SUMMARY_COLUMNS,
            "prediction.csv": PREDICTION_COLUMNS,
            "published.csv": published.COLUMNS,
        }

    def explain(self, experiment: Any, plugins: Mapping[str, Any]) -> str:
        from experiments.kinds.walkthrough.explain import explain

        return explain(experiment, plugins)

    def write_report(self, out: Path) -> Path:
        from experiments.kinds.walkthrough.report import write_report

        return write_report(out)

    def recompute(self, out: Path) -> int:
        from experiments.results.summary import recompute_metrics

        return recompute_metrics(out)
