"""Reprojection: where a point of this frame was in the previous one, and whether the same surface was stored there.

(Scherzer, Jeschke and Wimmer 2007; Schwaerzler 2009, section 5.2; Scherzer et al. 2009, section 3.2.) Points are moved
by the camera alone; a moving object's own motion is not followed. Pixel (x, y) covers [x, x + 1] x [y, y + 1], row 0 at
the top.
"""

from __future__ import annotations

import warp as wp

from wkernels.scene.views import View, pixel_along_ws, pixel_base_ws

OUTSIDE_PX = wp.constant(-1.0e9)
"""Screen position given to points that have none."""

EDGE_ON = wp.constant(1.0e-3)  # a plane seen at a smaller sine of the angle tells nothing about the next pixel's depth


@wp.func
def reproject(previous: View, position_ws: wp.vec3) -> wp.vec3:
    """Screen position and depth of a point in another view.

    Args:
        previous: The view of the previous frame, rebased by the same offset as ``position_ws``.
        position_ws: World space, scene units.

    Returns:
        x and y in pixels, y down, and linear depth in scene units. A point that projects nowhere (w <= 0, behind a
        perspective view) has ``OUTSIDE_PX`` for x and y.
    """
    h = previous.ws_to_ss * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    if h[3] <= 0.0:
        return wp.vec3(OUTSIDE_PX, OUTSIDE_PX, h[2])
    x_px = (0.5 + 0.5 * h[0] / h[3]) * float(previous.width)
    y_px = (0.5 - 0.5 * h[1] / h[3]) * float(previous.height)
    return wp.vec3(x_px, y_px, h[2])


@wp.func
def is_inside(view: View, x_px: float, y_px: float) -> bool:
    """Whether a screen position lies on the image."""
    return x_px >= 0.0 and y_px >= 0.0 and x_px < float(view.width) and y_px < float(view.height)


@wp.func
def is_same_depth(depth: float, stored_depth: float, epsilon: float) -> bool:
    """Whether ``|depth - stored_depth| < epsilon``, scene units (Scherzer et al. 2009, equation 4).

    An epsilon in proportion to the stored depth makes it the relative test of Schwaerzler 2009, equation 5.18.

    Args:
        depth: Linear depth of the reprojected point in the previous view.
        stored_depth: What the previous frame stored there; take the absolute value first where a sign tags movers.
        epsilon: Tolerance, scene units.

    Returns:
        False as well where nothing was stored (depth 0, infinite or NaN).
    """
    return stored_depth > 0.0 and wp.abs(stored_depth - depth) < epsilon


@wp.func
def depth_on_plane(
    view: View, x_px: float, y_px: float, position_ws: wp.vec3, normal_ws: wp.vec3, otherwise: float
) -> float:
    """Linear depth at a screen position of the plane through a point; ``otherwise`` where it is seen edge-on."""
    along = pixel_along_ws(view, x_px, y_px)
    slope = wp.dot(normal_ws, along)
    result = otherwise
    if wp.abs(slope) > EDGE_ON * wp.length(along):
        result = wp.dot(normal_ws, position_ws - pixel_base_ws(view, x_px, y_px)) / slope
    return result
