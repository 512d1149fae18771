"""``wkernels compare``: intervals, verdicts, the gate and what cannot be compared."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fake_engine import FakeEngine, make_experiment, make_run
from scipy.stats import binom

from experiments import cli
from experiments.kinds.walkthrough.run import run
from experiments.results.compare import compare, median_interval
from experiments.results.store import Store

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    def call(name: str, *runs, frames: int = 8, **engine) -> Path:
        experiment = make_experiment(runs=runs, frames=range(frames), every=1)
        out = run(experiment, tmp_path / name, engine=FakeEngine(experiment), report=False)
        return Path(out)

    return call


def by_label(a: Path, b: Path) -> dict[str, dict]:
    return {row["label"]: row for row in compare(a, b).rows}


@pytest.mark.parametrize("n", [1, 2, 5, 6, 7, 20, 101])
def test_the_interval_is_the_binomial_one(n: int) -> None:
    values = np.arange(1.0, n + 1.0)
    found = median_interval(np.random.default_rng(n).permutation(values))
    rank = int(found.low)
    assert found.high == n + 1 - rank and found.median == np.median(values)
    assert found.confidence == pytest.approx(1.0 - 2.0 * binom.cdf(rank - 1, n, 0.5), abs=1e-12)
    assert found.confidence >= 0.95 or rank == 1
    assert 1.0 - 2.0 * binom.cdf(rank, n, 0.5) < 0.95  # the next narrower one would not do


def test_the_interval_covers_the_median_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    hits = [not (found := median_interval(rng.lognormal(size=25))).low > 1.0 and found.high >= 1.0 for _ in range(2000)]
    assert abs(np.mean(hits) - found.confidence) < 0.015  # 3 standard errors of a share near .957 of 2000


def test_a_run_is_the_same_as_itself(make: Make) -> None:
    a = make("a", make_run("base"), make_run("x", ms=7.0))
    for row in compare(a, a).rows:
        assert row["error"] == "same" and row["time"] == "not distinguishable" and row["rmse_ratio"] == 1.0


def test_changes_are_seen_and_the_machine_cancels(make: Make) -> None:
    """B runs at half the speed (but for the fake frames' 0.25 ms each): x costs as before, y has become cheaper and worse."""
    a = make("a", make_run("base", ms=4.0), make_run("x", ms=8.0), make_run("y", error=0.1, ms=8.0), make_run("gone"))
    b = make("b", make_run("base", ms=8.0), make_run("x", ms=16.0), make_run("y", error=0.2, ms=8.0), make_run("new"))
    found, rows = compare(a, b), by_label(a, b)
    assert found.only_a == ["gone"] and found.only_b == ["new"]
    assert rows["base"]["time"] == "slower" and rows["base"]["relative_ms_ratio"] is None
    assert rows["x"]["frame_ms_ratio"] > 1.7 and abs(rows["x"]["relative_ms_ratio"] - 1.0) < 0.08
    assert rows["y"]["time"] == "faster" and rows["y"]["error"] == "worse"
    assert rows["y"]["rmse_low"] <= rows["y"]["rmse_ratio"] <= rows["y"]["rmse_high"]
    assert found.regressions(5.0) == [
        "gone: missing",
        next(r for r in found.regressions(5.0) if r.startswith("y: RMSE")),
    ]
    assert [reason for reason in found.regressions(500.0) if "RMSE" in reason] == []


def test_other_references_leave_what_is_within_their_errors(make: Make) -> None:
    """The fake reference's error is 0.01: a growth of 0.005 counts only where both runs share the reference."""
    a, b = make("a", make_run("base", error=0.1)), make("b", make_run("base", error=0.105))
    assert by_label(a, b)["base"]["error"] == "worse"
    store = Store.existing(b)
    store.update_environment(run={**store.environment()["run"], "reference_samples": 16})
    assert by_label(a, b)["base"]["error"] == "not distinguishable"


def test_another_definition_of_the_metric_is_not_compared(make: Make) -> None:
    a, b = make("a", make_run("base")), make("b", make_run("base", error=0.4))
    store = Store.existing(b)
    store.update_environment(metrics={**store.environment()["metrics"], "rmse": 99})
    found = compare(a, b)
    assert found.rows[0]["error"] is None and any("RMSE is defined differently" in note for note in found.notes)


def test_the_command_prints_gates_and_refuses(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = make("a", make_run("base", error=0.1)), make("b", make_run("base", error=0.2))
    other = make("other", make_run("base"))
    store = Store.existing(other)
    store.update_environment(identity={**store.environment()["identity"], "scene": "another"})

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["wkernels", "compare", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    status, out, _ = call(str(a), str(b))
    assert status == 0 and "worse" in out and "B / A" in out
    status, out, _ = call(str(a), str(b), "--gate", "10")
    assert status == 1 and "CLOSED" in out and "base: RMSE" in out
    status, out, _ = call(str(b), str(a), "--gate", "10", "--out", str(tmp_path / "c.csv"))
    assert status == 0 and "open" in out and (tmp_path / "c.csv").read_text().startswith("label,rmse_a")
    status, out, _ = call(str(a), str(b), "--json", "--gate", "10")
    assert status == 1 and json.loads(out)["rows"][0]["error"] == "worse"
    status, _, err = call(str(a), str(other))
    assert status == 2 and "its scene is another" in err
    status, _, err = call(str(a), str(tmp_path / "none"))
    assert status == 2 and "no such result folder" in err
