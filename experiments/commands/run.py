"""``wkernels run``, ``report`` and ``explain``: what all kinds of experiment have in common."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from algorithms.plugins import load_all
from experiments.commands.progress import progress_display
from experiments.kinds.kind import Kind, kind_of_file, kind_of_folder


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
    kind, experiment, plugins = _load(config, overrides, plugin_files)
    folder = out or Path("out") / experiment.name
    options = {"device": device, "threads": threads, "resume": resume, "skips": skips}
    with _interruptible(folder), progress_display() as progress:
        told = kind.run(experiment, folder, plugins, progress, **options)
    print(told)


def explain_experiment(config: Path, *, overrides: Sequence[str], plugin_files: Sequence[Path]) -> None:
    """Prints what an experiment will do."""
    kind, experiment, plugins = _load(config, overrides, plugin_files)
    print(kind.explain(experiment, plugins))


def report_folder(folder: Path, *, recompute: bool = False) -> None:
    """Writes the report of a result folder again; ``recompute`` computes its metrics again first."""
    kind = kind_of_folder(folder)
    if recompute:
        print(f"{kind.recompute(folder)} rows computed again from their images.")
    print(f"Report: {kind.write_report(folder)}")


def _load(config: Path, overrides: Sequence[str], plugin_files: Sequence[Path]) -> tuple[Kind, Any, Mapping[str, type]]:
    kind = kind_of_file(config, overrides)
    plugins = load_all(plugin_files) if kind.techniques or plugin_files else {}
    return kind, kind.load(config, overrides, plugins), plugins


@contextmanager
def _interruptible(folder: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as error:
        print(f"\nInterrupted; what is done is in {folder}, --resume continues.", file=sys.stderr)
        for note in getattr(error, "__notes__", ()):
            print(note, file=sys.stderr)
        raise
