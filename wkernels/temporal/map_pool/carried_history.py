"""Per-pixel history that is carried, not interpolated: a texel keeps the place that its sums belong to.

Interpolating history in every frame in which the eye moves blurs it a little each time. Here a pixel takes over one
texel whole, that whose point is nearest to its own, and remembers how far off that point is, in pixels. The next frame
looks for history from there, so that nothing sticks to the screen and no offset grows beyond about half a pixel.
"""

from __future__ import annotations

import warp as wp

from wkernels.scene.views import View
from wkernels.temporal.reprojection import depth_on_plane, is_inside, is_same_depth, reproject

STEPS = wp.constant(128.0)  # of an offset of one pixel
CODES = wp.constant(512.0)  # codes of an offset along one axis, -256 to 255
FARTHEST = wp.constant(1.0)  # pixels: history of a point farther off is another point's


@wp.struct
class CarriedSums:
    """What a pixel takes over; n = 0 where it is new."""

    rho: float  # sum of weighted shadow tests
    n: float  # sum of their weights
    offset: wp.vec2  # from the pixel's centre to the place they belong to, pixels


@wp.func
def encode_offset(offset: wp.vec2) -> float:
    """An offset of less than 2 pixels along each axis as one whole number."""
    x = wp.clamp(wp.floor(offset[0] * STEPS + 0.5), -256.0, 255.0)
    y = wp.clamp(wp.floor(offset[1] * STEPS + 0.5), -256.0, 255.0)
    return (x + 256.0) * CODES + (y + 256.0)


@wp.func
def decode_offset(code: float) -> wp.vec2:
    """The offset that a code stands for."""
    x = wp.floor(code / CODES)
    return wp.vec2((x - 256.0) / STEPS, (code - x * CODES - 256.0) / STEPS)


@wp.func
def fetch_sums(
    previous: wp.array2d(dtype=wp.vec4),
    view: View,
    position_ws: wp.vec3,
    normal_ws: wp.vec3,
    epsilon: float,
) -> CarriedSums:
    """The sums of the texel whose place was nearest to a receiver point, if the same surface was seen there.

    The offset of the texel that the point falls into stands for those around it, as neighbours move alike. The depth
    test is that of Scherzer et al. 2009, equation 4, at the texel's centre on the receiver's plane.

    Args:
        previous: (rho, n, linear eye depth, code of the offset) of the last frame, (H, W).
        view: The eye's view then. position_ws, normal_ws: The point. epsilon: Largest difference of depth, scene units.
    """
    result = CarriedSums()
    at = reproject(view, position_ws)
    if is_inside(view, at[0], at[1]):
        here = decode_offset(previous[int(at[1]), int(at[0])][3])
        x = wp.clamp(int(wp.floor(at[0] - here[0])), 0, view.width - 1)
        y = wp.clamp(int(wp.floor(at[1] - here[1])), 0, view.height - 1)
        texel = previous[y, x]
        expected = depth_on_plane(view, float(x) + 0.5, float(y) + 0.5, position_ws, normal_ws, at[2])
        held = decode_offset(texel[3])
        offset = wp.vec2(float(x) + 0.5 + held[0] - at[0], float(y) + 0.5 + held[1] - at[1])
        near = wp.max(wp.abs(offset[0]), wp.abs(offset[1])) < FARTHEST
        if texel[1] > 0.0 and near and is_same_depth(expected, texel[2], epsilon + 1.0e-6 * texel[2]):
            result.rho = texel[0]
            result.n = texel[1]
            result.offset = offset
    return result
