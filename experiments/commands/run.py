"""``wkernels run``, ``report`` and ``explain``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from algorithms.plugins import load_all
from experiments.commands.progress import progress_display
from experiments.config.analysis import is_analysis, load_analysis
from experiments.config.schema import load_experiment


def run_experiment(
    config: Path,
    out: Path | None,
    *,
    overrides: Sequence[str],
    device: str,
    threads: int | None,
    resume: bool,
    skips: bool,
    plugin_files: Sequence[Path],
) -> None:
    """Runs an experiment, which writes its report, and says where that is."""
    if is_analysis(config, overrides):
        from experiments.analysis import run_analysis

        analysis = load_analysis(config, overrides)
        table = run_analysis(analysis, out or Path("out") / analysis.name)
        _print_published(table.parent)
        print(f"Table: {table}")
        return
    from experiments.runner import run

    plugins = load_all(plugin_files)
    experiment = load_experiment(config, overrides, plugins)
    folder = out or Path("out") / experiment.name
    try:
        with progress_display() as progress:
            run(
                experiment,
                folder,
                device=device,
                threads=threads,
                resume=resume,
                skips=skips,
                plugins=plugins,
                progress=progress,
            )
    except KeyboardInterrupt:
        print(f"\nInterrupted; what is done is in {folder}, --resume continues.", file=sys.stderr)
        raise
    _print_published(folder)
    print(f"Report: {folder / 'report.html'}")


def _print_published(folder: Path) -> None:
    from experiments.published import published_text, read_published

    if text := published_text(read_published(folder)):
        print(f"{text}\n")


def report_folder(folder: Path) -> None:
    """Writes the report of a result folder again."""
    from experiments.report import write_report

    print(f"Report: {write_report(folder)}")


def explain_experiment(config: Path, *, overrides: Sequence[str], plugin_files: Sequence[Path]) -> None:
    """Prints what an experiment will do."""
    if is_analysis(config, overrides):
        from experiments.analysis import explain_analysis

        print(explain_analysis(load_analysis(config, overrides)))
        return
    from experiments.explain import explain

    plugins = load_all(plugin_files)
    print(explain(load_experiment(config, overrides, plugins), plugins))
