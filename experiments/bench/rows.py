"""Rows of the bench and the timing behind them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

Timed = Callable[[], float]
"""Runs one side once and returns its milliseconds; what is not part of the pass is left out of them."""

WARM_UPS = 3  # compiling, first touch of memory, and the launches that find out what is worth sharing


class PeerMissing(Exception):
    """A peer cannot run here; the message says why, for the rows that it leaves empty."""


@dataclass(frozen=True)
class Target:
    """What a row should reach: a least ratio, or a largest time.

    Attributes:
        ratio: Least peer_ms / ours_ms.
        ms: Largest ours_ms.
    """

    ratio: float | None = None
    ms: float | None = None

    def __str__(self) -> str:
        return f"ratio >= {self.ratio:g}" if self.ratio is not None else f"<= {self.ms:g} ms"


@dataclass(frozen=True)
class Row:
    """One line of the result.

    Attributes:
        name: The case, with a dot and the part where a case has several.
        ours_ms: Median of our pass [ms]; None where it could not run.
        peer: What it is compared with; None where nothing is.
        peer_ms: Median of the peer's pass [ms]; None where the peer is missing.
        mismatch: Share of pixels in which both images differ, in [0, 1]; None where they were not compared.
        note: What was timed or what is missing.
        target: What it should reach, if anything was asked for.
        paired: Median of the ratios of runs in a row, where they were kept: steadier than the medians' ratio.
        figures: Further numbers by name, units in the names; they become keys of the JSON row.
    """

    name: str
    ours_ms: float | None
    peer: str | None = None
    peer_ms: float | None = None
    mismatch: float | None = None
    note: str = ""
    target: Target | None = None
    paired: float | None = None
    figures: Mapping[str, object] = field(default_factory=dict)

    @property
    def ratio(self) -> float | None:
        """peer_ms / ours_ms, of pairs of runs where they were kept: above 1 we are faster."""
        if self.paired is not None:
            return self.paired
        return self.peer_ms / self.ours_ms if self.peer_ms is not None and self.ours_ms else None

    @property
    def reached(self) -> bool | None:
        """Whether the target is reached; None without one or where nothing was measured."""
        if self.target is None:
            return None
        if self.target.ratio is not None:
            return None if self.ratio is None else self.ratio >= self.target.ratio
        return None if self.ours_ms is None or self.target.ms is None else self.ours_ms <= self.target.ms

    def to_json(self) -> dict[str, object]:
        """The row as the JSON contract has it; null where nothing was measured."""
        return {
            "name": self.name,
            "ours_ms": self.ours_ms,
            "peer": self.peer,
            "peer_ms": self.peer_ms,
            "ratio": self.ratio,
            "target": None if self.target is None else str(self.target),
            "reached": self.reached,
            "mismatch": self.mismatch,
            "note": self.note,
            **self.figures,
        }


def interleaved_medians(
    sides: Sequence[Timed], repeats: int, *, warm_ups: int = WARM_UPS, most_s: float = float("inf")
) -> list[float]:
    """Median milliseconds of each side; the sides take turns, so that a slow second of the machine hits all of them.

    Args:
        sides: At least one.
        repeats: Timed runs of each, at least 1, after those that do not count.
        warm_ups: Runs of each side that do not count.
        most_s: After so many seconds no further round of timed runs begins; there is always one.
    """
    times = interleaved_times(sides, repeats, warm_ups=warm_ups, most_s=most_s)
    return [float(median) for median in np.median(times, axis=0)]


def interleaved_times(
    sides: Sequence[Timed], repeats: int, *, warm_ups: int = WARM_UPS, most_s: float = float("inf")
) -> np.ndarray:
    """The milliseconds behind ``interleaved_medians``, one row per round and one column per side."""
    for side in sides:
        for _ in range(warm_ups):
            side()
    begin = time.perf_counter()
    times: list[list[float]] = []
    while not times or (len(times) < repeats and time.perf_counter() - begin < most_s):
        times.append([side() for side in sides])
    return np.array(times)
