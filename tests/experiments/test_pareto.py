"""Who dominates whom, and what a sweep's tables say: from times and errors that are written down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments.kinds.sweep.equal import equal_error, equal_time
from experiments.kinds.sweep.overall import overall_rows
from experiments.kinds.sweep.pareto import WITHIN, SceneResults, errors_differ, scene_rows
from experiments.kinds.sweep.recommend import recommend, recommend_overall, weaknesses
from experiments.results.store import FRAME_COLUMNS
from experiments.results.summary import pareto_front, summarise

FRAMES = 12


def scene(
    labels: Mapping[str, tuple[float, float]],
    *,
    name: str = "s",
    noise: float = 1e-4,
    jitter: float = 0.0,
    incomplete: Sequence[str] = (),
    scores: Mapping[str, float] = {},
) -> SceneResults:
    """Milliseconds and RMSE by label; the first is the baseline. Times vary by a factor of exp(jitter) or so."""
    rng = np.random.default_rng(7)
    rows = []
    for label, (ms, rmse) in labels.items():
        for frame in range(FRAMES):
            speed = float(np.exp(jitter * rng.normal()))
            row = {"technique": label, "label": label, "frame": frame, "frame_ms": ms * speed, "rmse": rmse}
            rows.append(row | {"reference_standard_error": noise} | dict(scores))
    base = next(iter(labels))
    frames = pd.DataFrame(rows)
    table = frames.reindex(columns=list(FRAME_COLUMNS))
    numbers = [column for column in FRAME_COLUMNS if column not in ("technique", "label")]
    table[numbers] = table[numbers].astype(float)
    return SceneResults(
        name,
        base,
        summarise(table, base).set_index("label", drop=False),
        frames.pivot(index="frame", columns="label", values="frame_ms"),
        frames.pivot(index="frame", columns="label", values="rmse"),
        noise,
        frozenset(incomplete),
        len(labels),
    )


def front(results: SceneResults) -> list[str]:
    return [row["label"] for row in scene_rows(results) if row["on_front"] == "yes"]


def test_without_noise_the_front_is_the_ordinary_one() -> None:
    rng = np.random.default_rng(1)
    points = {f"l{i}": (float(np.exp(rng.normal())), float(np.exp(rng.normal() - 3.0))) for i in range(14)}
    cost, error = np.array(list(points.values())).T
    # no two of these are within WITHIN of each other where it would matter
    assert front(scene(points)) == [name for name, on in zip(points, pareto_front(cost, error), strict=True) if on]


@pytest.mark.parametrize(("ms", "on_front"), [(9.0, True), (9.9, True), (10.0, False), (11.0, False)])
def test_who_is_surely_faster_stays_on_the_front_however_bad(ms: float, on_front: bool) -> None:
    assert ("bad" in front(scene({"good": (10.0, 0.01), "bad": (ms, 0.5)}))) is on_front


def test_times_that_cannot_be_told_apart_do_not_save_a_worse_picture() -> None:
    found = scene({"good": (10.0, 0.01), "bad": (9.9, 0.5)}, jitter=0.05)
    relations = found.relations
    assert not relations.faster[1, 0] and relations.no_slower[0, 1]
    assert front(found) == ["good"] and scene_rows(found)[1]["dominated_by"] == "good"


def test_wide_intervals_do_not_call_a_much_slower_label_no_slower() -> None:
    found = scene({"good": (13.0, 0.01), "bad": (10.0, 0.5)}, jitter=1.0)
    relations = found.relations
    assert relations.log_low[0, 1] < 0.0 and relations.log_ratio[0, 1] > np.log1p(WITHIN)  # else the case is none
    assert front(found) == ["good", "bad"]


def test_errors_within_the_references_noise_are_the_same() -> None:
    labels = {"slow": (20.0, 0.010), "fast": (10.0, 0.011)}
    assert front(scene(labels, noise=1e-4)) == ["slow", "fast"]
    assert front(scene(labels, noise=0.01)) == ["fast"]


def test_errors_differ_in_squares() -> None:
    """The reference's own error is in both: two that are 0.30 and 0.31 apart from it differ by 0.08 from each other."""
    assert errors_differ(0.30, 0.31, 0.03) and not errors_differ(0.30, 0.31, 0.04)
    assert errors_differ(0.0, 0.03, 0.01) and not errors_differ(0.0, 0.03, 0.015) and not errors_differ(0.2, 0.2, 0.0)


def test_frames_that_disagree_leave_errors_undecided() -> None:
    found = scene({"a": (20.0, 0.1), "b": (10.0, 0.2)})
    found.errors.loc[found.errors.index % 2 == 0, "b"] = 0.01
    assert not found.relations.better[0, 1] and found.relations.no_worse[1, 0]
    assert front(found) == ["b"]


def test_what_failed_or_was_not_measured_is_on_no_front() -> None:
    rows = scene_rows(scene({"a": (1.0, 0.1), "b": (0.1, 0.01)}, incomplete=["b"]))
    assert [row["on_front"] for row in rows] == ["yes", None]
    rows = scene_rows(scene({"a": (1.0, np.nan), "b": (2.0, 0.1)}))
    assert [row["on_front"] for row in rows] == [None, "yes"]


LABELS = {
    "base": (10.0, 0.1),
    "twin": (10.2, 0.1001),
    "sharp": (9.0, 0.05),
    "cheap": (3.0, 0.09),
    "long": (40.0, 0.001),
}


def test_equal_time_ranks_by_error_and_shares_places() -> None:
    rows = equal_time(scene(LABELS, noise=0.004), ["cheap", 9.5])
    got = [(row["budget_label"], row["place"], row["label"]) for row in rows]
    assert got == [
        ("base", 1, "sharp"),
        ("base", 2, "cheap"),
        ("base", 3, "base"),
        ("base", 3, "twin"),  # within WITHIN of the budget, and not distinguishable in error
        ("cheap", 1, "cheap"),
        ("9.5 ms", 1, "sharp"),
        ("9.5 ms", 2, "cheap"),
    ]
    assert rows[0]["budget_ms"] == pytest.approx(10.0) and rows[-1]["budget_ms"] == 9.5


def test_equal_error_ranks_by_time() -> None:
    rows = equal_error(scene(LABELS, noise=0.004), ["sharp", 9.5])
    got = [(row["target_label"], row["place"], row["label"]) for row in rows]
    base = [("base", 1, "cheap"), ("base", 2, "sharp"), ("base", 3, "base"), ("base", 4, "twin"), ("base", 5, "long")]
    assert got == [*base, ("sharp", 1, "sharp"), ("sharp", 2, "long")]


def test_over_scenes_means_are_geometric_and_relative() -> None:
    a = scene({"base": (10.0, 0.1), "x": (20.0, 0.05), "gone": (1.0, 0.1)}, name="a")
    b = scene({"base": (1.0, 0.4), "x": (8.0, 0.025)}, name="b")
    rows = {row["label"]: row for row in overall_rows([a, b])}
    assert list(rows) == ["base", "x"] and {row["scene"] for row in rows.values()} == {"all"}
    assert rows["x"]["ratio"] == pytest.approx(4.0) and rows["x"]["rmse"] == pytest.approx(np.sqrt(0.5 * 0.0625))
    assert rows["x"]["ratio_q1"] == pytest.approx(3.5) and rows["base"]["ratio"] == pytest.approx(1.0)
    assert rows["x"]["on_front"] == rows["base"]["on_front"] == "yes"


def test_a_label_dominated_in_the_mean_is_off_the_front_over_scenes() -> None:
    a = scene({"base": (10.0, 0.1), "x": (9.0, 0.05)}, name="a")
    b = scene({"base": (10.0, 0.1), "x": (9.0, 0.11)}, name="b")
    rows = {row["label"]: row for row in overall_rows([a, b])}
    assert rows["base"]["on_front"] == "no" and rows["base"]["dominated_by"] == "x"
    assert overall_rows([a, scene({"base": (1.0, 0.1), "x": (1.0, 1.0)}, incomplete=["base"])]) == []


def test_a_recommendation_gives_its_numbers() -> None:
    row = recommend(scene(LABELS, noise=0.004))
    assert row["label"] == "sharp"
    for text in (
        "In the time of base (10 ms, RMSE 0.1) sharp errs least: RMSE 0.05 in 9 ms, 0.9 times the time of base.",
        "Cheapest at no larger error than base: cheap, RMSE 0.09 in 3 ms, 0.3 times the time of base.",
        "Least error of all: long, RMSE 0.001 in 40 ms, 4 times the time of base.",
    ):
        assert text in row["reason"]
    overall = recommend_overall([scene(LABELS, name="a"), scene(LABELS, name="b")])
    assert overall is not None and (overall["scene"], overall["label"]) == ("all", "sharp")
    assert "0.5 times its RMSE in 0.9 times its time" in overall["reason"] and "cheapest: cheap" in overall["reason"]


def test_nobody_is_recommended_without_a_baseline_or_errors() -> None:
    assert recommend(scene(LABELS, incomplete=["base"]))["label"] is None
    blind = scene({"base": (10.0, np.nan), "fast": (2.0, np.nan)})
    row = recommend(replace(blind, errors=blind.errors.iloc[:0]))
    assert row["label"] == "fast" and "errors are unknown" in row["reason"]


@pytest.mark.parametrize(
    ("scores", "says"),
    [
        ({"acne": 0.02, "leak": 0.003, "penumbra_width_error": -0.5}, "base has acne on 2 % of the pixels amid lit ones, leaks on 0.3 % of those amid umbra and penumbrae 50 % too hard; "),
        ({"acne": 0.0, "leak": 0.0, "penumbra_width_error": 0.05}, "base has no acne and no leaks worth naming, and penumbrae within 10 % of their width; "),
        ({"acne": 0.0, "penumbra_width_error": 0.3}, "base has penumbrae 30 % too wide; "),
    ],
)  # fmt: skip
def test_weaknesses_are_named(scores: dict[str, float], says: str) -> None:
    results = scene({"base": (1.0, 0.1)}, scores={**scores, "rmse_umbra": 0.2, "rmse_lit": 0.01})
    assert weaknesses(results, "base") == says + "RMSE in the umbra 0.2, where it is lit 0.01."
