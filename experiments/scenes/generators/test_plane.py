"""A long plane with posts in rows, seen along its length: 2044 triangles (the test plane of stingl2011).

Texels stretch and splits change along the view, so aliasing shows where it is expected. The plane is y = 0, 30 x 96,
and runs from z = 0 towards -z; posts stand in rows over all of it.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._shapes import boxes
from experiments.scenes.primitives import grid
from wkernels.scene.model import Mesh

_WIDTH, _LENGTH = 30.0, 96.0


def generate(
    *, seed: Annotated[int, Field(ge=0)] = 1, triangles: Annotated[int, Field(ge=500, le=200_000)] = 2_044
) -> list[Mesh]:
    """Builds the plane and its posts.

    Args:
        seed: Of the heights of the posts.
        triangles: Target of the total: 4 for the plane, 12 per post.
    """
    rng = np.random.default_rng(seed)
    plane_vertices, plane_faces = grid((_WIDTH, _LENGTH), (1, 2))
    count = (triangles - len(plane_faces)) // 12
    columns = max(2, round(np.sqrt(count * _WIDTH / _LENGTH)))
    row, column = np.divmod(np.arange(count), columns)
    rows = int(row[-1]) + 1
    x = ((column + 0.5) / columns - 0.5) * (_WIDTH - 2.0) + np.where(row % 2 == 0, 0.35, -0.35)
    z = -1.5 - (row + 0.5) / rows * (_LENGTH - 3.0)
    height = rng.uniform(0.6, 2.4, count)
    centre = np.stack([x, 0.5 * height, z], axis=1)
    thick = np.minimum(0.5, 0.4 * _WIDTH / columns)
    posts = boxes(centre, np.stack([np.full(count, thick), height, np.full(count, thick)], axis=1), 0.3)
    return [
        Mesh("plane", plane_vertices + np.array([0.0, 0.0, -0.5 * _LENGTH]), plane_faces, diffuse=(0.72, 0.72, 0.70)),
        Mesh("posts", *posts, diffuse=(0.62, 0.40, 0.26)),
    ]
