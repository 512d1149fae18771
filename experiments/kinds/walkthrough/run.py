"""Runs a walkthrough: every label on every frame, interleaved, timed by the same rules, stored as it happens.

Order of work, the same in every run: for each frame, ``repeats`` times, each label in file order (A B C A B C); then
every label commits its history. A row holds medians over the repeats. Warm-up (compile, load, first touch of memory)
comes before the first frame and is never timed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.kinds.kind import Progress
from experiments.kinds.walkthrough.label_run import Lane, Timing, pass_medians, timing_columns
from experiments.metrics import registry as metrics
from experiments.metrics.carry_over import carry_over, disoccluded
from experiments.rendering.engine import Engine, FrameLike, WarpEngine, check_result, kernels_of
from experiments.results.environment import describe_run
from experiments.results.failures import attempt_report, raise_failures
from experiments.results.images import error_view, shaded_view, visibility_view, write_exr, write_png
from experiments.results.store import Store
from experiments.results.tables import Row
from wkernels.errors import InputError

if TYPE_CHECKING:
    from experiments.schema.experiment import Experiment

UNUSED = "no label uses the technique, and nothing is compiled that is not launched"


def run(
    experiment: Experiment,
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
    left_out: Sequence[Row] = (),
    refusals_fail: bool = False,
) -> Path:
    """Runs an experiment and writes its result folder (docs/formats.md).

    Args:
        experiment: The resolved experiment.
        out: Result folder; created where missing.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; None for all.
        resume: Continue an interrupted run of the same experiment; rows that are there are kept.
        skips: Whether work that the scene cannot need may be left out.
        plugins: Technique classes by name; None finds those of the installed packages.
        progress: Is told what happens.
        engine: Renderer to use instead of ``WarpEngine``, which the arguments above configure.
        report: Whether to write summary.csv, plots and report.html at the end.
        left_out: Rows of left_out.csv that are known before.
        refusals_fail: A technique that refuses its input in the warm-up has failed, as by any other exception, and the
            rest goes on.

    Returns:
        The result folder.

    Raises:
        InputError: Wrong input, before anything is rendered; or a technique refuses its input in the warm-up.
        TechniquesFailed: At the end, if a technique raised; the others are complete.
        KeyboardInterrupt: Passed on; all complete rows are kept and the run can be resumed.
    """
    from experiments.kinds.walkthrough.report import write_report
    from experiments.results.summary import write_summary

    if engine is None:
        engine = WarpEngine(experiment, device=device, threads=threads, skips=skips, plugins=plugins)
    environment = describe_run(experiment, engine, skips=skips)
    store = Store.open(out, experiment.to_yaml(), environment, resume=resume)
    tell = progress or (lambda done, total, what: None)
    walkthrough = _Walkthrough(experiment, engine, store, tell, refusals_fail)
    with store.writing():
        store.append_once("left_out", left_out)
        walkthrough.render_all()
        store.put_in_order([run.label for run in experiment.runs])
        if report:
            tell(walkthrough.done, walkthrough.total, "writing the report")
            attempt_report(store, write_report if store.rows("frames") else write_summary)
    tell(walkthrough.done, walkthrough.total, "done")
    raise_failures(store)
    return store.out


class _Walkthrough:
    def __init__(
        self, experiment: Experiment, engine: Engine, store: Store, tell: Progress, refusals_fail: bool
    ) -> None:
        self.experiment, self.engine, self.store, self.tell = experiment, engine, store, tell
        self.refusals_fail = refusals_fail
        stored = store.done()
        failed = store.failed()
        self.lanes = [
            Lane(
                run=run,
                history=bool(getattr(getattr(engine.plugins[run.name], "needs", None), "history", False)),
                todo={frame for frame in experiment.frames if (run.label, frame) not in stored},
                failed=run.label in failed,
            )
            for run in experiment.runs
        ]
        self.total = len(experiment.runs) * len(experiment.frames)
        self.done = len(stored)
        self._unseen: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.wants_map_use = not set(metrics.MAP_METRICS).isdisjoint(experiment.metrics)
        reference = experiment.reference
        self.reference_frames = set(experiment.frames[:: reference.every]) if reference else set()

    # ---- Rendering ----

    def render_all(self) -> None:
        for lane in self.lanes:
            if lane.todo and not lane.failed:
                self.tell(self.done, self.total, f"compiling and warming up {lane.label}")
                self._warm_up(lane)
        frames = self.experiment.frames
        for frame, next_frame in zip(frames, [*frames[1:], -1], strict=True):
            timed = [lane for lane in self.lanes if frame in lane.todo and not lane.failed]
            replayed = [lane for lane in self.lanes if lane.replays(frame, next_frame)]
            if timed:
                self._render_timed(frame, timed)
            for lane in replayed:
                self.tell(self.done, self.total, f"frame {frame}, {lane.label} again, for the frames after it")
                self._attempt(lane, frame)
                self._commit(lane, frame)
        self._store_uncompiled()

    def _warm_up(self, lane: Lane) -> None:
        """Renders the first frame (with history: the second too, whose kernels differ), forgets it, and leads in."""
        try:
            lane.session, lane.technique = self.engine.open(lane.run)
            for frame in self.experiment.frames[: 2 if lane.history else 1]:
                lane.session.begin(frame)
                lane.session.render(lane.technique)
                lane.session.advance()
            lane.session.reset()
            for frame in self.experiment.lead_in_frames() if lane.history else ():
                lane.session.begin(frame)
                lane.session.render(lane.technique)
                lane.session.advance()
        except (Exception, SystemExit) as error:
            if isinstance(error, InputError) and not self.refusals_fail:
                raise
            self._fail(lane, self.experiment.frames[0], error)

    def _render_timed(self, frame: int, lanes: list[Lane]) -> None:
        reference = self._reference(frame) if frame in self.reference_frames else None
        for _ in range(self.experiment.repeats):
            for lane in lanes:
                if not lane.failed:
                    self.tell(self.done, self.total, f"frame {frame}, {lane.label}")
                    self._attempt(lane, frame)
        for lane in lanes:
            if not lane.failed:
                self._keep(lane, frame, reference)
                self._commit(lane, frame)

    def _reference(self, frame: int) -> tuple[np.ndarray, np.ndarray] | None:
        """The frame's reference, stored; None, and a failure, where it cannot be made."""
        self.tell(self.done, self.total, f"frame {frame}, reference")
        try:
            reference = self.engine.reference(frame)
        except Exception as error:
            self.store.record_failure("", "", frame, error, "reference")
            return None
        self._store_reference(frame, reference)
        return reference

    def _keep(self, lane: Lane, frame: int, reference: tuple[np.ndarray, np.ndarray] | None) -> None:
        try:
            check_result(lane.result, self.experiment.image)
            self._store(lane, frame, reference)
        except Exception as error:  # a result that cannot be measured
            self._fail(lane, frame, error)

    def _attempt(self, lane: Lane, frame: int) -> None:
        assert lane.session is not None
        try:
            lane.session.begin(frame)
            result = lane.result = lane.session.render(lane.technique)
            lane.timings.append(Timing(result.frame_ms, result.shadow_ms, result.passes))
        except (Exception, SystemExit) as error:
            self._fail(lane, frame, error)

    def _commit(self, lane: Lane, frame: int) -> None:
        if lane.failed or lane.session is None or lane.result is None:
            return
        lane.session.advance()
        lane.before = (frame, lane.result.visibility, lane.result.world_position)
        lane.timings, lane.result = [], None

    def _fail(self, lane: Lane, frame: int, error: BaseException) -> None:
        """Records a failure; the label is left out from here on and its memory is given back."""
        lane.failed = True
        lane.session = lane.technique = lane.before = lane.result = None
        lane.timings = []
        self.store.record_failure(lane.run.name, lane.label, frame, error)

    # ---- Storing ----

    def _store(self, lane: Lane, frame: int, reference: tuple[np.ndarray, np.ndarray] | None) -> None:
        result = lane.result
        assert result is not None
        key = {"technique": lane.run.name, "label": lane.label, "frame": frame}
        if reference is not None or frame == self.experiment.frames[-1]:
            self._store_images(lane, frame, result, reference)
        skipped = self._store_views(lane, frame, result, reference)
        repeats = [
            {**key, "repeat": i, "frame_ms": timing.frame_ms, "shadow_ms": timing.shadow_ms}
            for i, timing in enumerate(lane.timings)
        ]
        self.store.append("repeats", repeats)
        self.store.append("passes", [{**key, "pass": name, "ms": ms} for name, ms in pass_medians(lane.timings)])
        left_out = [
            {"label": lane.label, "frame": frame, "what": what, "reason": reason, "count": count}
            for what, reason, count in [*result.left_out, *skipped]
        ]
        self.store.append("left_out", left_out)
        measured = metrics.Measured(
            visibility=result.visibility,
            standard_error=result.standard_error,
            reference=reference[0] if reference else None,
            reference_standard_error=reference[1] if reference else None,
            previous=self._previous(lane, result, "flicker"),
            previous_across_edges=self._previous(lane, result, "flicker_edges"),
            map_use=self.engine.map_use(lane.session) if self.wants_map_use else None,
        )
        self.store.append(
            "frames",
            [
                {
                    **key,
                    **timing_columns(lane.timings),
                    **metrics.evaluate(frozenset(self.experiment.metrics), measured),
                    "m_x_max": result.m_x_max,
                    "m_z_max": result.m_z_max,
                    "receiver_pixels": int(np.isfinite(result.visibility).sum()),
                    "disoccluded": self._disoccluded(lane, result),
                }
            ],
        )
        lane.todo.discard(frame)
        self.done += 1

    def _store_uncompiled(self) -> None:
        """Rows of left_out.csv for the kernels of techniques that no label uses; of no label, at the last frame."""
        used = {lane.run.name for lane in self.lanes}
        common = {"label": "", "frame": self.experiment.frames[-1], "reason": UNUSED}
        rows = [
            common | {"what": f"kernels of {name}", "count": n}
            for name, cls in self.engine.plugins.items()
            if name not in used and (n := kernels_of(cls))
        ]
        self.store.append("left_out", rows)

    def _previous(self, lane: Lane, result: FrameLike, metric: str) -> np.ndarray | None:
        if lane.before is None or metric not in self.experiment.metrics:
            return None
        frame, visibility, position_ws = lane.before
        return carry_over(
            visibility,
            position_ws,
            self.engine.ws_to_ss(frame),
            result.world_position,
            across_edges=metric == "flicker_edges",
        )

    def _disoccluded(self, lane: Lane, result: FrameLike) -> float | None:
        """Share of the receiver pixels that the frame before did not see; None on the first frame."""
        receiver = np.isfinite(result.visibility)
        if lane.before is None or not receiver.any():
            return None
        frame, _, before = lane.before
        now, kept = result.world_position, self._unseen
        # Most labels see the very same points, and finding them again takes longer than many a frame.
        same = kept and all(np.array_equal(*pair, equal_nan=True) for pair in zip(kept, (before, now), strict=False))
        if not (kept and same):
            kept = self._unseen = (before, now, disoccluded(before, self.engine.ws_to_ss(frame), now))
        return float(kept[2][receiver].mean())

    def _store_reference(self, frame: int, reference: tuple[np.ndarray, np.ndarray]) -> None:
        visibility, standard_error = reference
        store, note = self.store, f"frame {frame}"
        with store.files("", "", frame) as put:
            put(write_exr, store.raw(None, "visibility", frame), visibility, f"reference visibility, {note}")
            put(
                write_exr, store.raw(None, "standard_error", frame), standard_error, f"reference standard error, {note}"
            )
            put(write_png, store.view(None, "visibility", frame), visibility_view(visibility))

    def _store_views(
        self, lane: Lane, frame: int, result: FrameLike, reference: tuple[np.ndarray, np.ndarray] | None
    ) -> list[tuple[str, str, int]]:
        views = self.experiment.views
        if views is None or frame not in (views.frames or ()):
            return []
        from experiments.views.render import make_views  # brings matplotlib, which few runs need before their end

        self.tell(self.done, self.total, f"frame {frame}, views of {lane.label}")
        engine: Any = self.engine
        session: Any = lane.session
        truth = reference[0] if reference else None
        return make_views(self.experiment, engine, lane.run, session, result, frame, truth, self.store)

    def _store_images(
        self, lane: Lane, frame: int, result: FrameLike, reference: tuple[np.ndarray, np.ndarray] | None
    ) -> None:
        store, label = self.store, lane.label
        with store.files(lane.run.name, label, frame) as put:
            note = f"{label}, frame {frame}"
            put(write_exr, store.raw(label, "visibility", frame), result.visibility, f"visibility, {note}")
            if result.standard_error is not None:
                put(
                    write_exr,
                    store.raw(label, "standard_error", frame),
                    result.standard_error,
                    f"standard error, {note}",
                )
            put(write_png, store.view(label, "visibility", frame), visibility_view(result.visibility))
            put(write_png, store.view(label, "shaded", frame), shaded_view(result.color))
            if reference is not None:
                put(write_png, store.view(label, "error", frame), error_view(result.visibility, reference[0]))
