"""The folder of a sweep: the scenes' result folders, and tables over them that can always be made again."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from experiments.results.sound import SweepRecord, check_environment
from experiments.results.store import Store
from experiments.results.tables import read_table

PARETO_COLUMNS = (
    "scene", "technique", "label", "frame_ms", "frame_ms_q1", "frame_ms_q3", "ratio", "ratio_q1", "ratio_q3",
    "rmse", "rmse_q1", "rmse_q3", "error_to_reference", "on_front", "dominated_by",
)  # fmt: skip
EQUAL_TIME_COLUMNS = ("scene", "budget_label", "budget_ms", "place", "label", "frame_ms", "rmse")
EQUAL_ERROR_COLUMNS = ("scene", "target_label", "target_rmse", "place", "label", "frame_ms", "rmse")
RECOMMENDATION_COLUMNS = ("scene", "label", "reason")
SWEEP_FAILURE_COLUMNS = ("scene", "technique", "label", "frame", "error", "what")


class SweepStore(Store):
    """The folder of a run of ``kind: sweep``; its tables are written whole, after each scene."""

    tables: Mapping[str, tuple[str, ...]] = MappingProxyType(
        {
            "pareto": PARETO_COLUMNS,
            "equal_time": EQUAL_TIME_COLUMNS,
            "equal_error": EQUAL_ERROR_COLUMNS,
            "recommendation": RECOMMENDATION_COLUMNS,
            "failures": SWEEP_FAILURE_COLUMNS,
        }
    )
    main = "pareto"
    record = SweepRecord
    unique = ("scene", "label")

    def scene_names(self) -> list[str]:
        """Names of the scenes, in file order; InputError where the record is damaged."""
        environment = self.environment()
        check_environment(environment, self.record, self.out / "environment.json")
        return [scene["name"] for scene in environment["run"]["scenes"]]

    def scene(self, name: str) -> Path:
        """Result folder of a scene."""
        return self.out / name

    def started(self) -> bool:
        if not (self.out / "environment.json").is_file():
            return False
        folders = [self.scene(name) for name in self.scene_names()]
        return any(read_table(folder / f"{name}.csv") for folder in folders for name in ("frames", "failures"))

    def recover(self) -> None:
        """Nothing: every table is made from the scenes' folders, which recover by themselves."""

    def _clear(self) -> None:
        if (self.out / "environment.json").is_file():
            for name in self.scene_names():
                if (self.scene(name) / "environment.json").is_file():  # a folder of an earlier run of this sweep
                    shutil.rmtree(self.scene(name))
        for name in self.tables:
            (self.out / f"{name}.csv").unlink(missing_ok=True)
        super()._clear()
