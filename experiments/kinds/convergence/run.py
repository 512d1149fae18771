"""``kind: convergence``: how error and standard error fall with frames or light samples.

After Scherzer et al. 2009, Figs 2 and 3.

Step by step, every label that goes over frames renders one more and every label that goes over samples renders with so
many. Nothing is timed. Rows are stored as they are made; a resumed run renders again what a history needs and keeps
every row that is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.kinds.convergence.config import SAMPLES, Convergence
from experiments.kinds.convergence.store import ConvergenceStore
from experiments.kinds.kind import Progress
from experiments.metrics import registry as metrics
from experiments.rendering.engine import Engine, FrameLike, SessionLike, WarpEngine, check_result
from experiments.results.environment import describe_run, text_digest
from experiments.results.failures import attempt_report, raise_failures
from experiments.results.images import (
    error_view,
    shaded_view,
    standard_error_view,
    visibility_view,
    write_exr,
    write_png,
)
from wkernels.errors import InputError

if TYPE_CHECKING:
    from experiments.schema.techniques import TechniqueRun

REACH = 2.0  # standard errors within which the true error should lie

Images = tuple[np.ndarray, np.ndarray]


def measure(visibility: np.ndarray, standard_error: np.ndarray | None, reference: Images) -> dict[str, Any]:
    """Errors of one step, as columns of convergence.csv; what cannot be known is None.

    Penumbra pixels are those whose reference lies between 0 and 1. ``coverage_2se`` is the share of them whose true
    error is at most twice the technique's own standard error at the pixel; ``zero_standard_error`` the share whose
    tests all agreed, which claims certainty; ``n_effective`` the median number of independent samples that visibility v
    and standard error s state together, 1 + v (1 - v) / s^2 (Scherzer et al. 2009, equation 3).

    Args:
        visibility: (H, W), NaN where no receiver is seen.
        standard_error: (H, W) of the technique; None where it has none.
        reference: Visibility and standard error of the reference, (H, W) each.
    """
    measured = metrics.Measured(visibility, standard_error, *reference)
    found = metrics.evaluate(frozenset(), measured)
    kept = ("rmse", "mean_signed_error", "p99_error", "standard_error", "reference_standard_error")
    out: dict[str, Any] = {name: found[name] for name in kept}
    with np.errstate(invalid="ignore"):
        penumbra = np.isfinite(visibility) & (reference[0] > 0.0) & (reference[0] < 1.0)
    out["receiver_pixels"] = int(np.isfinite(visibility).sum())
    out["penumbra_pixels"] = int(penumbra.sum())
    if not penumbra.any():
        return out
    v = visibility[penumbra].astype(np.float64)
    error = v - reference[0][penumbra]
    out["penumbra_rmse"] = float(np.sqrt(np.mean(error**2)))
    if standard_error is None:
        return out
    s = standard_error[penumbra].astype(np.float64)
    out["penumbra_standard_error"] = float(np.sqrt(np.mean(s**2)))
    out["coverage_2se"] = float(np.mean(np.abs(error) <= REACH * s))
    out["zero_standard_error"] = float(np.mean(s == 0.0))
    known = s > 0.0
    if known.any():
        # An error of 1 stands for "one sample, nothing known" (wkernels/sampling/estimators.py).
        n = np.where(s[known] >= 1.0, 1.0, 1.0 + np.clip(v * (1.0 - v), 0.0, None)[known] / s[known] ** 2)
        out["n_effective"] = float(np.median(n))
    return out


def run_convergence(
    convergence: Convergence,
    out: str | Path,
    *,
    device: str = "cpu",
    threads: int | None = None,
    resume: bool = False,
    skips: bool = True,
    plugins: Mapping[str, type] | None = None,
    progress: Progress | None = None,
    engine: Engine | None = None,
    report: bool = True,
) -> Path:
    """Runs a convergence experiment and writes its result folder; arguments and errors are those of ``runner.run``."""
    from experiments.kinds.convergence.report import write_convergence_report

    if engine is None:
        engine = WarpEngine(convergence.experiment, device=device, threads=threads, skips=skips, plugins=plugins)
    text = convergence.to_yaml()
    environment = describe_run(convergence.experiment, engine, skips=skips)
    environment["identity"]["config"] = text_digest(text)
    environment["identity"].pop("processor")  # nothing is timed
    environment["run"] |= {
        "kind": "convergence",
        "camera": convergence.camera,
        "frame": convergence.frame,
        "steps": list(convergence.steps),
        "crop": convergence.crop.model_dump() if convergence.crop else None,
        "expected": sum(len(convergence.measured(run.label)) for run in convergence.experiment.runs),
    }
    store = ConvergenceStore.open(out, text, environment, resume=resume)
    work = _Work(convergence, engine, store, progress or (lambda done, total, what: None))
    with store.writing():
        work.render_all()
        store.put_in_order([run.label for run in convergence.experiment.runs])
        if report and store.rows(store.main):
            work.tell(work.done, work.total, "writing the report")
            attempt_report(store, write_convergence_report)
    work.tell(work.done, work.total, "done")
    raise_failures(store)
    return store.out


@dataclass(eq=False)
class _Lane:
    """One label on its way through the steps."""

    run: TechniqueRun
    axis: str
    history: bool
    todo: set[int]
    failed: bool = False
    rendered: bool = False  # once, in this part of the run
    session: SessionLike | None = None
    technique: Any = None

    def renders(self, step: int) -> bool:
        if self.failed or not self.todo:
            return False
        return step in self.todo or (self.history and step < max(self.todo))


class _Work:
    def __init__(self, convergence: Convergence, engine: Engine, store: ConvergenceStore, tell: Progress) -> None:
        self.convergence, self.engine, self.store, self.tell = convergence, engine, store, tell
        stored = store.done()
        failed = store.failed()
        self.lanes, self.total = [], 0
        for run in convergence.experiment.runs:
            steps = convergence.measured(run.label)
            needs = getattr(engine.plugins[run.name], "needs", None)
            todo = {step for step in steps if (run.label, step) not in stored}
            history = bool(getattr(needs, "history", False))
            self.lanes.append(_Lane(run, convergence.axes[run.label], history, todo, run.label in failed))
            self.total += len(steps)
        self.done = len(stored)
        self._reference: tuple[int, Images | None] | None = None
        self._shown: set[int] = set()

    def render_all(self) -> None:
        for step in range(1, self.convergence.steps[-1] + 1):
            for lane in self.lanes:
                if lane.renders(step):
                    self._render(lane, step)

    def _render(self, lane: _Lane, step: int) -> None:
        frame = self.convergence.frame_of(step) if lane.axis == "frames" else self.convergence.frame_of(1)
        reference = self._reference_of(frame, step) if step in lane.todo else None
        self.tell(self.done, self.total, f"step {step}, {lane.run.label}")
        try:
            if lane.session is None:
                lane.session, lane.technique = self.engine.open(lane.run)
            if lane.axis == SAMPLES:
                cls: Any = self.engine.plugins[lane.run.name]
                lane.technique = cls(cls.Params(**{**lane.run.params, SAMPLES: step}))
            lane.session.begin(frame)
            result = lane.session.render(lane.technique)
            lane.session.advance()
            check_result(result, self.convergence.experiment.image)
            if reference is not None:
                self._store(lane, step, result, reference)
            lane.rendered = True
        except (Exception, SystemExit) as error:
            if isinstance(error, InputError) and not lane.rendered:
                raise
            self._fail(lane, step, error)

    def _reference_of(self, frame: int, step: int) -> Images | None:
        """The reference of a frame; None, and a failure, where it cannot be made."""
        if self.convergence.camera == "still":
            frame = 0
        if self._reference is None or self._reference[0] != frame:
            self.tell(self.done, self.total, f"reference of {self.convergence.reference.samples} samples")
            try:
                self._reference = (frame, self.engine.reference(frame))
            except Exception as error:
                self.store.record_failure("", "", step, error, "reference")
                self._reference = (frame, None)
        return self._reference[1]

    def _store(self, lane: _Lane, step: int, result: FrameLike, reference: Images) -> None:
        convergence, label = self.convergence, lane.run.label
        if step in convergence.steps or lane.axis == "none":
            self._store_images(lane.run, step, result, reference)
        a_frame = int(lane.run.params.get(SAMPLES, 1))
        spent = {"frames": a_frame * (step if lane.history else 1), SAMPLES: step}
        row = {
            "technique": lane.run.name,
            "label": label,
            "step": step,
            "n": None if result.standard_error is None else spent.get(lane.axis),
            "over": "" if lane.axis == "none" else lane.axis,
            **measure(result.visibility, result.standard_error, reference),
        }
        self.store.append(self.store.main, [row])
        lane.todo.discard(step)
        self.done += 1

    def _store_images(self, run: TechniqueRun, step: int, result: FrameLike, reference: Images) -> None:
        store, label, own = self.store, run.label, step if self.convergence.camera == "path" else 1
        if own not in self._shown:
            with store.files("", "", own) as put:
                put(write_exr, store.raw(None, "visibility", own), reference[0], f"reference visibility, step {own}")
                note = f"reference standard error, step {own}"
                put(write_exr, store.raw(None, "standard_error", own), reference[1], note)
                put(write_png, store.view(None, "visibility", own), visibility_view(reference[0]))
            self._shown.add(own)
        error = result.standard_error
        with store.files(run.name, label, step) as put:
            note = f"{label}, step {step}"
            put(write_exr, store.raw(label, "visibility", step), result.visibility, f"visibility, {note}")
            put(write_png, store.view(label, "visibility", step), visibility_view(result.visibility))
            put(write_png, store.view(label, "shaded", step), shaded_view(result.color))
            put(write_png, store.view(label, "error", step), error_view(result.visibility, reference[0]))
            if error is not None:
                put(write_exr, store.raw(label, "standard_error", step), error, f"standard error, {note}")
                put(write_png, store.view(label, "standard_error", step), standard_error_view(error))

    def _fail(self, lane: _Lane, step: int, error: BaseException) -> None:
        """Records a failure; the label is left out from here on."""
        lane.failed, lane.session, lane.technique = True, None, None
        self.store.record_failure(lane.run.name, lane.run.label, step, error)
