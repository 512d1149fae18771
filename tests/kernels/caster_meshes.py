"""Meshes that the tests of edges, silhouettes and volumes share: whole ones, and all kinds of broken ones."""

from __future__ import annotations

import numpy as np
import small_scenes
import trimesh
import warp as wp

from wkernels.casters.edges import Adjacency, find_edges
from wkernels.casters.silhouettes import Silhouettes, counted_turns, facing_of, find_silhouettes
from wkernels.workspace.workspace import Workspace

Mesh = tuple[np.ndarray, np.ndarray]


def torus() -> Mesh:
    shape = trimesh.creation.torus(1.0, 0.4, 13, 9)
    return np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int32)


def apart(mesh: Mesh) -> Mesh:
    """The same triangles, each with vertices of its own."""
    vertices, faces = mesh
    return vertices[faces].reshape(-1, 3), np.arange(faces.size, dtype=np.int32).reshape(-1, 3)


def fan(blades: int) -> Mesh:
    """Triangles that share the edge from vertex 0 to vertex 1, none beside another."""
    angle = 2.0 * np.pi * np.arange(blades) / blades + 0.1
    tips = np.stack([np.cos(angle), np.full(blades, 0.5), np.sin(angle)], axis=1)
    vertices = np.concatenate([[(0.0, 0.0, 0.0), (0.0, 1.0, 0.0)], tips])
    return vertices, np.array([(0, 1, k + 2) for k in range(blades)], np.int32)


def soup(seed: int) -> Mesh:
    """Triangles between few places: doubled, flipped, without area, with edges of one to many faces."""
    rng = np.random.default_rng(seed)
    places = rng.integers(0, 3, (9, 3)).astype(float)  # some coincide
    return places, rng.integers(0, len(places), (int(rng.integers(1, 40)), 3)).astype(np.int32)


def whole() -> dict[str, Mesh]:
    """Closed, consistently oriented meshes."""
    return {
        "cube": small_scenes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),
        "cube of loose triangles": apart(small_scenes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))),
        "sphere": small_scenes.sphere((0.3, 0.0, 0.0), 1.0),
        "torus": torus(),
    }


def broken() -> dict[str, Mesh]:
    """Meshes that are not."""
    vertices, faces = small_scenes.sphere((0.0, 0.0, 0.0), 1.0)
    out = {
        "grid": small_scenes.plane(2.0, cells=4),
        "fan of three": fan(3),
        "fan of five": fan(5),
        "doubled": (vertices, np.concatenate([faces, faces[:7]])),
        "doubled and flipped": (vertices, np.concatenate([faces, faces[:7, ::-1]])),
        "flipped": (vertices, np.concatenate([faces[:5, ::-1], faces[5:]])),
        "inside out": (vertices, faces[:, ::-1]),
        "without area": (vertices, np.concatenate([faces, [(0, 0, 1), (2, 3, 2)]])),
        "not finite": (np.concatenate([vertices, [(np.nan, 0, 0)]]), np.concatenate([faces, [(0, 1, len(vertices))]])),
        "two that touch at a corner": touching(),
        "empty": (np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
    }
    return out | {f"soup {seed}": soup(seed) for seed in range(12)}


def touching() -> Mesh:
    """Two tetrahedra with one corner in common, above each other."""
    corners = np.array([(0, 0, 0), (1, 1, 0.1), (-1, 1, 0.2), (0.1, 1, 1.0)], float)
    up, faces = small_scenes.convex(corners)
    down, other = small_scenes.convex(corners * (1.0, -1.0, 1.0))
    return np.concatenate([up, down]), np.concatenate([faces, other + len(up)])


def all_meshes() -> dict[str, Mesh]:
    return whole() | broken()


def facing(vertices: np.ndarray, faces: np.ndarray, light: tuple[float, ...], device: str = "cpu") -> np.ndarray:
    points = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=device)
    indices = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device)
    return facing_of(Workspace(device, 2), points, indices, np.array(light))


def silhouettes(
    vertices: np.ndarray, faces: np.ndarray, light: tuple[float, ...], closed: str = "lit"
) -> tuple[Adjacency, Silhouettes]:
    adjacency = find_edges(vertices.astype(np.float32), faces)
    turns = counted_turns(adjacency, facing(vertices, faces, light), closed)  # type: ignore[arg-type]
    return adjacency, find_silhouettes(adjacency, turns)
