"""The experiment file of ``kind: convergence``: error over the frames of a still camera or a path, or over samples.

A file with ``tests`` instead of a scene is the small form: the estimates of equations 2 and 3 of Scherzer et al. 2009
from shadow tests that are written down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError
from pydantic_core import to_jsonable_python

from algorithms.plugins import load_all
from algorithms.projections.schema import Projection
from experiments.config.messages import Loc
from experiments.config.source import Source, StrictModel, dump_yaml, validate
from experiments.schema.experiment import Experiment, open_scene, read_experiment
from experiments.schema.models import Image, Reference
from experiments.schema.needs import check_runs
from experiments.schema.techniques import TechniqueRun, expand_techniques
from wkernels.scene.model import Scene

Axis = Literal["frames", "samples", "none"]
Step = Annotated[int, Field(ge=1, le=1_000_000)]
SAMPLES = "samples"
STEPS = (1, 3, 7, 20, 256)  # the frames of Scherzer 2009, Fig 2


class Crop(StrictModel):
    """The part of the frames that the pictures side by side show.

    Attributes:
        x, y: Its upper left corner, pixels from that of the frame.
        width, height: Its size, pixels.
    """

    x: int = Field(ge=0)
    y: int = Field(ge=0)
    width: int = Field(ge=1)
    height: int = Field(ge=1)


class ConvergenceReference(Reference):
    """The reference; ``every``-th steps of techniques that go over frames are measured, and those with pictures."""

    samples: int = Field(4096, ge=1, le=1_000_000)


class ConvergenceFile(StrictModel):
    """An experiment file of ``kind: convergence``; ``Convergence`` says what the other keys mean.

    Attributes:
        scene: A scene file, or its keys.
        reference: As in a walkthrough, of 4096 samples; ``every`` is in steps.
        projection: As in a walkthrough.
        techniques: As in a walkthrough.
    """

    kind: Literal["convergence"]
    scene: str | dict[str, Any]
    image: Image
    reference: ConvergenceReference = Field(default_factory=lambda: ConvergenceReference.model_validate({}))
    projection: Projection | None = None
    techniques: list[str | dict[str, Any]] = Field(min_length=1)
    camera: Literal["still", "path"] = "still"
    frame: int = Field(0, ge=0, le=1_000_000)
    steps: list[Step] = Field(list(STEPS), min_length=1, max_length=40)
    crop: Crop | None = None
    seed: int = Field(1, ge=0, le=2**31 - 1)
    light: int = Field(0, ge=0)


class EstimatesFile(StrictModel):
    """The small form.

    Attributes:
        tests: Shadow tests of one point in order: 1 where the light sample is hidden.
    """

    kind: Literal["convergence"]
    tests: list[Annotated[int, Field(ge=0, le=1)]] = Field(min_length=1, max_length=100_000)


@dataclass(frozen=True, eq=False)
class Estimates:
    """Shadow tests of one point in order: 1 where the light sample is hidden.

    Attributes:
        name: Stem of the experiment file.
        tests: The tests.
    """

    name: str
    tests: tuple[int, ...]

    def to_yaml(self) -> str:
        """As a file that runs again."""
        return dump_yaml({"kind": "convergence", "tests": list(self.tests)})


@dataclass(frozen=True, eq=False)
class Convergence:
    """A resolved experiment.

    Attributes:
        experiment: What the renderer is given: scene (where the camera is still, everything in it is), image, runs, ...
        camera: ``still``: nothing moves; or ``path``: step n is the n-th frame from ``frame`` on.
        frame: Frame of the scene's path that is held, or that the steps begin with.
        steps: Steps of which pictures are kept, ascending; the last one ends the experiment.
        crop: Part of the frame that these pictures show side by side; None for all of it.
        axes: By label: ``frames`` for techniques with history, and all along a path; ``samples`` for those with this
            parameter, which the steps set; ``none`` for those with neither, which are rendered once.
    """

    experiment: Experiment
    camera: str
    frame: int
    steps: tuple[int, ...]
    crop: Crop | None
    axes: Mapping[str, Axis]

    @property
    def name(self) -> str:
        """Stem of the experiment file."""
        return self.experiment.name

    @property
    def reference(self) -> Reference:
        """Samples of the reference, and how many steps of a technique over frames share one measurement."""
        assert self.experiment.reference is not None
        return self.experiment.reference

    def frame_of(self, step: int) -> int:
        """The frame of the renderer's scene at a step; every technique that only goes over samples stays at step 1."""
        return step - 1 if self.camera == "still" else self.frame + step - 1

    def measured(self, label: str) -> tuple[int, ...]:
        """Steps of a label that give a row, ascending."""
        axis, last = self.axes[label], self.steps[-1]
        if axis == "none":
            return (1,)
        if axis == SAMPLES:
            ladder = {rung for k in range(last.bit_length()) for rung in (1 << k, 3 << k) if rung <= last}
        else:
            ladder = set(range(1, last + 1, self.reference.every))
        return tuple(sorted(ladder | set(self.steps)))

    def to_yaml(self) -> str:
        """The experiment as a file that runs again and gives the same results."""
        e = self.experiment
        data: dict[str, Any] = {
            "kind": "convergence",
            "scene": e.scene.as_posix() if isinstance(e.scene, Path) else e.scene,
            "image": e.image.model_dump(),
            "reference": self.reference.model_dump(),
            "projection": e.projection.written() if e.projection else None,
            "techniques": [self._entry(run) for run in e.runs],
            "camera": self.camera,
            "frame": self.frame,
            "steps": list(self.steps),
            "crop": self.crop.model_dump() if self.crop else None,
            "seed": e.seed,
            "light": e.light,
        }
        return dump_yaml(to_jsonable_python({key: value for key, value in data.items() if value is not None}))

    def _entry(self, run: TechniqueRun) -> dict[str, Any]:
        entry = run.entry()
        if self.axes[run.label] == SAMPLES:
            entry[run.name].pop(SAMPLES)
        return entry


def load_convergence(
    path: str | Path, overrides: Iterable[str] = (), plugins: Mapping[str, type] | None = None
) -> Convergence | Estimates:
    """Reads, checks and resolves an experiment file of this kind.

    Args:
        path: The YAML file.
        overrides: ``key.path=value`` texts, as given to ``--set``.
        plugins: Techniques by name; None finds those of the installed packages.

    Raises:
        InputError: Something in the file, the overrides or the scene is wrong, or a technique cannot use the light.
    """
    path = Path(path)
    source = read_experiment(path, overrides)
    if "tests" in source.data:
        return Estimates(path.stem, tuple(validate(EstimatesFile, source).tests))
    plugins = load_all() if plugins is None else plugins
    file = validate(ConvergenceFile, source)
    for i in range(1, len(file.steps)):
        if file.steps[i] <= file.steps[i - 1]:
            message = f"steps must rise, {file.steps[i]} follows {file.steps[i - 1]}."
            raise source.error(message, ("steps", i))
    _check_crop(source, file)
    runs = expand_techniques(source, plugins, file.projection)
    axes = {run.label: _axis(plugins[run.name], file.camera) for run in runs}
    for run in runs:
        if axes[run.label] == SAMPLES:
            _check_samples(source, run, plugins[run.name], file)
    scene_source, scene = open_scene(source, path.resolve().parent, file.light)
    check_runs(runs, plugins, scene, file.light, source)
    last = file.steps[-1]
    experiment = Experiment(
        name=path.stem,
        scene=scene_source,
        image=file.image,
        reference=file.reference,
        metrics=(),
        projection=file.projection,
        runs=runs,
        baseline=runs[0].label,
        repeats=1,
        seed=file.seed,
        frames=tuple(range(file.frame, file.frame + (last if file.camera == "path" else 1))),
        light=file.light,
        loaded_scene=held(scene, file.frame) if file.camera == "still" else scene,
    )
    return Convergence(experiment, file.camera, file.frame, tuple(file.steps), file.crop, axes)


def held(scene: Scene, frame: int) -> Scene:
    """The scene as it is at a frame, for ever: camera, lights and meshes stand."""
    camera = scene.camera(frame)
    meshes = tuple(
        replace(
            mesh,
            object_to_ws=_standing(mesh.object_to_ws(frame)),
            moving=False,
            vertices=mesh.vertices_at(frame),
            deformed=None,
        )
        for mesh in scene.meshes
    )
    lights = tuple(scene.light(i, frame) for i in range(len(scene.lights)))
    return replace(scene, meshes=meshes, lights=lights, camera=lambda _: camera, frames=1)


def _standing(pose: np.ndarray) -> Callable[[int], np.ndarray]:
    return lambda _: pose.copy()


def _axis(technique: Any, camera: str) -> Axis:
    if technique.needs.history or camera == "path":
        return "frames"
    return "samples" if SAMPLES in technique.Params.model_fields else "none"


def _check_samples(source: Source, run: TechniqueRun, technique: Any, file: ConvergenceFile) -> None:
    """Refuses ``samples`` in the entry of a technique that goes over samples, and steps that it cannot take."""
    entry = source.get(run.loc)
    options = (entry.get(run.name) or {}) if isinstance(entry, dict) else {}
    inner: Loc = (*run.loc, run.name)
    if SAMPLES in options:
        raise source.error("the steps set it; leave it out here.", (*inner, SAMPLES))
    if SAMPLES in (options.get("sweep") or {}):
        raise source.error("the steps set it; leave it out here.", (*inner, "sweep", SAMPLES))
    for i, step in enumerate(file.steps):
        try:
            technique.Params(**{**run.params, SAMPLES: step})
        except ValidationError as error:
            message = f"the technique '{run.name}' cannot take {step} samples: {error.errors()[0]['msg'].lower()}."
            raise source.error(message, ("steps", i)) from None


def _check_crop(source: Source, file: ConvergenceFile) -> None:
    crop, image = file.crop, file.image
    if crop is None:
        return
    for offset, size, whole in (("x", "width", image.width), ("y", "height", image.height)):
        if getattr(crop, offset) + getattr(crop, size) > whole:
            message = f"{offset} + {size} must be at most the image's {size}, {whole}."
            raise source.error(message, ("crop", size))
