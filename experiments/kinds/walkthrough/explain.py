"""``explain``: what an experiment will run, what it leaves out and why, from declarations and scene facts alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from algorithms.plugins import load_all
from algorithms.projections.schema import read_projection
from experiments.kinds.walkthrough.foreseen import light_moves, skip_lines
from experiments.metrics.registry import MAP_METRICS, METRICS
from experiments.schema.needs import check_runs, unmet_need

if TYPE_CHECKING:
    from experiments.schema.experiment import Experiment
    from wkernels.scene.model import Scene


def explain(experiment: Experiment, plugins: Mapping[str, type] | None = None) -> str:
    """A text for people; renders nothing and loads no device.

    Args:
        experiment: The resolved experiment.
        plugins: Technique classes by name; None finds those of the installed packages.
    """
    plugins = load_all() if plugins is None else plugins
    scene = experiment.load_scene()
    sections = [
        ("Scene", scene_lines(experiment, scene, plugins)),
        ("What will run", run_lines(experiment, plugins)),
        ("Amount of work", _work_lines(experiment, plugins)),
        *([("Views", _view_lines(experiment))] if experiment.views else []),
        ("Left out", left_out_lines(experiment, scene, plugins)),
    ]
    return sections_text(f"Experiment {experiment.name} (walkthrough)", sections)


def sections_text(head: str, sections: Sequence[tuple[str, Sequence[str]]]) -> str:
    """A head and titled lists of lines."""
    parts = (f"\n{title}\n" + "\n".join(f"  {line}" for line in lines) for title, lines in sections)
    return "\n".join([head, *parts])


def scene_lines(experiment: Experiment, scene: Scene, plugins: Mapping[str, type]) -> list[str]:
    """Meshes, light and path, and what an imported file brought or lost."""
    casters = [mesh for mesh in scene.meshes if mesh.casts]
    triangles = sum(len(mesh.faces) for mesh in scene.meshes)
    light = scene.light(experiment.light, experiment.frames[0])
    if not light.has_area:
        extent = "no area: all shadows are hard"
    elif light.is_directional:
        extent = f"{math.degrees(light.size):.3g} degrees wide"
    else:
        extent = f"size {light.size:.4g} scene units"
    if light_moves(experiment, scene):
        extent += ", moves"
    if check_runs(experiment.runs, plugins, scene, experiment.light):
        extent += "; techniques and reference show all lights, weighted by radiance"
    return [
        f"{scene.name}: {len(scene.meshes)} meshes, {triangles:,} triangles, {len(casters)} meshes cast, "
        f"{sum(mesh.receives for mesh in scene.meshes)} receive, {sum(mesh.moving for mesh in scene.meshes)} move",
        f"light {experiment.light} of {len(scene.lights)}: {light.kind}, {extent}",
        f"path of {scene.frames} frame{_s(scene.frames)}; "
        f"{len(experiment.frames)} rendered: {_ranges(experiment.frames)}",
        *(f"imported: {note}" for note in scene.notes),
    ]


def run_lines(experiment: Experiment, plugins: Mapping[str, type]) -> list[str]:
    """A line per label: technique, parameters and projection that are not at their defaults, and what it relies on."""
    width = max(len(run.label) for run in experiment.runs)
    lines = []
    for run in experiment.runs:
        cls: Any = plugins[run.name]
        defaults = cls.Params().model_dump()
        changed = ", ".join(f"{key}={value}" for key, value in run.params.items() if defaults.get(key) != value)
        notes = [f"{cls.family}/{run.name}", changed or "all parameters at their defaults"]
        projection = [f"{k}={v}" for k, v in read_projection(run.projection or {}).changed().items()]
        if projection:
            notes.append(f"projection {', '.join(projection)}")
        if pulled := [product.value for product in cls.products]:
            notes.append(f"pulls {', '.join(pulled)}")
        if cls.needs.history:
            notes.append("uses earlier frames")
        if run.label == experiment.baseline:
            notes.append("baseline of all costs")
        lines.append(f"{run.label:<{width}}  {'; '.join(notes)}")
    return lines


def _work_lines(experiment: Experiment, plugins: Mapping[str, type]) -> list[str]:
    labels, frames, repeats = len(experiment.runs), len(experiment.frames), experiment.repeats
    image = experiment.image
    pixels = image.width * image.height
    techniques: list[Any] = [plugins[run.name] for run in experiment.runs]
    warm = sum(min(frames, 2) + experiment.lead_in if technique.needs.history else 1 for technique in techniques)
    lines = [
        f"{labels * frames * repeats:,} timed renderings of {image.width} x {image.height}: "
        f"{labels} label{_s(labels)} x {frames} frame{_s(frames)} x {repeats} repeat{_s(repeats)}, "
        f"and {warm:,} untimed to warm up{' and lead in' if experiment.lead_in else ''}"
    ]
    if experiment.reference:
        chosen = experiment.frames[:: experiment.reference.every]
        rays = len(chosen) * pixels * experiment.reference.samples
        lines.append(
            f"reference on {len(chosen)} frame{_s(len(chosen))}: {_ranges(chosen)}; "
            f"{_samples_of(experiment)}, at most {rays:,} rays; "
            "frames in the cache are not traced again"
        )
    asked = set(experiment.metrics) | {metric.name for metric in METRICS.values() if metric.always}
    lines.append(f"metrics: {', '.join(name for name in METRICS if name in asked)}, m_x_max, m_z_max")
    return lines


def _view_lines(experiment: Experiment) -> list[str]:
    from experiments.schema.view_kinds import KINDS, picture_names

    views = experiment.views
    assert views is not None and views.frames is not None and views.image is not None
    names = [name for kind in KINDS if kind in views.kinds for name in picture_names(kind, list(views.modes))]
    frames = list(views.frames) if isinstance(views.frames, list) else list(views.frames.indices())
    whose = ", ".join(views.labels) if views.labels else "every label that reads a light map"
    size = views.image
    return [
        f"of {whose}, on frame{_s(len(frames))} {_ranges(frames)}; "
        f"third-person pictures of {size.width} x {size.height}",
        f"{len(names)} picture{_s(len(names))} each, to images/LABEL/views: {', '.join(names)}",
        "what has no meaning for a label is named in left_out.csv; none of this is timed",
    ]


def left_out_lines(experiment: Experiment, scene: Scene, plugins: Mapping[str, type]) -> list[str]:
    """Every line is (what: why); counts come with the run, in left_out.csv."""
    lines = skip_lines(experiment, scene, plugins)
    light = scene.lights[experiment.light]
    if not any(mesh.receives for mesh in scene.meshes):
        lines.append("all errors: no mesh receives shadows")
    if experiment.reference is None:
        names = [metric.title for metric in METRICS.values() if _needs_reference(metric.name)]
        lines.append(f"{', '.join(names)}: there is no reference; their columns stay empty")
    elif experiment.reference.every > 1 and len(experiment.frames) > 1:
        lines.append(
            f"errors on the other frames: the reference is made on every {experiment.reference.every}th frame only"
        )
    lines += [
        f"{METRICS[name].title}: not among the experiment's metrics"
        for name in ("flip", "flicker")
        if name not in experiment.metrics and (experiment.reference or not _needs_reference(name))
    ]
    if set(MAP_METRICS).isdisjoint(experiment.metrics):
        lines.append("sampling rates per pixel and wasted map area: not among the experiment's metrics (sampling)")
    used = {run.name for run in experiment.runs}
    for name, cls in plugins.items():
        if name not in used and (why := unmet_need(cls, scene, light)):
            lines.append(f"technique {name}, which could not run here: {why}")
    return lines or ["nothing that is known before rendering"]


def _samples_of(experiment: Experiment) -> str:
    assert experiment.reference is not None
    if experiment.reference.light == "centre":
        return "the light's centre alone"
    return f"{experiment.reference.samples} light samples"


def _needs_reference(name: str) -> bool:
    return name not in ("standard_error", "flicker", "flicker_edges", *MAP_METRICS)


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def _ranges(frames: Sequence[int]) -> str:
    """Frame numbers, shortened where they are evenly spaced."""
    if len(frames) <= 3:
        return ", ".join(map(str, frames))
    step = frames[1] - frames[0]
    if all(b - a == step for a, b in itertools.pairwise(frames)):
        return f"{frames[0]}, {frames[1]}, ..., {frames[-1]}"
    return ", ".join(map(str, frames))
