"""``kind: convergence``: its rows, pictures, resuming and report with a renderer that answers at once; its messages."""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from fake_engine import HEIGHT, WIDTH, FakeEngine, Flat, Remembering, Stop, make_scene, true_visibility
from pydantic import BaseModel, Field

from algorithms.technique import Needs
from experiments import cli
from experiments.kinds.convergence.config import Convergence, Estimates, held, load_convergence
from experiments.kinds.convergence.estimates import estimate_rows, estimates_text
from experiments.kinds.convergence.explain import explain_convergence
from experiments.kinds.convergence.report import fitted_slope, load_convergence_rows, summarise_convergence
from experiments.kinds.convergence.run import measure, run_convergence
from experiments.kinds.convergence.store import CONVERGENCE_COLUMNS, ConvergenceStore
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr
from wkernels.errors import InputError

SCENE = """\
meshes:
- {primitive: plane, size: [4, 4]}
- {primitive: box, size: [1, 1, 1], motion: {keyframes: [{frame: 0, translate: [0, 1, 0]}, {frame: 9, translate: [1, 1, 0]}]}}
lights:
- {kind: rectangle, center: [0, 4, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1]}
- {kind: point, position: [0, 4, 0]}
path: {frames: 9, keyframes: [{frame: 0, eye: [3, 3, 3], target: [0, 0, 0]}, {frame: 8, eye: [3, 3, 2], target: [0, 0, 0]}]}
"""
TEXT = f"""\
kind: convergence
scene: scene.yaml
image: {{width: {WIDTH}, height: {HEIGHT}}}
reference: {{samples: 64, every: 2}}
steps: [1, 3, 8]
techniques:
- fading: {{label: memory}}
- sampled
- flat
"""


class Sampled(Flat):
    """Its error is 0.4 over its number of samples."""

    name = "sampled"
    needs = Needs(lights=frozenset({"rectangle"}), area=True)

    class Params(BaseModel):
        samples: int = Field(64, ge=1, le=1000)
        error: float = 0.0
        ms: float = 1.0
        fails_on: int = -1
        own_error: bool = True

    def __init__(self, params: Any) -> None:
        self.params = params.model_copy(update={"error": 0.4 / params.samples})


class Fading(Remembering):
    """Half of its frames' history counts, so that the error depends on every frame since the start."""

    name = "fading"


PLUGINS: dict[str, type] = {"flat": Flat, "sampled": Sampled, "fading": Fading}
Load = Callable[..., Any]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Load:
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)

    def load_text(text: str = TEXT, *overrides: str) -> Any:
        Path("c.yaml").write_text(text)
        return load_convergence("c.yaml", overrides, PLUGINS)

    return load_text


class Engine(FakeEngine):
    def __post_init__(self) -> None:
        super().__post_init__()
        self.plugins, self.asked = PLUGINS, []
        self.scene = make_scene()

    def reference(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(frame)
        return super().reference(frame)


def run(convergence: Convergence, out: Path, **options: Any) -> tuple[ConvergenceStore, Engine]:
    engine = options.pop("engine", None) or Engine(convergence.experiment)
    return ConvergenceStore(run_convergence(convergence, out, engine=engine, report=False, **options)), engine


# ---- The file ----


def test_defaults_and_axes(load: Load) -> None:
    text = "\n".join(line for line in TEXT.splitlines() if not line.startswith(("reference", "steps")))
    c = load(text)
    assert (c.steps, c.camera, c.frame, c.crop) == ((1, 3, 7, 20, 256), "still", 0, None)
    assert (c.reference.samples, c.reference.every) == (4096, 1)
    assert c.axes == {"memory": "frames", "sampled": "samples", "flat": "none"}
    assert c.measured("memory") == tuple(range(1, 257)) and c.measured("flat") == (1,)
    assert c.measured("sampled") == (1, 2, 3, 4, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64, 96, 128, 192, 256)
    assert set(load(text + "\ncamera: path\n").axes.values()) == {"frames"}


def test_a_still_scene_stands(load: Load) -> None:
    scene = load(TEXT, "frame=4").experiment.load_scene()
    moving = load(TEXT, "camera=path").experiment.load_scene()
    for frame in (0, 3, 9):
        np.testing.assert_array_equal(scene.camera(frame).eye, moving.camera(4).eye)
        np.testing.assert_array_equal(scene.meshes[1].object_to_ws(frame), moving.meshes[1].object_to_ws(4))
    assert moving.meshes[1].moving and not scene.meshes[1].moving  # what stands must not count as a mover
    assert held(scene, 0).frames == 1
    swings = replace(moving, lights=(replace(moving.lights[0], motion=moving.meshes[1].object_to_ws),))
    lamp = held(swings, 4).light(0, 9)
    assert lamp.motion is None
    np.testing.assert_array_equal(lamp.centre, swings.light(0, 4).centre)
    assert not np.array_equal(swings.light(0, 4).centre, swings.light(0, 9).centre)


def test_the_resolved_file_gives_the_same(load: Load) -> None:
    c = load(TEXT, "crop={x: 2, y: 1, width: 4, height: 3}", "seed=7", "frame=3", "techniques.0.fading.error=0.2")
    again = load(c.to_yaml())
    assert again.to_yaml() == c.to_yaml() and again.experiment.runs[0].params["error"] == 0.2
    assert "samples: 64" in c.to_yaml() and again.axes == c.axes


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("steps: [1, 3, 8]", "steps: [1, 3, 3]", "c.yaml:5: steps.2: steps must rise, 3 follows 3."),
        ("steps: [1, 3, 8]", "steps: [0, 3]", "c.yaml:5: steps.0: must be at least 1, not 0."),
        ("steps: [1, 3, 8]", "steps: []", "c.yaml:5: steps: must have at least 1 item, not 0."),
        ("steps: [1, 3, 8]", "step: [1]", "c.yaml:5: step: is not a known key. Did you mean 'steps'?"),
        ("steps: [1, 3, 8]", "camera: pth", "c.yaml:5: camera: 'pth' is not a valid name. Did you mean 'path'?"),
        (
            "steps: [1, 3, 8]",
            "crop: {x: 20, y: 0, width: 5, height: 2}",
            "c.yaml:5: crop.width: x + width must be at most",
        ),
        ("steps: [1, 3, 8]", "steps: [1, 1001]", "c.yaml:5: steps.1: the technique 'sampled' cannot take 1001 samples"),
        ("steps: [1, 3, 8]", "light: 1", "c.yaml:8: techniques.1: 'sampled' works with"),
        (
            "- sampled",
            "- sampled: {samples: 4}",
            "c.yaml:8: techniques.1.sampled.samples: the steps set it; leave it out",
        ),
        ("- sampled", "- sampled: {sweep: {samples: [4]}}", "techniques.1.sampled.sweep.samples: the steps set it"),
        ("- sampled", "- samples", "c.yaml:8: techniques.1: there is no technique 'samples'. Did you mean 'sampled'?"),
        ("samples: 64, every", "samples: many, every", "c.yaml:4: reference.samples: must be a whole number"),
        ("scene: scene.yaml", "scene: scenes.yaml", "c.yaml:2: scene: no scene file"),
        ("scene: scene.yaml\n", "", "scene: is required."),
        (TEXT, "kind: convergence\ntests: [0, 2]\n", "c.yaml:2: tests.1: must be at most 1, not 2."),
        (TEXT, "kind: convergence\ntests: [0]\nscene: s\n", "c.yaml:3: scene: is not a known key."),
    ],
)
def test_a_mistake_is_one_message_with_file_line_and_key(load: Load, old: str, new: str, expected: str) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new).replace("- fading: {label: memory}\n" if "light: 1" in new else "", "")
    expected = expected.replace("c.yaml:8", "c.yaml:7") if "light: 1" in new else expected
    if "light: 1" in new:
        expected = expected.replace("techniques.1", "techniques.0")
    with pytest.raises(InputError) as caught:
        load(text)
    assert expected in str(caught.value)


# ---- The rows ----


def test_rows_steps_and_errors(load: Load, tmp_path: Path) -> None:
    c = load()
    store, engine = run(c, tmp_path / "o")
    rows = store.rows("convergence")
    assert list(rows[0]) == list(CONVERGENCE_COLUMNS)
    assert list(rows[0])[:8] == "technique,label,step,n,rmse,mean_signed_error,standard_error,coverage_2se".split(",")
    steps = {label: [int(r["step"]) for r in rows if r["label"] == label] for label in c.axes}
    assert steps == {"memory": [1, 3, 5, 7, 8], "sampled": [1, 2, 3, 4, 6, 8], "flat": [1]}
    assert engine.asked == [0]  # one reference for all of a still camera
    for row in rows:
        if row["label"] == "sampled":
            assert row["n"] == row["step"] and row["over"] == "samples"
            assert float(row["mean_signed_error"]) == pytest.approx(_clipped(0.4 / int(row["step"])), rel=1e-5)
        if row["label"] == "flat":
            assert (row["n"], row["over"], row["coverage_2se"], row["standard_error"]) == ("", "", "", "")
    # The fake adds 0.01 for frame 0, 0.02 for frame 1, ...: every frame of the history was rendered, and once.
    memory = {int(r["step"]): float(r["mean_signed_error"]) for r in rows if r["label"] == "memory"}
    for step, found in memory.items():
        truth = true_visibility(step - 1)
        shift = np.clip(truth + np.float32(0.1 + 0.01 * sum(range(1, step))), 0, 1) - true_visibility(0)
        assert found == pytest.approx(np.nanmean(shift), rel=1e-4)


def _clipped(error: float) -> float:
    truth = true_visibility(0)
    return float(np.nanmean(np.clip(truth + np.float32(error), 0.0, 1.0) - truth))


def test_pictures_of_the_steps(load: Load, tmp_path: Path) -> None:
    store, _ = run(load(), tmp_path / "o")
    assert store.image_frames("memory") == [1, 3, 8] == store.image_frames("sampled")
    assert store.image_frames("flat") == [1] and store.image_frames(None) == [1]
    assert store.raw("sampled", "standard_error", 3).is_file() and store.view("memory", "error", 8).is_file()
    np.testing.assert_array_equal(read_exr(store.raw(None, "visibility", 1)), true_visibility(0))


def test_a_path_takes_its_own_frames_and_references(load: Load, tmp_path: Path) -> None:
    c = load(TEXT, "camera=path", "frame=2", "steps=[1, 4]")
    store, engine = run(c, tmp_path / "o")
    assert engine.asked == [2, 4, 5]  # steps 1, 3 and 4
    assert {row["over"] for row in store.rows("convergence")} == {"frames"}
    assert store.image_frames(None) == [1, 4]
    rendered = [item[1] for item in engine.log if item[0] == "memory"]
    assert rendered == [2, 3, 4, 5]  # the history's, in between too
    assert [item[1] for item in engine.log if item[0] == "flat"] == [2, 4, 5]
    (row, *_) = [r for r in store.rows("convergence") if r["label"] == "sampled" and r["step"] == "4"]
    assert row["n"] == "64"  # without history samples do not add up


@pytest.mark.parametrize("stop_at", [0, 1, 4, 9, 14])
@pytest.mark.parametrize("camera", ["still", "path"])
def test_an_interrupted_run_resumes_to_the_same_rows(load: Load, tmp_path: Path, stop_at: int, camera: str) -> None:
    c = load(TEXT, f"camera={camera}")
    whole, _ = run(c, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(c, tmp_path / "parts", engine=Engine(c.experiment, Stop(stop_at)))
    parts, _ = run(c, tmp_path / "parts", resume=True)
    key = lambda row: (row["label"], int(row["step"]))  # noqa: E731
    assert sorted(parts.rows("convergence"), key=key) == sorted(whole.rows("convergence"), key=key)
    np.testing.assert_array_equal(*(read_exr(s.raw("memory", "visibility", 8)) for s in (parts, whole)))
    again = Engine(c.experiment)
    run(c, tmp_path / "parts", resume=True, engine=again)
    assert again.log == []


def test_another_experiment_is_not_resumed_nor_overwritten(load: Load, tmp_path: Path) -> None:
    run(load(), tmp_path / "o")
    with pytest.raises(InputError, match="holds results of another configuration"):
        run(load(TEXT, "seed=2"), tmp_path / "o")


def test_a_failing_technique_is_recorded_and_the_others_go_on(load: Load, tmp_path: Path) -> None:
    c = load(TEXT, "techniques.0.fading.fails_on=2")
    with pytest.raises(TechniquesFailed, match="'memory' failed on frame 3: ValueError: deliberate"):
        run(c, tmp_path / "o")
    store = ConvergenceStore(tmp_path / "o")
    assert sum(row["label"] == "memory" for row in store.rows("convergence")) == 1
    assert sum(row["label"] == "sampled" for row in store.rows("convergence")) == 6


# ---- The measures ----


def test_measure_against_a_direct_computation() -> None:
    reference = np.array([[0.0, 0.5, 0.25, 1.0, 0.5, np.nan]], np.float32)
    visibility = np.array([[0.1, 0.7, 0.25, 1.0, 0.5, np.nan]], np.float32)
    own = np.array([[0.5, 0.05, 0.1, 0.0, 0.0, np.nan]], np.float32)
    row = measure(visibility, own, (reference, np.full_like(reference, 0.01)))
    assert (row["receiver_pixels"], row["penumbra_pixels"]) == (5, 3)
    assert row["coverage_2se"] == pytest.approx(2 / 3)  # an error of 0.2 at s = 0.05 is not covered
    assert row["zero_standard_error"] == pytest.approx(1 / 3)
    assert row["penumbra_rmse"] == pytest.approx(0.2 / 3**0.5) and row["rmse"] == pytest.approx((0.05 / 5) ** 0.5)
    assert row["n_effective"] == pytest.approx(np.median([1 + 0.21 / 0.05**2, 1 + 0.1875 / 0.01]))
    lit = measure(np.ones((2, 2)), None, (np.ones((2, 2)), np.zeros((2, 2))))
    assert lit["rmse"] == 0.0 and "penumbra_rmse" not in lit and "coverage_2se" not in lit


def test_binomial_estimates_are_covered_as_they_should_be() -> None:
    """Independent tests: about 95 % within two standard errors, and n comes back from psi and s."""
    rng = np.random.default_rng(5)
    truth, n = rng.uniform(0.2, 0.8, (80, 80)), 64
    psi = rng.binomial(n, truth) / n
    own = np.sqrt(psi * (1 - psi) / (n - 1))
    row = measure(1 - psi, own, (1 - truth, np.zeros_like(truth)))
    assert 0.93 < row["coverage_2se"] < 0.97
    assert row["n_effective"] == pytest.approx(n, rel=1e-6)
    assert row["penumbra_rmse"] == pytest.approx(row["penumbra_standard_error"], rel=0.05)


def test_slopes() -> None:
    steps = np.arange(1, 257)
    assert fitted_slope(steps, 0.3 * steps**-0.5) == pytest.approx(-0.5)
    bent = np.maximum(0.3 / steps, 0.01)
    assert fitted_slope(steps, bent, floor=0.0101) == pytest.approx(-1.0)  # what lies on the floor says nothing
    assert np.isnan(fitted_slope(steps[:2], steps[:2] + 0.0)) and np.isnan(fitted_slope(steps, 0.0 * steps))


# ---- Report and command line ----


def test_report(load: Load, tmp_path: Path) -> None:
    c = load(TEXT, "crop={x: 2, y: 1, width: 8, height: 6}", "techniques.0.fading.own_error=true")
    out = run_convergence(c, tmp_path / "o", engine=Engine(c.experiment))
    page = (out / "report.html").read_text(encoding="utf-8")
    for name in ("convergence", "coverage", "steps_visibility", "steps_error", "steps_standard_error"):
        assert (out / "plots" / f"{name}.png").stat().st_size > 3_000
    assert page.count("<svg") == 2 and page.count("data:image/png") == 3
    assert not re.findall(r"(?:src|href)=\"(?!#|data:)", page)
    assert "memory" in page and "sampled" in page and "Not complete" not in page
    with open(out / "summary.csv", newline="") as file:
        rows = {row["label"]: row for row in csv.DictReader(file)}
    assert rows["sampled"]["last_step"] == "8" and rows["flat"]["rmse_slope"] == ""
    table = load_convergence_rows(ConvergenceStore(out))
    assert isinstance(table, pd.DataFrame) and len(table) == 12
    assert np.isnan(summarise_convergence(table, still=False)["rmse_slope"]).all()


def test_explain_says_what_is_rendered(load: Load) -> None:
    text = explain_convergence(load(), PLUGINS)
    assert "memory: rendered over 8 frames; 5 rows" in text and "flat: rendered once; 1 row\n" in text
    assert "frame 0, held" in text and "64 light samples" in text
    text = explain_convergence(load(TEXT, "camera=path", "frame=1"), PLUGINS)
    assert "frames 1 to 8 of the path" in text and "reference on 5 frames" in text


def test_the_published_table(load: Load) -> None:
    """Scherzer 2009, Table 1: psi, variance and s of 1 0 1 1 1 0 1, to the digits printed; n = 1 is undefined."""
    rows = estimate_rows(load("kind: convergence\ntests: [1, 0, 1, 1, 1, 0, 1]\n"))
    assert [f"{row['psi']:.2f}" for row in rows] == "1.00 0.50 0.67 0.75 0.80 0.67 0.71".split()
    assert [f"{row['variance']:.2f}" for row in rows[1:]] == "0.25 0.11 0.06 0.04 0.04 0.03".split()
    assert [f"{row['standard_error']:.2f}" for row in rows[1:]] == "0.50 0.33 0.25 0.20 0.21 0.18".split()
    assert rows[0]["variance"] is None and rows[0]["standard_error"] is None
    assert "undefined" in estimates_text(Estimates("t", (1,)))


def test_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("t.yaml").write_text("kind: convergence\ntests: [1, 0, 1]\n")
    for command in (["run", "t.yaml", "--out", "o", "--set", "tests=[0, 1]"], ["explain", "t.yaml"]):
        monkeypatch.setattr(sys, "argv", ["wkernels", *command])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert not ended.value.code
    text = capsys.readouterr().out
    assert "undefined" in text and "estimates from 3 shadow tests" in text
    lines = Path("o/estimates.csv").read_text().splitlines()
    assert lines == ["n,tau,psi,variance,standard_error", "1,0,0,,", "2,1,0.5,0.25,0.5"]
