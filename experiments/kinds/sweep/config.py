"""The experiment file of ``kind: sweep``: a walkthrough's keys, several scenes, and techniques that fit the scene.

A technique that a scene cannot serve is left out of that scene, with the reason; one that no scene can serve is a
mistake, unless it came with ``all``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic_core import to_jsonable_python

from algorithms.plugins import load_all
from experiments.config.messages import Loc
from experiments.config.source import Source, dump_yaml, validate
from experiments.schema.experiment import Experiment, open_scene, read_experiment, resolve
from experiments.schema.models import RunFile
from experiments.schema.needs import unmet_need
from experiments.schema.techniques import TechniqueRun, expand_techniques, names_a_folder
from wkernels.errors import nearest
from wkernels.scene.model import Scene

ALL = "all"
BASELINE = "pcss"
TAKEN = (ALL, "images", "plots", "failures")
"""Names that no scene can have: the rows over all scenes, and folders beside the scenes'."""

Budget = str | Annotated[float, Field(gt=0.0)]


class SweepFile(RunFile):
    """An experiment file of this kind.

    Attributes:
        scene: A scene file, or its keys; instead of ``scenes``.
        scenes: Several; one that is written here may have a ``name``.
        techniques: As in a walkthrough; ``all``, or as an entry, stands for all that no other entry names.
        budgets: Labels whose time and error, or milliseconds that, the others are compared at, besides the baseline.
    """

    kind: Literal["sweep"]
    scene: str | dict[str, Any] | None = None
    scenes: list[str | dict[str, Any]] | None = None
    techniques: str | list[str | dict[str, Any]]
    budgets: list[Budget] | None = None


@dataclass(frozen=True, eq=False)
class SweepScene:
    """One scene.

    Attributes:
        experiment: The walkthrough that is run there; its name is the scene's, which is also its result folder.
        unserved: Runs that the scene cannot serve, and why.
    """

    experiment: Experiment
    unserved: tuple[tuple[TechniqueRun, str], ...]

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.experiment.name


@dataclass(frozen=True, eq=False)
class Sweep:
    """A resolved sweep.

    Attributes:
        name: Stem of the experiment file.
        file: What is the same in all scenes, as it was written.
        scenes: In file order.
        runs: Those that some scene serves, one per label, in file order.
        baseline: The label that costs are relative to; every scene serves it.
        budgets: Labels whose time and error, or milliseconds that, the others are compared at, besides the baseline.
    """

    name: str
    file: SweepFile
    scenes: tuple[SweepScene, ...]
    runs: tuple[TechniqueRun, ...]
    baseline: str
    budgets: tuple[str | float, ...]

    def to_yaml(self) -> str:
        """The sweep as a file that runs again and gives the same results."""
        same = self.scenes[0].experiment
        data: dict[str, Any] = {
            "kind": "sweep",
            "scenes": [_scene_entry(scene.experiment) for scene in self.scenes],
            "image": same.image.model_dump(),
            "reference": same.reference.model_dump() if same.reference else None,
            "metrics": list(same.metrics),
            "projection": same.projection.written() if same.projection else None,
            "techniques": [run.entry() for run in self.runs],
            "baseline": self.baseline,
            "budgets": list(self.budgets) or None,
            "repeats": same.repeats,
            "seed": same.seed,
            "frames": self.file.frames,
            "lead_in": self.file.lead_in or None,
            "light": same.light,
            "views": self.file.views,
        }
        plain = to_jsonable_python({key: value for key, value in data.items() if value is not None})
        return dump_yaml(plain)


def load_sweep(path: str | Path, overrides: Iterable[str] = (), plugins: Mapping[str, type] | None = None) -> Sweep:
    """Reads, checks and resolves a sweep together with its scenes.

    Args:
        path: The YAML file.
        overrides: ``key.path=value`` texts, as given to ``--set``.
        plugins: Techniques by name; None finds those of the installed packages.

    Raises:
        InputError: Something in the file, the overrides or a scene is wrong, no scene serves a technique that is named,
            or one does not serve the baseline.
    """
    path, plugins = Path(path), load_all() if plugins is None else plugins
    source = read_experiment(path, overrides)
    file = validate(SweepFile, source)
    entries, named = _entries(source, file, plugins)
    runs = expand_techniques(source, plugins, file.projection, entries)
    labels = [run.label for run in runs]
    _check_labels(source, file, labels)
    opened = _open_scenes(source, file, path.resolve().parent)
    unmet = [
        {run.label: unmet_need(plugins[run.name], scene, scene.lights[file.light]) for run in runs}
        for _, _, scene in opened
    ]
    served = [run for run in runs if any(found[run.label] is None for found in unmet)]
    for run in runs:
        if run not in served and run.loc in named:
            raise source.error(f"no scene serves it: {unmet[0][run.label]}", run.loc)
    baseline = _baseline(source, file, runs, [name for name, _, _ in opened], unmet)
    scenes = []
    for (name, origin, scene), found in zip(opened, unmet, strict=True):
        own = tuple(run for run in runs if found[run.label] is None)
        experiment = resolve(name, source, file, own, baseline, (origin, scene), labels)
        if experiment.views and experiment.views.labels:
            wanted = [label for label in experiment.views.labels if found[label] is None]
            views = experiment.views.model_copy(update={"labels": wanted}) if wanted else None
            experiment = replace(experiment, views=views)
        unserved = tuple((run, why) for run in runs if (why := found[run.label]) is not None)
        scenes.append(SweepScene(experiment, unserved))
    return Sweep(path.stem, file, tuple(scenes), tuple(served), baseline, tuple(file.budgets or ()))


def _entries(source: Source, file: SweepFile, plugins: Mapping[str, type]) -> tuple[list[tuple[Loc, Any]], set[Loc]]:
    """Places and entries with ``all`` replaced by every plugin that no other entry names, and the others' places."""
    written: Sequence[tuple[Loc, Any]] = [(("techniques",), ALL)]
    if isinstance(file.techniques, str) and file.techniques != ALL:
        message = f"must be '{ALL}' or a list of techniques, not '{file.techniques}'."
        raise source.error(message, ("techniques",))
    if isinstance(file.techniques, list):
        written = [(("techniques", i), entry) for i, entry in enumerate(source.data["techniques"])]
    names = {name for _, entry in written for name in (entry if isinstance(entry, dict) else [entry])}
    everything = [loc for loc, entry in written if entry == ALL]
    if len(everything) > 1:
        raise source.error(f"'{ALL}' is listed twice.", everything[1])
    out: list[tuple[Loc, Any]] = []
    for loc, entry in written:
        out += [(loc, name) for name in plugins if name not in names] if entry == ALL else [(loc, entry)]
    if not out:
        raise source.error(f"must list at least one technique, or be '{ALL}'.", ("techniques",))
    return out, {loc for loc, entry in written if entry != ALL}


def _check_labels(source: Source, file: SweepFile, labels: Sequence[str]) -> None:
    """The labels that ``baseline`` and ``budgets`` name."""
    wanted: list[tuple[Loc, str | float]] = [(("budgets", i), budget) for i, budget in enumerate(file.budgets or ())]
    if file.baseline is not None:
        wanted = [(("baseline",), file.baseline), *wanted]
    for loc, label in wanted:
        if isinstance(label, str) and label not in labels:
            raise source.error(f"no technique has the label '{label}'." + nearest(label, labels), loc)
        if loc[0] == "budgets" and label in (file.budgets or ())[: int(loc[1])]:
            raise source.error(f"{label} is listed twice.", loc)


def _open_scenes(source: Source, file: SweepFile, base: Path) -> list[tuple[str, Path | dict[str, Any], Scene]]:
    """Name, origin and content of every scene."""
    if file.scene is not None and file.scenes is not None:
        raise source.error("give either 'scene' or 'scenes', not both.", ("scene",))
    if file.scene is None and not file.scenes:
        raise source.error("needs at least one scene.", ("scenes",) if file.scenes is not None else ())
    locs: list[Loc] = [("scene",)] if file.scenes is None else [("scenes", i) for i in range(len(file.scenes))]
    out: list[tuple[str, Path | dict[str, Any], Scene]] = []
    for loc in locs:
        name, bare = _named(source, loc)
        origin, scene = open_scene(bare, base, file.light, loc, name)
        name = name or (origin.stem if isinstance(origin, Path) else scene.name)
        _check_name(source, loc, name, [earlier for earlier, _, _ in out])
        out.append((name, origin, scene))
    return out


def _named(source: Source, loc: Loc) -> tuple[str | None, Source]:
    """The key ``name`` of a scene that is written here, and the source without it, in which lines are still found."""
    data = source.get(loc)
    if not isinstance(data, dict) or "name" not in data:
        return None, source
    name = data["name"]
    if not isinstance(name, str) or not name.strip():
        raise source.error("must be a name.", (*loc, "name"))
    bare = {key: value for key, value in data.items() if key != "name"}
    whole = dict(source.data)
    if len(loc) == 1:
        whole[str(loc[0])] = bare
    else:
        whole["scenes"] = [bare if i == loc[1] else item for i, item in enumerate(whole["scenes"])]
    return name, replace(source, data=whole)


def _check_name(source: Source, loc: Loc, name: str, earlier: Sequence[str]) -> None:
    if name.casefold() in TAKEN:
        message = f"a scene cannot be called '{name}', which names something else in the results; rename it."
        raise source.error(message, loc)
    if not names_a_folder(name):
        raise source.error('the name must be at most 100 printable characters without / \\ : * ? " < > |.', loc)
    if name.casefold() in [other.casefold() for other in earlier]:
        message = f"there is a scene '{name}' already; give one of the two another name (name: ... in a scene's keys)."
        raise source.error(message, loc)


def _baseline(
    source: Source,
    file: SweepFile,
    runs: Sequence[TechniqueRun],
    scenes: Sequence[str],
    unmet: Sequence[Mapping[str, str | None]],
) -> str:
    """The label that is asked for; else ``pcss``, else a run of it, else the first, among those that run everywhere."""
    if file.baseline is not None:
        for name, found in zip(scenes, unmet, strict=True):
            if found[file.baseline] is not None:
                message = f"the baseline must run in every scene; not in '{name}': {found[file.baseline]}"
                raise source.error(message, ("baseline",))
        return file.baseline
    everywhere = [run for run in runs if all(found[run.label] is None for found in unmet)]
    if not everywhere:
        raise source.error("no technique runs in every scene, so that there is no baseline.", ("techniques",))
    ranked = sorted(everywhere, key=lambda run: 0 if run.label == BASELINE else 1 if run.name == BASELINE else 2)
    return ranked[0].label


def _scene_entry(experiment: Experiment) -> Any:
    if isinstance(experiment.scene, Path):
        return experiment.scene.as_posix()
    return {"name": experiment.name, **experiment.scene}
