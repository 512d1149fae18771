"""The standard errors that techniques state: which have one, how often the truth lies within two, and the table of it."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest
import small_scenes

from algorithms.plugins import load_all
from algorithms.technique import Technique
from experiments.commands.coverage import coverage_table, main
from experiments.kinds.convergence.config import Convergence, load_convergence
from experiments.kinds.convergence.report import load_convergence_rows
from experiments.kinds.convergence.run import run_convergence
from experiments.kinds.convergence.store import ConvergenceStore
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry

CONFIG = Path(__file__).parents[2] / "configs" / "experiments" / "standard_error.yaml"
SMALL = ["image={width: 40, height: 30}", "reference={samples: 2048, every: 63}", "steps=[64]"]


def states_one(technique: type[Technique]) -> bool:
    """Whether a picture under a square light, which is sampled, comes with a standard error."""
    scene = small_scenes.box_on_ground(small_scenes.light("rectangle"))
    running = Session(Geometry(scene), width=16, height=12)
    sampling = {"light_samples": 4} if "light_samples" in technique.Params.model_fields else {}
    return running.render(technique(technique.Params(**sampling))).standard_error is not None


def test_the_experiment_has_every_technique_that_states_one() -> None:
    stating = {name for name, technique in load_all().items() if states_one(technique)}
    convergence = load_convergence(CONFIG)
    assert isinstance(convergence, Convergence)
    assert {run.name for run in convergence.experiment.runs} == stating
    assert len(stating) >= 5


def test_the_truth_lies_within_two_standard_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On A1; of independent samples it would for 95 %, and ours are evener. The published filters state what they blur."""
    monkeypatch.setenv("WKERNELS_CACHE", str(tmp_path / "cache"))
    convergence = load_convergence(CONFIG, SMALL)
    assert isinstance(convergence, Convergence)
    out = run_convergence(convergence, tmp_path / "out", report=False)
    table = load_convergence_rows(ConvergenceStore(out))
    last = table[(table["step"] == 64) | (table["over"] == "")].set_index("label")
    assert len(last) == len(convergence.experiment.runs) and (last["penumbra_pixels"] > 100).all()
    assert (last["coverage_2se"] > 0.9).all(), last["coverage_2se"]
    unfiltered = last.drop(index=["tc_soft_paper", "tc_soft_thesis"])
    assert (unfiltered["penumbra_standard_error"] > unfiltered["penumbra_rmse"]).all()


def test_the_table_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = {"step": [4, 8, 1, 8], "over": ["frames", "frames", "", "samples"], "label": ["a", "a", "one", "none"]}
    values = {"coverage_2se": [0.5, 0.984, 1.0, None], "penumbra_standard_error": [0.4, 0.06, 0.2, None]}
    values["zero_standard_error"] = [0.0, 0.012, 0.0, None]
    table = pd.DataFrame({**head, **values, "penumbra_rmse": [0.2, 0.03, 0.0, 0.1]})
    assert coverage_table({"x": table, "y": table[:1]}, 8).splitlines() == [
        "| n = 8 | x | y |",
        "|---|---|---|",
        "| a | 98.4 (99.6; 2.0) |  |",
        "| one | 100.0 (100.0; no error) |  |",
    ]
    with pytest.raises(SystemExit):
        main(["--help"])
    assert re.search(r"usage: .*--steps", capsys.readouterr().out)
