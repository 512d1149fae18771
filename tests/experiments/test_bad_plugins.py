"""Techniques that go wrong in the middle of a run, with the real renderer: each is a row, and the good one is complete."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from algorithms.plugins import load_all
from experiments import cli
from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.run import run
from experiments.results.failures import TechniquesFailed
from experiments.results.store import Store

PLUGIN = '''\
"""Goes wrong."""

import sys

import numpy as np
import warp as wp

from algorithms.technique import Technique


class {camel}(Technique):
    """Goes wrong."""

    name, family, paper, bias_sign = "{name}", "hard", ("williams1978",), "none"

    def render(self, frame):
        """Lit, but on frame 1."""
        shape = frame.gbuffer().depth.shape
        lit = wp.full(shape, 1.0, dtype=float)
        if frame.index == 0:
            return lit
        {does}
'''
BAD = {
    "bad_raise": ('raise ValueError("in the middle")', "ValueError: in the middle"),
    "bad_exit": ("sys.exit(3)", "SystemExit: 3"),
    "bad_none": ("return None", "ValueError: BadNone.render returned a NoneType, not float32 of a G-buffer's size (24, 32)"),
    "bad_array": ("return np.ones(shape, np.float32)", "ValueError: BadArray.render returned a ndarray, not float32"),
    "bad_dtype": ("return wp.full(shape, 1.0, dtype=wp.float64)", "returned float64 (24, 32), not float32"),
    "bad_shape": ("return wp.full((24, 31), 1.0, dtype=float)", "returned float32 (24, 31), not float32 of a"),
    "bad_nan": ("return wp.full(shape, wp.nan, dtype=float)", "visibility is not finite in "),
    "bad_error": ("frame.standard_error = wp.zeros((24, 31), dtype=float); return lit", "BadError's standard error is float32"),
    "bad_error_nan": ("frame.standard_error = wp.full(shape, wp.nan, dtype=float); return lit", "the standard error is negative"),
}  # fmt: skip
RUN = """
kind: walkthrough
scene:
  meshes:
    - {primitive: plane, size: [8, 8]}
    - {primitive: box, size: [1, 1, 1], transform: {translate: [0, 1.2, 0]}}
  lights: [{kind: point, position: [0, 5, 0]}]
  camera: {eye: [0, 3, 5], target: [0, 0.5, 0]}
image: {width: 32, height: 24}
reference: {samples: 1, every: 1}
techniques: [ray_cast_point_shadow, bad_raise, bad_exit, bad_none, bad_array, bad_dtype, bad_shape, bad_nan, bad_error, bad_error_nan]
frames: 3
repeats: 2
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("WKERNELS_CACHE", str(tmp_path / "cache"))
    yield


def write_plugins(folder: Path) -> list[Path]:
    files = []
    for name, (does, _) in BAD.items():
        camel = "".join(part.capitalize() for part in name.split("_"))
        files.append(folder / f"{name}.py")
        files[-1].write_text(PLUGIN.format(name=name, camel=camel, does=does))
    return files


def test_each_is_a_row_and_the_good_one_is_complete(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(RUN)
    plugins = load_all(write_plugins(tmp_path))
    with pytest.raises(TechniquesFailed) as caught:
        run(load_experiment(tmp_path / "c.yaml", [], plugins), tmp_path / "out", plugins=plugins, report=False)
    store = Store(tmp_path / "out")
    failures = {row["technique"]: row for row in store.rows("failures")}
    assert set(failures) == set(BAD) == set(caught.value.labels)
    for name, (_, says) in BAD.items():
        assert says in failures[name]["error"] and failures[name]["frame"] == "1", failures[name]
        assert failures[name]["what"] == "technique" and (tmp_path / "out" / "failures" / f"{name}.txt").is_file()
    frames = [(row["label"], row["frame"]) for row in store.rows("frames")]
    assert [frame for label, frame in frames if label == "ray_cast_point_shadow"] == ["0", "1", "2"]
    assert all((name, "0") in frames and (name, "1") not in frames for name in BAD)
    assert {row["rmse"] for row in store.rows("frames") if row["label"] == "ray_cast_point_shadow"} == {"0"}


def test_a_plugin_that_cannot_be_imported_is_one_message_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.yaml").write_text(RUN)
    (tmp_path / "broken.py").write_text("import os\n1 / 0\n")
    plugin = str(tmp_path / "broken.py")
    arguments = ["wkernels", "run", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out"), "--plugin", plugin]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    message = capsys.readouterr().err
    assert ended.value.code == 2 and f"{plugin}:2: cannot be imported: ZeroDivisionError" in message
    assert not (tmp_path / "out").exists()
