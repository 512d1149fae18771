"""Two runs of a sweep: whether they agree (rank correlations, membership in Pareto fronts), and scene by scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from experiments.kinds.sweep.config import ALL
from experiments.kinds.sweep.store import SweepStore
from experiments.results.compare import COLUMNS as SCENE_COLUMNS
from experiments.results.compare import Comparison, compare
from experiments.results.tables import Row, aligned
from wkernels.errors import InputError

COLUMNS = ("scene", "labels", "spearman_time", "spearman_error", "front_a", "front_b", "differ")


@dataclass(frozen=True)
class Agreement:
    """What two sweeps say of one scene.

    Attributes:
        scene: Its name; ``all`` for the rows over all scenes.
        labels: How many labels both have.
        spearman_time: Rank correlation of the times, as paired ratios to the baseline, in which the machine's speed at
            the moment cancels; -1 to 1, None with fewer than two labels that have one.
        spearman_error: The same of the RMSE.
        front_a, front_b: Which of these labels are on each front.
        differ: Those that are on one of the two only.
    """

    scene: str
    labels: int
    spearman_time: float | None
    spearman_error: float | None
    front_a: tuple[str, ...]
    front_b: tuple[str, ...]

    @property
    def differ(self) -> tuple[str, ...]:
        return tuple(sorted(set(self.front_a) ^ set(self.front_b)))

    def row(self) -> dict[str, Any]:
        """As a row of ``COLUMNS``."""
        texts = {name: "; ".join(getattr(self, name)) for name in ("front_a", "front_b", "differ")}
        return {name: texts.get(name, getattr(self, name)) for name in COLUMNS}


def agree(a: str | Path, b: str | Path) -> list[Agreement]:
    """One entry per scene that both sweeps have rows of, in A's order.

    Raises:
        InputError: One is no folder of a sweep, or they share no scene.
    """
    rows = [SweepStore.existing(out).rows("pareto") for out in (a, b)]
    tables = [_by_scene(part) for part in rows]
    same = tables[0].keys() == tables[1].keys()  # rows over all scenes are of the same ones only then
    scenes = [scene for scene in tables[0] if scene in tables[1] and (same or scene != ALL)]
    if not scenes:
        raise InputError(f"shares no scene with {a}.", file=b)
    return [_agreement(scene, tables[0][scene], tables[1][scene]) for scene in scenes]


@dataclass(frozen=True)
class SweepComparison:
    """A ``experiments.results.compare.Compared``.

    Attributes:
        agreements: What both say of each scene.
        scenes: Label by label, of every scene that both have results of.
    """

    agreements: list[Agreement]
    scenes: dict[str, Comparison]
    columns: tuple[str, ...] = ("scene", *SCENE_COLUMNS)

    @property
    def rows(self) -> list[dict[str, Any]]:
        return [{"scene": name, **row} for name, found in self.scenes.items() for row in found.rows]

    def regressions(self, percent: float) -> list[str]:
        return [f"{name}: {why}" for name, found in self.scenes.items() for why in found.regressions(percent)]

    def as_json(self) -> dict[str, Any]:
        scenes = {name: found.as_json() for name, found in self.scenes.items()}
        return {"agreement": [entry.row() for entry in self.agreements], "scenes": scenes}

    def text(self) -> str:
        head = ["", "Rank correlations (Spearman) and Pareto fronts", aligned(_rows_for_people(self.agreements))]
        return "\n".join(head + [f"\n==== {name}\n{found.text()}" for name, found in self.scenes.items()])


def compare_sweeps(a: str | Path, b: str | Path) -> SweepComparison:
    """How sweep B differs from A.

    Raises:
        InputError: One is no folder of a sweep, they share no scene, or one is not the same in both.
    """
    agreements = agree(a, b)
    stores = [SweepStore.existing(out) for out in (a, b)]
    both = [name for name in stores[0].scene_names() if all((s.scene(name) / "frames.csv").is_file() for s in stores)]
    return SweepComparison(agreements, {name: compare(*(s.scene(name) for s in stores)) for name in both})


def _by_scene(rows: list[dict[str, str]]) -> dict[str, dict[str, Row]]:
    out: dict[str, dict[str, Row]] = {}
    for row in rows:
        out.setdefault(row["scene"], {})[row["label"]] = row
    return out


def _agreement(scene: str, a: Mapping[str, Row], b: Mapping[str, Row]) -> Agreement:
    common = [label for label in a if label in b]
    fronts = [tuple(label for label in common if part[label]["on_front"] == "yes") for part in (a, b)]
    return Agreement(scene, len(common), _spearman(common, a, b, "ratio"), _spearman(common, a, b, "rmse"), *fronts)


def _spearman(labels: list[str], a: Mapping[str, Row], b: Mapping[str, Row], column: str) -> float | None:
    pairs = [(a[label][column], b[label][column]) for label in labels]
    values = np.array([(float(x), float(y)) for x, y in pairs if x and y]).reshape(-1, 2)
    if len(values) < 2 or (values.max(axis=0) == values.min(axis=0)).any():
        return None
    return float(stats.spearmanr(values[:, 0], values[:, 1]).statistic)


def _rows_for_people(found: list[Agreement]) -> list[list[str]]:
    """A head and one line per scene."""

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    lines = [["scene", "labels", "ranks by time", "ranks by error", "on the fronts", "on one only"]]
    for entry in found:
        union = len(set(entry.front_a) | set(entry.front_b))
        same = f"{union - len(entry.differ)} of {union} agree"
        numbers = [number(entry.spearman_time), number(entry.spearman_error)]
        lines.append([entry.scene, str(entry.labels), *numbers, same, ", ".join(entry.differ) or "-"])
    return lines
