"""The primitives of scene files as triangle meshes, centred on the origin.

Every function returns ``(vertices, faces)``: float64 (V, 3) in scene units and int32 (F, 3), counter-clockwise seen
from outside. Flat ones lie in XZ with normal +Y.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh

from experiments.scenes import schema

Triangles = tuple[np.ndarray, np.ndarray]

DISC_SEGMENTS = 256  # the polygon's inradius is 0.9999 of the radius: far below the error of any map
CYLINDER_SEGMENTS = 64


def box(size: tuple[float, float, float]) -> Triangles:
    """A closed box, 12 triangles; ``size`` along x, y, z."""
    return _arrays(trimesh.creation.box(extents=size))


def plane(size: tuple[float, float]) -> Triangles:
    """A rectangle of 2 triangles; ``size`` along x, z."""
    return grid(size, 1)


def grid(size: tuple[float, float], cells: int | tuple[int, int]) -> Triangles:
    """A rectangle of ``cells`` x ``cells`` quads (or as many along x, z as a pair says); ``size`` along x, z."""
    across, along = (cells, cells) if isinstance(cells, int) else cells
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, across + 1) * size[0], np.linspace(-0.5, 0.5, along + 1) * size[1])
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    return vertices, grid_faces(across, along)


def grid_faces(across: int, along: int) -> np.ndarray:
    """Faces (2 * across * along, 3) of a grid whose vertices run along x first, then z; normal +Y."""
    corner = (np.arange(along)[:, None] * (across + 1) + np.arange(across)).ravel()
    below = corner + across + 1
    quads = np.stack([corner, below, below + 1, corner, below + 1, corner + 1], axis=1)
    return quads.reshape(-1, 3).astype(np.int32)


def disc(radius: float) -> Triangles:
    """A fan of ``DISC_SEGMENTS`` triangles, its corners on the circle."""
    angle = 2.0 * np.pi * np.arange(DISC_SEGMENTS) / DISC_SEGMENTS
    rim = radius * np.stack([np.sin(angle), np.zeros(DISC_SEGMENTS), np.cos(angle)], axis=1)
    here = np.arange(1, DISC_SEGMENTS + 1)
    faces = np.stack([np.zeros_like(here), here, np.roll(here, -1)], axis=1)
    return np.concatenate([np.zeros((1, 3)), rim]), faces.astype(np.int32)


def sphere(radius: float, subdivisions: int) -> Triangles:
    """A closed icosphere of 20 * 4^subdivisions triangles, its corners on the sphere."""
    return _arrays(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def cylinder(radius: float, height: float) -> Triangles:
    """A closed cylinder along y with ``CYLINDER_SEGMENTS`` sides."""
    vertices, faces = _arrays(trimesh.creation.cylinder(radius, height, sections=CYLINDER_SEGMENTS))
    return vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), faces  # trimesh's is along z


def _arrays(mesh: trimesh.Trimesh) -> Triangles:
    return np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32)


PRIMITIVES: dict[type[schema.MeshOptions], Callable[..., Triangles]] = {
    schema.Box: box,
    schema.Plane: plane,
    schema.Disc: disc,
    schema.Grid: grid,
    schema.Sphere: sphere,
    schema.Cylinder: cylinder,
}


def triangulate(options: schema.MeshOptions) -> Triangles:
    """The triangles of a primitive's options: each of its own keys is an argument of the function of the same name."""
    own = {
        key: getattr(options, key)
        for key in type(options).model_fields
        if key != "primitive" and key not in schema.FlatOptions.model_fields
    }
    return _shape(PRIMITIVES[type(options)], tuple(own.items()))


@functools.lru_cache(maxsize=64)
def _shape(primitive: Callable[..., Triangles], own: tuple[tuple[str, Any], ...]) -> Triangles:
    """One pair of arrays for all meshes of the same size, not to be written to: scenes repeat their primitives."""
    vertices, faces = primitive(**dict(own))
    vertices.flags.writeable = faces.flags.writeable = False
    return vertices, faces
