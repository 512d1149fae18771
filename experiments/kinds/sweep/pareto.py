"""Who is worth the time in one scene: paired times, errors, and which label dominates which.

Times are compared in pairs, label with label, on the same frame and repeat, because these were rendered in turns; an
interval of the median ratio that holds 1 leaves them "not distinguishable" (``results.compare``). It takes pairs
for independent, which the repeats of a frame are not quite. Errors are "not distinguishable" within twice the
reference's standard error (``errors_differ``), or where the frames do not agree on who is better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.metrics.registry import distinguishable
from experiments.results.compare import median_interval
from experiments.results.store import REPEAT_COLUMNS, Store
from experiments.results.summary import load_frames, summarise

WITHIN = 0.05
"""Times that differ by no more, by their medians, are the same time to a user. It also keeps the wide intervals of few
frames from calling clearly slower labels no slower."""


@dataclass(frozen=True, eq=False)
class Relations:
    """Every label against every other; matrices (N, N), row against column, NaN or False where unknown.

    Attributes:
        labels: In order.
        log_ratio, log_low, log_high: Median of the paired time ratios row / column, and its interval; logarithms.
        faster: The row's time is shorter beyond doubt.
        no_slower: It is not longer beyond doubt, and by the medians at most ``WITHIN`` longer.
        better: The row's error is smaller beyond doubt.
        no_worse: It is not larger beyond doubt.
    """

    labels: tuple[str, ...]
    log_ratio: np.ndarray
    log_low: np.ndarray
    log_high: np.ndarray
    better: np.ndarray
    no_worse: np.ndarray

    @cached_property
    def faster(self) -> np.ndarray:
        return self.log_high < 0.0

    @cached_property
    def no_slower(self) -> np.ndarray:
        return (self.log_low <= 0.0) & (self.log_ratio <= np.log1p(WITHIN))

    @cached_property
    def dominates(self) -> np.ndarray:
        """Whether the row is no worse than the column in both, and better in one."""
        return self.no_slower & self.no_worse & (self.faster | self.better)

    def front(self) -> list[bool | None]:
        """Whether each label is dominated by none; None where its time or error is unknown."""
        known = np.isfinite(np.diagonal(self.log_ratio)) & np.diagonal(self.no_worse)
        beaten = self.dominates[known].any(axis=0)
        return [bool(not b) if k else None for k, b in zip(known, beaten, strict=True)]

    def dominators(self, label: str) -> list[str]:
        """Labels that dominate a label: those on the front, or all where none of them is."""
        found = np.flatnonzero(self.dominates[:, self.labels.index(label)])
        front = self.front()
        return [self.labels[i] for i in found if front[i]] or [self.labels[i] for i in found]


@dataclass(frozen=True, eq=False)
class SceneResults:
    """What one scene's folder says.

    Attributes:
        name: Of the scene.
        baseline: The label that ratios are relative to.
        summary: As ``experiments.results.summary.summarise`` gives it, by label.
        times: Milliseconds, a row per frame and repeat, a column per label.
        errors: RMSE, a row per frame with a reference, a column per label.
        noise: Median standard error of the reference; NaN without one.
        incomplete: Labels that failed, or that have not been through all frames: their numbers are not compared.
        wanted: How many labels there should be.
    """

    name: str
    baseline: str
    summary: pd.DataFrame
    times: pd.DataFrame
    errors: pd.DataFrame
    noise: float
    incomplete: frozenset[str] = field(default_factory=frozenset)
    wanted: int = 0

    @property
    def labels(self) -> list[str]:
        """Those with rows, in order."""
        return list(self.summary.index)

    @cached_property
    def complete(self) -> list[str]:
        """Labels that were rendered on every frame."""
        return [label for label in self.labels if label not in self.incomplete]

    @cached_property
    def relations(self) -> Relations:
        """Of all labels that are complete."""
        labels = self.complete
        count = len(labels)
        log = {name: np.full((count, count), np.nan) for name in ("ratio", "low", "high")}
        better, no_worse = (np.zeros((count, count), bool) for _ in range(2))
        times = self.times.reindex(columns=labels).to_numpy(float)
        errors = self.errors.reindex(columns=labels).to_numpy(float)
        for i in range(count):
            for j in range(count):
                log["ratio"][i, j], log["low"][i, j], log["high"][i, j] = _log_interval(times[:, i], times[:, j])
                better[i, j], no_worse[i, j] = self._errors_told_apart(errors[:, i], errors[:, j])
        return Relations(tuple(labels), log["ratio"], log["low"], log["high"], better, no_worse)

    def _errors_told_apart(self, a: np.ndarray, b: np.ndarray) -> tuple[bool, bool]:
        """Whether a is smaller beyond doubt, and whether it is not larger beyond doubt."""
        known = np.isfinite(a) & np.isfinite(b)
        if not known.any():
            return False, False
        if not errors_differ(float(np.median(a[known])), float(np.median(b[known])), self.noise):
            return False, True
        signs = np.sign(a[known] - b[known])
        # the interval of a median of differences holds 0 where frames disagree
        found = median_interval(np.exp(signs))
        return found.high < 1.0, found.low <= 1.0

    def row(self, label: str) -> pd.Series:
        """A label's row of the summary."""
        return self.summary.loc[label]

    def ratio(self, label: str, other: str) -> float:
        """Median of the paired time ratios of two complete labels."""
        r = self.relations
        return float(np.exp(r.log_ratio[r.labels.index(label), r.labels.index(other)]))


def errors_differ(a: float, b: float, noise: float) -> bool:
    """Whether two RMSE against the same reference differ by more than twice its standard error.

    Independent errors add up in squares, and the reference's own is in both: it is the root of the difference of the
    squares that is compared. Against the reference itself, whose error is 0, that is the RMSE.
    """
    return bool(distinguishable(float(np.sqrt(abs(a * a - b * b))), noise))


def _log_interval(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    known = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
    if not known.any():
        return np.nan, np.nan, np.nan
    found = median_interval(a[known] / b[known])
    return float(np.log(found.median)), float(np.log(found.low)), float(np.log(found.high))


def load_results(folder: Path, name: str) -> SceneResults | None:
    """A scene's results; None where its folder holds no rows yet."""
    if not (folder / "frames.csv").is_file():
        return None
    store = Store.existing(folder)
    frames = load_frames(store)
    if frames.empty:
        return None
    run = store.environment()["run"]
    counts = frames.groupby("label")["frame"].nunique()
    failed = {row["label"] for row in store.rows("failures")}
    incomplete = failed | {str(label) for label, count in counts.items() if count < len(run["frames"])}
    measured = frames[frames["rmse"].notna()]
    return SceneResults(
        name=name,
        baseline=run["baseline"],
        summary=summarise(frames, run["baseline"]).set_index("label", drop=False),
        times=_times(store, frames),
        errors=measured.pivot(index="frame", columns="label", values="rmse"),
        noise=float(measured["reference_standard_error"].median()) if len(measured) else float("nan"),
        incomplete=frozenset(incomplete),
        wanted=len(run["labels"]),
    )


def _times(store: Store, frames: pd.DataFrame) -> pd.DataFrame:
    """By frame and repeat; by frame alone where a folder of an older version has no repeats.csv."""
    rows = store.rows("repeats")
    if not rows:
        return frames.pivot(index="frame", columns="label", values="frame_ms")
    table = pd.DataFrame(rows, columns=list(REPEAT_COLUMNS))
    for column in ("frame", "repeat", "frame_ms"):
        table[column] = pd.to_numeric(table[column])
    return table.pivot(index=["frame", "repeat"], columns="label", values="frame_ms")


def scene_rows(results: SceneResults) -> list[dict[str, Any]]:
    """Rows of pareto.csv of one scene, in the order of its labels."""
    front = dict(zip(results.relations.labels, results.relations.front(), strict=True))
    out = []
    for label in results.labels:
        own = results.row(label)
        row: dict[str, Any] = {"scene": results.name, "technique": own["technique"], "label": label}
        for name in ("frame_ms", "rmse"):
            row |= {column: float(own[column]) for column in (name, f"{name}_q1", f"{name}_q3")}
        row |= quartiles("ratio", _paired(results, label))
        told = own["distinguishable"]
        row["error_to_reference"] = None if told is None else "distinguishable" if told else "not distinguishable"
        row["on_front"] = yes_no(front.get(label))
        if front.get(label) is False:
            row["dominated_by"] = "; ".join(results.relations.dominators(label))
        out.append(row)
    return out


def _paired(results: SceneResults, label: str) -> np.ndarray:
    if label not in results.times or results.baseline not in results.times:
        return np.empty(0)
    ratios = (results.times[label] / results.times[results.baseline]).to_numpy(float)
    return ratios[np.isfinite(ratios)]


def quartiles(name: str, values: np.ndarray | Sequence[float]) -> dict[str, float | None]:
    """Median and quartiles of values as columns; None without values."""
    keys = (f"{name}_q1", name, f"{name}_q3")
    if not len(values):
        return dict.fromkeys(keys)
    return dict(zip(keys, map(float, np.percentile(values, [25.0, 50.0, 75.0])), strict=True))


def yes_no(value: bool | None) -> str | None:
    """As a cell of a table."""
    return None if value is None else "yes" if value else "no"
