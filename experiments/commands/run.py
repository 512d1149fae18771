"""``wkernels run``, ``report`` and ``explain``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from algorithms.plugins import load_all
from experiments.commands.progress import progress_display
from experiments.config.analysis import load_analysis
from experiments.config.convergence import Convergence, Estimates, load_convergence
from experiments.config.kinds import kind_of
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
    kind = kind_of(config, overrides)
    if kind == "analysis":
        from experiments.analysis import run_analysis

        analysis = load_analysis(config, overrides)
        print(f"Table: {run_analysis(analysis, out or Path('out') / analysis.name)}")
        return
    from experiments.convergence import run_convergence
    from experiments.runner import run

    plugins = load_all(plugin_files)
    load = load_convergence if kind == "convergence" else load_experiment
    experiment = load(config, overrides, plugins)
    folder = out or Path("out") / experiment.name
    if isinstance(experiment, Estimates):
        from experiments.estimates import estimates_text, run_estimates

        table = run_estimates(experiment, folder)
        print(f"{estimates_text(experiment)}\nTable: {table}")
        return
    options: dict[str, Any] = {"device": device, "threads": threads, "resume": resume, "skips": skips}
    try:
        with progress_display() as progress:
            if isinstance(experiment, Convergence):
                run_convergence(experiment, folder, plugins=plugins, progress=progress, **options)
            else:
                run(experiment, folder, plugins=plugins, progress=progress, **options)
    except KeyboardInterrupt:
        print(f"\nInterrupted; what is done is in {folder}, --resume continues.", file=sys.stderr)
        raise
    print(f"Report: {folder / 'report.html'}")


def report_folder(folder: Path) -> None:
    """Writes the report of a result folder again."""
    from experiments.report import write_report
    from experiments.report.convergence import write_convergence_report

    write = write_convergence_report if (folder / "convergence.csv").is_file() else write_report
    print(f"Report: {write(folder)}")


def explain_experiment(config: Path, *, overrides: Sequence[str], plugin_files: Sequence[Path]) -> None:
    """Prints what an experiment will do."""
    kind = kind_of(config, overrides)
    if kind == "analysis":
        from experiments.analysis import explain_analysis

        print(explain_analysis(load_analysis(config, overrides)))
        return
    from experiments.explain import explain

    plugins = load_all(plugin_files)
    if kind == "convergence":
        from experiments.convergence import explain_convergence

        convergence = load_convergence(config, overrides, plugins)
        if isinstance(convergence, Estimates):
            print(f"Experiment {convergence.name} (convergence): estimates from {len(convergence.tests)} shadow tests")
        else:
            print(explain_convergence(convergence, plugins))
        return
    print(explain(load_experiment(config, overrides, plugins), plugins))
