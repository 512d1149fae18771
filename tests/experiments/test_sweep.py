"""Running sweeps with a renderer that answers at once: folders, resuming, failures, reports, and how far runs agree."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fake_engine import PLUGINS, FakeEngine, make_experiment, make_run

from experiments import cli
from experiments.kinds.kind import kind_of_folder
from experiments.kinds.sweep.agreement import agree
from experiments.kinds.sweep.config import Sweep, SweepFile, SweepScene
from experiments.kinds.sweep.report import write_sweep_report
from experiments.kinds.sweep.run import SweepFailed, run_sweep
from experiments.kinds.sweep.store import SweepStore
from experiments.results.store import TABLES, Store
from experiments.schema.experiment import Experiment
from wkernels.errors import InputError

FILE = {"kind": "sweep", "image": {"width": 24, "height": 16}, "scene": "x", "techniques": "all"}
SCENES = ("one", "two", "three")
RUNS = (
    make_run("base", error=0.1, ms=4.0),
    make_run("exact", error=0.0, ms=9.0),
    make_run("poor", error=0.3, ms=8.0),
    make_run("quick", error=0.2, ms=2.0),
)


def make_sweep(runs: Sequence[Any] = RUNS, *, scenes: Sequence[str] = SCENES, budgets: Sequence[Any] = ()) -> Sweep:
    """The middle scene does not serve the label `poor`."""
    parts = []
    for i, name in enumerate(scenes):
        left = [run for run in runs if i == 1 and run.label == "poor"]
        own = [run for run in runs if run not in left]
        experiment = replace(make_experiment(own, frames=range(4), every=1, repeats=2), name=name)
        parts.append(SweepScene(experiment, tuple((run, "it is not made for it") for run in left)))
    return Sweep("fake", SweepFile.model_validate(FILE), tuple(parts), tuple(runs), "base", tuple(budgets))


def swept(out: Path, sweep: Sweep | None = None, **options: Any) -> SweepStore:
    options.setdefault("engine", FakeEngine)
    options.setdefault("report", False)  # a scene's takes a second
    return SweepStore(run_sweep(sweep or make_sweep(), out, plugins=PLUGINS, **options))


def everything(out: Path) -> dict[str, bytes]:
    """All tables of a sweep and its scenes."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*.csv"))}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return swept(tmp_path_factory.mktemp("whole") / "o", make_sweep(budgets=("quick", 9.0))).out


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes with reports."""
    return swept(tmp_path_factory.mktemp("reported") / "o", make_sweep(scenes=SCENES[:2]), report=True).out


def test_every_scene_is_a_walkthroughs_folder(reported: Path) -> None:
    for name in SCENES[:2]:
        store = Store.existing(reported / name)
        assert {f"{table}.csv" for table in TABLES} <= {path.name for path in store.out.iterdir()}
        assert (store.out / "report.html").is_file() and (store.out / "summary.csv").is_file()
        assert store.image_frames("exact") == store.image_frames(None) == [0, 1, 2, 3]
        assert len(store.rows("repeats")) == 2 * len(store.rows("frames"))
    assert (reported / "config.yaml").is_file() and SweepStore.existing(reported).scene_names() == list(SCENES[:2])
    assert {path.name for path in (reported / "plots").glob("*.png")} == {
        f"pareto_{n}.png" for n in (*SCENES[:2], "all")
    }


def test_what_a_scene_does_not_serve_is_a_row(reported: Path) -> None:
    rows = [row for row in Store(reported / "two").rows("left_out") if row["label"] == "poor"]
    assert [(row["reason"], row["count"], row["frame"]) for row in rows] == [("it is not made for it", "4", "")]
    assert "it is not made for it" in (reported / "two" / "report.html").read_text()


def test_repeats_are_kept_and_give_the_frames_medians(whole: Path) -> None:
    store = Store(whole / "one")
    for row in store.rows("frames"):
        own = [
            float(r["frame_ms"])
            for r in store.rows("repeats")
            if (r["label"], r["frame"]) == (row["label"], row["frame"])
        ]
        assert float(row["frame_ms"]) == pytest.approx(sum(own) / 2)


def test_the_tables_say_who_is_worth_the_time(whole: Path) -> None:
    rows = {(row["scene"], row["label"]): row for row in SweepStore(whole).rows("pareto")}
    assert [label for scene, label in rows if scene == "all"] == ["base", "exact", "quick"]
    for scene in (*SCENES, "all"):
        front = {label for (place, label), row in rows.items() if place == scene and row["on_front"] == "yes"}
        assert front == {"base", "exact", "quick"}, scene
    assert rows["one", "poor"]["on_front"] == "no" and rows["one", "poor"]["dominated_by"] == "base; quick"
    assert rows["one", "exact"]["error_to_reference"] == "not distinguishable"
    assert rows["one", "base"]["ratio"] == rows["all", "base"]["rmse"] == "1"
    assert 1.9 < float(rows["all", "exact"]["ratio"]) < 2.3 and rows["all", "exact"]["frame_ms"] == ""
    equal = [row for row in SweepStore(whole).rows("equal_time") if row["scene"] == "one"]
    placed = {
        budget: [r["label"] for r in equal if r["budget_label"] == budget] for budget in ("base", "quick", "9 ms")
    }
    assert placed == {"base": ["base", "quick"], "quick": ["quick"], "9 ms": ["base", "quick", "poor"]}
    assert [row["place"] for row in equal if row["budget_label"] == "9 ms"] == ["1", "2", "3"]
    targets = [(r["target_label"], r["label"]) for r in SweepStore(whole).rows("equal_error") if r["scene"] == "two"]
    assert targets == [("base", "base"), ("base", "exact"), ("quick", "quick"), ("quick", "base"), ("quick", "exact")]
    advice = {row["scene"]: row for row in SweepStore(whole).rows("recommendation")}
    assert list(advice) == [*SCENES, "all"] and {row["label"] for row in advice.values()} == {"base"}
    assert "nothing errs less" in advice["one"]["reason"] and "Least error of all: exact" in advice["one"]["reason"]


def test_a_page_is_written_that_needs_no_other_file(reported: Path) -> None:
    text = write_sweep_report(reported).read_text()
    assert 'href="two/report.html"' in text and text.count("data-chart=") == 3 and "nothing errs less" in text


def test_reporting_again_gives_the_same_tables_and_recomputing_the_same_scores(
    reported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(reported, copy)
    for name in ("pareto", "equal_time", "equal_error", "recommendation", "failures"):
        (copy / f"{name}.csv").unlink()
    store = Store(copy / "two")
    store.update_environment(metrics={**store.environment()["metrics"], "acne": 0})
    assert kind_of_folder(copy).name == "sweep"
    assert call(monkeypatch, "report", str(copy), "--recompute") == 0
    assert everything(copy) == everything(reported)
    assert Store(copy / "two").environment()["metrics"]["acne"] > 0


def test_a_report_says_which_metrics_are_of_another_version(reported: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(reported, copy)
    store = SweepStore.existing(copy)
    store.update_environment(metrics={**store.environment()["metrics"], "rmse": 9})
    assert "RMSE is that of version 9" in write_sweep_report(copy).read_text()
    assert "RMSE is that of version" not in (reported / "report.html").read_text()


def test_a_failure_is_a_row_and_the_rest_goes_on(tmp_path: Path) -> None:
    broken = make_run("broken", fails_on=2)

    def engine(experiment: Experiment) -> FakeEngine:
        if experiment.name == "two":
            raise MemoryError("no room")
        return FakeEngine(experiment)

    with pytest.raises(SweepFailed, match="'broken' failed in 'one': ValueError"):
        swept(tmp_path, make_sweep((*RUNS, broken)), engine=engine)
    store = SweepStore.existing(tmp_path)
    failed = [(row["scene"], row["label"], row["frame"]) for row in store.rows("failures")]
    assert failed == [("one", "broken", "2"), ("three", "broken", "2"), ("two", "", "")]
    assert "MemoryError: no room" in (tmp_path / "failures" / "two.txt").read_text()
    rows = {(row["scene"], row["label"]): row["on_front"] for row in store.rows("pareto")}
    assert rows["one", "broken"] == "" and rows["three", "base"] == "yes" and ("two", "base") not in rows
    assert ("all", "broken") not in rows and rows["all", "poor"] == "no"
    with pytest.raises(SweepFailed, match="'broken'"):  # what could not be made is tried again
        swept(tmp_path, make_sweep((*RUNS, broken)), resume=True)
    assert [row["scene"] for row in store.rows("failures")] == ["one", "two", "three"]


def test_a_report_that_cannot_be_written_is_a_row_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(out: Path) -> Path:
        raise InputError("the report cannot be written (No space left on device).", file=out)

    monkeypatch.setattr("experiments.kinds.walkthrough.report.write_report", full)
    with pytest.raises(SweepFailed, match=r"'one' failed: InputError: .*No space left"):
        swept(tmp_path, make_sweep(scenes=("one",)), report=True)
    assert len(Store(tmp_path / "one").rows("frames")) == 16 and len(SweepStore(tmp_path).rows("pareto")) == 4


def test_a_scene_that_is_complete_is_not_reported_again(reported: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(reported, copy)
    (copy / "one" / "report.html").write_text("mine")
    lines = (copy / "two" / "frames.csv").read_text().splitlines(keepends=True)
    (copy / "two" / "frames.csv").write_text("".join(lines[:-2]))
    (copy / "two" / "report.html").write_text("partial")
    swept(copy, make_sweep(scenes=SCENES[:2]), resume=True, report=True)
    assert (copy / "one" / "report.html").read_text() == "mine"
    assert (copy / "two" / "report.html").read_text() != "partial" and everything(copy) == everything(reported)


def test_a_technique_that_refuses_its_input_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(frame: int) -> None:
        raise InputError("cannot do this.")

    def engine(experiment: Experiment) -> FakeEngine:
        made = FakeEngine(experiment)
        opened = made.open

        def open_(run: Any) -> Any:
            session, technique = opened(run)
            if run.label == "poor":
                session.on_render = refuse
            return session, technique

        monkeypatch.setattr(made, "open", open_)
        return made

    with pytest.raises(SweepFailed, match="'poor' failed in 'one': InputError: cannot do this"):
        swept(tmp_path, engine=engine)
    assert len(SweepStore(tmp_path).rows("failures")) == 2


def test_interrupted_in_any_scene_it_goes_on_to_the_same_rows(whole: Path, tmp_path: Path) -> None:
    sweep = make_sweep(budgets=("quick", 9.0))
    for count in (1, 20, 55, 90):
        out, seen = tmp_path / str(count), 0

        def stop(frame: int, count: int = count) -> None:
            nonlocal seen
            seen += 1
            if seen == count:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            swept(out, sweep, engine=lambda experiment: FakeEngine(experiment, stop))
        swept(out, sweep, resume=True)
        assert everything(out) == everything(whole), count


def test_a_killed_process_goes_on_to_the_same_rows(whole: Path, tmp_path: Path) -> None:
    script = f"""
        import os, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from test_sweep import FakeEngine, make_sweep, swept

        count = 0

        def kill(frame):
            global count
            count += 1
            if count == 47:
                os.kill(os.getpid(), signal.SIGKILL)

        swept({str(tmp_path / "o")!r}, make_sweep(budgets=("quick", 9.0)), engine=lambda e: FakeEngine(e, kill))
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], env=environment, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    swept(tmp_path / "o", make_sweep(budgets=("quick", 9.0)), resume=True)
    assert everything(tmp_path / "o") == everything(whole)


def test_folders_of_others_are_left_alone(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="another configuration"):
        swept(whole, make_sweep(scenes=("one", "two")))
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds other files"):
        swept(tmp_path)
    assert [kind_of_folder(out).name for out in (whole, whole / "one", tmp_path)] == ["sweep"] + 2 * ["walkthrough"]


def test_a_fresh_start_forgets_every_scene(tmp_path: Path) -> None:
    """Else a kill in the first scene would leave rows of an earlier run in the others, and resuming would keep them."""
    swept(tmp_path)

    def stop(frame: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        swept(tmp_path, engine=lambda experiment: FakeEngine(experiment, stop))
    assert not (tmp_path / "three").exists() and not (tmp_path / "pareto.csv").exists()


def test_progress_counts_all_scenes(tmp_path: Path) -> None:
    told: list[tuple[int, int, str]] = []
    swept(tmp_path, progress=lambda done, total, what: told.append((done, total, what)))
    assert {total for _, total, _ in told} == {44} and told[-1] == (44, 44, "done")
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert any(what.startswith("three: frame 0") for _, _, what in told)


# ---- two sweeps ------------------------------------------------------------------------------------------------------


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["wkernels", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`quick` has become as slow as `exact` and slower; the order of the errors is as it was."""
    runs = [make_run("quick", error=0.2, ms=12.0) if run.label == "quick" else run for run in RUNS]
    return swept(tmp_path_factory.mktemp("other") / "o", make_sweep(runs)).out


def test_a_sweep_agrees_with_itself(whole: Path) -> None:
    for entry in agree(whole, whole):
        assert entry.spearman_time == entry.spearman_error == pytest.approx(1.0) and entry.differ == ()
        assert set(entry.front_a) == {"base", "exact", "quick"}


def test_what_differs_is_named(whole: Path, other: Path, tmp_path: Path) -> None:
    found = {entry.scene: entry for entry in agree(whole, other)}
    fewer = swept(tmp_path, make_sweep(scenes=SCENES[:2])).out
    assert [entry.scene for entry in agree(whole, fewer)] == ["one", "two"]  # `all` would be of other scenes
    assert list(found) == [*SCENES, "all"]
    assert found["one"].differ == found["all"].differ == ("quick",)
    # times by rank: base 2, exact 4, poor 3, quick 1 has become base 1, exact 3, poor 2, quick 4
    assert found["one"].spearman_time == pytest.approx(1.0 - 6.0 * (1 + 1 + 1 + 9) / (4 * 15))
    assert found["one"].spearman_error == pytest.approx(1.0)


def test_compare_takes_two_sweeps(
    whole: Path, other: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "compare", str(whole), str(other), "--out", str(tmp_path / "c.csv")) == 0
    out = capsys.readouterr().out
    assert "2 of 3 agree" in out and "==== three" in out and "slower" in out
    assert (tmp_path / "c.csv").read_text().startswith("scene,label,rmse_a")
    assert call(monkeypatch, "compare", str(whole), str(other), "--json", "--gate", "0") == 0
    data = json.loads(capsys.readouterr().out)
    assert data["agreement"][0]["differ"] == "quick" and set(data["scenes"]) == set(SCENES)
    assert call(monkeypatch, "compare", str(whole / "one"), str(other / "one")) == 0
