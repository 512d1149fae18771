"""What leaving out saves: every technique with its skips, without them, and without each one, in turns.

One session per side walks the same frames in the same order; each frame is rendered ``repeats`` times, the sides in
turns, so that a slow second of the machine hits all of them. A skip is judged by the frames in which it happened.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.rendering.engine import WarpEngine
from experiments.results.environment import describe_machine, file_digest
from experiments.results.failures import TechniquesFailed
from experiments.results.store import Store
from experiments.results.tables import Row, Table, read_table, table_text, write_text
from wkernels import __version__
from wkernels.device.launch import default_threads
from wkernels.errors import InputError

if TYPE_CHECKING:
    from experiments.kinds.kind import Progress
    from experiments.kinds.savings.config import Savings
    from experiments.schema.techniques import TechniqueRun
    from wkernels.frame.session import Session
    from wkernels.workspace.left_out import Reasoned

COLUMNS = (
    "scene", "technique", "label", "what", "ms_without", "ms_with", "saving_ms", "ratio", "image_difference",
    "reason", "count", "frames",
)  # fmt: skip
EVERYTHING = "everything"
"""``what`` of the row in which all skips are off; its reason is empty."""


@dataclass
class _Side:
    """One session on its way, and what it measured: per frame milliseconds, image, and what was left out."""

    session: Session
    technique: Any
    ms: list[float] = field(default_factory=list)
    images: list[np.ndarray] = field(default_factory=list)
    left_out: list[dict[Reasoned, int]] = field(default_factory=list)
    _timed: list[float] = field(default_factory=list)

    def render(self, frame: int) -> None:
        self.session.begin(frame)
        result = self.session.render(self.technique)
        self._timed.append(result.frame_ms)
        if len(self._timed) == 1:  # repeats give the same
            self.images.append(result.visibility)
            self.left_out.append({(what, reason): count for what, reason, count in result.left_out})

    def commit(self) -> None:
        self.ms.append(float(np.median(self._timed)))
        self._timed.clear()
        self.session.advance()


def measure(engine: WarpEngine, run: TechniqueRun, walk: Sequence[int], repeats: int) -> list[Row]:
    """Rows of one label: each skip that can be taken back alone, then all of them together.

    Args:
        engine: Of the experiment.
        run: The label.
        walk: Frames in the order in which they are rendered.
        repeats: Timed renderings of each.
    """
    ours, without = _Side(*engine.open(run)), _Side(*engine.open(run, skips=False))
    _walk([ours, without], walk, 1)  # warms up, and finds out what is left out
    found: dict[Reasoned, int] = {}
    for told, anyway in zip(ours.left_out, without.left_out, strict=True):
        for omission, count in told.items():
            if omission not in anyway and omission not in ours.session.inherent:
                found[omission] = found.get(omission, 0) + count
    each = {omission: _Side(*engine.open(run, done_anyway=[omission])) for omission in found}
    _walk(list(each.values()), walk, 1)  # all alike, so that history is: a reset would build slow products again
    sides = [ours, without, *each.values()]
    for side in sides:
        side.ms, side.images, side.left_out = [], [], []
    _walk(sides, walk, repeats)
    key: dict[str, Any] = {"scene": engine.scene.name, "technique": run.name, "label": run.label}
    frames = list(range(len(walk)))
    rows: list[Row] = []
    for (what, reason), side in each.items():
        happened = [i for i in frames if (what, reason) in ours.left_out[i]]
        if happened:
            row = key | {"what": what, "reason": reason, "count": sum(ours.left_out[i][what, reason] for i in happened)}
            rows.append({**row, **_compared(ours, side, happened)})
    # the last one, which says that the label is complete
    everything = key | {"what": EVERYTHING, "count": sum(row["count"] for row in rows)}
    return [*rows, {**everything, **_compared(ours, without, frames)}]


def _walk(sides: Sequence[_Side], walk: Sequence[int], repeats: int) -> None:
    for frame in walk:
        for _ in range(repeats):
            for side in sides:
                side.render(frame)
        for side in sides:
            side.commit()


def _compared(ours: _Side, other: _Side, frames: Sequence[int]) -> dict[str, Any]:
    """Medians over frames; the ratio is the median of the frames' own. The images of all frames are compared."""
    ms_with, ms_without = np.array(ours.ms)[frames], np.array(other.ms)[frames]
    return {
        "ms_without": float(np.median(ms_without)),
        "ms_with": float(np.median(ms_with)),
        "saving_ms": float(np.median(ms_without - ms_with)),
        "ratio": float(np.median(ms_without / ms_with)),
        "image_difference": max(_difference(a, b) for a, b in zip(ours.images, other.images, strict=True)),
        "frames": len(frames),
    }


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of two images; infinite where only one of them has a receiver."""
    if not np.array_equal(np.isnan(a), np.isnan(b)):
        return float("inf")
    return float(np.nanmax(np.abs(a - b))) if np.isfinite(a).any() else 0.0


def run_savings(
    savings: Savings,
    out: str | Path,
    plugins: Mapping[str, type],
    *,
    device: str = "cpu",
    threads: int | None = None,
    resume: bool = False,
    skips: bool = True,
    progress: Progress | None = None,
) -> Path:
    """Measures every label in every scene and writes savings.csv as it goes.

    Args:
        savings: The resolved experiment.
        out: Result folder; created where missing.
        plugins: Technique classes by name.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; None for all.
        resume: Keep the labels that an interrupted run of the same experiment has completed.
        skips: Must be True.
        progress: Is told what happens; counts labels.

    Returns:
        savings.csv.

    Raises:
        InputError: Skips are off; the folder cannot be written, or holds something else; no such device.
        TechniquesFailed: At the end, if a technique raised; the others are complete.
    """
    if not skips:
        raise InputError("an experiment of kind savings runs with and without them.", key="--no-skips")
    out = Path(out)
    environment: dict[str, Any] = {
        "identity": _identity(savings, plugins, device, threads or default_threads()),
        "run": {"name": savings.name, "kind": "savings", "scenes": [e.loaded_scene.name for e in savings.experiments]},
        "environment": describe_machine(device, threads or default_threads()),
        "metrics": {},
    }
    kept = _kept(out, savings, environment["identity"]) if resume else []
    store = Store.open(out, savings.to_yaml(), environment, resume=False)
    path = out / "savings.csv"
    write_text(path, table_text(COLUMNS, kept))
    table = Table(path, COLUMNS)
    done = {(row["scene"], row["label"]) for row in kept}
    total, count = sum(len(experiment.runs) for experiment in savings.experiments), 0
    try:
        for experiment in savings.experiments:
            engine = WarpEngine(experiment, device=device, threads=threads, plugins=plugins)
            for run in experiment.runs:
                if progress:
                    progress(count, total, f"{engine.scene.name}, {run.label}")
                if (engine.scene.name, run.label) not in done:
                    try:
                        table.append(measure(engine, run, savings.walk(experiment), experiment.repeats))
                    except InputError:
                        raise
                    except Exception as error:
                        store.record_failure(run.name, run.label, experiment.frames[0], error)
                count += 1
    finally:
        table.close()
        store.close()
    if progress:
        progress(count, total, "done")
    if failures := store.rows("failures"):
        raise TechniquesFailed(out, failures)
    return path


def _identity(savings: Savings, plugins: Mapping[str, type], device: str, threads: int) -> dict[str, Any]:
    """What rows must share to be comparable."""
    scenes = {f"scene {e.loaded_scene.name}": e.loaded_scene.content_hash for e in savings.experiments}
    used = sorted({run.name for experiment in savings.experiments for run in experiment.runs})
    digests = {f"plugin {name}": file_digest(inspect.getfile(plugins[name])) for name in used}
    return {"wkernels": __version__, "device": device, "threads": threads, **scenes, **digests}


def _kept(out: Path, savings: Savings, identity: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of labels that are complete, if the folder holds an earlier run of the same experiment."""
    config = out / "config.yaml"
    if not config.is_file() or config.read_text(encoding="utf-8") != savings.to_yaml():
        return []
    if Store(out).environment().get("identity") != identity:
        return []
    rows = read_table(out / "savings.csv")
    complete = {(row["scene"], row["label"]) for row in rows if row["what"] == EVERYTHING}
    return [row for row in rows if (row["scene"], row["label"]) in complete]


def savings_text(rows: Sequence[Row]) -> str:
    """A line per label and skip."""
    width = max((len(f"{row['scene']}, {row['label']}") for row in rows), default=0)
    lines = []
    for row in rows:
        what = f"{row['what']}: {row['reason']}" if row["reason"] else row["what"]
        shows = "" if float(row["image_difference"]) == 0.0 else f"; images differ by {row['image_difference']}"
        name = f"{row['scene']}, {row['label']}"
        lines.append(
            f"{name:<{width}}  {float(row['ms_without']):8.2f} -> {float(row['ms_with']):8.2f} ms, "
            f"{float(row['ratio']):6.2f} times  {what}{shows}"
        )
    return "\n".join(lines)
