"""What metrics are computed from, and what describes one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from wkernels.analysis.sampling_rate import MapUse

HARD_EDGE = 0.5  # a larger difference of visibility between neighbouring pixels is an edge, not a slope


@dataclass(frozen=True, eq=False)
class Measured:
    """What one frame of one label offers to the metrics.

    Attributes:
        visibility: (H, W), 1 = lit, NaN where no receiver is seen.
        standard_error: (H, W) of the technique's light sampling; None for techniques that do not sample the light.
        reference: (H, W) reference visibility of the same receiver points; None where none was made.
        reference_standard_error: (H, W), goes with ``reference``.
        previous: Visibility of the frame before, carried to this frame's receiver points (``carry_over``), (H, W), NaN
            where these were not seen or lie at a hard edge; None on a first frame or where nothing asked for it.
        previous_across_edges: The same with what lies at hard edges.
        map_use: How the light map that the technique read suits the frame; None for techniques that read none, or where
            nothing asked for it.
    """

    visibility: np.ndarray
    standard_error: np.ndarray | None = None
    reference: np.ndarray | None = None
    reference_standard_error: np.ndarray | None = None
    previous: np.ndarray | None = None
    previous_across_edges: np.ndarray | None = None
    map_use: MapUse | None = None


@dataclass(frozen=True)
class Metric:
    """One metric.

    Attributes:
        name: Column in frames.csv and key under ``metrics`` in an experiment file.
        title: Name for axes and table heads.
        description: What it measures, in one sentence.
        unit: Unit of the number.
        evaluate: The function; None where an input is missing.
        best: The value of a perfect image; larger distance from it is worse.
        worst: The value furthest from ``best`` that can occur.
        always: Whether it is computed without being asked for (whenever its inputs exist).
        from_images: Whether the stored raw images of that frame suffice to compute it again.
        version: Version of the definition.
    """

    name: str
    title: str
    description: str
    unit: str
    evaluate: Callable[[Measured], float | None]
    _: KW_ONLY
    best: float = 0.0
    worst: float = 1.0
    always: bool = True
    from_images: bool = True
    version: int = 1


def beside_hard_edge(visibility: np.ndarray) -> np.ndarray:
    """Whether one of a pixel's four neighbours differs by more than ``HARD_EDGE``; bool (H, W)."""
    out = np.zeros(visibility.shape, dtype=bool)
    across, down = np.abs(np.diff(visibility, axis=1)), np.abs(np.diff(visibility, axis=0))
    with np.errstate(invalid="ignore"):
        across, down = across > HARD_EDGE, down > HARD_EDGE
    out[:, 1:] |= across
    out[:, :-1] |= across
    out[1:] |= down
    out[:-1] |= down
    return out
