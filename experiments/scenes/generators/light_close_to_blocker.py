"""A blocker for a large light close above it (schwaerzler2009, Fig 3.5).

Different parts of the light see different sides of the blocker and the umbra nearly disappears, which methods with a
single light sample cannot show. The blocker is a goblet-like solid of revolution with a handle on a floor, y = 0, 12
x 12; it ends at y = 2.05.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._shapes import lathe, merge, moved, rotation, sampling_of, torus
from experiments.scenes.primitives import grid
from wkernels.scene.model import Mesh

_PROFILE = (
    (0.62, 0.0), (0.64, 0.05), (0.50, 0.12), (0.20, 0.22), (0.11, 0.40), (0.10, 0.62), (0.18, 0.68), (0.19, 0.76),
    (0.10, 0.82), (0.14, 0.94), (0.42, 1.10), (0.58, 1.30), (0.64, 1.55), (0.63, 1.80), (0.66, 2.00), (0.62, 2.05),
)  # fmt: skip


def generate(
    *, seed: Annotated[int, Field(ge=0)] = 1, triangles: Annotated[int, Field(ge=2_000, le=1_000_000)] = 12_000
) -> list[Mesh]:
    """Builds floor and blocker; both are the same for every seed.

    Args:
        seed: Accepted as by every generator.
        triangles: Target of the total.
    """
    rows = np.array(_PROFILE)
    floor = grid((12.0, 12.0), 4)
    left = triangles - len(floor[1])
    fine = np.linspace(0.0, len(rows) - 1.0, max(16, round(np.sqrt(left / 6.0))))
    profile = np.stack([np.interp(fine, np.arange(len(rows)), rows[:, axis]) for axis in (0, 1)], axis=1)
    segments = max(12, round((0.72 * left + 4.0) / (2.0 * len(profile))))
    goblet = lathe(profile, segments)
    handle_vertices, handle_faces = torus(0.34, 0.065, *sampling_of((left - len(goblet[1])) // 2, 8.0))
    handles = [
        moved((handle_vertices @ rotation(90.0), handle_faces), (side * 0.78, 1.48, 0.0)) for side in (-1.0, 1.0)
    ]
    return [
        Mesh("floor", *floor, diffuse=(0.74, 0.72, 0.68)),
        Mesh("goblet", *merge([goblet, *handles]), diffuse=(0.76, 0.52, 0.26)),
    ]
