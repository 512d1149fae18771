"""Where a light depth map looks: the views that one light sample needs to cover all receivers."""

from __future__ import annotations

import numpy as np

from wkernels.scene.geometry import Bounds
from wkernels.scene.lights import orthonormal_frame
from wkernels.scene.views import HostView

MAX_TANGENT = 3.0  # a wider frustum wastes most texels at its rim; six faces cover the receivers better
FACE_TANGENT = 1.05  # faces overlap, so that filter kernels at an edge of the cube stay inside their face
NEAR_TO_FAR = 1e-6  # depth is linear: a tiny near plane costs no precision


def scene_views(light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int) -> list[HostView]:
    """Views that cover the receivers' boxes from one light sample ("fit: scene").

    Args:
        light_ws: Light sample (4,), ``w = 1`` a point, ``w = 0`` a unit direction towards the light.
        receivers: Boxes to cover; must not be empty.
        casters: Boxes whose nearest side bounds the depth range of directional maps; may be empty.
        resolution: Texels per side.

    Returns:
        One orthographic view for a direction, one perspective view for a point that sees the box within a moderate
        angle, else six faces of a cube.
    """
    if light_ws[3] == 0.0:
        return [_directional_view(light_ws[:3], receivers, casters, resolution)]
    return _point_views(light_ws[:3], receivers, resolution)


def fit_scene(sample: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView) -> list[HostView]:
    """``scene_views`` as a projection: wherever the eye is."""
    return scene_views(sample, receivers, casters, resolution)


def _window(x: np.ndarray, y: np.ndarray, resolution: int) -> tuple[float, float, float, float]:
    """Bounding rectangle with one texel of margin, never empty."""
    middle = 0.5 * np.array([x.min() + x.max(), y.min() + y.max()])
    half = 0.5 * np.array([np.ptp(x), np.ptp(y)])
    half = np.maximum(half, 1e-6 * max(1e-6, float(np.abs(middle).max()), float(half.max())))
    half *= resolution / max(resolution - 2.0, 0.5 * resolution)
    return (middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1])


def _directional_view(towards: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int) -> HostView:
    forward = -towards / np.linalg.norm(towards)
    right, up = orthonormal_frame(-forward)
    corners = receivers.corners
    depths = corners @ forward
    nearest = depths.min() if casters.empty else min(depths.min(), float((casters.corners @ forward).min()))
    span = max(float(depths.max() - nearest), 1e-6)
    eye = forward * (nearest - 0.01 * span)
    return HostView(
        eye_ws=eye,
        right_ws=right,
        up_ws=up,
        forward_ws=forward,
        window=_window(corners @ right, corners @ up, resolution),
        near=0.0,
        far=1.02 * span,
        width=resolution,
        height=resolution,
        perspective=False,
    )


def _point_views(position: np.ndarray, receivers: Bounds, resolution: int) -> list[HostView]:
    offsets = receivers.corners - position
    distances = np.linalg.norm(offsets, axis=1)
    reach = max(float(distances.max()), 1e-6)
    towards = (offsets / np.maximum(distances, 1e-6 * reach)[:, None]).mean(axis=0)
    best: HostView | None = None
    # a floor is covered best by a view straight down on it, a distant object by one towards its middle
    for axis in (towards, *np.eye(3), *-np.eye(3)):
        view = _covering_view(position, axis, offsets, reach, resolution)
        if view is not None and (best is None or _window_area(view) < _window_area(best)):
            best = view
    if best is not None:
        return [best]
    window = (-FACE_TANGENT, FACE_TANGENT, -FACE_TANGENT, FACE_TANGENT)
    directions = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    return [_perspective_view(position, forward, window, reach, resolution) for forward in directions]


def _covering_view(
    position: np.ndarray, axis: np.ndarray, offsets: np.ndarray, reach: float, resolution: int
) -> HostView | None:
    """The view along ``axis`` that holds all offsets, unless they reach behind it or too far to the side."""
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        return None
    forward = axis / length
    depths = offsets @ forward
    if depths.min() <= 1e-3 * reach:
        return None
    right, up = orthonormal_frame(-forward)
    x, y = offsets @ right / depths, offsets @ up / depths
    if max(np.abs(x).max(), np.abs(y).max()) > MAX_TANGENT:
        return None
    return _perspective_view(position, forward, _window(x, y, resolution), float(depths.max()), resolution)


def _window_area(view: HostView) -> float:
    left, right, bottom, top = view.window
    return (right - left) * (top - bottom)


def _perspective_view(
    position: np.ndarray, forward: np.ndarray, window: tuple[float, float, float, float], reach: float, resolution: int
) -> HostView:
    right, up = orthonormal_frame(-forward)
    return HostView(
        eye_ws=position,
        right_ws=right,
        up_ws=up,
        forward_ws=forward,
        window=window,
        near=NEAR_TO_FAR * reach,
        far=1.001 * reach,
        width=resolution,
        height=resolution,
    )


def perspective_aliasing(
    light_views: list[HostView], light_ws: np.ndarray, eye: HostView, steps: int = 256
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Perspective aliasing error along the view vector, from the Jacobian of the map in use.

    ``m`` is the length of a map texel over the length of a pixel, both in the world at the same point: above 1 the map
    is undersampled. ``x`` is across view and light direction, ``z`` the view direction within the plane across the
    light (Stingl 2011, section 2.3.2, equations 2.3 and 2.4, which these values equal for overhead light).

    Returns:
        Depths z (steps,) from near to far, m_x and m_z (steps,); NaN where no map covers the point.
    """
    z = np.geomspace(eye.near, eye.far, steps)
    points = eye.eye_ws + z[:, None] * eye.forward_ws
    pixel = (z if eye.perspective else np.ones(steps)) * (eye.window[3] - eye.window[2]) / eye.height
    m_x, m_z = np.full(steps, np.nan), np.full(steps, np.nan)
    taken, margin = np.zeros(steps, dtype=bool), np.zeros(steps)
    for view in light_views:
        rows = view.ws_to_ss
        h = points @ rows[:, :3].T + rows[:, 3]
        inside = (h[:, 3] > 0) & (np.abs(h[:, 0]) <= h[:, 3]) & (np.abs(h[:, 1]) <= h[:, 3])
        choice = getattr(view, "choice", None)
        with np.errstate(divide="ignore", invalid="ignore"):
            ndc = h[:, :2] / h[:, 3:]
        if choice is not None:  # as receivers choose: the first layer, with depth the first whose split has not ended
            inside &= ~taken & (z < choice.far if choice.rule == "depth" else True)
            taken |= inside
        else:  # the layer that holds the point most centrally
            room = 1.0 - np.abs(ndc).max(axis=1)
            inside &= room >= margin
            margin = np.where(inside, room, margin)
        with np.errstate(divide="ignore", invalid="ignore"):
            gradient = (rows[None, :2, :3] - ndc[:, :, None] * rows[None, 3:, :3]) / h[:, 3, None, None]
        gradient *= 0.5 * np.array([view.width, view.height])[None, :, None]  # texels per unit length
        to_light = light_ws[:3] - points * light_ws[3]
        to_light /= np.maximum(np.linalg.norm(to_light, axis=1, keepdims=True), 1e-30)
        along = eye.forward_ws - (to_light @ eye.forward_ws)[:, None] * to_light
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = np.where(length > 1e-6, along / np.maximum(length, 1e-30), eye.up_ws)
        across = np.cross(to_light, along)
        for out, direction in ((m_x, across), (m_z, along)):
            density = np.linalg.norm(np.einsum("nij,nj->ni", gradient, direction), axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                out[inside] = (1.0 / density / pixel)[inside]
    return z, m_x, m_z
