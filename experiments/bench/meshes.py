"""Spheres on a terrain: the mesh of the bench's passes, with a camera in it and a sun above it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.scenes.primitives import Triangles, grid, sphere
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Mesh, Scene

HALF_SIDE = 425.0  # of the terrain, scene units


@dataclass(frozen=True)
class Mix:
    """How many triangles, and how small they are.

    Attributes:
        spheres: Number of icospheres.
        subdivisions: Each has 20 * 4^subdivisions triangles.
        cells: The terrain has 2 * cells^2.
        radii: Least and largest radius [scene units].
    """

    spheres: int
    subdivisions: int
    cells: int
    radii: tuple[float, float] = (2.0, 12.0)


def spheres_on_terrain(mix: Mix, seed: int = 0) -> Triangles:
    """Spheres strewn over a wavy terrain of 850 x 850 scene units.

    Returns:
        Vertices float64 (V, 3) and faces int32 (F, 3), counter-clockwise seen from outside and from above.
    """
    rng = np.random.default_rng(seed)
    ground, ground_faces = grid((2.0 * HALF_SIDE, 2.0 * HALF_SIDE), mix.cells)
    ground[:, 1] = 2.0 * np.sin(0.05 * ground[:, 0]) * np.cos(0.04 * ground[:, 2])
    ball, ball_faces = sphere(1.0, mix.subdivisions)
    radius = rng.uniform(*mix.radii, mix.spheres)
    x, z = rng.uniform(-400.0, 400.0, (2, mix.spheres))
    centre = np.stack([x, radius, z], axis=1)
    balls = (ball * radius[:, None, None] + centre[:, None]).reshape(-1, 3)
    offsets = len(ball) * np.arange(mix.spheres)[:, None, None]
    faces = [(ball_faces + offsets).reshape(-1, 3), ground_faces + len(balls)]
    return np.concatenate([balls, ground]), np.concatenate(faces).astype(np.int32)


def sun(angle_deg: float = 0.0) -> DirectionalLight:
    """Light from above at an angle; ``angle_deg`` is its angular diameter."""
    return DirectionalLight(direction=np.array([0.5, -1.0, 0.3]), angle_deg=angle_deg)


def camera(height: float = 15.0) -> Camera:
    """A camera at the terrain's rim, at such a height, that looks across all of it."""
    eye, target = np.array([0.0, height, 400.0]), np.array([0.0, 15.0, 0.0])
    return Camera(eye=eye, target=target, up=np.array([0.0, 1.0, 0.0]), fov_deg=60.0, near=1.0, far=1000.0)


def sunlit_scene(triangles: Triangles, angle_deg: float, camera_height: float) -> Scene:
    """The mesh as a scene of one sun and one camera."""
    vertices, faces = triangles
    mesh = Mesh("spheres on terrain", vertices, faces)
    return Scene("spheres on terrain", (mesh,), (sun(angle_deg),), lambda frame: camera(camera_height))
