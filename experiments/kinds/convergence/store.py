"""The result folder of ``kind: convergence``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from experiments.results.result_tables import FAILURE_COLUMNS
from experiments.results.sound import ConvergenceRecord
from experiments.results.store import Store

CONVERGENCE_COLUMNS = (
    "technique", "label", "step", "n", "rmse", "mean_signed_error", "standard_error", "coverage_2se",
    "over", "p99_error", "reference_standard_error", "penumbra_rmse", "penumbra_standard_error",
    "n_effective", "zero_standard_error", "receiver_pixels", "penumbra_pixels",
)  # fmt: skip


class ConvergenceStore(Store):
    """The folder of a run of ``kind: convergence``: images are of steps, a still camera's reference is of step 1."""

    tables: Mapping[str, tuple[str, ...]] = MappingProxyType(
        {"convergence": CONVERGENCE_COLUMNS, "failures": FAILURE_COLUMNS}
    )
    main = "convergence"
    place = "step"
    record = ConvergenceRecord
    unique = ("label", "step")

    def _images_of(self, row: Mapping[str, str]) -> list[Path]:
        step, run = int(row["step"]), self.environment()["run"]
        if row["over"] and step not in run.get("steps", []):
            return []
        shown = step if run.get("camera") == "path" else 1
        return [self.raw(row["label"], "visibility", step), self.raw(None, "visibility", shown)]
