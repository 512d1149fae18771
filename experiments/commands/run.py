"""``wkernels run``, ``report`` and ``explain``: each kind of experiment has its own loader, run and explanation."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from algorithms.plugins import load_all
from experiments.commands.progress import progress_display
from experiments.config.kinds import kind_of
from wkernels.errors import InputError


@dataclass(frozen=True)
class _Request:
    """What the command line asks for.

    Attributes:
        config: Experiment file.
        out: Result folder; None for ``out/NAME``.
        overrides: Texts of ``--set``.
        plugin_files: Files of ``--plugin``.
        options: Further arguments of ``runner.run`` and its like: device, threads, resume, skips.
    """

    config: Path
    out: Path | None
    overrides: Sequence[str]
    plugin_files: Sequence[Path]
    options: dict[str, Any]

    def folder(self, name: str) -> Path:
        return self.out or Path("out") / name


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
    options = {"device": device, "threads": threads, "resume": resume, "skips": skips}
    kinds = {
        "analysis": _run_analysis,
        "convergence": _run_convergence,
        "savings": _run_savings,
        "stability": _run_stability,
        "sweep": _run_sweep,
    }
    run = kinds.get(kind_of(config, overrides) or "", _run_walkthrough)
    run(_Request(config, out, overrides, plugin_files, options))


def _run_walkthrough(request: _Request) -> None:
    from experiments.kinds.walkthrough.config import load_experiment
    from experiments.kinds.walkthrough.run import run

    plugins = load_all(request.plugin_files)
    experiment = load_experiment(request.config, request.overrides, plugins)
    folder = request.folder(experiment.name)
    with _interruptible(folder), progress_display() as progress:
        run(experiment, folder, plugins=plugins, progress=progress, **request.options)
    _print_published(folder)
    print(f"Report: {folder / 'report.html'}")


def _run_analysis(request: _Request) -> None:
    from experiments.kinds.analysis.config import load_analysis
    from experiments.kinds.analysis.run import run_analysis

    analysis = load_analysis(request.config, request.overrides)
    table = run_analysis(analysis, request.folder(analysis.name))
    _print_published(table.parent)
    print(f"Table: {table}")


def _run_convergence(request: _Request) -> None:
    from experiments.kinds.convergence.config import Estimates, load_convergence
    from experiments.kinds.convergence.estimates import estimates_text, run_estimates
    from experiments.kinds.convergence.run import run_convergence

    plugins = load_all(request.plugin_files)
    convergence = load_convergence(request.config, request.overrides, plugins)
    folder = request.folder(convergence.name)
    if isinstance(convergence, Estimates):
        table = run_estimates(convergence, folder)
        print(f"{estimates_text(convergence)}\nTable: {table}")
        return
    with _interruptible(folder), progress_display() as progress:
        run_convergence(convergence, folder, plugins=plugins, progress=progress, **request.options)
    print(f"Report: {folder / 'report.html'}")


def _run_stability(request: _Request) -> None:
    from experiments.kinds.stability.config import load_stability
    from experiments.kinds.stability.run import run_stability, summary_text
    from experiments.results.tables import read_table

    plugins = load_all(request.plugin_files)
    stability = load_stability(request.config, request.overrides, plugins)
    folder = request.folder(stability.name)
    with _interruptible(folder), progress_display() as progress:
        table = run_stability(stability, folder, plugins, progress=progress, **request.options)
    print(f"{summary_text(read_table(table))}\nTable: {table}\nReport: {folder / 'report.html'}")


def _run_sweep(request: _Request) -> None:
    from experiments.kinds.sweep.config import load_sweep
    from experiments.kinds.sweep.run import run_sweep
    from experiments.results.tables import read_table

    plugins = load_all(request.plugin_files)
    sweep = load_sweep(request.config, request.overrides, plugins)
    folder = request.folder(sweep.name)
    with _interruptible(folder), progress_display() as progress:
        run_sweep(sweep, folder, plugins=plugins, progress=progress, **request.options)
    for row in read_table(folder / "recommendation.csv"):
        print(f"{row['scene']}: {row['reason']}")
    print(f"Report: {folder / 'report.html'}")


def _run_savings(request: _Request) -> None:
    from experiments.kinds.savings.config import load_savings
    from experiments.kinds.savings.report import write_savings_report
    from experiments.kinds.savings.run import run_savings, savings_text
    from experiments.results.tables import read_table

    plugins = load_all(request.plugin_files)
    savings = load_savings(request.config, request.overrides, plugins)
    folder = request.folder(savings.name)
    with _interruptible(folder), progress_display() as progress:
        table = run_savings(savings, folder, plugins, progress=progress, **request.options)
    print(f"{savings_text(read_table(table))}\nTable: {table}\nReport: {write_savings_report(folder)}")


@contextmanager
def _interruptible(folder: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as error:
        print(f"\nInterrupted; what is done is in {folder}, --resume continues.", file=sys.stderr)
        for note in getattr(error, "__notes__", ()):
            print(note, file=sys.stderr)
        raise


def _print_published(folder: Path) -> None:
    from experiments.results.published import published_text, read_published

    if text := published_text(read_published(folder)):
        print(f"{text}\n")


def report_folder(folder: Path, *, recompute: bool = False) -> None:
    """Writes the report of a result folder again; ``recompute`` computes its metrics again first."""
    from experiments.kinds.convergence.report import write_convergence_report
    from experiments.kinds.savings.report import is_savings, write_savings_report
    from experiments.kinds.stability.report import is_stability, write_stability_report
    from experiments.kinds.sweep.store import is_sweep
    from experiments.kinds.sweep.write import write_sweep
    from experiments.report import recompute_metrics, write_report

    if is_sweep(folder):
        print(f"Report: {write_sweep(folder, recompute=recompute)}")
        return
    kinds = (
        ("stability", is_stability(folder), write_stability_report),
        ("convergence", (folder / "convergence.csv").is_file(), write_convergence_report),
        ("savings", is_savings(folder), write_savings_report),
    )
    for kind, is_it, write in kinds:
        if is_it:
            if recompute:
                raise InputError(f"is of the kind {kind}, whose rows cannot be computed again.", file=folder)
            print(f"Report: {write(folder)}")
            return
    if recompute:
        print(f"{recompute_metrics(folder)} rows computed again from their images.")
    print(f"Report: {write_report(folder)}")


def explain_experiment(config: Path, *, overrides: Sequence[str], plugin_files: Sequence[Path]) -> None:
    """Prints what an experiment will do."""
    kind = kind_of(config, overrides)
    if kind == "analysis":
        from experiments.kinds.analysis.config import load_analysis
        from experiments.kinds.analysis.run import explain_analysis

        print(explain_analysis(load_analysis(config, overrides)))
        return
    plugins = load_all(plugin_files)
    if kind == "stability":
        from experiments.kinds.stability.config import load_stability
        from experiments.kinds.stability.run import explain_stability

        print(explain_stability(load_stability(config, overrides, plugins), plugins))
    elif kind == "sweep":
        from experiments.kinds.sweep.config import load_sweep
        from experiments.kinds.sweep.run import explain_sweep

        print(explain_sweep(load_sweep(config, overrides, plugins), plugins))
    elif kind == "savings":
        from experiments.kinds.savings.config import load_savings
        from experiments.kinds.savings.run import explain_savings

        print(explain_savings(load_savings(config, overrides, plugins), plugins))
    elif kind == "convergence":
        from experiments.kinds.convergence.config import Estimates, load_convergence
        from experiments.kinds.convergence.run import explain_convergence

        convergence = load_convergence(config, overrides, plugins)
        if isinstance(convergence, Estimates):
            print(f"Experiment {convergence.name} (convergence): estimates from {len(convergence.tests)} shadow tests")
        else:
            print(explain_convergence(convergence, plugins))
    else:
        from experiments.kinds.walkthrough.config import load_experiment
        from experiments.kinds.walkthrough.explain import explain

        print(explain(load_experiment(config, overrides, plugins), plugins))
