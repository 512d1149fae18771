"""How much one hard shadow test says of a point, and what it adds to what earlier frames said.

Source: Scherzer, Jeschke and Wimmer 2007; the formula of the confidence is our reading of it. A texel's depth is true
at its centre; the test of a point at (dx, dy) texels from there has the confidence (1 - 2 max(|dx|, |dy|))^m. Over a
map that is shifted in every frame the weighted mean of the tests of one point is the exact shadow, smoothed over the
kernel of that formula: its mean distance from the point is 1 / (m + 3) texels along the longer axis.
"""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.light_map import BIAS_SLOPE, Bias, Receiver

LEAST_CONFIDENCE = wp.constant(1.0e-6)  # a single test must say something, even from a corner of its texel


@wp.struct
class Blending:
    """How a test joins what a pixel remembers."""

    power: int  # m, or the greatest m
    growth: float  # of m with the square root of the frames that are remembered
    memory: float  # frames that are remembered
    recursive: int  # 1: the confidence itself is the new test's share; 0: weighted mean of all that is remembered
    blur: float  # variance that repeated reads may blur history by, pixels squared


@wp.struct
class Shares:
    """What history and a new test count."""

    kept: float  # frames that are kept of history
    weight: float  # of the new test, 1 on average
    blur: float  # variance of the reads behind the sum, pixels squared


@wp.func
def mean_confidence(power: float) -> float:
    """Confidence of a point at a random place in its texel: the integral of (1 - d)^m over the square's d, 2 d dd."""
    return 2.0 / ((power + 1.0) * (power + 2.0))


@wp.func
def chosen_power(n: float, blending: Blending) -> int:
    """m for a point that remembers ``n`` frames.

    A weighted mean of n tests is worth n E(c)^2 / E(c^2) of them, about 8 n / m^2. So m may grow with the square root
    of n: the kernel narrows as far as there are tests to fill it.
    """
    result = blending.power
    if blending.recursive == 0:
        result = wp.clamp(int(blending.growth * wp.sqrt(n)) - 1, 0, blending.power)
    return result


@wp.func
def confidence_of(receiver: Receiver, power: int) -> float:
    """Confidence of the test of a receiver, 0 to 1; 1 where no texel was asked (back-lit, or outside the map)."""
    result = float(1.0)
    if receiver.layer >= 0:
        dx = wp.abs(receiver.x - wp.floor(receiver.x) - 0.5)
        dy = wp.abs(receiver.y - wp.floor(receiver.y) - 0.5)
        nearness = 1.0 - 2.0 * wp.max(dx, dy)
        for _ in range(power):
            result = result * nearness
        result = wp.max(result, LEAST_CONFIDENCE)
    return result


@wp.func
def spare_bias(receiver: Receiver, bias: Bias) -> float:
    """The part of a receiver's slope bias that its own place does not need, scene units.

    ``locate_receiver`` allows for half a texel of the receiver's plane either way; from the centre of its texel the
    plane rises by |dx dz/dx| + |dy dz/dy| only. 0 for other biases.
    """
    result = float(0.0)
    if receiver.layer >= 0 and bias.kind == BIAS_SLOPE:
        dx = wp.abs(receiver.x - wp.floor(receiver.x) - 0.5)
        dy = wp.abs(receiver.y - wp.floor(receiver.y) - 0.5)
        depth = receiver.plane_depth
        slope_x = wp.abs(depth[0] - depth[2] * receiver.plane_scale[0])
        slope_y = wp.abs(depth[1] - depth[2] * receiver.plane_scale[1])
        result = bias.slope * (slope_x * (0.5 - dx) + slope_y * (0.5 - dy))
    return result


@wp.func
def read_blur(share_x: float, share_y: float) -> float:
    """Variance that a bilinear read adds, mean of both axes, pixels squared, from weights of right and lower texels."""
    return 0.5 * (share_x * (1.0 - share_x) + share_y * (1.0 - share_y))


@wp.func
def kept_frames(n: float, blur: float, blending: Blending) -> float:
    """Frames that history counts for.

    Memory is bounded by ``blending.memory``, and so that ``blur``, history's with this frame's read, stays about
    ``blending.blur``: with a share a of new tests in every frame it settles at (1 - a) (blur + read).

    Args:
        n: Frames remembered so far; 0: nothing is known.
        blur: Variance of all reads behind history, this one included.
        blending: The settings.
    """
    result = wp.min(n, blending.memory)
    if blur > blending.blur:
        result = wp.min(result, blending.blur / (blur - blending.blur))
    return result


@wp.func
def blend_shares(kept: float, blur: float, confidence: float, power: int, blending: Blending) -> Shares:
    """How a test is added to the ``kept_frames`` of a history.

    Args:
        kept: Frames; 0: nothing is known.
        blur: As for ``kept_frames``.
        confidence: Of the new test, for this ``power``.
        power: ``chosen_power(kept, blending)``.
        blending: The settings.
    """
    result = Shares()
    if blending.recursive != 0:
        result.weight = wp.max(confidence, 1.0 / (blending.memory + 1.0))
        result.kept = wp.where(kept > 0.0, 1.0 - result.weight, 0.0)
    else:
        result.weight = confidence / mean_confidence(float(power))
        result.kept = kept
    result.blur = blur * result.kept / (result.kept + result.weight)
    return result
