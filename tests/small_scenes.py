"""Small scenes built by hand, and brute-force twins that more than one test file compares with. No files are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    PolygonLight,
    RectangleLight,
    SphereLight,
)
from wkernels.scene.model import Camera, Mesh, Scene

Triangles = tuple[np.ndarray, np.ndarray]


# ---- shapes: (vertices float64 (V, 3), faces int32 (F, 3)), counter-clockwise from outside ------------------------------


def plane(size: float, y: float = 0.0, centre: tuple[float, float] = (0.0, 0.0), cells: int = 1) -> Triangles:
    """A square in XZ with normal +Y."""
    line = np.linspace(-0.5 * size, 0.5 * size, cells + 1)
    x, z = np.meshgrid(line + centre[0], line + centre[1])
    return np.stack([x, np.full_like(x, y), z], axis=-1).reshape(-1, 3), grid_faces(cells, cells)


def grid_faces(columns: int, rows: int) -> np.ndarray:
    """Faces of a grid of (rows + 1) x (columns + 1) vertices, normal +Y for x along columns and z along rows."""
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    below = corner + columns + 1
    faces = np.concatenate([np.hstack([corner, below, corner + 1]), np.hstack([corner + 1, below, below + 1])])
    return faces.astype(np.int32)


def convex(points: np.ndarray) -> Triangles:
    """The hull of points as a closed triangle mesh."""
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces.astype(np.int32)


def box(centre: tuple[float, float, float], size: tuple[float, float, float]) -> Triangles:
    """A closed axis-aligned box of 12 triangles."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return convex(np.array(centre) + corners * np.array(size))


def sphere(centre: tuple[float, float, float], radius: float, points: int = 80) -> Triangles:
    """A closed, roughly even sphere: the hull of a spiral of points."""
    k = np.arange(points) + 0.5
    z, angle = 1.0 - 2.0 * k / points, np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    return convex(np.array(centre) + radius * np.stack([ring * np.cos(angle), z, ring * np.sin(angle)], axis=1))


def terrain(size: float, cells: int, height: float, seed: int = 3) -> Triangles:
    """A bumpy square."""
    vertices, faces = plane(size, cells=cells)
    vertices[:, 1] += height * np.random.default_rng(seed).random(len(vertices))
    return vertices, faces


def random_boxes(count: int, seed: int) -> Triangles:
    """Turned boxes between y = 0.5 and y = 4 over the square [-3, 3]^2."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(count):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        corners, _ = box((0.0, 0.0, 0.0), tuple(rng.uniform(0.2, 1.2, 3)))
        parts.append(convex(rng.uniform((-3.0, 0.5, -3.0), (3.0, 4.0, 3.0)) + corners @ axes.T))
    starts = np.cumsum([0] + [len(v) for v, _ in parts])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [f + start for (_, f), start in zip(parts, starts[:-1], strict=True)]
    )


def mesh(name: str, shape: Triangles, **attributes: object) -> Mesh:
    """A named mesh; ``attributes`` as in ``wkernels.scene.model.Mesh``."""
    return Mesh(name, shape[0], shape[1], **attributes)  # type: ignore[arg-type]


# ---- lights, cameras, scenes ----------------------------------------------------------------------------------------


def light(kind: str, centre: tuple[float, float, float] = (0.0, 10.0, 0.0), size: float = 1.5) -> Light:
    """A light of any kind above the scene, about ``size`` wide."""
    middle, half = np.array(centre), 0.5 * size
    u, v = np.array([size, 0.0, 0.0]), np.array([0.0, 0.0, size])
    kinds: dict[str, Callable[[], Light]] = {
        "point": lambda: PointLight(position=middle),
        "directional": lambda: DirectionalLight(direction=-middle, angle_deg=np.degrees(size / np.linalg.norm(middle))),
        "rectangle": lambda: RectangleLight(center=middle, edge_u=u, edge_v=v),
        "disc": lambda: DiscLight(center=middle, normal=np.array([0.0, -1.0, 0.0]), radius=half),
        "sphere": lambda: SphereLight(center=middle, radius=half),
        "linear": lambda: LinearLight(a=middle - 0.5 * u, b=middle + 0.5 * u),
        "polygon": lambda: PolygonLight(
            vertices=middle + half * np.array([(np.cos(t), 0.0, np.sin(t)) for t in 2.0 * np.pi * np.arange(5) / 5.0])
        ),
    }
    return kinds[kind]()


def camera(
    eye: tuple[float, float, float] = (0.0, 6.0, 8.0),
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    fov_deg: float = 50.0,
    near: float = 0.1,
    far: float = 100.0,
) -> Camera:
    """A camera that looks down at the middle of the scene."""
    return Camera(np.array(eye), np.array(target), np.array([0.0, 1.0, 0.0]), fov_deg, near, far)


def sideways(pixels: float, rows: int) -> Callable[[int], Camera]:
    """A path sideways by so many pixels a frame, seen at the target in an image of ``rows``; at frame 20 in the middle."""
    pixel = 2.0 * 10.0 * np.tan(np.radians(25.0)) / rows

    def path(frame: int) -> Camera:
        x = pixel * pixels * (frame - 20)
        return camera((x, 6.0, 8.0), (x, 0.0, 0.0))

    return path


def circling(degrees: float) -> Callable[[int], Camera]:
    """A path round the middle of the scene by so many degrees a frame."""

    def path(frame: int) -> Camera:
        angle = np.radians(degrees) * frame
        return camera((8.0 * np.sin(angle), 6.0, 8.0 * np.cos(angle)))

    return path


def scene(
    meshes: tuple[Mesh, ...] | list[Mesh], lamp: Light, view: Camera | Callable[[int], Camera] | None = None
) -> Scene:
    """A scene with one light; the camera stands still unless it is a function of the frame."""
    view = view or camera()
    path = view if callable(view) else lambda frame: view
    return Scene("test", tuple(meshes), (lamp,), path)


def box_on_ground(lamp: Light, view: Camera | Callable[[int], Camera] | None = None) -> Scene:
    """A closed box that floats over a planar receiver: a scene that no technique may refuse."""
    return scene(
        [
            mesh("ground", plane(12.0), casts=False),
            mesh("box", box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6)), receives=False),
        ],
        lamp,
        view,
    )


def cluttered(lamp: Light, view: Camera | None = None) -> Scene:
    """Bumpy ground, turned boxes and a sphere, all of which cast and receive."""
    return scene(
        [
            mesh("terrain", terrain(12.0, 12, 0.6)),
            mesh("boxes", random_boxes(6, seed=4)),
            mesh("sphere", sphere((1.5, 1.6, 1.0), 0.8)),
        ],
        lamp,
        view,
    )


def moved(still: Scene, mesh: int, offset: Callable[[int], float]) -> Scene:
    """The scene with one mesh that moves along x, ``offset`` of the frame."""

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = offset(frame)
        return out

    meshes = list(still.meshes)
    meshes[mesh] = replace(meshes[mesh], object_to_ws=pose, moving=True)
    return replace(still, meshes=tuple(meshes))


def corners_of(shapes: list[Triangles]) -> np.ndarray:
    """The corners of every triangle, float64 (F, 3, 3)."""
    return np.concatenate([vertices[faces] for vertices, faces in shapes])


# ---- brute force ----------------------------------------------------------------------------------------------------


def ray_hits(origin: np.ndarray, along: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays meet triangles, each with each, in float64.

    Args:
        origin: (R, 3).
        along: (R, 3), any length: the parameter counts in it.
        corners: (T, 3, 3).

    Returns:
        Ray parameter (R, T), +inf where the ray misses or runs parallel; and how far inside the triangle the hit is, as
        the least barycentric coordinate (R, T), negative outside.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = (np.einsum("ti,ti->t", normal, a) - origin @ normal.T) / (along @ normal.T)
        weights = []
        for towards in (np.cross(c - a, normal), np.cross(normal, b - a)):  # gradients of the barycentric coordinates
            towards /= np.einsum("ti,ti->t", normal, normal)[:, None]
            weights.append(origin @ towards.T - np.einsum("ti,ti->t", towards, a) + t * (along @ towards.T))
        least = np.minimum(np.minimum(*weights), 1.0 - weights[0] - weights[1])
    miss = ~np.isfinite(t) | ~np.isfinite(least)
    least = np.where(miss, -np.inf, least)
    return np.where(least >= 0.0, t, np.inf), least
