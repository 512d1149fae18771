"""Detailed objects above one another over a floor, so that penumbrae overlap: about 70 000 triangles.

After schwaerzler2009, Figs 3.4 and 5.1.

A knot hangs over a grille, an openwork ball, a large ring and a studded ball; figures and pillars stand below.
Everything but the floor is closed. The floor is y = 0, 24 x 24; an area light belongs at about y = 9.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._shapes import (
    beams,
    boxes,
    cage,
    lathe,
    merge,
    moved,
    rotation,
    sampling_of,
    torus,
    torus_knot_tube,
)
from experiments.scenes.primitives import Triangles, grid, sphere
from wkernels.scene.model import Mesh

_FIGURE = (
    (0.42, 0.0), (0.44, 0.06), (0.40, 0.14), (0.27, 0.20), (0.20, 0.34), (0.15, 0.58), (0.13, 0.80), (0.26, 0.86),
    (0.27, 0.91), (0.14, 0.95), (0.20, 1.02), (0.27, 1.14), (0.28, 1.24), (0.23, 1.36), (0.13, 1.44), (0.02, 1.47),
)  # fmt: skip
_PILLAR = (
    (0.42, 0.0), (0.42, 0.18), (0.34, 0.22), (0.36, 0.28), (0.27, 0.36), (0.26, 1.2), (0.24, 2.1), (0.22, 2.9),
    (0.30, 2.96), (0.30, 3.02), (0.40, 3.12), (0.42, 3.3),
)  # fmt: skip


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=40_000, le=2_000_000)] = 70_000,
    figures: Annotated[int, Field(ge=0, le=9)] = 6,
) -> list[Mesh]:
    """Builds the scene.

    Args:
        seed: Of the studs of the ball and the turn of the figures' ring.
        triangles: Target of the total, met by how finely the knot is divided.
        figures: Number of standing figures.
    """
    rng = np.random.default_rng(seed)
    parts = {
        "floor": (grid((24.0, 24.0), 16), (0.74, 0.72, 0.68)),
        "grille": (_grille(), (0.24, 0.34, 0.48)),
        "ball_cage": (moved(cage(1.05, 2, 0.075), (-1.75, 2.55, 0.35)), (0.72, 0.30, 0.22)),
        "ring": (_ring(), (0.30, 0.52, 0.36)),
        "studded_ball": (_studded_ball(rng), (0.50, 0.36, 0.58)),
        "pillars": (_pillars(), (0.80, 0.77, 0.70)),
        **({"figures": (_figures(rng, figures), (0.86, 0.82, 0.74))} if figures else {}),
    }
    left = triangles - sum(len(part[1]) for part, _ in parts.values())
    parts["knot"] = (_knot(max(3_000, left)), (0.80, 0.58, 0.24))
    return [Mesh(name, *part, diffuse=colour) for name, (part, colour) in parts.items()]


def _knot(triangles: int) -> Triangles:
    vertices, faces = torus_knot_tube(0.95, 0.42, 0.17, 2, 5, *sampling_of(triangles, 24.0))
    return vertices @ rotation(20.0, 0.0, 14.0) + np.array([0.25, 4.35, 0.15]), faces


def _grille() -> Triangles:
    """A frame with bars both ways."""
    s = np.linspace(-1.15, 1.15, 9)
    ends = np.full_like(s, 1.25)
    zero = np.zeros_like(s)
    across = beams(np.stack([-ends, zero, s], axis=1), np.stack([ends, zero, s], axis=1), 0.07)
    along = beams(np.stack([s, zero + 0.06, -ends], axis=1), np.stack([s, zero + 0.06, ends], axis=1), 0.07)
    frame = boxes(
        np.array([[0.0, 0.0, -1.3], [0.0, 0.0, 1.3], [-1.3, 0.0, 0.0], [1.3, 0.0, 0.0]]),
        np.array([[2.76, 0.2, 0.16], [2.76, 0.2, 0.16], [0.16, 0.2, 2.44], [0.16, 0.2, 2.44]]),
    )
    vertices, faces = merge([across, along, frame])
    return vertices @ rotation(8.0, 25.0, -6.0) + np.array([1.55, 3.1, -0.5]), faces


def _ring() -> Triangles:
    vertices, faces = torus(1.75, 0.15, 112, 24)
    return vertices @ rotation(14.0, 0.0, 9.0) + np.array([0.1, 1.75, 0.2]), faces


def _studded_ball(rng: np.random.Generator) -> Triangles:
    vertices, faces = sphere(1.0, 5)
    studs = rng.normal(size=(42, 3))
    studs /= np.linalg.norm(studs, axis=1, keepdims=True)
    nearest = np.max(vertices @ studs.T, axis=1)
    swell = 0.16 * np.exp(-((1.0 - nearest) / 0.012))
    return 0.6 * vertices * (1.0 + swell)[:, None] + np.array([1.3, 1.35, 1.55]), faces


def _pillars() -> Triangles:
    pillar = lathe(_PILLAR, 40)
    return merge([moved(pillar, (3.3 * sx, 0.0, 3.1 * sz)) for sx in (-1, 1) for sz in (-1, 1)])


def _figures(rng: np.random.Generator, count: int) -> Triangles:
    figure = lathe(_FIGURE, 48)
    turn = 2.0 * np.pi * np.arange(count) / count + rng.uniform(0.0, 0.4)
    return merge([moved(figure, (1.9 * np.sin(a), 0.0, 1.7 * np.cos(a))) for a in turn])
