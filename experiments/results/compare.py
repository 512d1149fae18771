"""Two result folders side by side: per label, ratios of error and time with confidence intervals.

Values are paired frame by frame, because frames differ more than runs do. Ratios are B over A. An interval is that of
the median by order statistics: it assumes nothing of the distribution but that frames are independent, and with fewer
than 6 pairs is the whole range, whose confidence is then below 95 %. Times are also compared *relative* to each run's
own baseline label, which was timed in turns with the others, so that the machine's speed cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd

from experiments.metrics.registry import METRICS
from experiments.results.store import Store, labels_in_order
from experiments.results.summary import load_frames
from experiments.results.tables import Row, aligned
from wkernels.errors import InputError

CONFIDENCE = 0.95
COLUMNS = (
    "label",
    *(f"{name}_{what}" for name in ("rmse", "frame_ms", "relative_ms") for what in ("a", "b", "ratio", "low", "high")),
    "pairs", "confidence", "error", "time",
)  # fmt: skip


@dataclass(frozen=True)
class Interval:
    """The median of paired ratios.

    Attributes:
        median, low, high: Of the ratios B / A.
        pairs: How many there are.
        confidence: That the true median lies within [low, high].
    """

    median: float
    low: float
    high: float
    pairs: int
    confidence: float

    @property
    def holds_one(self) -> bool:
        """Whether A and B may be equal."""
        return self.low <= 1.0 <= self.high


class Compared(Protocol):
    """How two result folders differ.

    Attributes:
        columns: Of ``rows``.
        rows: One per thing that both have.
    """

    @property
    def columns(self) -> tuple[str, ...]: ...

    @property
    def rows(self) -> list[dict[str, Any]]: ...

    def regressions(self, percent: float) -> list[str]:
        """What grew worse by more than that beyond doubt, or is missing in B; with the reason."""

    def as_json(self) -> dict[str, Any]:
        """Everything, for programs."""

    def text(self) -> str:
        """Everything, for people."""


@dataclass(frozen=True)
class Comparison:
    """What ``compare`` finds of two runs of one scene; a ``Compared``.

    Attributes:
        rows: One per common label, keys of ``COLUMNS``; a missing value is None.
        only_a, only_b: Labels that only one run has.
        notes: What a reader must know: machines, commits, plugins, metrics that differ.
    """

    rows: list[dict[str, Any]]
    only_a: list[str]
    only_b: list[str]
    notes: list[str]
    columns: tuple[str, ...] = COLUMNS

    def as_json(self) -> dict[str, Any]:
        return {"rows": self.rows, "only_a": self.only_a, "only_b": self.only_b, "notes": self.notes}

    def text(self) -> str:
        lines = [*(f"  {note}" for note in self.notes), "", aligned(_rows_for_people(self.rows))]
        only = (("A", self.only_a), ("B", self.only_b))
        return "\n".join(lines + [f"only in {name}: {', '.join(labels)}" for name, labels in only if labels])

    def regressions(self, percent: float) -> list[str]:
        """Labels whose error grew by more than ``percent`` beyond doubt, or that B lost; with the reason."""
        out = [f"{label}: missing" for label in self.only_a]
        for row in self.rows:
            if row["error"] == "worse" and row["rmse_ratio"] > 1.0 + 0.01 * percent:
                out.append(f"{row['label']}: RMSE {row['rmse_a']:.4g} to {row['rmse_b']:.4g}")
            elif row["error"] == "lost":
                out.append(f"{row['label']}: no RMSE any more")
        return out


def median_interval(ratios: np.ndarray) -> Interval:
    """The median of positive ratios (n,), n >= 1, with its interval of at least 95 % where n allows one."""
    values = np.sort(ratios)
    n = len(values)
    rank, tail = 1, 0.5**n  # tail: P(at most rank - 1 of n lie below the median)
    while 2.0 * (wider := tail + comb(n, rank) * 0.5**n) <= 1.0 - CONFIDENCE:
        rank, tail = rank + 1, wider
    return Interval(float(np.median(values)), float(values[rank - 1]), float(values[n - rank]), n, 1.0 - 2.0 * tail)


def compare(a: str | Path, b: str | Path) -> Comparison:
    """Compares two result folders of the same scene and picture size.

    Raises:
        InputError: One is no result folder, or they show different things.
    """
    stores = Store.existing(a), Store.existing(b)
    told = [store.environment() for store in stores]
    _check_same_picture(stores, told)
    frames = [load_frames(store) for store in stores]
    labels = [labels_in_order(store.rows("frames")) for store in stores]
    same_reference = told[0]["run"]["reference_samples"] == told[1]["run"]["reference_samples"]
    notes = _notes(told)
    if told[0]["metrics"].get("rmse") != told[1]["metrics"].get("rmse"):
        for table in frames:
            table["rmse"] = np.nan
    baseline = told[0]["run"]["baseline"]
    if baseline != told[1]["run"]["baseline"]:
        notes.append(f"the baselines differ ({baseline}, {told[1]['run']['baseline']}): no relative times")
        baseline = None
    common = [label for label in labels[0] if label in labels[1]]
    return Comparison(
        rows=[_row(label, frames[0], frames[1], baseline, same_reference) for label in common],
        only_a=[label for label in labels[0] if label not in labels[1]],
        only_b=[label for label in labels[1] if label not in labels[0]],
        notes=notes,
    )


def _check_same_picture(stores: tuple[Store, Store], told: list[dict[str, Any]]) -> None:
    for place, key, what in (("identity", "scene", "scene"), ("run", "width", "width"), ("run", "height", "height")):
        values = [one[place].get(key) for one in told]
        if values[0] != values[1]:
            raise InputError(
                f"cannot be compared with {stores[0].out}: its {what} is another ({values[0]}, {values[1]}).",
                file=stores[1].out,
            )


def _notes(told: list[dict[str, Any]]) -> list[str]:
    out = []
    pairs = [("environment", key) for key in ("device_name", "threads", "git", "wkernels")]
    pairs += [("identity", key) for key in ("code", "warp")]
    pairs += [("identity", key) for key in sorted({*told[0]["identity"], *told[1]["identity"]}) if "plugin" in key]
    for place, key in pairs:
        values = [one[place].get(key) for one in told]
        if values[0] != values[1] and None not in values:
            out.append(f"{key}: {values[0]} and {values[1]}")
    for name, metric in METRICS.items():
        versions = [one["metrics"].get(name) for one in told]
        if versions[0] != versions[1]:
            out.append(f"{metric.title} is defined differently (versions {versions[0]} and {versions[1]})")
    return out


def _row(label: str, a: pd.DataFrame, b: pd.DataFrame, baseline: str | None, same_reference: bool) -> dict[str, Any]:
    own = [table[table["label"] == label].set_index("frame") for table in (a, b)]
    row: dict[str, Any] = dict.fromkeys(COLUMNS) | {"label": label}
    error = _put(row, "rmse", own[0]["rmse"], own[1]["rmse"])
    time = _put(row, "frame_ms", own[0]["frame_ms"], own[1]["frame_ms"])
    if baseline is not None and label != baseline:
        bases = [table[table["label"] == baseline].set_index("frame")["frame_ms"] for table in (a, b)]
        relative = [table["frame_ms"] / base for table, base in zip(own, bases, strict=True)]
        time = _put(row, "relative_ms", *relative) or time
    if time is not None:
        row["pairs"], row["confidence"] = time.pairs, time.confidence
        row["time"] = "not distinguishable" if time.holds_one else ("slower" if time.median > 1.0 else "faster")
    row["error"] = _error_verdict(own, error, same_reference)
    return row


def _put(row: dict[str, Any], name: str, a: pd.Series, b: pd.Series) -> Interval | None:
    """Fills the columns of one quantity from the frames that both have; None where there are none."""
    pairs = pd.concat([a, b], axis=1, keys=["a", "b"]).dropna()
    if pairs.empty:
        return None
    row[f"{name}_a"], row[f"{name}_b"] = float(pairs["a"].median()), float(pairs["b"].median())
    both_zero = (pairs["a"] == 0.0) & (pairs["b"] == 0.0)
    with np.errstate(divide="ignore"):
        ratios = np.where(both_zero, 1.0, pairs["b"].to_numpy() / np.where(both_zero, 1.0, pairs["a"]))
    found = median_interval(ratios)
    row[f"{name}_ratio"], row[f"{name}_low"], row[f"{name}_high"] = found.median, found.low, found.high
    return found


def _error_verdict(own: list[pd.DataFrame], error: Interval | None, same_reference: bool) -> str | None:
    """``same`` to the last digit, ``better``, ``worse`` or ``not distinguishable``; ``lost`` where only A has one."""
    if error is None:
        return "lost" if own[0]["rmse"].notna().any() and own[1]["rmse"].isna().all() else None
    if error.low == error.high == 1.0:
        return "same"
    doubt = error.holds_one
    if not same_reference:  # each has an error of its own then, which does not cancel
        noise = max(float(table["reference_standard_error"].median()) for table in own)
        doubt |= abs(float(own[1]["rmse"].median() - own[0]["rmse"].median())) <= 2.0 * noise
    if doubt:
        return "not distinguishable"
    return "worse" if error.median > 1.0 else "better"


def _rows_for_people(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A head and one line per label: medians, ratio with its interval, verdict."""

    def text(row: Row, name: str) -> list[str]:
        if row[f"{name}_ratio"] is None:
            return ["-", "-", "-"]
        ratio = f"{row[f'{name}_ratio']:.3f} [{row[f'{name}_low']:.3f}, {row[f'{name}_high']:.3f}]"
        return [f"{row[f'{name}_a']:.4g}", f"{row[f'{name}_b']:.4g}", ratio]

    head = ["label", "RMSE A", "B", "B / A", "error", "ms A", "B", "B / A", "B / A relative", "time", "sure"]
    out = [head]
    for row in rows:
        sure = "-" if row["confidence"] is None else f"{100.0 * row['confidence']:.0f} % of {row['pairs']}"
        times = [*text(row, "frame_ms"), text(row, "relative_ms")[2], row["time"] or "-", sure]
        out.append([row["label"], *text(row, "rmse"), row["error"] or "-", *times])
    return out
