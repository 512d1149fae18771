"""Slender screws along the axis of the light, one end near it and one near the floor (schwaerzler2009, 3.2.1).

The near and the far end of such a caster ask for very different penumbrae at the same place. The floor is y = 0, 14 x
14; the light belongs at about (0, 9, 0), and the screws point at it from below.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._shapes import lofts
from experiments.scenes.primitives import Triangles, grid
from wkernels.scene.model import Mesh

_COLOURS = ((0.74, 0.36, 0.24), (0.30, 0.46, 0.62), (0.36, 0.55, 0.34), (0.78, 0.60, 0.28))


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=2_000, le=1_000_000)] = 16_000,
    length: Annotated[float, Field(gt=0, le=8.0)] = 5.5,
) -> list[Mesh]:
    """Builds floor and four screws.

    Args:
        seed: Of the screws' twists.
        triangles: Target of the total.
        length: Of a screw.
    """
    rng = np.random.default_rng(seed)
    floor = grid((14.0, 14.0), 4)
    sides = 20
    rings = max(8, round(((triangles - len(floor[1])) / len(_COLOURS) - 2 * (sides - 2)) / (2 * sides)) + 1)
    meshes = [Mesh("floor", *floor, diffuse=(0.74, 0.72, 0.68))]
    focus = np.array([0.0, 9.0, 0.0])
    feet = np.array([[0.0, 0.15, 0.0], [2.6, 0.15, 0.9], [-2.3, 0.15, 1.3], [-0.4, 0.15, -2.7]])
    for i, (foot, colour) in enumerate(zip(feet, _COLOURS, strict=True)):
        axis = (focus - foot) / np.linalg.norm(focus - foot)
        screw = _screw(foot, axis, length, rings, sides, float(rng.uniform(2.5, 4.5)))
        meshes.append(Mesh(f"screw_{i}", *screw, diffuse=colour))
    return meshes


def _screw(foot: np.ndarray, axis: np.ndarray, length: float, rings: int, sides: int, turns: float) -> Triangles:
    """A twisted star section that tapers towards the light."""
    u = np.cross(axis, np.array([1.0, 0.0, 0.0]))
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    t = np.linspace(0.0, 1.0, rings)[:, None]
    angle = 2.0 * np.pi * (np.arange(sides) / sides + turns * t)
    radius = (0.34 - 0.16 * t) * (1.0 + 0.22 * np.cos(5.0 * 2.0 * np.pi * np.arange(sides) / sides))
    along = foot + length * t[..., None] * axis
    ring = along + radius[..., None] * (np.cos(angle)[..., None] * u + np.sin(angle)[..., None] * v)
    return lofts(ring[None])
