"""The stiff cases X1 to X13 (docs/glossary.md), each with levels of rising stiffness; the first is the easy one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from experiments.kinds.stability.shapes import BODY, EYE, LAMP, casters, floor, lamp, look, scaled_scene, scene_of, slab
from wkernels.scene.model import Mesh, Scene

Level = float | str
HISTORY_FRAMES = 6
"""Frames that techniques with a history are given."""
WARPED: Mapping[str, Any] = {"fit": "focused", "warp": "lispsm_nopt", "splits": 2, "scheme": "log"}
"""Where depth ranges and directions matter, light maps are warped and split: a uniform map would not notice."""


@dataclass(frozen=True, eq=False)
class Setting:
    """One level of a case.

    Attributes:
        scene: What is rendered.
        params: Parameters that a technique is given where it has them.
        projection: Of light maps.
        size: Picture, pixels.
        walks: Whether the last of ``HISTORY_FRAMES`` frames is judged, after those before it, and not the first.
    """

    scene: Scene
    params: Mapping[str, Any] = field(default_factory=dict)
    projection: Mapping[str, Any] | None = None
    size: tuple[int, int] = (64, 48)
    walks: bool = False


@dataclass(frozen=True)
class Case:
    """One kind of stiffness.

    Attributes:
        name: Key in files.
        title: What grows, for people.
        source: X number of the case.
        levels: The easy one first.
        build: Level and light kind -> setting.
        needs: Parameter without which a technique is not concerned; None: all are.
        judged: Whether the error counts besides finite values in range: not where every method must lose the shadow.
    """

    name: str
    title: str
    source: str
    levels: tuple[Level, ...]
    build: Callable[[Any, str], Setting]
    needs: str | None = None
    judged: bool = True


CASES: dict[str, Case] = {}


def _case(
    title: str, source: str, levels: tuple[Level, ...], *, needs: str | None = None, judged: bool = True
) -> Callable[[Callable[[Any, str], Setting]], Callable[[Any, str], Setting]]:
    def register(build: Callable[[Any, str], Setting]) -> Callable[[Any, str], Setting]:
        CASES[build.__name__] = Case(build.__name__, title, source, levels, build, needs, judged)
        return build

    return register


def _plain(kind: str) -> Scene:
    return scene_of([floor(), *casters()], lamp(kind))


@_case("far / near of the eye", "X1", (1e1, 1e2, 1e4, 1e6, 1e8))
def depth_range(ratio: float, kind: str) -> Setting:
    """The scene lies between 4 and 18; near and far move away from it on either side."""
    near = 3.0 / np.sqrt(0.1 * ratio)
    return Setting(replace(_plain(kind), camera=lambda frame: look(near=near, far=near * ratio)), projection=WARPED)


@_case("angle between light and view, from behind the eye [degrees]", "X2", (10.0, 1.0, 0.1, 1e-3, 0.0))
def light_behind_eye(angle: float, kind: str) -> Setting:
    """Duelling frusta, gamma to 0."""
    return _duel(angle, kind, -1.0)


@_case("angle between light and view, towards the eye [degrees]", "X2", (10.0, 1.0, 0.1, 1e-3, 0.0))
def light_before_eye(angle: float, kind: str) -> Setting:
    """Duelling frusta, gamma to 180."""
    return _duel(angle, kind, 1.0)


def _duel(angle: float, kind: str, side: float) -> Setting:
    eye = np.array((0.0, 1.5, 8.0) if side > 0.0 else EYE)
    view = np.array((0.0, 0.12, -1.0)) if side > 0.0 else -eye
    view = view / np.linalg.norm(view)
    turned = np.radians(angle)
    up = np.cross(np.cross(view, (0.0, 1.0, 0.0)), view)
    up /= np.linalg.norm(up)
    way = side * (np.cos(turned) * view + side * np.sin(turned) * up)
    light = lamp(kind, 40.0 * way, 6.0)
    return Setting(scene_of([floor(), *casters()], light, look(eye, eye + view)), projection=WARPED)


@_case("place of the light", "X3", ("above", "inside a caster", "on the receiver", "behind the receiver"))
def light_place(place: str, kind: str) -> Setting:
    """The light, 0.2 wide, where no map can look from. Directions have no place: they turn instead."""
    centres = {"above": LAMP, "inside a caster": BODY, "on the receiver": (3.0, 0.0, 2.0)}
    return Setting(replace(_plain(kind), lights=(lamp(kind, centres.get(place, (0.3, -5.0, 0.2)), 0.2),)))


@_case("place of the eye", "X4", ("clear", "in shadow", "near plane cuts a caster", "inside a caster"))
def eye_place(place: str, kind: str) -> Setting:
    """What volumes and caps must survive."""
    views = {
        "clear": look(),
        "in shadow": look((0.5, 1.0, -0.3), (-3.0, 0.0, 4.0)),
        "near plane cuts a caster": look((0.5, 5.0, 0.7), (-2.0, 0.0, -0.3), near=2.5),
        "inside a caster": look(BODY, (-2.0, 0.0, 3.0), near=2.0),
    }
    return Setting(replace(_plain(kind), camera=lambda frame: views[place]))


@_case("the light shrinks: size", "X5", (1.5, 1e-2, 1e-4, 1e-8))
def light_shrinks(size: float, kind: str) -> Setting:
    """In the limit the hard shadow."""
    return Setting(replace(_plain(kind), lights=(lamp(kind, LAMP, size),)))


@_case("the light grows: size at a distance of 10", "X5", (1.5, 4.0, 10.0, 40.0))
def light_grows(size: float, kind: str) -> Setting:
    """Up to four times its distance."""
    return Setting(replace(_plain(kind), lights=(lamp(kind, LAMP, size),)))


@_case(
    "damaged meshes",
    "X6",
    ("clean", "duplicate faces", "zero area", "open", "non-manifold", "NaN vertex", "infinite vertex"),
)
def mesh_damage(damage: str, kind: str) -> Setting:
    """Faces that no modeller should deliver, in the body; its shadow must not change but for an open side."""
    ground, body, *rest = floor(), *casters()
    vertices, faces = body.vertices.copy(), body.faces.copy()
    if damage == "duplicate faces":
        faces = np.concatenate([faces, faces[:6]])
    elif damage == "zero area":
        flat = np.array([[0, 0, 0], [0, 1, 1], [2, 3, 2]], np.int32)
        faces = np.concatenate([flat, faces])
    elif damage == "open":
        faces = faces[2:]
    elif damage == "non-manifold":
        vertices = np.concatenate([vertices, vertices[:1] + np.array((0.4, 0.4, 0.0))])
        faces = np.concatenate([faces, [[0, int(faces[0, 1]), 8], [0, int(faces[1, 2]), 8]]])
    elif damage in ("NaN vertex", "infinite vertex"):
        value = np.nan if damage == "NaN vertex" else np.inf
        vertices = np.concatenate([vertices, [[value, 1.0, 0.0]]])
        faces = np.concatenate([faces, [[0, 1, 8]]])
    damaged = replace(body, vertices=vertices, faces=faces.astype(np.int32))
    return Setting(scene_of([ground, damaged, *rest], lamp(kind)))


@_case("N.L on the receiver", "X7", (1.0, 1e-1, 1e-2, 1e-4, 1e-6))
def grazing(cosine: float, kind: str) -> Setting:
    """The sun sinks to the horizon; at the end the light is small, far away, and half below it."""
    way = np.array((-np.sqrt(1.0 - cosine**2), cosine, 0.0))
    return Setting(replace(_plain(kind), lights=(lamp(kind, 40.0 * way, min(1.5, 40.0 * cosine)),)))


@_case("world offset", "X8", (0.0, 1e2, 1e4, 1e6, 1e7))
def world_offset(offset: float, kind: str) -> Setting:
    """The whole scene elsewhere; positions are rebased in float64."""
    return Setting(scaled_scene(_plain(kind), 1.0, kind, (offset, -offset, offset)))


@_case("length of the scene's unit", "X8", (1.0, 1e-3, 1e-6, 1e3, 1e6))
def unit_length(factor: float, kind: str) -> Setting:
    """The whole scene larger or smaller, near and far with it."""
    return Setting(scaled_scene(_plain(kind), factor, kind))


@_case("few samples", "X9", (64.0, 2.0, 1.0), needs="samples", judged=False)
def few_samples(count: float, kind: str) -> Setting:
    """One sample is a hard shadow; the error must grow, but nothing else may happen."""
    return Setting(_plain(kind), {"samples": int(count)})


@_case("many samples", "X9", (64.0, 1e3, 1e4, 1e5), needs="samples")
def many_samples(count: float, kind: str) -> Setting:
    """Sums of 1e5 tests in float32, at a size that a person waits for."""
    return Setting(_plain(kind), {"samples": int(count), "resolution": 64}, size=(24, 18))


@_case("empty scenes", "X10", ("full", "no casters", "no receivers", "nothing", "all behind the eye"))
def emptiness(what: str, kind: str) -> Setting:
    """Nothing to cast, to receive, or to be seen."""
    full = _plain(kind)
    if what == "all behind the eye":
        return Setting(replace(full, camera=lambda frame: look(EYE, 2.0 * np.asarray(EYE))), projection=WARPED)
    kept: dict[str, list[Mesh]] = {
        "full": list(full.meshes),
        "no casters": [floor()],
        "no receivers": [floor(receives=False), *casters()],
        "nothing": [],
    }
    return Setting(replace(full, meshes=tuple(kept[what])), projection=WARPED)


@_case("coarse maps: texels per side", "X11", (512.0, 64.0, 8.0, 2.0, 1.0), needs="resolution", judged=False)
def coarse_map(resolution: float, kind: str) -> Setting:
    """One texel knows nothing of edges, and filters are larger than the map."""
    return Setting(_plain(kind), {"resolution": int(resolution)})


@_case("fine maps: texels per side", "X11", (512.0, 2048.0, 8192.0), needs="resolution")
def fine_map(resolution: float, kind: str) -> Setting:
    """Texels much smaller than pixels."""
    return Setting(_plain(kind), {"resolution": int(resolution)})


@_case("gap between blocker and receiver", "X12", (0.5, 1e-2, 1e-4, 1e-6, 0.0))
def contact_receiver(gap: float, kind: str) -> Setting:
    """The body sinks onto the floor: z_r - z_b to 0."""
    body = slab("body", (0.5, 0.5 + gap, -0.3), (2.0, 1.0, 1.6))
    return Setting(scene_of([floor(), body, *casters()[1:]], lamp(kind, (3.0, 10.0, 2.0))))


@_case("distance of a blocker from the light", "X12", (2.0, 1e-1, 1e-2, 1e-4, 1e-6))
def contact_light(distance: float, kind: str) -> Setting:
    """A plate that hides half of the light from below rises to it: z_b to 0. For directions it rises just as well."""
    plate = slab("plate", (5.0, LAMP[1] - distance - 1e-3, 0.0), (10.0, 2e-3, 10.0))
    return Setting(scene_of([floor(), plate, *casters()[1:]], lamp(kind)))


@_case("distance of one more object; 0: none", "X13", (0.0, 1e3, 1e6, 1e9, 1e12))
def far_object(distance: float, kind: str) -> Setting:
    """A box so far away that nothing is seen of it: whatever is relative to the scene's size would grow with it."""
    full = _plain(kind)
    if distance == 0.0:
        return Setting(full)
    box = replace(slab("far", distance * np.array((0.9, 0.1, -0.4)), (1.0, 1.0, 1.0)), receives=True)
    return Setting(replace(full, meshes=(*full.meshes, box)))


@_case("extent of the ground, the eye at its middle", "X13", (12.0, 1e3, 1e4, 1e5, 1e6))
def ground_extent(size: float, kind: str) -> Setting:
    """A ground that goes on far beyond what is seen."""
    return Setting(scene_of([floor(size), *casters()], lamp(kind)), projection=WARPED)


@_case("extent of the ground, the eye at its corner", "X13", (12.0, 1e3, 1e4, 1e5, 1e6))
def ground_corner(size: float, kind: str) -> Setting:
    """The same where the middle of the scene is far away."""
    ground = floor(size)
    ground = replace(ground, vertices=ground.vertices + 0.5 * (size - 12.0) * np.array((1.0, 0.0, -1.0)))
    return Setting(scene_of([ground, *casters()], lamp(kind)), projection=WARPED)


@_case("how far a caster goes away", "X13", (20.0, 1e3, 1e6, 1e12))
def mover_leaves(distance: float, kind: str) -> Setting:
    """It stands before the eye at frame 0 and leaves; the others' shadows stay."""

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = distance * min(frame / (HISTORY_FRAMES - 1.0), 1.0) ** 3
        return out

    plate = replace(slab("mover", (2.4, 1.6, 1.4), (1.4, 0.2, 1.4)), object_to_ws=pose, moving=True)
    full = _plain(kind)
    return Setting(replace(full, meshes=(*full.meshes, plate)), walks=True)


@_case("length of the meshes' unit, undone by their poses", "X13", (1.0, 1e-6, 1e-3, 1e3, 1e6, 1e9))
def mesh_units(factor: float, kind: str) -> Setting:
    """The same scene from vertices in other units."""
    back = np.diag([1.0 / factor] * 3 + [1.0])
    full = _plain(kind)
    meshes = [replace(mesh, vertices=mesh.vertices * factor, object_to_ws=lambda frame: back) for mesh in full.meshes]
    return Setting(replace(full, meshes=tuple(meshes)))
