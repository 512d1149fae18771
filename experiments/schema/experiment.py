"""What every kind that renders frames resolves its file to: one scene, techniques, frames, reference, metrics.

What a file may leave out is filled in here, so that the resolved form, written beside the results, says everything and
can be run again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from algorithms.projections.schema import Projection
from experiments.config.messages import Loc
from experiments.config.overrides import apply_overrides
from experiments.config.source import Source, dump_yaml, load_yaml
from experiments.metrics.registry import GROUPS, METRICS
from experiments.scenes import load_scene, scene_from_source
from experiments.scenes.assets import PREFIXES
from experiments.schema.models import FrameRange, Image, Reference, RunFile, Views
from experiments.schema.techniques import TechniqueRun
from experiments.schema.views import resolve_views
from wkernels.errors import nearest
from wkernels.scene.model import Scene

REFERENCE_METRICS = frozenset({"rmse", "mean_signed_error", "p99_error", "flip", "reference_standard_error"})


@dataclass(frozen=True, eq=False)
class Experiment:
    """A resolved walkthrough: every default filled in, sweeps multiplied out, names checked.

    Attributes:
        name: Stem of the experiment file.
        scene: Absolute path of the scene file, or its data (file names in it are absolute).
        image: Frame size.
        reference: None where no reference is to be made.
        metrics: Names of the metrics to compute.
        projection: Default projection; None leaves it to each technique.
        runs: One per label, in file order.
        baseline: The label that costs are relative to.
        repeats: Timed repetitions of each frame.
        seed: Seed of every sample set.
        frames: Frame numbers to render, ascending.
        lead_in: How many frames before the first, of the same step, techniques with history go through before it:
            neither timed nor measured, so that a part of a path can be measured in mid-flight.
        light: Index of the light whose visibility is compared.
        views: Pictures to make, every default filled in; None for none.
    """

    name: str
    scene: Path | dict[str, Any]
    image: Image
    reference: Reference | None
    metrics: tuple[str, ...]
    projection: Projection | None
    runs: tuple[TechniqueRun, ...]
    baseline: str
    repeats: int
    seed: int
    frames: tuple[int, ...]
    light: int
    loaded_scene: Scene
    views: Views | None = None
    lead_in: int = 0

    def lead_in_frames(self) -> range:
        """The frames before the first that are neither timed nor measured."""
        first, step = self.frames[0], _step(self.frames)
        return range(first - self.lead_in * step, first, step)

    def load_scene(self) -> Scene:
        """The scene, which was loaded to check the experiment against it."""
        return self.loaded_scene

    def to_yaml(self) -> str:
        """The experiment as a file that runs again and gives the same results."""
        data: dict[str, Any] = {
            "kind": "walkthrough",
            "scene": self.scene.as_posix() if isinstance(self.scene, Path) else self.scene,
            "image": self.image.model_dump(),
            "reference": self.reference.model_dump() if self.reference else None,
            "metrics": list(self.metrics),
            "projection": self.projection.written() if self.projection else None,
            "techniques": [run.entry() for run in self.runs],
            "baseline": self.baseline,
            "repeats": self.repeats,
            "seed": self.seed,
            "frames": _as_range(self.frames),
            "lead_in": self.lead_in or None,
            "light": self.light,
            "views": self.views.model_dump() if self.views else None,
        }
        return dump_yaml(to_jsonable_python({key: value for key, value in data.items() if value is not None}))


def read_experiment(path: Path, overrides: Iterable[str]) -> Source:
    """An experiment file with its overrides applied, not checked yet; InputError where it is no mapping."""
    source = load_yaml(path)
    if not isinstance(source.data, dict):
        raise source.error("must be a mapping with the keys kind, scene, image, techniques, ...")
    return apply_overrides(source, overrides, lambda s, loc: _inline_scene(s, path.resolve().parent, loc))


def open_scene(
    source: Source, base: Path, light: int, loc: Loc = ("scene",), name: str | None = None
) -> tuple[Path | dict[str, Any], Scene]:
    """The scene of an experiment: where it comes from, as ``Experiment.scene`` says it, and itself.

    Args:
        source: The experiment file.
        base: Folder that file names are relative to.
        light: Index that the experiment uses.
        loc: Place of the scene.
        name: Name of a scene that is not a file's; its first generator's unless given.

    Raises:
        InputError: There is no such file, something in it is wrong, or it has no light of that index.
    """
    scene_source = _scene_source(source, base, loc)
    if isinstance(scene_source, Path):
        scene = load_scene(scene_source)
    else:
        scene = scene_from_source(source, loc, base=base, name=name)
    if light >= len(scene.lights):
        raise source.error(f"the scene has {len(scene.lights)} light(s); there is no light {light}.", ("light",))
    return scene_source, scene


def resolve(
    name: str,
    source: Source,
    file: RunFile,
    runs: tuple[TechniqueRun, ...],
    baseline: str,
    opened: tuple[Path | dict[str, Any], Scene],
    labels: Sequence[str],
) -> Experiment:
    """One scene's experiment, once its scene and techniques are known.

    Args:
        name: Of the experiment.
        source: The experiment file.
        file: Its content.
        runs: What is rendered of this scene.
        baseline: One of their labels.
        opened: The scene, as ``open_scene`` gives it.
        labels: All labels of the file, which its views may name.

    Raises:
        InputError: A metric or view is wrong.
    """
    scene_source, scene = opened
    frames = _frames(file, scene)
    return Experiment(
        name=name,
        scene=scene_source,
        image=file.image,
        reference=file.reference,
        metrics=_metrics(source, file),
        projection=file.projection,
        runs=runs,
        baseline=baseline,
        repeats=file.repeats,
        seed=file.seed,
        frames=frames,
        light=file.light,
        loaded_scene=scene,
        views=resolve_views(source, file, frames, labels),
        lead_in=_lead_in(source, file, frames),
    )


def _metrics(source: Source, file: RunFile) -> tuple[str, ...]:
    if file.metrics is None:
        return ("rmse", "mean_signed_error", "p99_error", "flip") if file.reference else ()
    out: list[str] = []
    for i, entry in enumerate(file.metrics):
        for name in GROUPS.get(entry, (entry,)):
            if name not in METRICS:
                raise source.error(f"there is no metric '{name}'." + nearest(name, (*METRICS, *GROUPS)), ("metrics", i))
            if name in REFERENCE_METRICS and file.reference is None:
                raise source.error(f"the metric '{name}' needs the key 'reference' in this file.", ("metrics", i))
            if name in out:
                raise source.error(f"the metric '{name}' is listed twice.", ("metrics", i))
            out.append(name)
    return tuple(out)


def _frames(file: RunFile, scene: Scene) -> tuple[int, ...]:
    if isinstance(file.frames, FrameRange):
        return file.frames.indices()
    return tuple(range(scene.frames if file.frames is None else file.frames))


def _lead_in(source: Source, file: RunFile, frames: tuple[int, ...]) -> int:
    most = frames[0] // _step(frames)
    if file.lead_in > most:
        raise source.error(f"there are {most} frames before frame {frames[0]}, not {file.lead_in}.", ("lead_in",))
    return file.lead_in


def _step(frames: Sequence[int]) -> int:
    """From one frame to the next."""
    return frames[1] - frames[0] if len(frames) > 1 else 1


def _as_range(frames: tuple[int, ...]) -> dict[str, int]:
    return {"start": frames[0], "stop": frames[-1] + 1, "step": _step(frames)}


def _scene_source(source: Source, base: Path, loc: Loc) -> Path | dict[str, Any]:
    scene = source.get(loc)
    if isinstance(scene, dict):
        return dict(_with_absolute_files(scene, base))
    path = base / scene
    if not path.is_file():
        raise source.error(f"no scene file {path}.", loc)
    return path


def _inline_scene(source: Source, base: Path, loc: Loc) -> Source:
    """Puts the scene file's data into the experiment, for ``--set scene.camera.fov_deg=40`` to change."""
    path = _scene_source(source, base, loc)
    assert isinstance(path, Path)
    data = _with_absolute_files(load_yaml(path).data, path.parent)
    if loc != ("scene",) and isinstance(data, dict):  # one of several keeps its name, which is that of its results
        data = {"name": path.stem, **data}
    return source.replaced(loc, data, str(path))


def _with_absolute_files(data: Any, base: Path) -> Any:
    if isinstance(data, list):
        return [_with_absolute_files(item, base) for item in data]
    if not isinstance(data, dict):
        return data
    out = {}
    for key, value in data.items():
        is_file = key in ("file", "texture", "import") and isinstance(value, str) and not value.startswith(PREFIXES)
        out[key] = (base / value).as_posix() if is_file else _with_absolute_files(value, base)
    return out
