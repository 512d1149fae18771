"""Where the shadow of a caster may fall: a ball round it and a ball or cone round the light."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.scene.lights import Light


@wp.struct
class MoverReach:
    """A ball round casters, and a ball or cone round the light: what bounds where their shadows fall."""

    centre_ws: wp.vec3
    radius: float
    light_ws: wp.vec4  # the light's centre
    spread: float  # how far off that its points lie, scene units; of a direction the tangent of its largest angle


@wp.func
def may_reach(reach: MoverReach, position_ws: wp.vec3) -> bool:
    """Whether the casters may hide some of the light from a point; never false where they do.

    The way to a point of the light leaves that to its centre by at most ``spread`` at its end, and in proportion
    before. It meets the ball no farther along than the ball's centre, its radius and the spread together allow.
    """
    way = wp.vec3(reach.light_ws[0], reach.light_ws[1], reach.light_ws[2]) - position_ws * reach.light_ws[3]
    length = wp.max(wp.length(way), 1.0e-20)
    to_ball = reach.centre_ws - position_ws
    along = wp.max(wp.dot(to_ball, way) / length, 0.0)
    aside = wp.length(to_ball - way * (along / length))
    slack = reach.radius + reach.spread
    widest = reach.spread * wp.min((along + slack) / length, 1.0)
    if reach.light_ws[3] == 0.0:
        widest = reach.spread * 2.0 * (along + reach.radius)
    return aside <= 1.001 * (reach.radius + widest)


def mover_reach(light: Light, low: np.ndarray, high: np.ndarray) -> MoverReach:
    """Balls round casters between two corners (3,), and round the light; rebased world."""
    out = MoverReach()
    out.centre_ws, out.radius = wp.vec3(*(0.5 * (low + high))), 0.5 * float(np.linalg.norm(high - low))
    centre, hull = light.centre, light.hull
    out.light_ws = wp.vec4(*centre)
    if light.is_directional:
        cosines = hull[:, :3] @ centre[:3] / np.linalg.norm(hull[:, :3], axis=1) / np.linalg.norm(centre[:3])
        out.spread = float(np.tan(np.arccos(np.clip(cosines.min(), 1e-3, 1.0))))
    else:
        out.spread = float(np.linalg.norm(hull[:, :3] - centre[:3], axis=1).max())
    return out
