"""A city quarter with one tall lattice tower: 850 x 800 x 330 m, about 255 000 triangles (after stingl2011).

Flat ground, a river with a bridge, a park along the tower's axis, and courtyard blocks of mansard houses on a street
grid that is bent a little. Everything but ground, water and window panes is closed. Units are metres.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._paris_houses import PARK, WALLS, blocks, bodies, build_houses, details
from experiments.scenes.generators._paris_tower import FOOTPRINT, tower
from experiments.scenes.generators._shapes import boxes, copies, lofts, merge
from experiments.scenes.primitives import Triangles, grid, sphere
from wkernels.scene.model import Mesh

_SIZE = (850.0, 800.0)
_RIVER = (-300.0, -215.0)  # z
_TOWER_Z = -105.0


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=100_000, le=600_000)] = 255_000,
    house_width: Annotated[float, Field(ge=8.0, le=40.0)] = 15.0,
) -> list[Mesh]:
    """Builds the quarter.

    Args:
        seed: Of everything random: heights, colours, details, trees.
        triangles: Target of the total, met by the number of details.
        house_width: Mean length of a facade in metres.
    """
    rng = np.random.default_rng(seed)
    detail = float(np.clip(np.sqrt(triangles / 255_000), 0.6, 1.5))
    houses = build_houses(rng, house_width / detail)
    solid = bodies(houses)
    ground = _ground()
    trees, trunks = _trees(rng, detail)
    tower_vertices, tower_faces = tower(detail)
    fixed = {
        "ground": (ground, (0.42, 0.41, 0.40)),
        "river": (_slab_grid(_RIVER), (0.20, 0.30, 0.34)),
        "pavements": (_bent(_pavements()), (0.52, 0.51, 0.49)),
        "park": (_lawns(), (0.24, 0.38, 0.13)),
        "quays": (_quays(), (0.60, 0.57, 0.50)),
        "tower": ((tower_vertices + np.array([0.0, 0.0, _TOWER_Z]), tower_faces), (0.36, 0.25, 0.17)),
        "trees": (trees, (0.20, 0.33, 0.11)),
        "trunks": (trunks, (0.25, 0.18, 0.12)),
        "roofs": (_bent(solid["roofs"]), (0.33, 0.37, 0.42)),
        **{f"houses_{i}": (_bent(solid[f"houses_{i}"]), WALLS[i]) for i in range(len(WALLS))},
    }
    left = max(0, triangles - sum(len(part[1]) for part, _ in fixed.values()))
    fittings = {name: (_bent(part), colour) for name, (part, colour) in details(rng, houses, left).items()}
    # Panes lie a finger in front of their wall: they are colour, not geometry, and cast nothing that the wall does not.
    return [
        Mesh(name, part[0], part[1], diffuse=colour, casts=name != "windows")
        for name, (part, colour) in {**fixed, **fittings}.items()
        if len(part[1])
    ]


def _bent(part: Triangles) -> Triangles:
    """Bends the street grid; the quarter's border, the park and the river stay where they are."""
    vertices, faces = part
    if not len(vertices):
        return part
    x, z = vertices[:, 0], vertices[:, 2]
    inland = np.clip((z - _RIVER[1] - 15.0) / 120.0, 0.0, 1.0) * np.clip((400.0 - z) / 120.0, 0.0, 1.0)
    aside = np.clip((np.abs(x) - PARK) / 90.0, 0.0, 1.0) * np.clip((425.0 - np.abs(x)) / 90.0, 0.0, 1.0)
    weight = inland * inland * (3.0 - 2.0 * inland) * aside * aside * (3.0 - 2.0 * aside)
    bent = vertices.copy()
    bent[:, 0] += weight * 16.0 * np.sin(z / 95.0)
    bent[:, 2] += weight * 15.0 * np.sin(x / 75.0 + 0.6)
    return bent, faces


def _slab_grid(z: tuple[float, float]) -> Triangles:
    """Flat ground over the whole width between two z."""
    vertices, faces = grid((_SIZE[0], z[1] - z[0]), (17, max(2, round((z[1] - z[0]) / 50.0))))
    return vertices + np.array([0.0, 0.0, 0.5 * (z[0] + z[1])]), faces


def _ground() -> Triangles:
    half = 0.5 * _SIZE[1]
    return merge([_slab_grid((-half, _RIVER[0])), _slab_grid((_RIVER[1], half))])


def _pavements() -> Triangles:
    """A kerb under every block, 15 cm high, cut fine enough to follow the bent streets."""
    rings = []
    for x0, x1, z0, z1 in blocks():
        t = np.linspace(0.0, 1.0, 5)[:-1]
        x0, x1, z0, z1 = x0 - 2.2, x1 + 2.2, z0 - 2.2, z1 + 2.2
        x = np.concatenate([x0 + t * (x1 - x0), np.full(4, x1), x1 + t * (x0 - x1), np.full(4, x0)])
        z = np.concatenate([np.full(4, z1), z1 + t * (z0 - z1), np.full(4, z0), z0 + t * (z1 - z0)])
        rings.append(np.stack([np.stack([x, np.full(16, y), z], axis=1) for y in (0.0, 0.15)]))
    return lofts(np.array(rings))


def _lawns() -> Triangles:
    z = np.linspace(-20.0, 385.0, 6)
    middle = 0.5 * (z[1:] + z[:-1])
    size = np.stack([np.full(5, 66.0), np.full(5, 0.12), np.diff(z) - 12.0], axis=1)
    return boxes(np.stack([np.zeros(5), np.full(5, 0.06), middle], axis=1), size)


def _quays() -> Triangles:
    """Parapets along the river and a bridge on the tower's axis."""
    banks = np.array([[s * 219.25, 0.55, z] for s in (-1, 1) for z in (_RIVER[0] - 0.5, _RIVER[1] + 0.5)])
    walls = boxes(banks, np.array([[411.5, 1.1, 0.8]]))
    middle, span = 0.5 * sum(_RIVER), _RIVER[1] - _RIVER[0]
    bridge = boxes(np.array([[0.0, 1.6, middle]]), np.array([[26.0, 0.8, span + 10.0]]))
    rails = boxes(np.array([[s * 12.6, 2.55, middle] for s in (-1, 1)]), np.array([[0.5, 1.1, span + 10.0]]))
    piers = boxes(
        np.array([[0.0, 0.6, middle + k * span / 5.0] for k in (-2, -1, 0, 1, 2)]), np.array([[24.0, 1.2, 3.0]])
    )
    lamp_z = np.linspace(_RIVER[0], _RIVER[1], 9)
    posts = boxes(np.array([[s * 12.6, 5.0, z] for s in (-1, 1) for z in lamp_z]), np.array([[0.2, 4.0, 0.2]]))
    lamps = boxes(np.array([[s * 12.6, 7.2, z] for s in (-1, 1) for z in lamp_z]), np.array([[0.6, 0.7, 0.6]]))
    return merge([walls, bridge, rails, piers, posts, lamps])


def _trees(rng: np.random.Generator, detail: float) -> tuple[Triangles, Triangles]:
    """Avenues in the park and along the river: crowns and trunks."""
    step = 10.5 / detail
    avenue = [
        (s * x, z) for s in (-1, 1) for x in (43.0, 53.0, 63.0) for z in np.arange(0.5 * FOOTPRINT - 70.0, 392.0, step)
    ]
    quay = [(x, z) for x in np.arange(-410.0, 411.0, 14.0 / detail) for z in (-306.0, -208.0) if abs(x) > 22.0]
    xz = np.array(avenue + quay) + rng.uniform(-0.6, 0.6, (len(avenue) + len(quay), 2))
    n = len(xz)
    height, radius = rng.uniform(3.2, 4.4, n), rng.uniform(2.6, 3.7, n)
    ball = sphere(1.0, 1)
    swell = rng.uniform(0.8, 1.15, (n, len(ball[0]), 1)) * radius[:, None, None] * np.array([1.0, 1.25, 1.0])
    top = np.stack([xz[:, 0], height + 1.05 * radius, xz[:, 1]], axis=1)
    crowns = copies(ball[1], ball[0] * swell + top[:, None])
    angle = 2.0 * np.pi * np.arange(5) / 5
    section = 0.28 * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    rings = np.empty((n, 2, 5, 3))
    rings[..., 0] = (xz[:, 0, None] + section[:, 0])[:, None]
    rings[..., 2] = (xz[:, 1, None] + section[:, 1])[:, None]
    rings[:, 0, :, 1], rings[:, 1, :, 1] = 0.0, (height + 0.4)[:, None]
    return crowns, lofts(rings)
