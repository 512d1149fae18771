"""The experiment files that come with the project load, and every figure of the sources has its file."""

from __future__ import annotations

from pathlib import Path

import pytest

from algorithms.plugins import load_all
from experiments.kinds.kind import kind_of_file
from experiments.kinds.sweep.config import Sweep
from experiments.kinds.walkthrough.config import load_experiment
from experiments.scenes.assets import fetched_folder
from experiments.schema.experiment import Experiment

CONFIGS = Path(__file__).parents[2] / "configs"
FILES = sorted([*CONFIGS.glob("papers/*.yaml"), *CONFIGS.glob("experiments/*.yaml")])


@pytest.mark.parametrize("file", FILES, ids=[file.stem for file in FILES])
def test_experiment_file_loads(file: Path) -> None:
    kind = kind_of_file(file)
    if "scenes/real/" in file.read_text(encoding="utf-8") and not (fetched_folder() / "sponza").is_dir():
        pytest.skip("`make scenes` fetches its scenes")
    loaded = kind.load(file, [], load_all())
    assert loaded.name == file.stem and f"kind: {kind.name}" in loaded.to_yaml()
    if isinstance(loaded, Sweep):
        if file.stem == "sweep_all":
            assert len(loaded.scenes) >= 5 and len(loaded.runs) >= len(load_all())
        for scene in loaded.scenes:
            assert scene.experiment.reference is not None and max(scene.experiment.frames) < 100  # all have so many
    elif isinstance(loaded, Experiment):
        # A reference that no rendered frame meets would leave the figure without errors.
        assert loaded.reference is None or loaded.reference.every <= max(1, len(loaded.frames))


def test_every_figure_of_the_temporal_sources_has_its_file() -> None:
    stems = {file.stem for file in FILES}
    of_the_paper = {"1_left", "1_right", "2", "3", "4", "5_left", "5_right"}
    of_the_thesis = {"1", "2", "3", "4", "5", "6", "7_upper", "7_lower"}
    assert {f"s3_fig_{name}" for name in of_the_paper} | {"s3_table_1", "s0_table_5_1"} <= stems
    assert {f"s0_fig_5_{name}" for name in of_the_thesis} <= stems


def test_walkthrough_figures_have_the_published_sizes() -> None:
    for name, size in (("s3_fig_4", (1024, 768)), ("s0_fig_5_6", (800, 600))):
        experiment = load_experiment(CONFIGS / "papers" / f"{name}.yaml")
        assert (experiment.image.width, experiment.image.height) == size
        assert {run.params["resolution"] for run in experiment.runs} == {1024}
        taps = [(r.params["blocker_taps"], r.params["filter_taps"]) for r in experiment.runs if r.name == "pcss"]
        assert taps == [(16, 16), (32, 32)]
