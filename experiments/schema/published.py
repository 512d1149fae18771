"""The key ``published`` of a technique or a curve: what its source printed, and which quantities it may print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from experiments.config.messages import Loc, shown
from experiments.config.source import Source
from experiments.metrics.registry import METRICS
from wkernels.errors import nearest

QUANTITIES = ("frame_ms", "shadow_ms", "fps", *METRICS, "m_x_max", "m_z_max")
"""What a technique's entry may publish: columns of summary.csv."""

CURVE_QUANTITIES = tuple(f"{m}_{place}" for m in ("m_x", "m_z") for place in ("near", "far", "min", "max"))
CURVE_QUANTITIES += ("storage_factor",)
"""What a curve may publish: its errors at the ends of the depth range, the least and the greatest, and S."""


def check_published(source: Source, loc: Loc, figures: Any, known: Sequence[str]) -> dict[str, float]:
    """The key ``published``: finite numbers by name.

    Raises:
        InputError: It is no mapping, or has an unknown name or no number.
    """
    if figures is None:
        return {}
    if not isinstance(figures, dict) or not figures:
        raise source.error(f"must map quantities to numbers, not {shown(figures)}.", loc)
    for name, value in figures.items():
        if name not in known:
            raise source.error(f"there is no quantity '{name}'." + nearest(name, known), (*loc, name))
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise source.error(f"must be a finite number, not {shown(value)}.", (*loc, name))
    return {name: float(value) for name, value in figures.items()}
