"""recommendation.csv: which label to take in a scene, and why, in sentences that give the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.kinds.sweep.config import ALL
from experiments.kinds.sweep.equal import by_error, equal_error, equal_time
from experiments.kinds.sweep.overall import geometric_mean, overall_relations, relative_error
from experiments.kinds.sweep.pareto import WITHIN, SceneResults

NOTED_SHARE = 0.001  # of the pixels: a thousandth is 230 of 640 x 360, a spot that is seen
NOTED_WIDTH = 0.1  # of a penumbra's width


def recommend(scene: SceneResults) -> dict[str, Any]:
    """The row of one scene: the label with the least error in the baseline's time, the fastest of those that tie."""
    base = scene.baseline
    if base not in scene.complete:
        return _row(scene.name, None, f"The baseline {base} did not run to its end, so that nothing can be compared.")
    if not len(scene.errors):
        fastest = min(scene.complete, key=lambda label: scene.ratio(label, base))
        cost = f"{fastest} is fastest ({_times(scene, fastest)})"
        return _row(scene.name, fastest, f"No reference frame was made, so that errors are unknown; {cost}.")
    ranked = [row for row in equal_time(scene, []) if row["budget_label"] == base]
    if not ranked:
        return _row(scene.name, None, f"The error of {base} is unknown, so that nothing can be compared.")
    best = str(ranked[0]["label"])
    ties = [str(row["label"]) for row in ranked if row["place"] == 1 and row["label"] != best]
    budget = f"In the time of {base} ({_number(ranked[0]['budget_ms'])} ms, RMSE {_rmse(scene, base)})"
    if best == base:
        sentences = [f"{budget} nothing errs less."]
    else:
        sentences = [f"{budget} {best} errs least: RMSE {_rmse(scene, best)} in {_times(scene, best)}."]
    if ties:
        sentences.append(f"Not distinguishable from it in error: {', '.join(ties)}.")
    sentences.append(_cheapest(scene))
    most = by_error(scene, [label for label in scene.complete if np.isfinite(scene.row(label)["rmse"])])[0][1]
    if most != best:
        sentences.append(f"Least error of all: {most}, RMSE {_rmse(scene, most)} in {_times(scene, most)}.")
    sentences.append(weaknesses(scene, best))
    return _row(scene.name, best, " ".join(sentence for sentence in sentences if sentence))


def recommend_overall(scenes: Sequence[SceneResults]) -> dict[str, Any] | None:
    """The row over all scenes; None where no label can be compared over them."""
    relations = overall_relations(scenes)
    if relations is None:
        return None
    base = relations.labels.index(scenes[0].baseline)
    costs = {label: float(np.exp(relations.log_ratio[i, base])) for i, label in enumerate(relations.labels)}
    errors = {
        label: geometric_mean([relative_error(scene, label) for scene in scenes])
        for label in relations.labels
        if costs[label] <= 1.0 + WITHIN
    }
    known = {label: error for label, error in errors.items() if np.isfinite(error)}
    if not known:
        return None
    best = min(known, key=lambda label: (known[label], costs[label]))
    name = scenes[0].baseline
    where = f"Over {len(scenes)} scenes, in the time of {name}"
    if best == name:
        sentences = [f"{where} nothing errs less."]
    else:
        sentences = [
            f"{where}, {best} errs least: {_number(known[best])} times its RMSE in {_number(costs[best])} times its "
            "time (geometric means)."
        ]
    own = [f"{scene.name} {_number(relative_error(scene, best))}" for scene in scenes]
    if best != name:
        sentences.append(f"Its RMSE relative to {name} by scene: {', '.join(own)}.")
    good = [
        label
        for i, label in enumerate(relations.labels)
        if relations.no_worse[i, base] and costs[label] < 1.0 and relations.faster[i, base]
    ]
    if good:
        cheapest = min(good, key=lambda label: costs[label])
        sentences.append(f"No worse than {name} and cheapest: {cheapest}, {_number(costs[cheapest])} times its time.")
    return _row(ALL, best, " ".join(sentences))


def _cheapest(scene: SceneResults) -> str:
    """Who reaches the baseline's error in the least time."""
    base = scene.baseline
    ranked = [row for row in equal_error(scene, []) if row["target_label"] == base]
    fastest = str(min(ranked, key=lambda row: scene.ratio(str(row["label"]), base))["label"]) if ranked else base
    if fastest == base:
        return f"Nothing reaches its error in less time than {base}."
    cost = f"RMSE {_rmse(scene, fastest)} in {_times(scene, fastest)}"
    return f"Cheapest at no larger error than {base}: {fastest}, {cost}."


def weaknesses(scene: SceneResults, label: str) -> str:
    """What a label's errors are: acne, leaks, penumbrae too wide or too hard; empty where nothing was measured."""
    own = scene.row(label)
    acne, leak, width = (float(own[name]) for name in ("acne", "leak", "penumbra_width_error"))
    found = []
    if acne > NOTED_SHARE:
        found.append(f"acne on {_percent(acne)} of the pixels amid lit ones")
    if leak > NOTED_SHARE:
        found.append(f"leaks on {_percent(leak)} of those amid umbra")
    if abs(width) > NOTED_WIDTH:
        found.append(f"penumbrae {_percent(abs(width))} too {'wide' if width > 0.0 else 'hard'}")
    parts = {"RMSE in the umbra": "rmse_umbra", "in the penumbra": "rmse_penumbra", "where it is lit": "rmse_lit"}
    scores = [f"{text} {_number(float(own[name]))}" for text, name in parts.items() if np.isfinite(float(own[name]))]
    if not scores:
        return ""
    fails = f"{label} has {' and '.join([', '.join(found[:-1]), found[-1]] if found[1:] else found)}" if found else ""
    good = f"{label} has no acne and no leaks worth naming"
    if not found and np.isfinite(width):
        good += f", and penumbrae within {_percent(NOTED_WIDTH)} of their width"
    return f"{fails or good}; {', '.join(scores)}."


def _row(scene: str, label: str | None, reason: str) -> dict[str, Any]:
    return {"scene": scene, "label": label, "reason": reason}


def _times(scene: SceneResults, label: str) -> str:
    ms = f"{_number(float(scene.row(label)['frame_ms']))} ms"
    if label == scene.baseline:
        return ms
    return f"{ms}, {_number(scene.ratio(label, scene.baseline))} times the time of {scene.baseline}"


def _rmse(scene: SceneResults, label: str) -> str:
    return _number(float(scene.row(label)["rmse"]))


def _number(value: float) -> str:
    return format(value, ".3g")


def _percent(share: float) -> str:
    percent = 100.0 * share
    return f"{percent:.2g} %" if percent < 99.5 else f"{percent:.0f} %"
