"""Reprojection: where a point of this frame was in the previous one, and whether the same surface was stored there.

(Scherzer, Jeschke and Wimmer 2007; Schwaerzler 2009, section 5.2; Scherzer et al. 2009, section 3.2.) Points are moved
by the camera alone; a moving object's own motion is not followed. Pixel (x, y) covers [x, x + 1] x [y, y + 1], row 0 at
the top.
"""

from __future__ import annotations

import warp as wp

from wkernels.scene.views import View

OUTSIDE_PX = wp.constant(-1.0e9)
"""Screen position given to points that have none."""


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
def nearest_texel(view: View, x_px: float, y_px: float) -> wp.vec2i:
    """Column and row of the pixel that covers a screen position; (-1, -1) outside the image."""
    if not is_inside(view, x_px, y_px):
        return wp.vec2i(-1, -1)
    return wp.vec2i(int(x_px), int(y_px))


@wp.func
def accept_relative(depth: float, stored_depth: float, epsilon: float) -> bool:
    """Whether ``|1 - depth / stored_depth| < epsilon``: the test of the thesis (Schwaerzler 2009, 5.2), 1e-3 there.

    Args:
        depth: Linear depth of the reprojected point in the previous view.
        stored_depth: What the previous frame stored there; take the absolute value first where a sign tags movers.
        epsilon: Relative tolerance, no unit.

    Returns:
        False as well where nothing was stored (depth 0, infinite or NaN).
    """
    return stored_depth > 0.0 and wp.abs(stored_depth - depth) < epsilon * stored_depth


@wp.func
def accept_absolute(depth: float, stored_depth: float, epsilon: float) -> bool:
    """Whether ``|depth - stored_depth| < epsilon``, in scene units (Scherzer et al. 2009, equation 4).

    The thesis finds this one unstable: no epsilon suits both ends of a deep scene. Otherwise as ``accept_relative``.
    """
    return stored_depth > 0.0 and wp.abs(stored_depth - depth) < epsilon
