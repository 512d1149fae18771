"""Rows of the bench and the timing behind them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Timed = Callable[[], float]
"""Runs one side once and returns its milliseconds; what is not part of the pass is left out of them."""

WARM_UPS = 3  # compiling, first touch of memory, and the launches that find out what is worth sharing


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
    """

    name: str
    ours_ms: float | None
    peer: str | None = None
    peer_ms: float | None = None
    mismatch: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """peer_ms / ours_ms: above 1 we are faster."""
        return self.peer_ms / self.ours_ms if self.peer_ms is not None and self.ours_ms else None

    def to_json(self) -> dict[str, object]:
        """The row as the JSON contract has it; null where nothing was measured."""
        return {
            "name": self.name,
            "ours_ms": self.ours_ms,
            "peer": self.peer,
            "peer_ms": self.peer_ms,
            "ratio": self.ratio,
            "mismatch": self.mismatch,
            "note": self.note,
        }


def interleaved_medians(sides: Sequence[Timed], repeats: int) -> list[float]:
    """Median milliseconds of each side; the sides take turns, so that a slow second of the machine hits all of them.

    Args:
        sides: At least one.
        repeats: Timed runs of each, at least 1, after ``WARM_UPS`` that do not count.
    """
    for side in sides:
        for _ in range(WARM_UPS):
            side()
    times = [[side() for side in sides] for _ in range(repeats)]
    return [float(median) for median in np.median(times, axis=0)]
