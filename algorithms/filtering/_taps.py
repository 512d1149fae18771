"""Parameters that filters of comparisons share."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ValidationInfo, field_validator

from algorithms.technique import MapParams, setting
from wkernels.filters.penumbra import check_tap_count


def tap_count(default: int, text: str, source: str) -> Any:
    """A number of taps, 1 to 4096; of a box a square number."""
    return setting(default, text + "; a square number for box", unit="taps", source=source, ge=1, le=4096)


class TapParams(MapParams):
    """Shape and interpolation of tap sets; how many taps there are is each technique's own."""

    kernel: Literal["poisson", "box"] = setting(
        "poisson",
        "shape of every tap set: poisson disc, or box of k x k taps",
        unit="name",
        source="Schwaerzler 2009, app. A",
    )
    bilinear: bool = setting(
        True, "each tap is the bilinear mean of 2 x 2 comparisons", unit="yes/no", source="Stingl 2011, sec. 3.6"
    )

    @field_validator("taps", "blocker_taps", "filter_taps", check_fields=False)
    @classmethod
    def _fit_kernel(cls, taps: int, info: ValidationInfo) -> int:
        return check_tap_count(taps, info.data.get("kernel", "poisson"))
