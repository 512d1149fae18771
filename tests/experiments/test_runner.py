"""The runner's rules (order, timing, resuming, failures), with a renderer that answers at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_engine import HEIGHT, WIDTH, FakeEngine, Stop, make_experiment, make_run, true_visibility

from experiments.kinds.walkthrough.label_run import Timing, pass_medians, timing_columns
from experiments.kinds.walkthrough.run import run
from experiments.metrics import registry as metrics
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr
from experiments.results.store import FRAME_COLUMNS, TABLES, Store
from experiments.schema.experiment import Experiment
from wkernels.errors import InputError


def tables(out: Path) -> dict[str, bytes]:
    return {name: (out / f"{name}.csv").read_bytes() for name in TABLES}


def finished(out: Path, experiment: Experiment | None = None, **options: Any) -> Store:
    experiment = experiment or make_experiment()
    engine = options.pop("engine", None) or FakeEngine(experiment)
    return Store(run(experiment, out, engine=engine, report=False, **options))


def test_one_row_per_label_and_frame_in_order(tmp_path: Path) -> None:
    store = finished(tmp_path)
    rows = store.rows("frames")
    labels = ["cheap", "memory", "slow [exact]"]
    assert [(row["label"], int(row["frame"])) for row in rows] == [(name, f) for f in range(5) for name in labels]
    assert list(rows[0]) == list(FRAME_COLUMNS)
    assert {name for name in TABLES if (tmp_path / f"{name}.csv").is_file()} == set(TABLES)


def test_labels_are_interleaved_after_an_untimed_warm_up(tmp_path: Path) -> None:
    experiment = make_experiment(frames=[4, 7], repeats=2)
    engine = FakeEngine(experiment)
    finished(tmp_path, experiment, engine=engine)
    cheap, memory, slow = (lane.label for lane in experiment.runs)
    warm_up = [(cheap, 4), (cheap, "reset")]
    warm_up += [(memory, 4), (memory, 7), (memory, "reset")]  # with history the second frame's kernels differ
    warm_up += [(slow, 4), (slow, "reset")]
    timed = [(label, frame) for frame in (4, 7) for _ in range(2) for label in (cheap, memory, slow)]
    assert engine.log == warm_up + timed


def test_what_remembers_is_led_in_untimed_and_nothing_else_is(tmp_path: Path) -> None:
    led, whole = (replace(make_experiment(frames=frames), lead_in=n) for frames, n in ((range(2, 5), 2), (range(5), 0)))
    engine = FakeEngine(led)
    store = Store.existing(run(led, tmp_path / "led", engine=engine, report=False))
    other = Store.existing(run(whole, tmp_path / "whole", engine=FakeEngine(whole), report=False))
    assert {entry for entry in engine.log if entry[1] in (0, 1)} == {("memory", 0), ("memory", 1)}
    assert {int(row["frame"]) for row in store.rows("frames")} == {2, 3, 4}
    rmse = [{(r["label"], r["frame"]): r["rmse"] for r in s.rows("frames")} for s in (store, other)]
    assert all(rmse[0][key] == rmse[1][key] for key in rmse[0] if rmse[0][key]), "as if all had been measured"


def test_times_are_medians_and_quartiles_of_the_repeats(tmp_path: Path) -> None:
    row = finished(tmp_path).rows("frames")[0]  # the fake adds 0.5, 0 and 1 ms to 3 ms
    assert (float(row["frame_ms_q1"]), float(row["frame_ms"]), float(row["frame_ms_q3"])) == (3.25, 3.5, 3.75)
    assert float(row["shadow_ms"]) == 2.0
    assert float(row["fps"]) == pytest.approx(1000.0 / 3.5, rel=1e-8)


def test_pass_medians_add_up_repeated_passes_and_count_missing_ones_as_nothing() -> None:
    timings = [
        Timing(5.0, 4.0, [("a", 1.0), ("b", 2.0), ("a", 2.0)]),
        Timing(4.0, 3.0, [("a", 4.0)]),
        Timing(6.0, 5.0, [("a", 5.0), ("b", 1.0)]),
    ]
    assert pass_medians(timings) == [("a", 4.0), ("b", 1.0)]
    assert timing_columns(timings)["frame_ms"] == 5.0


def test_errors_are_empty_where_there_is_no_reference(tmp_path: Path) -> None:
    rows = finished(tmp_path).rows("frames")
    for row in rows:
        measured = int(row["frame"]) % 2 == 0
        for name in ("rmse", "mean_signed_error", "p99_error", "flip", "reference_standard_error"):
            assert bool(row[name]) is measured, (row["label"], row["frame"], name)
        assert row["m_x_max"] == "" and row["m_z_max"] == "2" and row["flicker"] == ""
        assert bool(row["standard_error"]) is (row["label"] == "memory")
        assert int(row["receiver_pixels"]) == np.isfinite(true_visibility(int(row["frame"]))).sum()
    exact = [row for row in rows if row["label"] == "slow [exact]" and row["rmse"]]
    assert {row["rmse"] for row in exact} == {"0"}  # measured, and none


def test_sampling_is_measured_only_where_it_is_asked_for_and_a_map_is_read(tmp_path: Path) -> None:
    rows = finished(tmp_path / "without").rows("frames")
    assert all(row[name] == "" for row in rows for name in metrics.MAP_METRICS)
    rows = finished(tmp_path / "with", make_experiment(metrics=["rmse", *metrics.MAP_METRICS])).rows("frames")
    for row in rows:
        size = float(row["frame"]) + 1.0
        if row["label"] == "memory":  # reads no map
            assert all(row[name] == "" for name in metrics.MAP_METRICS)
            continue
        assert float(row["m_pixel_median"]) == float(row["m_pixel_p99"]) == size
        assert float(row["undersampled"]) == float(size > 1.0)
        assert (row["map_waste"], row["map_unread"]) == ("0.25", "0.5")
        # the fake's reference is smooth: it has no hard edge
        assert row["m_edge"] == row["rmse_predicted"] == ""


def test_errors_are_those_of_the_stored_images(tmp_path: Path) -> None:
    store = finished(tmp_path)
    for row in store.rows("frames"):
        if not row["rmse"]:
            continue
        frame = int(row["frame"])
        visibility, reference = (read_exr(store.raw(name, "visibility", frame)) for name in (row["label"], None))
        got = metrics.evaluate(frozenset({"flip"}), metrics.Measured(visibility, reference=reference))
        assert float(row["rmse"]) == pytest.approx(got["rmse"], rel=1e-8)
        assert float(row["flip"]) == pytest.approx(got["flip"], rel=1e-8)
        np.testing.assert_array_equal(reference, true_visibility(frame))


def test_raw_images_of_reference_frames_and_the_last(tmp_path: Path) -> None:
    store = finished(tmp_path, make_experiment(frames=range(4)))
    assert store.image_frames("cheap") == [0, 2, 3] and store.image_frames(None) == [0, 2]
    assert store.raw("memory", "standard_error", 3).is_file()
    assert not store.raw("cheap", "standard_error", 2).exists()
    assert store.view("cheap", "error", 2).is_file() and not store.view("cheap", "error", 3).exists()
    assert read_exr(store.raw("cheap", "visibility", 3)).shape == (HEIGHT, WIDTH)


def test_flicker_follows_surfaces_and_starts_on_the_second_frame(tmp_path: Path) -> None:
    experiment = make_experiment([make_run("steady"), make_run("history", "remembering")], metrics=["flicker"])
    rows = finished(tmp_path, experiment).rows("frames")
    steady = [float(row["flicker"] or "nan") for row in rows if row["label"] == "steady"]
    history = [float(row["flicker"] or "nan") for row in rows if row["label"] == "history"]
    assert np.isnan(steady[0]) and np.isnan(history[0])
    assert max(steady[1:]) < 0.02 < history[-1]  # the fake history drifts by 0.01 (frame + 1) per frame


def test_every_frame_but_the_first_says_what_it_saw_anew(tmp_path: Path) -> None:
    rows = finished(tmp_path, make_experiment(frames=[0, 40, 60])).rows("frames")
    shares = {int(row["frame"]): row["disoccluded"] for row in rows}
    assert list(rows[0]).index("disoccluded") == list(rows[0]).index("receiver_pixels") + 1 and shares[0] == ""
    assert 0.0 < float(shares[40]) < 0.5 and len({row["disoccluded"] for row in rows}) == 3


def test_a_failing_technique_is_recorded_and_the_others_go_on(tmp_path: Path) -> None:
    runs = [make_run("good"), make_run("bad", fails_on=2), make_run("late", "remembering", fails_on=3)]
    with pytest.raises(
        TechniquesFailed, match="'bad' failed on frame 2: ValueError: deliberate, over two lines"
    ) as caught:
        finished(tmp_path, make_experiment(runs))
    assert caught.value.labels == ("bad", "late") and caught.value.out == tmp_path
    store = Store(tmp_path)
    assert [(row["label"], row["frame"]) for row in store.rows("failures")] == [("bad", "2"), ("late", "3")]
    frames = {
        label: [int(r["frame"]) for r in store.rows("frames") if r["label"] == label] for label in caught.value.labels
    }
    assert frames == {"bad": [0, 1], "late": [0, 1, 2]}
    assert sum(row["label"] == "good" for row in store.rows("frames")) == 5
    assert 'raise ValueError("deliberate' in (tmp_path / "failures" / "bad.txt").read_text()
    kept = tables(tmp_path)
    with pytest.raises(TechniquesFailed):  # resuming neither tries again nor loses the record
        finished(tmp_path, make_experiment(runs), resume=True)
    assert tables(tmp_path) == kept


def test_wrong_input_in_the_warm_up_ends_the_run(tmp_path: Path) -> None:
    def refuse(frame: int) -> None:
        raise InputError("resolution and splits do not fit together")

    experiment = make_experiment()
    with pytest.raises(InputError, match="do not fit"):
        finished(tmp_path, experiment, engine=FakeEngine(experiment, refuse))
    finished(tmp_path, make_experiment(frames=[0]))  # and blocks nothing: no row was stored


@pytest.mark.parametrize("stop_at", [0, 3, 4, 5, 13, 14, 21, 22, 38, 48])
def test_an_interrupted_run_resumes_to_the_same_rows(tmp_path: Path, stop_at: int) -> None:
    """Interrupted in the warm-up, within and between frames; history and kept products must not tell the difference."""
    experiment = make_experiment(metrics=["rmse", "flicker"])
    finished(tmp_path / "whole", experiment)
    with pytest.raises(KeyboardInterrupt):
        finished(tmp_path / "parts", experiment, engine=FakeEngine(experiment, Stop(stop_at)))
    before = len(Store(tmp_path / "parts").rows("frames"))
    finished(tmp_path / "parts", experiment, resume=True)
    assert tables(tmp_path / "parts") == tables(tmp_path / "whole")
    assert before == 3 * max(0, (stop_at - 4) // 9)  # three labels, three repeats, after four renderings to warm up
    for label in (None, "memory"):
        for frame in (0, 2, 4):
            images = [read_exr(Store(tmp_path / part).raw(label, "visibility", frame)) for part in ("parts", "whole")]
            np.testing.assert_array_equal(*images)


@pytest.mark.parametrize("rows", [0, 1, 2, 4, 8, 14, 15])
@pytest.mark.parametrize("torn", ["", "flat,ch"])
def test_a_run_cut_after_any_row_resumes_to_the_same_rows(tmp_path: Path, rows: int, torn: str) -> None:
    """Also in the middle of a frame's labels: what is stored stays, what is missing is rendered with its history."""
    experiment = make_experiment(metrics=["rmse", "flicker"])
    finished(tmp_path, experiment)
    whole = tables(tmp_path)
    lines = whole["frames"].decode().splitlines(keepends=True)
    (tmp_path / "frames.csv").write_text("".join(lines[: rows + 1]) + torn)
    finished(tmp_path, experiment, resume=True)
    assert tables(tmp_path) == whole


def test_resuming_a_finished_run_renders_nothing(tmp_path: Path) -> None:
    experiment = make_experiment()
    finished(tmp_path, experiment)
    engine = FakeEngine(experiment)
    finished(tmp_path, experiment, engine=engine, resume=True)
    assert engine.log == []


def test_a_killed_process_resumes_to_the_same_rows(tmp_path: Path) -> None:
    """A real kill -9, with whatever it leaves in the files."""
    experiment = make_experiment()
    finished(tmp_path / "whole", experiment)
    script = f"""
        import os, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        from fake_engine import FakeEngine, make_experiment
        from experiments.kinds.walkthrough.run import run

        count = 0

        def kill(frame):
            global count
            count += 1
            if count == 30:
                os.kill(os.getpid(), signal.SIGKILL)

        experiment = make_experiment()
        run(experiment, {str(tmp_path / "parts")!r}, engine=FakeEngine(experiment, kill), report=False)
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], env=environment, capture_output=True, timeout=120
    )
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    assert len(Store(tmp_path / "parts").rows("frames")) == 6
    finished(tmp_path / "parts", experiment, resume=True)
    assert tables(tmp_path / "parts") == tables(tmp_path / "whole")


def test_two_runs_give_the_same_bytes(tmp_path: Path) -> None:
    finished(tmp_path / "a")
    finished(tmp_path / "b")
    assert tables(tmp_path / "a") == tables(tmp_path / "b")


def test_the_record_says_what_was_run(tmp_path: Path) -> None:
    experiment = make_experiment()
    data = finished(tmp_path, experiment).environment()
    assert set(data["identity"]) >= {
        "config",
        "scene",
        "plugin flat",
        "plugin remembering",
        "device",
        "threads",
        "skips",
    }
    assert data["run"]["baseline"] == "cheap" and data["run"]["frames"] == [0, 1, 2, 3, 4]
    assert [entry["history"] for entry in data["run"]["labels"]] == [False, True, False]
    assert {"date", "cpu", "cores", "threads", "device", "git", "python", "packages"} <= set(data["environment"])
    assert data["environment"]["packages"]["numpy"] == np.__version__
    assert data["metrics"]["rmse"] == metrics.METRICS["rmse"].version
    assert (tmp_path / "config.yaml").read_text() == experiment.to_yaml()


def test_progress_reaches_its_total(tmp_path: Path) -> None:
    told: list[tuple[int, int, str]] = []
    finished(tmp_path, progress=lambda done, total, what: told.append((done, total, what)))
    assert told[0][:2] == (0, 15) and told[-1] == (15, 15, "done")
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert any("warming up memory" in what for _, _, what in told)
