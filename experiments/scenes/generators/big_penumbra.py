"""Casters from the floor up to near a large light: penumbrae grow from nothing at the contacts to very wide ones.

A comb of posts, a lattice arch and a ball on a thin stand; floor and back wall receive. The floor is y = 0, 20 x 20,
the wall stands at z = -6.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from experiments.scenes.generators._shapes import beams, boxes, lathe, merge, polyline_beams, sampling_of, tube
from experiments.scenes.primitives import Triangles, grid
from wkernels.scene.model import Mesh


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=6_000, le=1_000_000)] = 20_000,
    posts: Annotated[int, Field(ge=2, le=60)] = 13,
) -> list[Mesh]:
    """Builds the scene.

    Args:
        seed: Of the heights of the posts.
        triangles: Target of the total, met by how finely the rings around the stand are divided.
        posts: Number of posts in the comb.
    """
    rng = np.random.default_rng(seed)
    wall_vertices, wall_faces = grid((20.0, 9.0), 4)
    upright = np.stack([wall_vertices[:, 0], 4.5 - wall_vertices[:, 2], np.full(len(wall_vertices), -6.0)], axis=1)
    parts = {
        "floor": (grid((20.0, 20.0), 8), (0.74, 0.72, 0.68)),
        "wall": ((upright, wall_faces), (0.70, 0.70, 0.72)),
        "posts": (_posts(rng, posts), (0.42, 0.30, 0.20)),
        "arch": (_arch(), (0.28, 0.36, 0.44)),
    }
    left = triangles - sum(len(part[1]) for part, _ in parts.values())
    parts["stand"] = (_stand(left), (0.74, 0.44, 0.26))
    return [Mesh(name, *part, diffuse=colour) for name, (part, colour) in parts.items()]


def _posts(rng: np.random.Generator, count: int) -> Triangles:
    x = np.linspace(-4.5, 4.5, count)
    height = 0.4 + 4.6 * np.abs(np.sin(1.3 * np.linspace(0.3, 2.9, count))) * rng.uniform(0.75, 1.0, count)
    centre = np.stack([x, 0.5 * height, np.full(count, 1.6)], axis=1)
    size = np.stack([np.full(count, 0.22), height, np.full(count, 0.22)], axis=1)
    return boxes(centre, size, 0.4)


def _arch() -> Triangles:
    angle = np.linspace(0.0, np.pi, 37)
    inner = np.stack([3.0 * np.cos(angle), 3.6 * np.sin(angle), np.full(37, -1.6)], axis=1)
    outer = np.stack([3.5 * np.cos(angle), 4.1 * np.sin(angle), np.full(37, -1.6)], axis=1)
    depth = np.array([0.0, 0.0, 0.7])
    chords = [polyline_beams(curve + shift, 0.09) for curve in (inner, outer) for shift in (0.0 * depth, -depth)]
    braces = [
        beams(inner[:-1], outer[1:], 0.055),
        beams(inner - depth, outer, 0.055),
        beams(inner[1:], outer[:-1] - depth, 0.055),
    ]
    vertices, faces = merge(chords + braces)
    vertices[:, 1] = np.maximum(vertices[:, 1], 0.0)
    return vertices, faces


def _stand(triangles: int) -> Triangles:
    """A ball on a thin stand with tilted rings around it."""
    latitude = np.linspace(-0.48 * np.pi, 0.5 * np.pi - 0.02, 22)
    ball = np.stack([0.75 * np.cos(latitude), 3.6 + 0.75 * np.sin(latitude)], axis=1)
    stem = np.array([[0.7, 0.0], [0.7, 0.08], [0.1, 0.2], [0.06, 1.0], [0.05, 2.84]])
    parts = [lathe(np.concatenate([stem, ball]), 36)]
    segments, sides = sampling_of((triangles - len(parts[0][1])) // 3)
    turn = 2.0 * np.pi * np.arange(segments) / segments
    for tilt, radius in ((0.5, 1.15), (-0.35, 1.4), (1.15, 1.65)):
        out = np.stack([np.sin(turn), np.cos(turn) * np.sin(tilt), np.cos(turn) * np.cos(tilt)], axis=1)
        parts.append(tube(radius * out + np.array([0.0, 3.6, 0.0]), out, 0.05, sides))
    vertices, faces = merge(parts)
    return vertices + np.array([0.6, 0.0, 0.2]), faces
