"""A hedge of leaf cards: a textured twig on each of thousands of quads, which alpha cuts out.

The hedge is 4 x 1.6 x 1 m and stands on y = 0; cards hang in it at random, a few reach out of it. A closed core of
stems stands inside. Units are metres.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from experiments.scenes.primitives import grid_faces
from wkernels.scene.cutouts import Mask
from wkernels.scene.model import Mesh

_LENGTH, _HEIGHT, _DEPTH = 4.0, 1.6, 1.0
_TEXELS = 128
_STEM_SIDES = 6


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=500, le=2_000_000)] = 6000,
    card: Annotated[float, Field(gt=0, le=1)] = 0.22,
) -> list[Mesh]:
    """Builds the hedge.

    Args:
        seed: Of everything random.
        triangles: Target of the total; two a card.
        card: Side of a card.
    """
    rng = np.random.default_rng(seed)
    stems = _stems(rng, max(4, triangles // 400))
    count = (triangles - len(stems.faces)) // 2
    half = 0.5 * np.array([_LENGTH, _HEIGHT, _DEPTH])
    # towards the outside, where a hedge has its leaves
    middle = np.sign(rng.uniform(-1.0, 1.0, (count, 3))) * (1.0 - rng.uniform(0.0, 1.0, (count, 3)) ** 2)
    middle = middle * half + np.array([0.0, half[1] + 0.05, 0.0])
    corner = np.array([[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [-0.5, 0.0, 0.5], [0.5, 0.0, 0.5]])
    turn = Rotation.random(count, rng=rng).as_matrix()
    size = card * rng.uniform(0.7, 1.3, count)
    vertices = (middle[:, None] + size[:, None, None] * np.einsum("nij,kj->nki", turn, corner)).reshape(-1, 3)
    vertices[:, 1] = np.maximum(vertices[:, 1], 0.01)  # none of them reaches into the ground
    faces = (grid_faces(1, 1)[None] + 4 * np.arange(count)[:, None, None]).reshape(-1, 3).astype(np.int32)
    mask = Mask(np.tile(corner[:, [0, 2]] + 0.5, (count, 1)), twig(_TEXELS), 0.5, ("clamp", "clamp"))
    return [Mesh("leaves", vertices, faces, diffuse=(0.16, 0.36, 0.12), mask=mask), stems]


def twig(texels: int) -> np.ndarray:
    """Alpha of a twig with seven leaves, float32 (texels, texels), soft over two texels at outlines."""
    at = (np.arange(texels) + 0.5) / texels
    u, v = np.meshgrid(at, at)
    inside = 0.012 - np.abs(u - 0.5) - 10.0 * np.maximum(np.maximum(0.02 - v, v - 0.8), 0.0)
    leaves = [(0.5, 0.84, 0.0)] + [
        (0.5 + side * 0.22, 0.2 + 0.22 * i + 0.05 * side, side * 1.05) for i in range(3) for side in (-1.0, 1.0)
    ]
    for x, y, turn in leaves:
        along = np.sin(turn) * (u - x) + np.cos(turn) * (v - y)
        across = np.cos(turn) * (u - x) - np.sin(turn) * (v - y)
        reach = np.clip(1.0 - (along / 0.16) ** 2, 0.0, None)
        serration = 0.006 * np.sin(70.0 * np.pi * along)
        inside = np.maximum(inside, 0.085 * reach**0.8 + np.where(reach > 0.0, serration, -1.0) - np.abs(across))
    return np.clip(0.5 + 0.5 * inside * texels, 0.0, 1.0).astype(np.float32)


def _stems(rng: np.random.Generator, count: int) -> Mesh:
    """Upright closed prisms along the middle of the hedge."""
    foot = np.stack([rng.uniform(-0.48, 0.48, count) * _LENGTH, rng.uniform(-0.15, 0.15, count) * _DEPTH], axis=1)
    top = foot + rng.uniform(-0.15, 0.15, (count, 2))
    angle = 2.0 * np.pi * np.arange(_STEM_SIDES) / _STEM_SIDES
    ring = 0.015 * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    low = np.insert(foot[:, None] + ring, 1, 0.0, axis=2)
    high = np.insert(top[:, None] + 0.5 * ring, 1, rng.uniform(0.8, 1.4, (count, 1)), axis=2)
    vertices = np.concatenate([low, high], axis=1).reshape(-1, 3)
    here = np.arange(_STEM_SIDES)
    after = np.roll(here, -1)
    sides = np.concatenate([np.stack([here, after, after + _STEM_SIDES], 1)])
    sides = np.concatenate([sides, np.stack([here, after + _STEM_SIDES, here + _STEM_SIDES], 1)])
    fan = np.stack([np.zeros(_STEM_SIDES - 2, int), here[1:-1], here[2:]], axis=1)
    one = np.concatenate([sides, fan[:, ::-1], fan + _STEM_SIDES])
    faces = (one[None] + 2 * _STEM_SIDES * np.arange(count)[:, None, None]).reshape(-1, 3)
    return Mesh("stems", vertices, faces.astype(np.int32), diffuse=(0.3, 0.22, 0.15))
