"""The small scene that all stability cases are made of: a body, a ball and a column over a floor, under a lamp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh

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

Point = Sequence[float] | np.ndarray
LIGHT_KINDS = ("rectangle", "disc", "sphere", "polygon", "linear", "directional", "point")
LAMP, LAMP_SIZE = (0.0, 10.0, 0.0), 1.5
EYE, UP = (0.0, 6.0, 8.0), (0.0, 1.0, 0.0)
BODY = (0.5, 2.2, -0.3)


def floor(size: float = 12.0, *, receives: bool = True) -> Mesh:
    """A square in y = 0 that casts nothing."""
    half = 0.5 * size
    corners = np.array([(x, 0.0, z) for z in (-half, half) for x in (-half, half)])
    return Mesh("floor", corners, np.array([[0, 2, 1], [1, 2, 3]], np.int32), casts=False, receives=receives)


def slab(name: str, centre: Point, size: Point) -> Mesh:
    """A closed box that casts and does not receive."""
    box = trimesh.creation.box(extents=size)
    return Mesh(name, np.asarray(centre) + box.vertices, box.faces.astype(np.int32), receives=False)


def ball(name: str, centre: Point, radius: float) -> Mesh:
    """A closed sphere of 80 triangles that casts and does not receive."""
    sphere = trimesh.creation.icosphere(subdivisions=1, radius=radius)
    return Mesh(name, np.asarray(centre) + sphere.vertices, sphere.faces.astype(np.int32), receives=False)


def casters() -> list[Mesh]:
    """A body and a ball clear of the floor, and a column that stands in it, for lights low in the sky."""
    return [
        slab("body", BODY, (3.0, 0.8, 2.2)),
        ball("ball", (-2.0, 1.4, 1.2), 0.9),
        slab("column", (-2.6, 1.49, -2.2), (0.9, 3.0, 0.9)),
    ]


def lamp(kind: str, centre: Point = LAMP, size: float = LAMP_SIZE) -> Light:
    """A light about ``size`` wide at ``centre``; for directions as wide as that looks from the origin."""
    middle = np.asarray(centre, dtype=float)
    distance = float(np.linalg.norm(middle))
    down = -middle / distance
    right = np.cross(down, (0.0, 0.0, 1.0) if abs(down[2]) < 0.9 else (1.0, 0.0, 0.0))
    u = size * right / np.linalg.norm(right)
    v = np.cross(u, down)
    ring = 2.0 * np.pi * np.arange(5) / 5.0
    if kind == "point":
        return PointLight(position=middle)
    if kind == "directional":
        return DirectionalLight(direction=down, angle_deg=float(np.degrees(2.0 * np.arctan(0.5 * size / distance))))
    if kind == "rectangle":
        return RectangleLight(center=middle, edge_u=u, edge_v=v)
    if kind == "disc":
        return DiscLight(center=middle, normal=down, radius=0.5 * size)
    if kind == "sphere":
        return SphereLight(center=middle, radius=0.5 * size)
    if kind == "linear":
        return LinearLight(a=middle - 0.5 * u, b=middle + 0.5 * u)
    corners = middle + 0.5 * (np.cos(ring)[:, None] * u + np.sin(ring)[:, None] * v)
    return PolygonLight(vertices=corners)


def look(eye: Point = EYE, target: Point = (0.0, 0.0, 0.0), near: float = 0.1, far: float = 100.0) -> Camera:
    """A camera of 50 degrees."""
    return Camera(np.asarray(eye, float), np.asarray(target, float), np.array(UP), 50.0, near, far)


def scene_of(meshes: Sequence[Mesh], light: Light, camera: Camera | None = None) -> Scene:
    """A still scene."""
    view = camera or look()
    return Scene("stability", tuple(meshes), (light,), lambda frame: view)


def scaled_scene(scene: Scene, factor: float, kind: str, offset: Point = (0.0, 0.0, 0.0)) -> Scene:
    """Everything ``factor`` times as large and moved by ``offset``, the default lamp included."""
    shift = np.asarray(offset, float)
    view = scene.camera(0)
    moved = replace(
        view,
        eye=view.eye * factor + shift,
        target=view.target * factor + shift,
        near=view.near * factor,
        far=view.far * factor,
    )
    meshes = tuple(replace(mesh, vertices=mesh.vertices * factor + shift) for mesh in scene.meshes)
    if kind == "directional":
        light = scene.lights[0]
    else:
        light = lamp(kind, np.asarray(LAMP) * factor, LAMP_SIZE * factor).moved(shift)
    return replace(scene, meshes=meshes, lights=(light,), camera=lambda frame: moved)
