"""A small walkthrough from YAML to report with the real renderer: rows, resuming, skips, and input refused in time."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.explain import explain
from experiments.kinds.walkthrough.run import run
from experiments.results.images import read_exr
from experiments.results.store import FRAME_COLUMNS, Store
from experiments.schema.experiment import Experiment
from wkernels.errors import InputError

SCENE = """
scene:
  meshes:
    - {primitive: plane, size: [8, 8]}
    - primitive: box
      size: [1, 0.4, 1]
      transform: {translate: [0, 1.2, 0]}
      motion: {keyframes: [{frame: 0, translate: [0, 0, 0]}, {frame: 3, translate: [0.4, 0, 0]}]}
  lights:
    - {kind: rectangle, center: [0, 5, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1]}
  camera: {eye: [0, 3, 5], target: [0, 0.5, 0], up: [0, 1, 0], fov_deg: 45, near: 0.1, far: 50}
  path: {frames: 4, keyframes: [{frame: 0, eye: [0, 3, 5], target: [0, 0.5, 0]},
                                {frame: 3, eye: [0.6, 3, 5], target: [0, 0.5, 0]}]}
"""
RUN = """
kind: walkthrough
image: {width: 48, height: 32}
reference: {samples: 64, every: 2}
metrics: [rmse, flip, flicker]
techniques:
  - shadow_map: {resolution: 64}
  - ray_cast_point_shadow
  - tc_soft_paper: {resolution: 64}
  - reference_multisample: {samples: 64}
"""
TIMES = {name for name in FRAME_COLUMNS if "_ms" in name} | {"fps"}


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An own reference cache, empty at first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WKERNELS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    path = tmp_path_factory.mktemp("config") / "small.yaml"
    path.write_text(RUN + SCENE)
    return load_experiment(path)


@pytest.fixture(scope="module")
def whole(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(experiment, tmp_path_factory.mktemp("out") / "whole", threads=1)


def without_times(out: Path, table: str) -> list[dict[str, str]]:
    return [{k: v for k, v in row.items() if k not in TIMES | {"ms"}} for row in Store(out).rows(table)]


def test_every_file_of_the_result_contract_is_there(whole: Path) -> None:
    names = [
        "config.yaml",
        "environment.json",
        "frames.csv",
        "passes.csv",
        "summary.csv",
        "left_out.csv",
        "report.html",
    ]
    assert not [name for name in [*names, "plots/error_vs_time.png"] if not (whole / name).is_file()]
    with open(whole / "frames.csv", newline="") as file:
        head = next(csv.reader(file))
    contract = (
        "technique,label,frame,frame_ms,shadow_ms,fps,rmse,mean_signed_error,p99_error,flip,standard_error,"
        "reference_standard_error,m_x_max,m_z_max"
    )
    assert head[:14] == contract.split(",")


def test_rows_are_sane(whole: Path) -> None:
    rows = Store(whole).rows("frames")
    assert len(rows) == 16
    for row in rows:
        assert 0.0 < float(row["shadow_ms"]) < float(row["frame_ms"])
        assert bool(row["rmse"]) is (row["frame"] in ("0", "2"))
        assert bool(row["m_x_max"]) is (row["label"] in ("shadow_map", "tc_soft_paper"))
        assert bool(row["flicker"]) is (row["frame"] != "0")
    errors = {row["label"]: float(row["rmse"]) for row in rows if row["frame"] == "2"}
    standard_error = float(rows[-1]["standard_error"])
    assert (
        0.0 < errors["reference_multisample"] < 2.0 * standard_error
    )  # as many samples as the reference, but not the same
    assert 0.01 < errors["ray_cast_point_shadow"] < 0.5


def test_passes_add_up_to_the_frame_time(whole: Path) -> None:
    store = Store(whole)
    for row in store.rows("frames"):
        key = (row["label"], row["frame"])
        passes = [float(p["ms"]) for p in store.rows("passes") if (p["label"], p["frame"]) == key]
        assert sum(passes) == pytest.approx(float(row["frame_ms"]), rel=1e-6)


@pytest.mark.parametrize("stop_at", [1, 7, 13])
def test_an_interrupted_run_resumes_to_the_same_rows_and_images(
    experiment: Experiment, whole: Path, tmp_path: Path, stop_at: int
) -> None:
    shutil.copytree(whole, tmp_path / "parts")
    lines = (whole / "frames.csv").read_text().splitlines(keepends=True)
    (tmp_path / "parts" / "frames.csv").write_text("".join(lines[: stop_at + 1]) + "tc_so")
    resumed = run(experiment, tmp_path / "parts", threads=1, resume=True, report=False)
    for table in ("frames", "passes", "left_out", "failures"):
        assert without_times(resumed, table) == without_times(whole, table), table
    for label in (None, "tc_soft_paper", "shadow_map"):
        for frame in Store(whole).image_frames(label):
            images = [read_exr(Store(out).raw(label, "visibility", frame)) for out in (whole, resumed)]
            np.testing.assert_array_equal(*images)


def test_explain_renders_nothing_and_names_everything(experiment: Experiment) -> None:
    text = explain(experiment)
    assert (
        "16 timed renderings of 48 x 32" in text and "tc_soft_paper" in text and "rectangle, size 1 scene units" in text
    )


def test_input_that_cannot_work_is_refused_before_any_work(experiment: Experiment, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no device 'cuda:99'"):
        run(experiment, tmp_path / "out", device="cuda:99")
    assert not (tmp_path / "out").exists()
