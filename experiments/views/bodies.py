"""Convex bodies in a picture: their edges as lines, and themselves as tinted glass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wkernels.projections.clipping import ConvexBody, box_polyhedron, view_polyhedron
from wkernels.scene.views import HostView


def edges(body: ConvexBody) -> np.ndarray:
    """Every edge once, (n, 2, 3); triangles' edges within a flat side are none."""
    sides: dict[tuple[bytes, bytes], list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = {}
    for face in body.faces:
        normal = _normal(face)
        for a, b in zip(face, np.roll(face, -1, axis=0), strict=True):
            key = sorted((a.tobytes(), b.tobytes()))
            sides.setdefault((key[0], key[1]), []).append((a, b, normal))
    kept = []
    for found in sides.values():
        a, b, normal = found[0]
        if len(found) == 2 and float(normal @ found[1][2]) > 1.0 - 1e-9:
            continue
        kept.append((a, b))
    return np.array(kept).reshape(-1, 2, 3)


def box_of(body: ConvexBody) -> ConvexBody:
    """The axis-aligned box around a body that is not empty."""
    corners = body.vertices
    return box_polyhedron(corners.min(axis=0), corners.max(axis=0))


def frustum_between(view: HostView, near: float, far: float) -> ConvexBody:
    """What a view sees between two depths."""
    return view_polyhedron(replace(view, near=near, far=far))


def pixel_rays(view: HostView) -> tuple[np.ndarray, np.ndarray]:
    """Start and way of every pixel centre's ray, (H, W, 3) each; the parameter counts linear depth."""
    left, right, bottom, top = view.window
    x = left + (np.arange(view.width) + 0.5) / view.width * (right - left)
    y = top + (np.arange(view.height) + 0.5) / view.height * (bottom - top)
    offset = x[None, :, None] * view.right_ws + y[:, None, None] * view.up_ws
    if view.perspective:
        return np.broadcast_to(view.eye_ws, offset.shape), view.forward_ws + offset
    return view.eye_ws + offset, np.broadcast_to(view.forward_ws, offset.shape)


def spans(view: HostView, body: ConvexBody) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each pixel's ray enters and leaves a body, linear depth (H, W), and which face it enters by (-1: none).

    It leaves before it enters where it misses the body.
    """
    base, along = pixel_rays(view)
    enter = np.full(base.shape[:2], -np.inf)
    leave = np.full(base.shape[:2], np.inf)
    by = np.full(base.shape[:2], -1)
    for i, face in enumerate(body.faces):
        normal = _normal(face)
        distance = base @ normal - float(normal @ face[0])
        speed = along @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -distance / speed
        entering = (speed < 0.0) & (t > enter)
        enter, by = np.where(entering, t, enter), np.where(entering, i, by)
        leave = np.where((speed > 0.0) & (t < leave), t, leave)
        leave = np.where((speed == 0.0) & (distance > 0.0), -np.inf, leave)
    return enter, leave, by


def fill(
    image: np.ndarray, view: HostView, body: ConvexBody, color: Sequence[float], depth: np.ndarray, alpha: float = 0.22
) -> None:
    """Tints what is seen through a body, more where the ray enters and leaves it in front of the surface.

    Args:
        image: float (H, W, 3), display colours; changed in place.
        view: What the picture looks through; its pixels have rays.
        body: Convex; an empty one leaves the picture as it is.
        color: RGB in [0, 1].
        depth: Linear depth of the surfaces (H, W), +inf where there is none.
        alpha: Opacity of one side.
    """
    if body.is_empty:
        return
    enter, leave, by = spans(view, body)
    hit = (leave > np.maximum(enter, 0.0)) & (np.maximum(enter, 0.0) < depth)
    # sides that face the camera are lighter: the body gets a shape
    lights = np.array([0.72 + 0.28 * abs(float(_normal(face) @ view.forward_ws)) for face in body.faces])
    tone = np.where(by >= 0, lights[np.maximum(by, 0)], 0.8)
    opacity = np.where(hit, alpha, 0.0)
    opacity = np.where(hit & (leave < depth), 1.0 - (1.0 - opacity) * (1.0 - 0.7 * alpha), opacity)[..., None]
    image[:] = image * (1.0 - opacity) + np.clip(tone[..., None] * np.asarray(color, float), 0.0, 1.0) * opacity


def _normal(face: np.ndarray) -> np.ndarray:
    spokes = face[1:] - face[0]
    area = np.cross(spokes[:-1], spokes[1:]).sum(axis=0)
    out: np.ndarray = area / max(float(np.linalg.norm(area)), 1e-300)
    return out
