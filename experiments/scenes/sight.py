"""What the eye can see of a scene: depth planes where a file gives none, and why a picture may be empty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wkernels.projections.clipping import box_polyhedron, clip_polyhedron, frustum_planes
from wkernels.scene.geometry import box_of, placed_vertices
from wkernels.scene.model import Mesh, Scene
from wkernels.scene.origin import LEAST_ANGLE, gaps
from wkernels.scene.views import eye_view

NEAR, FAR = 0.1, 1000.0
"""Depth planes of scenes that fit between them, scene units."""
NEAR_SHARE = 1.0 / 50.0
"""Of the farthest thing: the near plane of a small scene."""
RANGE = 1e4
"""Far over near of a large scene whose things leave the room for it."""
BEHIND = 1e-6
"""Of the far plane: what is not so far before the eye counts as behind it."""


def depth_planes(
    meshes: Sequence[Mesh], eyes: np.ndarray, near: float | None, far: float | None
) -> tuple[float, float]:
    """Near and far planes, scene units, as given; where they are not, ``NEAR`` and ``FAR`` or what the scene needs.

    Needed is what is seen larger than ``LEAST_ANGLE`` from somewhere on the path, whichever way the eye looks.

    Args:
        meshes: The scene's, taken at frame 0.
        eyes: Where the eye is along the path, float64 (n, 3).
        near, far: As the file gives them.
    """
    held = [box for mesh in meshes if (box := box_of(placed_vertices(mesh, 0))) is not None]
    boxes = np.array(held).reshape(-1, 2, 3)
    nearest, farthest = np.inf, 0.0
    for eye in eyes if len(boxes) else ():
        apart = gaps(eye, eye, boxes)
        shown = (boxes[:, 1] - boxes[:, 0]).max(axis=1) >= LEAST_ANGLE * apart
        if shown.any():
            reach = np.linalg.norm(np.maximum(np.abs(boxes[shown, 0] - eye), np.abs(boxes[shown, 1] - eye)), axis=1)
            nearest, farthest = min(nearest, float(apart[shown].min())), max(farthest, float(reach.max()))
    own_far = 1.1 * farthest if farthest > FAR else FAR
    own_near = NEAR if farthest == 0.0 else min(NEAR, NEAR_SHARE * farthest)
    if farthest > FAR:
        own_near = max(own_near, min(0.5 * nearest, own_far / RANGE))
    if near is not None and near >= own_far:
        own_far = RANGE * near
    if far is not None and far <= own_near:
        own_near = far / RANGE
    return near if near is not None else own_near, far if far is not None else own_far


def why_nothing_is_seen(scene: Scene, frame: int, width: int, height: int) -> str:
    """Why no receiver is in a picture of a scene: which key of the camera hides them all, for people."""
    camera = scene.camera(frame)
    boxes = [box_of(placed_vertices(mesh, frame)) for mesh in scene.meshes if mesh.receives]
    held = [box for box in boxes if box is not None]
    if not held:
        return "nothing in the scene receives"
    view = eye_view(camera, width, height, np.asarray(camera.eye, np.float64))
    depths: list[float] = []
    for low, high in (box - np.asarray(camera.eye) for box in held):
        corners = np.maximum(np.abs(low), np.abs(high))
        reach = max(float(np.linalg.norm(corners)), camera.far)
        sides = frustum_planes(view.ws_to_ss, BEHIND * reach, 2.0 * reach)
        seen = clip_polyhedron(box_polyhedron(low, high), sides)
        if not seen.is_empty:
            depths += [float(depth) for depth in seen.vertices @ view.forward_ws]
    if not depths:
        lens = "fov_deg" if camera.height is None else "height"
        return f"all receivers lie outside the field of view: see camera.target and camera.{lens}"
    nearest, farthest = min(depths), max(depths)
    if farthest < camera.near:
        return f"camera.near ({camera.near:g}) hides all receivers, which lie up to {farthest:.4g} before the eye"
    if nearest > camera.far:
        return f"camera.far ({camera.far:g}) hides all receivers, which lie {nearest:.4g} and more before the eye"
    return "what does not receive hides all that does, or no receiver covers the centre of a pixel"
