"""What a run will leave out and why, as far as the scene, the path and the techniques' declarations tell beforehand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from algorithms.projections.composition import compose
from algorithms.projections.schema import read_projection
from algorithms.projections.table import fits
from wkernels.frame.empty_maps import EmptyMaps, may_see
from wkernels.frame.map_keeper import BesideViews
from wkernels.frame.result import TurnedAway
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Bounds
from wkernels.scene.rest import Poses
from wkernels.scene.views import HostView, eye_view
from wkernels.workspace.left_out import Because, Omission, Reasoned
from wkernels.workspace.products import Product, Unasked

if TYPE_CHECKING:
    from experiments.schema.experiment import Experiment
    from experiments.schema.techniques import TechniqueRun
    from wkernels.scene.model import Mesh, Scene

LOOKED_AT = 10_000  # frames of a path, for whether movers rest in any
FRAMES_LOOKED_AT = 30  # of a walkthrough, evenly spaced, for what depends on where the eye is


def skip_lines(experiment: Experiment, scene: Scene, plugins: Mapping[str, type]) -> list[str]:
    """Every line is (what: why), after the labels that it is about unless that is all of them."""
    casters = [mesh for mesh in scene.meshes if mesh.casts]
    if not casters:
        return ["depth maps, blocker searches and rays: no mesh casts, everything is lit"]
    lines = [*_kept_lines(experiment, scene, plugins), *_fallback_lines(experiment, scene)]
    found: dict[Reasoned, list[str]] = {}
    for run in experiment.runs:
        for pair in own_omissions(scene, experiment.light, plugins[run.name], run.params):
            found.setdefault(pair, []).append(run.label)
    readers = [run for run in experiment.runs if reads_map(plugins[run.name])]
    if readers:
        found[TurnedAway.PIXELS.pair] = [run.label for run in readers]
    for run in readers:
        for omission, frames in _of_views(experiment, scene, run).items():
            what, why = omission.pair
            found.setdefault((what, f"{why} ({frames})"), []).append(run.label)
    if len(readers) < len(experiment.runs):
        others = [run.label for run in experiment.runs if run not in readers]
        found[Unasked.LIGHT_MAP.pair] = others
    every = len(experiment.runs)
    lines += [
        f"{'' if len(labels) == every else ', '.join(labels) + ': '}{what}: {why}"
        for (what, why), labels in found.items()
    ]
    unused = set(plugins) - {run.name for run in experiment.runs}
    if unused:
        lines.append(f"compiling the kernels of {len(unused)} other techniques: no label uses them")
    return lines


def own_omissions(scene: Scene, light: int, technique: Any, params: Mapping[str, Any]) -> Iterator[Reasoned]:
    """What a technique declares that it may leave out with these parameters, without what the scene rules out."""
    holds = {
        Because.NO_AREA: not scene.lights[light].has_area,
        Because.NO_CASTER_MOVES: casters_rest(scene),
        Because.NOTHING_CASTS: not any(mesh.casts for mesh in scene.meshes),
    }
    for omission in technique(technique.Params(**params)).leaves_out():
        if omission.because is None or holds[omission.because]:
            yield omission.pair


def casters_rest(scene: Scene) -> bool:
    """Whether there is a frame in which no caster moves: none may, or all that may rest (``scene.rest``)."""
    movers = dict(enumerate(mesh.object_to_ws for mesh in scene.meshes if mesh.moving and mesh.casts))
    poses = Poses(movers)
    return any(len(poses.resting(frame)) == len(movers) for frame in range(min(scene.frames, LOOKED_AT)))


def reads_map(technique: Any) -> bool:
    """Whether a technique reads light depth maps."""
    return not {Product.LIGHT_MAP, Product.KEPT_MAPS}.isdisjoint(technique.products)


def _kept_lines(experiment: Experiment, scene: Scene, plugins: Mapping[str, type]) -> Iterator[str]:
    """What later frames take over from earlier ones."""
    if len(experiment.frames) == 1:
        return
    rests = camera_rests(experiment, scene)
    anew = [run.label for run in experiment.runs if _draws_anew(plugins[run.name])]
    casters_move = any(mesh.moving and mesh.casts for mesh in scene.meshes)
    if len(anew) < len(experiment.runs) and not light_moves(experiment, scene):
        follows = not rests and any(follows_eye(run) for run in experiment.runs)
        maps = "depth maps that do not follow the eye" if follows else "depth maps"
        when = "on frames in which no caster has moved" if casters_move else "on later frames"
        why = "the light stands still" if casters_move else "no caster moves and neither does the light"
        but = f" (but not the maps of {', '.join(anew)})" if anew else ""
        yield f"building {maps} and ray structures anew {when}: {why}{but}"
    if anew:
        yield f"nothing of the depth maps of {', '.join(anew)}: every frame draws one for a sample of its own"
    if rests and not any(mesh.moving for mesh in scene.meshes):
        yield "drawing the G-buffer again on later frames: neither the camera nor a mesh moves"


def _draws_anew(technique: Any) -> bool:
    """Whether a technique draws other maps in every frame: with memory, but none of maps."""
    return bool(technique.needs.history and Product.KEPT_MAPS not in technique.products)


def light_moves(experiment: Experiment, scene: Scene) -> bool:
    """Whether the light moves between any two of the frames; otherwise its motion is as good as none."""
    motion = scene.lights[experiment.light].motion
    if motion is None:
        return False
    first = motion(experiment.frames[0])
    return not all(np.array_equal(first, motion(frame)) for frame in experiment.frames)


def follows_eye(run: TechniqueRun) -> bool:
    """Whether a label's maps depend on where the eye is."""
    return fits()[read_projection(run.projection or {}).fit].follows_eye


def camera_rests(experiment: Experiment, scene: Scene) -> bool:
    """Whether the camera is the same on all frames."""
    first = scene.camera(experiment.frames[0])
    poses = (scene.camera(frame) for frame in experiment.frames)
    return all(
        np.array_equal(np.concatenate([p.eye, p.target, p.up]), np.concatenate([first.eye, first.target, first.up]))
        for p in poses
    )


def _boxes(experiment: Experiment, scene: Scene) -> tuple[Bounds, Bounds]:
    """Boxes of what receives and of what casts, on the first frame."""
    receivers, casters = Bounds(), Bounds()
    for mesh in scene.meshes:
        for bounds, takes_part in ((receivers, mesh.receives), (casters, mesh.casts)):
            if takes_part:
                bounds.add(_corners(mesh, experiment.frames[0]))
    return receivers, casters


def _corners(mesh: Mesh, frame: int) -> np.ndarray:
    pose = mesh.object_to_ws(frame)
    points = np.asarray(mesh.vertices_at(frame), float) @ pose[:3, :3].T + pose[:3, 3]
    return points[np.isfinite(points).all(axis=1)]


def _looked_at(experiment: Experiment) -> Sequence[int]:
    return experiment.frames[:: -(-len(experiment.frames) // FRAMES_LOOKED_AT)]


def _eye(experiment: Experiment, scene: Scene, frame: int) -> HostView:
    return eye_view(scene.camera(frame), experiment.image.width, experiment.image.height, np.zeros(3))


def _of_views(experiment: Experiment, scene: Scene, run: TechniqueRun) -> dict[Omission, str]:
    """What the light's views say of a label's maps, and on how many frames: from boxes, from the light's centre."""
    receivers, casters = _boxes(experiment, scene)
    if receivers.empty or casters.empty:
        return {}
    views: Any = compose(run.projection) if run.projection else None
    changes = follows_eye(run) or light_moves(experiment, scene)
    frames = _looked_at(experiment) if changes else experiment.frames[:1]
    counts: Counter[Omission] = Counter()
    for frame in frames:
        light_ws = scene.light(experiment.light, frame).centre
        if views is None:
            made = scene_views(light_ws, receivers, casters, 64)
        else:
            made = views(light_ws, receivers, casters, 64, _eye(experiment, scene, frame))
        told: list[Omission] = [BesideViews.BLOCKS] if len(made) > 1 else []
        if not may_see(made, casters):
            told = [EmptyMaps.UNDRAWN, EmptyMaps.UNCOMPARED]
        counts.update(told)
    often = {omission: f"on {n} of {len(frames)} frames looked at" for omission, n in counts.items()}
    return often if changes else dict.fromkeys(counts, "on all frames")


def _fallback_lines(experiment: Experiment, scene: Scene) -> list[str]:
    """What the projections cannot do, or need not, on some of the frames: from boxes, with the camera's near plane."""
    receivers, casters = _boxes(experiment, scene)
    frames = _looked_at(experiment)
    lines: list[str] = []
    for run in experiment.runs:
        views: Any = compose(run.projection) if follows_eye(run) and not receivers.empty else None
        counts: Counter[Omission] = Counter()
        for frame in frames if views is not None else ():
            views(scene.light(experiment.light, frame).centre, receivers, casters, 64, _eye(experiment, scene, frame))
            counts.update(dict.fromkeys(views.left_out, 1))
        lines += [
            f"{run.label}: {what} on {count} of {len(frames)} frame{'' if len(frames) == 1 else 's'} looked at: {why}"
            for (what, why), count in ((omission.pair, count) for omission, count in counts.items())
        ]
    return lines
