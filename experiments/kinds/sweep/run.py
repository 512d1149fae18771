"""``run_sweep``: the result folder of ``kind: sweep``."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.kinds.kind import Progress
from experiments.kinds.sweep.store import SweepStore
from experiments.kinds.sweep.write import write_sweep, write_tables
from experiments.kinds.walkthrough.run import run
from experiments.metrics.registry import METRICS
from experiments.rendering.engine import Engine, check_device
from experiments.results.environment import declared, describe_machine, text_digest
from experiments.results.failures import TechniquesFailed
from experiments.results.store import Store
from experiments.results.tables import read_table, write_text
from wkernels import __version__
from wkernels.device.launch import default_threads
from wkernels.errors import InputError

if TYPE_CHECKING:
    from experiments.kinds.sweep.config import Sweep, SweepScene
    from experiments.schema.experiment import Experiment

Row = dict[str, Any]


class SweepFailed(TechniquesFailed):
    """Some techniques or scenes failed; everything else was run and stored, report included."""

    def __init__(self, out: Path, rows: list[dict[str, str]]) -> None:
        self.out, self.labels = out, tuple(row["label"] for row in rows)
        first = rows[0]
        who = f"'{first['label']}' failed in '{first['scene']}'" if first["label"] else f"'{first['scene']}' failed"
        more = f" ({len(rows) - 1} more)" if len(rows) > 1 else ""
        where = f"All failures are in {out / 'failures.csv'}, the other results in {out}."
        RuntimeError.__init__(self, f"{who}: {first['error']}{more}. {where}")


def run_sweep(
    sweep: Sweep,
    out: str | Path,
    *,
    device: str = "cpu",
    threads: int | None = None,
    resume: bool = False,
    skips: bool = True,
    plugins: Mapping[str, type],
    progress: Progress | None = None,
    engine: Callable[[Experiment], Engine] | None = None,
    report: bool = True,
) -> Path:
    """Runs every scene of a sweep as a walkthrough, writes its report, and tables and report over all of them.

    A label or scene that fails is a row in failures.csv, and the rest goes on.

    Args:
        sweep: The resolved sweep.
        out: Result folder; created where missing.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; None for all.
        resume: Continue an interrupted run of the same sweep; rows that are there are kept.
        skips: Whether work that a scene cannot need may be left out.
        plugins: Technique classes by name.
        progress: Is told what happens; counts frames of labels over all scenes.
        engine: Makes the renderer of a scene's experiment; None for ``WarpEngine``.
        report: Whether to write the scenes' summaries, plots and pages, and those over all of them.

    Returns:
        The result folder.

    Raises:
        InputError: Wrong input; the folder cannot be written, or holds another experiment.
        SweepFailed: At the end, if something failed.
        KeyboardInterrupt: Passed on; the run can be resumed.
    """
    if engine is None:
        check_device(device)
    environment = describe_sweep(sweep, plugins, device=device, threads=threads or default_threads(), skips=skips)
    store = SweepStore.open(out, sweep.to_yaml(), environment, resume=resume)
    failures: list[Row] = []
    total = sum(len(scene.experiment.runs) * len(scene.experiment.frames) for scene in sweep.scenes)
    before = 0
    for scene in sweep.scenes:
        tell = _shifted(progress, scene.name, before, total)
        options: dict[str, Any] = {"device": device, "threads": threads, "skips": skips, "plugins": plugins}
        folder = store.scene(scene.name)
        reported = _rows(folder) if (folder / "report.html").is_file() else None
        try:
            _run_scene(scene, store, failures, resume, tell, engine, options)
        except InputError:
            raise
        except Exception as error:
            failures.append(_record(store, scene.name, error))
        before += len(scene.experiment.runs) * len(scene.experiment.frames)
        tell = _shifted(progress, scene.name, before, total)
        if report and folder.is_dir() and _rows(folder) != reported:
            _report_scene(store, scene.name, tell, failures)
        with suppress(OSError):  # they are all written again at the end
            write_tables(store, failures)
    if progress:
        progress(total, total, "writing the report")
    if any(_rows(store.scene(scene.name))[0] for scene in sweep.scenes) and report:
        write_sweep(store.out, scene_failures=failures)
    else:
        write_tables(store, failures)
    if progress:
        progress(total, total, "done")
    if rows := store.rows("failures"):
        raise SweepFailed(store.out, rows)
    return store.out


def _run_scene(
    scene: SweepScene,
    store: SweepStore,
    failures: list[Row],
    resume: bool,
    tell: Progress,
    engine: Callable[[Experiment], Engine] | None,
    options: dict[str, Any],
) -> None:
    frames = len(scene.experiment.frames)
    unserved = [
        {"label": run.label, "what": "every frame: the scene does not serve it", "reason": why, "count": frames}
        for run, why in scene.unserved
    ]
    made = engine(scene.experiment) if engine else None
    try:
        run(
            scene.experiment,
            store.scene(scene.name),
            resume=resume,
            progress=tell,
            engine=made,
            report=False,
            left_out=unserved,
            refusals_fail=True,
            **options,
        )
    except TechniquesFailed as failed:
        if failed.unwritten:  # of the rest there are rows in its failures.csv
            failures.append(_record(store, scene.name, failed))


def _rows(folder: Path) -> tuple[int, int]:
    """How many frames and failures a scene's folder holds; its report, which is written last, is about all of them."""
    return len(read_table(folder / "frames.csv")), len(read_table(folder / "failures.csv"))


def _report_scene(store: SweepStore, name: str, tell: Progress, failures: list[Row]) -> None:
    """Writes a scene's report; one that cannot be written is a failure and no reason to stop."""
    from experiments.kinds.walkthrough.report import write_report
    from experiments.results.summary import write_summary

    tell(0, 0, "writing the report")
    try:
        write = write_report if Store(store.scene(name)).rows("frames") else write_summary
        write(store.scene(name))
    except Exception as error:
        failures.append(_record(store, name, error))


def _shifted(progress: Progress | None, name: str, before: int, every: int) -> Progress:
    """Tells of one scene's progress as part of all."""

    def tell(done: int, total: int, what: str) -> None:
        if progress and what != "done":
            progress(before + done, every, f"{name}: {what}")

    return tell


def _record(store: SweepStore, scene: str, error: Exception) -> Row:
    """A failure of a whole scene as a row of failures.csv, and its traceback in a file."""
    short = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    try:
        (store.out / "failures").mkdir(exist_ok=True)
        write_text(store.out / "failures" / f"{scene}.txt", "".join(traceback.format_exception(error)))
    except OSError:
        pass  # a full disk is the likeliest failure of a scene; the row says what happened
    return {"scene": scene, "technique": None, "label": None, "frame": None, "error": short, "what": "scene"}


def describe_sweep(
    sweep: Sweep, plugins: Mapping[str, type], *, device: str, threads: int, skips: bool
) -> dict[str, Any]:
    """environment.json of a sweep; see ``experiments.results.environment.describe_run``."""
    same = sweep.scenes[0].experiment
    labels = [{"label": run.label, "technique": run.name, **declared(plugins[run.name])} for run in sweep.runs]
    return {
        "identity": {
            "config": text_digest(sweep.to_yaml()),
            "device": device,
            "threads": threads,
            "skips": skips,
            "wkernels": __version__,
        },
        "run": {
            "name": sweep.name,
            "kind": "sweep",
            "width": same.image.width,
            "height": same.image.height,
            "reference_samples": same.reference.samples if same.reference else None,
            "reference_light": same.reference.light if same.reference else None,
            "repeats": same.repeats,
            "baseline": sweep.baseline,
            "budgets": list(sweep.budgets),
            "labels": labels,
            "scenes": [_described(scene) for scene in sweep.scenes],
        },
        "environment": describe_machine(device, threads),
        "metrics": {metric.name: metric.version for metric in METRICS.values()},
    }


def _described(scene: SweepScene) -> dict[str, Any]:
    loaded = scene.experiment.load_scene()
    return {
        "name": scene.name,
        "triangles": int(sum(len(mesh.faces) for mesh in loaded.meshes)),
        "light": loaded.lights[scene.experiment.light].kind,
        "frames": list(scene.experiment.frames),
        "labels": [run.label for run in scene.experiment.runs],
        "left_out": [{"label": run.label, "reason": why} for run, why in scene.unserved],
    }
