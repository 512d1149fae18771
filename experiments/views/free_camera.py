"""Where the free camera of the third-person views stands."""

from __future__ import annotations

import numpy as np

from experiments.schema.models import ThirdPerson
from wkernels.scene.model import Camera
from wkernels.scene.views import HostView

AZIMUTH_DEG, ELEVATION_DEG = 60.0, 35.0
ROOM = 1.06  # so that nothing of what the eye sees touches the picture's rim


def free_camera(
    settings: ThirdPerson, eye: HostView, up: np.ndarray, points: np.ndarray, reach: float, aspect: float
) -> Camera:
    """The third-person camera, in the space of its arguments.

    Args:
        settings: What the experiment says.
        eye: The eye's view.
        up: The scene's vertical axis, any length.
        points: What should be in the picture (n, 3): the corners of what the eye sees; the eye itself is added.
        reach: How far the scene extends from any point in it, scene units; bounds the depth range.
        aspect: Width over height of the picture.
    """
    points = np.concatenate([np.asarray(points, float).reshape(-1, 3), eye.eye_ws[None]])
    vertical = np.asarray(up if settings.up is None else settings.up, float)
    vertical = vertical / np.linalg.norm(vertical)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    target = middle if settings.target is None else np.asarray(settings.target, float)
    if settings.eye is not None:
        position = np.asarray(settings.eye, float)
    else:
        towards = _direction(settings, eye, vertical)
        distance = _fitting_distance(points - target, towards, vertical, settings.fov_deg, aspect)
        position = target + towards * distance * (1.0 if settings.distance is None else settings.distance)
    if np.linalg.norm(target - position) < 1e-9 * max(reach, 1e-9):
        target = position + eye.forward_ws
    size = max(float(np.linalg.norm(position - middle)), 1e-6)
    return Camera(position, target, vertical, settings.fov_deg, 1e-3 * size, 1.01 * (size + reach))


def _direction(settings: ThirdPerson, eye: HostView, vertical: np.ndarray) -> np.ndarray:
    """From what is looked at to the camera, unit."""
    azimuth = np.radians(AZIMUTH_DEG if settings.azimuth_deg is None else settings.azimuth_deg)
    elevation = np.radians(ELEVATION_DEG if settings.elevation_deg is None else settings.elevation_deg)
    ahead = eye.forward_ws - (eye.forward_ws @ vertical) * vertical
    if np.linalg.norm(ahead) < 1e-6:  # the eye looks straight up or down
        ahead = eye.up_ws - (eye.up_ws @ vertical) * vertical
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, vertical)
    level = -np.cos(azimuth) * ahead + np.sin(azimuth) * right
    out: np.ndarray = np.cos(elevation) * level + np.sin(elevation) * vertical
    return out


def _fitting_distance(
    offsets: np.ndarray, towards: np.ndarray, vertical: np.ndarray, fov_deg: float, aspect: float
) -> float:
    """How far along ``towards`` a camera must stand to see all ``offsets`` (n, 3) from its target."""
    forward = -towards
    right = np.cross(forward, vertical)
    right /= np.linalg.norm(right)
    above = np.cross(right, forward)
    tangent = np.tan(np.radians(fov_deg) / 2.0)
    depth = offsets @ forward
    needed = np.maximum(np.abs(offsets @ right) / (tangent * aspect), np.abs(offsets @ above) / tangent) - depth
    return ROOM * max(float(needed.max()), 1e-3 * max(1.0, float(np.abs(offsets).max())))
