"""Lanes: one label each on its way through a walkthrough's frames, and what its repeats are reduced to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.rendering.engine import FrameLike, SessionLike

if TYPE_CHECKING:
    from experiments.schema.techniques import TechniqueRun


class Timing(NamedTuple):
    """Times of one rendering of one frame, milliseconds; see ``wkernels.frame.session.FrameResult``."""

    frame_ms: float
    shadow_ms: float
    passes: list[tuple[str, float]]


@dataclass(eq=False)
class Lane:
    """One label on its way through the frames."""

    run: TechniqueRun
    history: bool
    todo: set[int]
    failed: bool = False
    session: SessionLike | None = None
    technique: Any = None
    timings: list[Timing] = field(default_factory=list)
    result: FrameLike | None = None
    before: tuple[int, np.ndarray, np.ndarray] | None = None  # frame, visibility, positions

    @property
    def label(self) -> str:
        return self.run.label

    def replays(self, frame: int, next_frame: int) -> bool:
        """Whether a frame that is stored already must be rendered again, untimed, for the sake of a later one.

        Methods with history need all earlier frames. The others need only the one before: what stays the same between
        two frames is not built again, and a row must not depend on whether the run was interrupted there.
        """
        if self.failed or not self.todo or frame in self.todo:
            return False
        return next_frame in self.todo or (self.history and frame < max(self.todo))


def timing_columns(timings: list[Timing]) -> dict[str, float]:
    """Medians and quartiles of a frame's repeats, milliseconds, as columns of frames.csv."""
    out: dict[str, float] = {}
    for name in ("frame_ms", "shadow_ms"):
        q1, median, q3 = np.percentile([getattr(timing, name) for timing in timings], [25, 50, 75])
        out[name], out[f"{name}_q1"], out[f"{name}_q3"] = float(median), float(q1), float(q3)
    out["fps"] = 1000.0 / out["frame_ms"] if out["frame_ms"] > 0.0 else float("nan")
    return out


def pass_medians(timings: list[Timing]) -> list[tuple[str, float]]:
    """Median milliseconds per pass over the repeats, in order of first use; a repeat without the pass counts as 0."""
    totals: list[dict[str, float]] = []
    for timing in timings:
        spent: dict[str, float] = {}
        for name, ms in timing.passes:
            spent[name] = spent.get(name, 0.0) + ms
        totals.append(spent)
    names = dict.fromkeys(name for spent in totals for name in spent)
    return [(name, float(np.median([spent.get(name, 0.0) for spent in totals]))) for name in names]
