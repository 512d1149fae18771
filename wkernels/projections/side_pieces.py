"""What is seen, divided by the side faces of the eye's frustum (Kozlov 2004; Lloyd et al. 2006). Host, float64.

A map that is warped for one face of the frustum is warped towards a direction in that face, which makes an angle with
the light even where the view direction itself does not. Kozlov draws a map for each face of the frustum in the eye's
post-projective space; here a piece is what lies between the middle of the view and one side face, bounded by the two
planes through the view's axis and the face's edges, so that every receiver is in a piece whichever way the light comes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wkernels.projections.clipping import ConvexBody, clip_polyhedron
from wkernels.scene.views import HostView


def side_pieces(body: ConvexBody, eye: HostView) -> list[tuple[ConvexBody, HostView]]:
    """The parts of a body that belong to the bottom, right, top and left face of a perspective view, in that order.

    Args:
        body: Convex, within the view's frustum.
        eye: The view.

    Returns:
        One pair for each part that is not empty: the part, and a view from the same place that looks along the middle
        of its face, whose depth range is the part's.
    """
    left, right, bottom, top = eye.window
    corners = [
        eye.forward_ws + x * eye.right_ws + y * eye.up_ws
        for x, y in ((left, bottom), (right, bottom), (right, top), (left, top))
    ]
    axis = np.mean(corners, axis=0)
    out = []
    for i, first in enumerate(corners):
        second = corners[(i + 1) % 4]
        middle = 0.5 * (first + second)
        planes = []
        for corner in (first, second):
            normal = np.cross(axis, corner)
            normal *= np.sign(normal @ middle) / np.linalg.norm(normal)
            planes.append(np.append(normal, -normal @ eye.eye_ws))
        part = clip_polyhedron(body, np.array(planes))
        if not part.is_empty:
            out.append((part, _turned(eye, middle, part.vertices)))
    return out


def _turned(eye: HostView, towards: np.ndarray, corners: np.ndarray) -> HostView:
    forward = towards / np.linalg.norm(towards)
    right = np.cross(forward, eye.up_ws)
    right /= np.linalg.norm(right)
    depth = (corners - eye.eye_ws) @ forward
    return replace(
        eye,
        forward_ws=forward,
        right_ws=right,
        up_ws=np.cross(right, forward),
        near=float(depth.min()),
        far=float(depth.max()),
    )
