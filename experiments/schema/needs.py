"""Whether a scene offers what a technique declares to need, asked before any work is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.config.messages import Loc
from experiments.config.source import Source
from experiments.schema.techniques import TechniqueRun
from wkernels.casters.closed import is_closed
from wkernels.errors import InputError
from wkernels.scene.lights import Light
from wkernels.scene.model import Mesh, Scene

PLANAR_TOLERANCE = 1e-6  # of the mesh's extent


def unmet_need(technique: Any, scene: Scene, light: Light) -> str | None:
    """One sentence about the first need that is not met, or None.

    Args:
        technique: A technique class.
        scene: The scene.
        light: The light whose shadows are asked for.
    """
    needs, name = technique.needs, technique.name
    if light.kind not in needs.lights:
        known = ", ".join(sorted(needs.lights))
        return f"'{name}' works with lights of kind {known}; this one is a {light.kind} light."
    if needs.area and not light.has_area:
        how = {"directional": "an angle_deg greater than 0", "point": "another kind, such as sphere or rectangle"}
        remedy = how.get(light.kind, "a size greater than 0")
        return f"'{name}' needs a light with an area; this {light.kind} light has none (give it {remedy})."
    if needs.closed_meshes:
        opened = next((mesh.name for mesh in scene.meshes if mesh.casts and not is_closed(mesh)), None)
        if opened is not None:
            return f"'{name}' needs closed casters; the mesh '{opened}' is open (casts: false takes it out)."
    if needs.whole_casters and (cut := scene.cut_caster) is not None:
        return f"'{name}' needs whole casters; '{cut.name}' is cut out by a texture (casts: false takes it out)."
    if needs.planar_receiver and not any(mesh.receives and is_planar(mesh) for mesh in scene.meshes):
        return f"'{name}' needs a planar receiver; no receiving mesh of the scene is flat."
    if needs.still_light and light.motion is not None:
        return f"'{name}' is made for lights that stand still; this one moves."
    return None


def check_needs(technique: Any, scene: Scene, light: Light, *, source: Source | None = None, loc: Loc = ()) -> None:
    """Refuses a technique that cannot work in a scene.

    Args:
        technique: A technique class.
        scene: The scene.
        light: The light whose shadows are asked for.
        source: The experiment file that asks for it, if there is one.
        loc: Where it does.

    Raises:
        InputError: A need is not met; says which one and, where possible, what would meet it.
    """
    message = unmet_need(technique, scene, light)
    if message is not None:
        raise source.error(message, loc) if source else InputError(message)


def check_runs(
    runs: Sequence[TechniqueRun],
    plugins: Mapping[str, Any],
    scene: Scene,
    light: int,
    source: Source | None = None,
) -> bool:
    """Refuses techniques that cannot work in a scene, or not together.

    Args:
        runs: An experiment's techniques.
        plugins: Technique classes by name.
        scene: The scene.
        light: Index of the light that the experiment asks for.
        source: The experiment file.

    Returns:
        Whether they show all lights together and are scored by the weighted mean of references; with one light in the
        scene it makes no difference, and this is False.

    Raises:
        InputError: A need is not met, or some show all lights and others one, which no reference suits.
    """
    for run in runs:
        check_needs(plugins[run.name], scene, scene.lights[light], source=source, loc=run.loc)
    if len(scene.lights) < 2:
        return False
    own = {run.label: _shows_all(plugins[run.name], run.params) for run in runs}
    odd = [run for run in runs if own[run.label] != next(iter(own.values()))]
    if odd:
        message = (
            f"'{odd[0].label}' shows {'all lights' if own[odd[0].label] else 'one light'} and '{next(iter(own))}' "
            f"{'one' if own[odd[0].label] else 'all'}: no reference suits both, give each an experiment of its own."
        )
        raise source.error(message, odd[0].loc) if source else InputError(message)
    for run in runs:
        for other in scene.lights if own[run.label] else ():
            check_needs(plugins[run.name], scene, other, source=source, loc=run.loc)
    return any(own.values())


def _shows_all(technique: Any, params: Mapping[str, Any]) -> bool:
    return bool(hasattr(technique, "all_lights") and technique(technique.Params(**params)).all_lights)


def is_planar(mesh: Mesh) -> bool:
    """Whether all vertices lie in one plane, within a millionth of the mesh's extent, and for ever."""
    if mesh.deformed is not None:
        return False
    centred = mesh.vertices - mesh.vertices.mean(axis=0)
    values = np.linalg.svd(centred, compute_uv=False) if len(centred) >= 3 else np.zeros(3)
    return bool(values[-1] <= PLANAR_TOLERANCE * max(values[0], 1e-300))
