"""The experiment file of ``kind: savings``: what leaving out saves, on several scenes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic_core import to_jsonable_python

from algorithms.projections.schema import Projection
from experiments.config.overrides import apply_overrides
from experiments.config.source import Source, StrictModel, dump_yaml, load_yaml, validate
from experiments.scenes import load_scene
from experiments.schema.experiment import Experiment
from experiments.schema.models import FrameRange, Image
from experiments.schema.needs import unmet_need
from experiments.schema.techniques import TechniqueRun, expand_techniques


class SavingsFile(StrictModel):
    """An experiment file of ``kind: savings``.

    Attributes:
        scenes: Scene files.
        image: Frame size.
        projection: Default projection of techniques with a map.
        techniques: As in a walkthrough; all with their defaults unless listed. Those that cannot work in one of the
            scenes are left out there.
        frames: Frames of each scene's path.
        still: How often the last of them is rendered again, for what only a view that stands still can leave out.
        repeats: Timed renderings of each frame.
        seed: Of every sample set.
    """

    kind: Literal["savings"]
    scenes: list[str] = Field(min_length=1)
    image: Image
    projection: Projection | None = None
    techniques: list[str | dict[str, Any]] | None = Field(None, min_length=1)
    frames: Annotated[int, Field(ge=1)] | FrameRange = 6
    still: int = Field(2, ge=0, le=1000)
    repeats: int = Field(3, ge=1, le=1000)
    seed: int = Field(1, ge=0, le=2**31 - 1)


@dataclass(frozen=True, eq=False)
class Savings:
    """A resolved experiment.

    Attributes:
        name: Stem of the experiment file.
        experiments: One per scene, with what runs there.
        unmet: (scene, label) -> why the technique cannot work there.
        still: How often the last frame is rendered again.
    """

    name: str
    experiments: tuple[Experiment, ...]
    unmet: Mapping[tuple[str, str], str]
    still: int
    _file: dict[str, Any]

    def walk(self, experiment: Experiment) -> tuple[int, ...]:
        """Frames in the order in which they are rendered."""
        return (*experiment.frames, *[experiment.frames[-1]] * self.still)

    def to_yaml(self) -> str:
        """The experiment as a file that runs again and gives the same results."""
        return dump_yaml(self._file)


def load_savings(path: str | Path, overrides: Iterable[str], plugins: Mapping[str, type]) -> Savings:
    """Reads, checks and resolves an experiment file of this kind.

    Raises:
        InputError: Something in the file, the overrides or a scene is wrong, two scenes have one name, or no technique
            can work in a scene.
    """
    path = Path(path)
    source = apply_overrides(load_yaml(path), overrides)
    file = validate(SavingsFile, source)
    if file.techniques is None:
        source = source.replaced(("techniques",), list(plugins), "all techniques")
    runs = expand_techniques(source, plugins, file.projection)
    unmet: dict[tuple[str, str], str] = {}
    frames = file.frames.indices() if isinstance(file.frames, FrameRange) else tuple(range(file.frames))
    _check_names(source, file.scenes)
    experiments = tuple(_of_scene(source, file, path, i, runs, plugins, frames, unmet) for i in range(len(file.scenes)))
    written = file.model_dump(by_alias=True, exclude_none=True) | {
        "scenes": [str(experiment.scene) for experiment in experiments],
        "techniques": [run.entry() for run in runs],
    }
    return Savings(path.stem, experiments, unmet, file.still, to_jsonable_python(written))


def _check_names(source: Source, scenes: list[str]) -> None:
    """Raises InputError where two scenes have one name, by which rows are told apart and an earlier run's are kept."""
    first: dict[str, int] = {}
    for i, scene in enumerate(scenes):
        stem = Path(scene).stem
        if (earlier := first.setdefault(stem, i)) != i:
            raise source.error(f"has the name '{stem}', as scenes.{earlier} has.", ("scenes", i))


def _of_scene(
    source: Source,
    file: SavingsFile,
    path: Path,
    index: int,
    runs: tuple[TechniqueRun, ...],
    plugins: Mapping[str, type],
    frames: tuple[int, ...],
    unmet: dict[tuple[str, str], str],
) -> Experiment:
    scene_file = path.resolve().parent / file.scenes[index]
    if not scene_file.is_file():
        raise source.error(f"no scene file {scene_file}.", ("scenes", index))
    scene = load_scene(scene_file)
    able = []
    for run in runs:
        if why := unmet_need(plugins[run.name], scene, scene.lights[0]):
            unmet[scene.name, run.label] = why
        else:
            able.append(run)
    if not able:
        raise source.error(f"none of the techniques can work in '{scene.name}'.", ("scenes", index))
    return Experiment(
        name=path.stem,
        scene=scene_file,
        image=file.image,
        reference=None,
        metrics=(),
        projection=file.projection,
        runs=tuple(able),
        baseline=able[0].label,
        repeats=file.repeats,
        seed=file.seed,
        frames=frames,
        light=0,
        loaded_scene=scene,
    )
