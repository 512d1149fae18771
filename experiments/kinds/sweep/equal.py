"""At the same time, who errs least; at the same error, who is fastest: equal_time.csv and equal_error.csv.

Places are shared by labels that cannot be told apart from the first of their place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from experiments.kinds.sweep.pareto import WITHIN, SceneResults, errors_differ


def equal_time(scene: SceneResults, budgets: Sequence[str | float]) -> list[dict[str, Any]]:
    """Labels that take no more than the baseline's time, and than each budget's, from the least error on.

    A label's time as a budget compares by paired ratios and is kept by what takes at most ``WITHIN`` longer; a budget
    in milliseconds is kept as it stands.
    """
    out: list[dict[str, Any]] = []
    for budget in (scene.baseline, *(b for b in budgets if b != scene.baseline)):
        if isinstance(budget, str):
            if budget not in scene.complete:
                continue
            within = [label for label in _measured(scene) if scene.ratio(label, budget) <= 1.0 + WITHIN]
            head = {"budget_label": budget, "budget_ms": _ms(scene, budget)}
        else:
            within = [label for label in _measured(scene) if _ms(scene, label) <= budget]
            head = {"budget_label": f"{budget:g} ms", "budget_ms": float(budget)}
        out += [
            {"scene": scene.name, **head, "place": place, **_numbers(scene, label)}
            for place, label in by_error(scene, within)
        ]
    return out


def equal_error(scene: SceneResults, budgets: Sequence[str | float]) -> list[dict[str, Any]]:
    """Labels whose error is not distinguishably larger than the baseline's, and than each label's of the budgets."""
    out: list[dict[str, Any]] = []
    known = _measured(scene)
    for target in (scene.baseline, *(b for b in budgets if b != scene.baseline)):
        if not isinstance(target, str) or target not in known:
            continue
        relations = scene.relations
        good = [label for label in known if relations.no_worse[_at(scene, label), _at(scene, target)]]
        head = {"scene": scene.name, "target_label": target, "target_rmse": _rmse(scene, target)}
        out += [{**head, "place": place, **_numbers(scene, label)} for place, label in by_time(scene, good)]
    return out


def by_error(scene: SceneResults, labels: Sequence[str]) -> list[tuple[int, str]]:
    """Places from the least error on; within a place, from the fastest on."""

    def same(leader: str, label: str) -> bool:
        return not errors_differ(_rmse(scene, label), _rmse(scene, leader), scene.noise)

    placed = _places(sorted(labels, key=lambda label: (_rmse(scene, label), _ms(scene, label))), same)
    return sorted(placed, key=lambda entry: (entry[0], _ms(scene, entry[1])))


def by_time(scene: SceneResults, labels: Sequence[str]) -> list[tuple[int, str]]:
    """Places from the fastest on; within a place, from the least error on."""

    def same(leader: str, label: str) -> bool:
        return bool(scene.relations.log_low[_at(scene, label), _at(scene, leader)] <= 0.0)

    placed = _places(sorted(labels, key=lambda label: (_ms(scene, label), _rmse(scene, label))), same)
    return sorted(placed, key=lambda entry: (entry[0], _rmse(scene, entry[1])))


def _places(ranked: Sequence[str], same: Callable[[str, str], bool]) -> list[tuple[int, str]]:
    out: list[tuple[int, str]] = []
    place, leader = 0, ""
    for i, label in enumerate(ranked):
        if not out or not same(leader, label):
            place, leader = i + 1, label
        out.append((place, label))
    return out


def _measured(scene: SceneResults) -> list[str]:
    return [label for label in scene.complete if np.isfinite(_rmse(scene, label))]


def _numbers(scene: SceneResults, label: str) -> dict[str, Any]:
    return {"label": label, "frame_ms": _ms(scene, label), "rmse": _rmse(scene, label)}


def _at(scene: SceneResults, label: str) -> int:
    return scene.relations.labels.index(label)


def _ms(scene: SceneResults, label: str) -> float:
    return float(scene.row(label)["frame_ms"])


def _rmse(scene: SceneResults, label: str) -> float:
    return float(scene.row(label)["rmse"])
