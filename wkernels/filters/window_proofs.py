"""What a map's min/max pyramid proves of all comparisons in a window.

Where the receiver's plane lies before the least depth of a window all comparisons in it are lit, where it lies behind
the greatest none is, and a filter or a search over it need not look (Guennebaud, Barthe and Paulin 2006).
"""

from __future__ import annotations

import warp as wp

from wkernels.filters.pyramid import DepthPyramid, window_range
from wkernels.light_maps.light_map import LightMap, Receiver

UNDECIDED, ALL_LIT, ALL_DARK = wp.constant(0), wp.constant(1), wp.constant(2)
PLANE_ROUNDING = wp.constant(1.0e-6)  # relative to the plane's terms: four times what float32 loses in their sum


@wp.func
def plane_range(receiver: Receiver, x0: float, y0: float, x1: float, y1: float):
    """Bounds of a receiver's biased depth over a rectangle of texel offsets: on its plane, and its own.

    They hold for ``receiver_depth_at``, for filters that take the receiver's own depth towards the plane's horizon, and
    for what either loses to rounding. A rectangle that the horizon crosses has no bounds.
    """
    lowest = float(wp.inf)
    highest = float(-wp.inf)
    least_scale = float(wp.inf)
    rise_size = float(0.0)
    scale_size = float(0.0)
    for i in range(4):
        dx = wp.where(i % 2 == 0, x0, x1)
        dy = wp.where(i < 2, y0, y1)
        scale_x = receiver.plane_scale[0] * dx
        scale_y = receiver.plane_scale[1] * dy
        rise_x = receiver.plane_depth[0] * dx
        rise_y = receiver.plane_depth[1] * dy
        scale = scale_x + scale_y + 1.0
        depth = (rise_x + rise_y + receiver.plane_depth[2]) / scale
        least_scale = wp.min(least_scale, scale)
        # the ratio of two affine functions is monotone along every line on which the lower one is positive
        lowest = wp.min(lowest, depth)
        highest = wp.max(highest, depth)
        scale_size = wp.max(scale_size, wp.abs(scale_x) + wp.abs(scale_y) + 1.0)
        rise_size = wp.max(rise_size, wp.abs(rise_x) + wp.abs(rise_y) + wp.abs(receiver.plane_depth[2]))
    result = wp.vec2(-wp.inf, wp.inf)
    if least_scale > 16.0 * PLANE_ROUNDING * scale_size:
        size = wp.max(wp.abs(lowest), wp.abs(highest))
        slack = PLANE_ROUNDING * (rise_size + size * scale_size) / least_scale + receiver.bias
        lowest = wp.min(lowest - slack, receiver.depth)
        highest = wp.max(highest + (slack - 2.0 * receiver.bias), receiver.depth)
        result = wp.vec2(lowest, highest)
    return result


@wp.func
def judge_window(
    light_map: LightMap,
    pyramid: DepthPyramid,
    receiver: Receiver,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    reads: int,
):
    """What is known of all comparisons of a receiver's plane with the texels that a window touches.

    Args:
        light_map: The map.
        pyramid: Its pyramid.
        receiver: Of ``locate_receiver``, on a layer.
        x0: Left border of the window [texels]; ``compare_bilinear`` reads texels half a texel beyond its taps.
        y0: Upper border.
        x1: Right border, >= ``x0``.
        y1: Lower border, >= ``y0``.
        reads: As in ``window_range``.

    Returns:
        ALL_LIT, ALL_DARK or UNDECIDED. It holds for filters that move taps beyond the layer to its border and for those
        to which all is lit there: what sticks out is never all dark.
    """
    last = light_map.resolution - 1
    left = int(wp.floor(x0))
    top = int(wp.floor(y0))
    right = int(wp.floor(x1))
    bottom = int(wp.floor(y1))
    within = left >= 0 and top >= 0 and right <= last and bottom <= last
    left = wp.clamp(left, 0, last)
    top = wp.clamp(top, 0, last)
    right = wp.clamp(right, 0, last)
    bottom = wp.clamp(bottom, 0, last)
    stored = window_range(light_map, pyramid, receiver.layer, left, top, right, bottom, reads)
    plane = plane_range(
        receiver,
        float(left) - receiver.x,
        float(top) - receiver.y,
        float(right + 1) - receiver.x,
        float(bottom + 1) - receiver.y,
    )
    result = UNDECIDED
    if plane[1] <= stored[0]:
        result = ALL_LIT
    elif within and plane[0] > stored[1]:
        result = ALL_DARK
    return result
