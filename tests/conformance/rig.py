"""What every check works with: a registry, small parameters, scenes that any technique accepts, one way to render."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import small_scenes
from sessions import open_session, render_frames, true_visibility

from algorithms.technique import Technique
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    PolygonLight,
    RectangleLight,
    SphereLight,
)
from wkernels.scene.model import Camera, Mesh, Scene

SIZE = (64, 48)
SMALL = {"resolution": 256, "samples": 16}  # shared parameter names that cost time
KINDS = ("rectangle", "disc", "sphere", "polygon", "linear", "directional", "point")


@dataclass(frozen=True)
class Check:
    """One thing that must hold for every technique it applies to."""

    name: str
    run: Callable[[type[Technique], str], None]
    applies: Callable[[type[Technique]], bool]


CHECKS: dict[str, Check] = {}


def check(
    applies: Callable[[type[Technique]], bool] = lambda technique: True,
) -> Callable[[Callable[[type[Technique], str], None]], Callable[[type[Technique], str], None]]:
    """Registers a function of (technique, device) that raises AssertionError where the technique does not conform."""

    def register(run: Callable[[type[Technique], str], None]) -> Callable[[type[Technique], str], None]:
        assert run.__name__ not in CHECKS
        CHECKS[run.__name__] = Check(run.__name__, run, applies)
        return run

    return register


def run_check(check: Check, technique: type[Technique], device: str) -> str | None:
    """Runs a check; why it failed if the technique expects that failure, None if it passed.

    Raises:
        Exception: What the check raised, unless the technique expects an assertion with such a text.
        AssertionError: A failure was expected that did not come.
    """
    expected = next((failure for failure in technique.expected_failures if failure.check == check.name), None)
    try:
        check.run(technique, device)
    except AssertionError as error:
        if expected is None or not re.search(expected.message, str(error)):
            raise
        return expected.because
    assert expected is None, f"'{check.name}' passes now: take it out of expected_failures"
    return None


def has_history(technique: type[Technique]) -> bool:
    """Whether results depend on earlier frames."""
    return technique.needs.history


def has_no_history(technique: type[Technique]) -> bool:
    """Whether results depend on this frame alone."""
    return not technique.needs.history


def takes_any_mesh(technique: type[Technique]) -> bool:
    """Whether open casters that also receive, on bumpy ground, are fine."""
    return not technique.needs.closed_meshes and not technique.needs.planar_receiver


# ---- parameters and rendering ---------------------------------------------------------------------------------------


def small_params(technique: type[Technique], **wanted: Any) -> Any:
    """Parameters that render fast: the shared names reduced, ``wanted`` on top where the technique has them."""
    fields = technique.Params.model_fields
    values = {name: min(value, fields[name].default) for name, value in SMALL.items() if name in fields}
    return technique.Params(**{**values, **{name: value for name, value in wanted.items() if name in fields}})


def small_session(scene: Scene, device: str, *, size: tuple[int, int] = SIZE, **options: Any) -> Session:
    """A fresh session on fresh geometry."""
    return open_session(scene, device, size=size, **options)


def render(
    technique: type[Technique], scene: Scene, device: str, *, params: Any = None, frames: int = 1, **session: Any
) -> FrameResult:
    """The last of ``frames`` frames in a fresh session, small parameters unless given."""
    made = technique(params if params is not None else small_params(technique))
    return render_frames(small_session(scene, device, **session), made, frames)[-1]


# ---- lights ---------------------------------------------------------------------------------------------------------


def kinds_of(technique: type[Technique]) -> list[str]:
    """Light kinds that a technique is defined for."""
    return [kind for kind in KINDS if kind in technique.needs.lights and not (technique.needs.area and kind == "point")]


def lamp(technique: type[Technique], **attributes: Any) -> Light:
    """A light that a technique accepts, with an area where it may have one."""
    return small_scenes.light(kinds_of(technique)[0], **attributes)


def scaled(light: Light, factor: float) -> Light:
    """The same light, shrunk towards its centre."""
    middle = light.centre[:3]
    if isinstance(light, PointLight):
        return light
    if isinstance(light, DirectionalLight):
        return replace(light, angle_deg=light.angle_deg * factor)
    if isinstance(light, RectangleLight):
        return replace(light, edge_u=light.edge_u * factor, edge_v=light.edge_v * factor)
    if isinstance(light, DiscLight | SphereLight):
        return replace(light, radius=light.radius * factor)
    if isinstance(light, LinearLight):
        return replace(light, a=middle + factor * (light.a - middle), b=middle + factor * (light.b - middle))
    assert isinstance(light, PolygonLight)
    return replace(light, vertices=middle + factor * (light.vertices - middle))


def turned(light: Light, rotation: np.ndarray, offset: np.ndarray) -> Light:
    """The same light after a rigid move of the world."""

    def point(p: np.ndarray) -> np.ndarray:
        return rotation @ p + offset

    if isinstance(light, PointLight):
        return replace(light, position=point(light.position))
    if isinstance(light, DirectionalLight):
        return replace(light, direction=rotation @ light.direction)
    if isinstance(light, RectangleLight):
        edges = {"edge_u": rotation @ light.edge_u, "edge_v": rotation @ light.edge_v}
        return replace(light, center=point(light.center), **edges)
    if isinstance(light, DiscLight):
        return replace(light, center=point(light.center), normal=rotation @ light.normal)
    if isinstance(light, SphereLight):
        return replace(light, center=point(light.center))
    if isinstance(light, LinearLight):
        return replace(light, a=point(light.a), b=point(light.b))
    assert isinstance(light, PolygonLight)
    return replace(light, vertices=light.vertices @ rotation.T + offset)


# ---- scenes ---------------------------------------------------------------------------------------------------------


def scenes_for(technique: type[Technique]) -> list[Scene]:
    """A plain scene that every technique accepts, and one full of everything where it may be."""
    light = lamp(technique)
    plain = [small_scenes.box_on_ground(light)]
    return [*plain, small_scenes.cluttered(light)] if takes_any_mesh(technique) else plain


def moved_world(scene: Scene, rotation: np.ndarray, offset: np.ndarray) -> Scene:
    """Everything in a scene (meshes, lights, camera) after one rigid move."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, offset

    def moved_mesh(mesh: Mesh) -> Mesh:
        before = mesh.object_to_ws
        return replace(mesh, object_to_ws=lambda frame: pose @ before(frame))

    def camera(frame: int) -> Camera:
        view = scene.camera(frame)
        eye, target = rotation @ view.eye + offset, rotation @ view.target + offset
        return replace(view, eye=eye, target=target, up=rotation @ view.up)

    lights = tuple(turned(light, rotation, offset) for light in scene.lights)
    return replace(scene, meshes=tuple(moved_mesh(mesh) for mesh in scene.meshes), lights=lights, camera=camera)


def overlapping_boxes(light: Light) -> Scene:
    """Two closed boxes, one partly over the other, over a planar receiver: penumbrae that meet at different depths."""
    return small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False),
            small_scenes.mesh("lower", small_scenes.box((0.8, 1.5, 0.2), (2.0, 0.6, 1.8)), receives=False),
            small_scenes.mesh("upper", small_scenes.box((-0.6, 4.0, -0.2), (1.8, 0.5, 1.6)), receives=False),
        ],
        light,
    )


def a_piece_apart(light: Light) -> Scene:
    """One caster of two boxes, the second small and far from the first."""
    first, second = (small_scenes.box(*box) for box in (((0.0, 1.0, 0.0), (1.5,) * 3), ((4.0, 0.5, 3.0), (0.3,) * 3)))
    both = np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1] + len(first[0])])
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)
    return small_scenes.scene([ground, small_scenes.mesh("pair", both, receives=False)], light)


def behind_two_casters(light: Light) -> Scene:
    """Slats high over a wide plate, and an eye below it: the ground is in the umbra of the one and of both.

    A statistic of depths that takes the slats' edges for a penumbra lets light through.
    """

    def plate(name: str, y: float, width: float, depth: float, x: float = 0.0) -> Mesh:
        return small_scenes.mesh(name, small_scenes.box((x, y, 0.0), (width, 0.1, depth)), receives=False)

    slats = [plate(f"slat {i}", 5.0, 0.4, 8.0, 0.8 * i - 3.6) for i in range(10)]
    return small_scenes.scene(
        [small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False), plate("plate", 1.2, 14.0, 14.0), *slats],
        light,
        small_scenes.camera((0.0, 0.8, 6.0)),
    )


def truth(
    technique: type[Technique],
    build: Callable[[Light], Scene],
    device: str,
    kind: str,
    centre: tuple[float, float, float] = (0.0, 10.0, 0.0),
    size: float = 1.5,
) -> np.ndarray:
    """What a technique should show: hard shadows of the light's centre for hard ones, soft ones for all others."""
    scene = build(small_scenes.light(kind, centre, size))
    return true_visibility(scene, device, size=SIZE, centre=is_hard(technique))


def is_hard(technique: type[Technique]) -> bool:
    """Whether the technique reduces lights to their centre."""
    return technique.family == "hard" or technique.hard
