"""Eyes, lights and small scenes that the tests of projections share."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import small_scenes

from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from wkernels.frame.session import Session
from wkernels.scene.geometry import Bounds, Geometry
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Mesh
from wkernels.scene.views import HostView

WARPS: dict[str, dict[str, Any]] = {
    "none": {},
    "psm": {},
    "lispsm_nopt": {},
    "lispsm_nrepar": {},
    "arbitrary": {"warp_distance": 0.3},
}
FOV = np.radians(60.0)
TEXELS = 512


def eye_at(
    position: tuple[float, ...], forward: tuple[float, ...] = (0, 0, 1), near: float = 1.0, far: float = 40.0
) -> HostView:
    ahead = np.array(forward, float) / np.linalg.norm(forward)
    guide = np.array([0.0, 1.0, 0.0]) if abs(ahead[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(ahead, guide)
    right /= np.linalg.norm(right)
    tangent = float(np.tan(0.5 * FOV))
    window = (-tangent, tangent, -tangent, tangent)
    return HostView(np.array(position, float), right, np.cross(right, ahead), ahead, window, near, far, TEXELS, TEXELS)


def bounds(low: tuple[float, ...], high: tuple[float, ...]) -> Bounds:
    out = Bounds()
    out.add(np.array([low, high], float))
    return out


def towards(gamma_deg: float) -> np.ndarray:
    """A directional sample whose light comes from above and makes that angle with the view direction +Z."""
    gamma = np.radians(gamma_deg)
    return np.array([0.0, np.sin(gamma), -np.cos(gamma), 0.0])


def project(view: HostView, points: np.ndarray) -> np.ndarray:
    h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
    return np.column_stack([h[:, :2] / h[:, 3:], h[:, 2:]])


SCENE = bounds((-60.0, -5.0, -60.0), (60.0, 30.0, 60.0))
EYES = {
    "inside": eye_at((0, 2, -20)),
    "outside": eye_at((0, 10, -80), far=400.0),
    "looking down": eye_at((0, 25, 0), (0.1, -1, 0.2)),
    "turned": eye_at((5, 3, 5), (1, -0.2, -0.6)),
}
LIGHTS = {
    "overhead": np.array([0.0, 1.0, 0.0, 0.0]),
    "slanted": np.array([0.4, 0.8, -0.3, 0.0]) / np.linalg.norm([0.4, 0.8, -0.3]),
    "point": np.array([10.0, 200.0, -30.0, 1.0]),
}

# The closed forms speak of the frustum alone: a scene that holds all of it, and a map whose margin is taken off.
ALL = bounds((-300.0, -300.0, -300.0), (300.0, 300.0, 300.0))
MARGIN = (TEXELS - 2.0) / TEXELS


def posts(offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Mesh]:
    shift = np.array(offset)
    ground, faces = small_scenes.plane(160.0)
    meshes = [Mesh("ground", ground + shift, faces)]
    for i, (x, z) in enumerate(itertools.product((-5.0, -2.5, 0.0, 2.5), (-73.0, -70.0, -62.0, -45.0, 30.0))):
        vertices, faces = small_scenes.box((x + 0.1 * i, 1.0, z), (0.4, 2.0, 0.4))
        meshes.append(Mesh(f"post {i}", vertices + shift, faces))
    return meshes


def hard_error(
    projection: dict[str, Any], device: str, lamp: Any, offset=(0.0, 0.0, 0.0), technique="shadow_map"
) -> float:
    """Share of receiver pixels in the lower half of the picture, near the eye, that differ from the ray cast."""
    eye = np.array([0.0, 3.0, -76.0]) + offset
    camera = Camera(eye, eye + np.array([0.0, -0.35, 1.0]), np.array([0.0, 1.0, 0.0]), 60.0, 0.5, 400.0)
    geometry = Geometry(small_scenes.scene(posts(offset), lamp, camera), device)
    table = load_all()
    pictures = []
    for name in ("ray_cast_point_shadow", technique):
        params = {"resolution": 256} if name == technique else {}
        session = Session(geometry, width=160, height=120, device=device, projection=compose(projection))
        pictures.append(session.render(table[name](table[name].Params(**params))).visibility[60:])
    seen = np.isfinite(pictures[0])
    return float((np.abs(pictures[0] - pictures[1])[seen] > 0.5).mean())


SUN = DirectionalLight(direction=np.array([0.6, -1.0, 0.3]))
FINER = {
    "psm": {"fit": "focused", "warp": "psm"},
    "n_opt": {"fit": "focused", "warp": "lispsm_nopt"},
    "n_repar": {"fit": "focused", "warp": "lispsm_nrepar"},
    "pssm4": {"fit": "focused", "splits": 4},
    "pssm4 best": {"fit": "focused", "splits": 4, "selection": "best"},
    "log4 n_opt": {"fit": "focused", "splits": 4, "scheme": "log", "warp": "lispsm_nopt"},
    "auto near n_opt": {"fit": "focused", "warp": "lispsm_nopt", "near": "auto"},
    "faces n_opt": {"fit": "focused", "warp": "lispsm_nopt", "partition": "faces"},
    "tight log4 n_opt": {"fit": "focused", "splits": 4, "scheme": "log", "warp": "lispsm_nopt", "depth": "tight"},
    "exact": {"fit": "focused", "splits": 4, "scheme": "log", "stabilise": "exact"},
    "approximate": {"fit": "focused", "splits": 4, "scheme": "log", "stabilise": "approximate"},
}
