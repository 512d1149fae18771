"""Mesh files in the tests: read alone, and compared with the surface that they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from experiments.config.source import from_dict
from experiments.scenes.files import read_triangles
from experiments.scenes.place import Place

CASES = Path(__file__).parent / "cases"


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    return read_triangles(path.name, Place(from_dict({}), path.parent))


def written(folder: Path, name: str, data: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def solid(triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(*triangles, process=False)


def corners(triangles) -> np.ndarray:
    """Triangles (F, 3, 3), each turned to begin with its least corner, in order: equal for equal oriented surfaces."""
    vertices, faces = triangles
    found = np.round(np.asarray(vertices)[faces], 3) + 0.0
    turned = [min((face[[0, 1, 2]], face[[1, 2, 0]], face[[2, 0, 1]]), key=lambda f: f.tolist()) for face in found]
    return np.array(sorted(turned, key=lambda face: face.tolist()))


def assert_same(a, b) -> None:
    np.testing.assert_allclose(corners(a), corners(b), atol=2e-3)


def coverage(triangles, points: np.ndarray) -> np.ndarray:
    """How many triangles hold each point (N, 2) of the plane z = 0; points on edges belong to neither side."""
    vertices, faces = triangles
    flat = np.asarray(vertices)[faces][:, :, :2]
    count = np.zeros(len(points), int)
    for a, b, c in flat:
        sides = [
            np.cross(np.append(q - p, 0.0), np.c_[points - p, np.zeros(len(points))])[:, 2]
            for p, q in ((a, b), (b, c), (c, a))
        ]
        count += np.all(np.array(sides) > 0.0, axis=0) | np.all(np.array(sides) < 0.0, axis=0)
    return count
