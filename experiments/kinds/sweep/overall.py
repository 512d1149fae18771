"""Rows of pareto.csv over all scenes: geometric means of what each label costs, and errs, relative to the baseline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.kinds.sweep.config import ALL
from experiments.kinds.sweep.pareto import Relations, SceneResults, quartiles, yes_no


def overall_rows(scenes: Sequence[SceneResults]) -> list[dict[str, Any]]:
    """One row per label that is complete in every scene.

    ``ratio`` and ``rmse`` are relative to the baseline; their quartiles are over the scenes.
    """
    relations = overall_relations(scenes)
    if relations is None:
        return []
    out: list[dict[str, Any]] = []
    for label, on_front in zip(relations.labels, relations.front(), strict=True):
        row: dict[str, Any] = {"scene": ALL, "technique": scenes[0].row(label)["technique"], "label": label}
        costs = np.array([scene.ratio(label, scene.baseline) for scene in scenes])
        errors = np.array([relative_error(scene, label) for scene in scenes])
        for name, values in (("ratio", costs), ("rmse", errors)):
            if np.isfinite(values).all():
                row |= quartiles(name, values) | {name: geometric_mean(values)}
        told = [scene.row(label)["distinguishable"] for scene in scenes]
        if all(value is not None for value in told):
            row["error_to_reference"] = "distinguishable" if any(told) else "not distinguishable"
        row["on_front"] = yes_no(on_front)
        if on_front is False:
            row["dominated_by"] = "; ".join(relations.dominators(label))
        out.append(row)
    return out


def overall_relations(scenes: Sequence[SceneResults]) -> Relations | None:
    """Every label that is complete in every scene against every other; None without labels or baseline.

    Times: the mean over scenes of the logarithms of ratio and interval. Errors: a label is better than another where
    its geometric mean is smaller and some scene tells them apart so; no worse where its mean is no larger, or where no
    scene tells that it is worse.
    """
    if not scenes:
        return None
    labels = tuple(label for label in scenes[0].complete if all(label in scene.complete for scene in scenes[1:]))
    if not labels or any(scene.baseline not in scene.complete for scene in scenes):
        return None
    places = [np.array([scene.complete.index(label) for label in labels]) for scene in scenes]

    def over_scenes(name: str) -> np.ndarray:
        parts = [getattr(scene.relations, name)[np.ix_(at, at)] for scene, at in zip(scenes, places, strict=True)]
        return np.stack(parts)

    means = np.array([geometric_mean([relative_error(scene, label) for scene in scenes]) for label in labels])
    less, known = means[:, None] < means[None, :], np.isfinite(means)[:, None] & np.isfinite(means)[None, :]
    better = over_scenes("better")
    no_scene_worse = over_scenes("no_worse").all(axis=0)
    return Relations(
        labels,
        over_scenes("log_ratio").mean(axis=0),
        over_scenes("log_low").mean(axis=0),
        over_scenes("log_high").mean(axis=0),
        less & better.any(axis=0),
        known & (less | (means[:, None] == means[None, :]) | no_scene_worse),
    )


def relative_error(scene: SceneResults, label: str) -> float:
    """RMSE over the baseline's, of medians over frames; NaN where either is unknown or the baseline has no error."""
    own, base = (float(scene.row(name)["rmse"]) for name in (label, scene.baseline))
    return own / base if base > 0.0 else float("nan")


def geometric_mean(values: Sequence[float] | np.ndarray) -> float:
    """0 where one of them is 0."""
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(np.asarray(values, float)))))
