"""How much of a light lies beyond an edge: the one formula of penumbra wedges.

A point q of the light is hidden from a receiver p by n(q) faces. Going from the light's centre c to q, n changes where
the way crosses an edge of the silhouette, as seen from p: one less where it leaves a loop that runs counter-clockwise.
So the mean of n over the light is n(c), which hard shadow volumes count, less for every edge the share of the light
that lies beyond it, signed by whether it passes c counter-clockwise: the share between the two rays from c through its
ends, less the triangle of c and the ends (Assarsson et al. 2003, sections 4.2.1 and 4.2.2). That is their inner half
of a wedge, which adds visibility, and the outer half, which subtracts it.

Functions take ends as ``light_shapes.seen`` gives them; those on numbers alone are lanes' too.
"""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.light_shapes import DISC, SQUARE, Sight

PI = wp.constant(3.14159265358979)
HALF_PI = wp.constant(1.5707963267948966)
QUARTER_PI = wp.constant(0.7853981633974483)
OVER_TWO_PI = wp.constant(0.15915494309189535)


@wp.func
def enters(low: float, f0: float, f1: float):
    """The later of ``low`` and where a linear function, f0 at 0 and f1 at 1, stops to be negative; 2: nowhere."""
    return wp.max(low, wp.where(f0 < 0.0, wp.where(f1 > 0.0, f0 / (f0 - f1), 2.0), low))


@wp.func
def leaves(high: float, f0: float, f1: float):
    """The earlier of ``high`` and where a linear function begins to be negative; -1: it is nowhere else."""
    return wp.min(high, wp.where(f1 < 0.0, wp.where(f0 > 0.0, f0 / (f0 - f1), -1.0), high))


@wp.func
def enters_disc(a: float, b: float, c: float, d: float, rise: float):
    """Where a line of ends (u, v, w) enters the cone u^2 + v^2 = w^2, w > 0.

    Args:
        a, b, c: a t^2 + 2 b t + c is u^2 + v^2 - w^2 along it.
        d: b^2 - a c.
        rise: By how much w grows along it.
    """
    root = wp.sqrt(wp.max(d, 0.0))
    q = -b - wp.where(b < 0.0, -root, root)
    r = q / a
    s = c / q
    # steeper than the cone it enters and never leaves, or the other way round
    steep = wp.where(rise > 0.0, wp.max(r, s), -1.0)
    return wp.where(a >= 0.0, wp.where(d <= 0.0, 2.0, wp.min(r, s)), steep)


@wp.func
def leaves_disc(a: float, b: float, c: float, d: float, rise: float):
    """Where it leaves the cone; as ``enters_disc``."""
    root = wp.sqrt(wp.max(d, 0.0))
    q = -b - wp.where(b < 0.0, -root, root)
    r = q / a
    s = c / q
    steep = wp.where(rise > 0.0, 2.0, wp.min(r, s))
    return wp.where(a >= 0.0, wp.where(d <= 0.0, -1.0, wp.max(r, s)), steep)


@wp.func
def angle_of(y: float, x: float):
    """Angle of (x, y) from the x axis for y >= 0, [0, pi], to 2e-7 (the polynomial of Moshier's Cephes ``atanf``)."""
    width = wp.abs(x)
    most = wp.max(wp.max(width, y), 1e-37)
    ratio = wp.min(width, y) / most
    upper = ratio > 0.41421356
    t = wp.where(upper, (ratio - 1.0) / (ratio + 1.0), ratio)
    z = t * t
    series = ((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1
    angle = series * z * t + t + wp.where(upper, QUARTER_PI, 0.0)
    angle = wp.where(y > width, HALF_PI - angle, angle)
    return wp.where(x < 0.0, PI - angle, angle)


@wp.func
def border_at(x: float, y: float):
    """Where the ray through (x, y) meets the border of the square, as a way along it from (1, -1): [-1, 7)."""
    wide = wp.abs(x) >= wp.abs(y)
    ratio = wp.where(wide, y, x) / wp.where(wp.where(wide, x, y) == 0.0, 1.0, wp.where(wide, x, y))
    across = wp.where(x > 0.0, ratio, 4.0 + ratio)
    along = wp.where(y > 0.0, 2.0 - ratio, 6.0 - ratio)
    return wp.where(wide, across, along)


@wp.func
def beyond_in_disc(x0: float, y0: float, x1: float, y1: float):
    """Signed share of the disc beyond the edge between two points in it; positive: counter-clockwise round the centre.

    Twice the sector is the angle between the rays, and twice the triangle the cross product.
    """
    cross = x0 * y1 - y0 * x1
    share = (angle_of(wp.abs(cross), x0 * x1 + y0 * y1) - wp.abs(cross)) * OVER_TWO_PI
    return wp.where(cross < 0.0, -share, share)


@wp.func
def beyond_in_square(x0: float, y0: float, x1: float, y1: float):
    """The same for the square, whose sides all lie 1 away: a sector is half the way along the border."""
    cross = x0 * y1 - y0 * x1
    way = wp.abs(border_at(x1, y1) - border_at(x0, y0))
    way = wp.min(way, 8.0 - way)
    share = 0.125 * (way - wp.abs(cross))
    return wp.where(cross < 0.0, -share, share)


@wp.func
def clip_to_light(shape: int, sight: Sight, p0: wp.vec3, p1: wp.vec3):
    """Which part of an edge, ends (u, v, w), lies before the light as seen from the receiver; none if low >= high."""
    low = enters(0.0, p0[2] - sight.nearest, p1[2] - sight.nearest)
    high = leaves(1.0, p0[2] - sight.nearest, p1[2] - sight.nearest)
    low = enters(low, sight.depth - p0[2], sight.depth - p1[2])
    high = leaves(high, sight.depth - p0[2], sight.depth - p1[2])
    if shape == SQUARE:
        for k in range(2):
            low = enters(enters(low, p0[2] - p0[k], p1[2] - p1[k]), p0[2] + p0[k], p1[2] + p1[k])
            high = leaves(leaves(high, p0[2] - p0[k], p1[2] - p1[k]), p0[2] + p0[k], p1[2] + p1[k])
    elif low < high:
        along = p1 - p0
        line = wp.cross(p0, p1)
        a = along[0] * along[0] + along[1] * along[1] - along[2] * along[2]
        b = p0[0] * along[0] + p0[1] * along[1] - p0[2] * along[2]
        c = p0[0] * p0[0] + p0[1] * p0[1] - p0[2] * p0[2]
        d = line[0] * line[0] + line[1] * line[1] - line[2] * line[2]
        low = wp.max(low, enters_disc(a, b, c, d, along[2]))
        high = wp.min(high, leaves_disc(a, b, c, d, along[2]))
    return wp.vec2(low, high)


@wp.func
def on_light(p0: wp.vec3, p1: wp.vec3, span: wp.vec2):
    """Both ends of the part ``span`` of an edge on the light: (x0, y0, x1, y1), half sizes."""
    first = p0 + span[0] * (p1 - p0)
    last = p0 + span[1] * (p1 - p0)
    return wp.vec4(first[0] / first[2], first[1] / first[2], last[0] / last[2], last[1] / last[2])


@wp.func
def beyond(shape: int, ends: wp.vec4):
    """Signed share of the light beyond an edge that is clipped to it, ends (x0, y0, x1, y1)."""
    share = float(0.0)
    if shape == DISC:
        share = beyond_in_disc(ends[0], ends[1], ends[2], ends[3])
    else:
        share = beyond_in_square(ends[0], ends[1], ends[2], ends[3])
    return share


@wp.func
def share_above(shape: int, a: float, b: float, c: float):
    """Share of the light where a x + b y + c > 0, x and y in half sizes."""
    wide = wp.max(wp.abs(a), wp.abs(b))
    narrow = wp.min(wp.abs(a), wp.abs(b))
    share = wp.where(c > 0.0, 1.0, 0.0)
    if shape == DISC:
        reach = wp.sqrt(a * a + b * b)
        if wp.abs(c) < reach:
            x = c / reach
            share = 0.5 + (x * wp.sqrt(1.0 - x * x) + wp.asin(x)) / PI
    elif wp.abs(c) < wide + narrow:
        if wp.abs(c) <= wide - narrow:
            share = 0.5 + 0.5 * c / wide
        else:
            corner = wide + narrow - wp.abs(c)
            cut = corner * corner / (8.0 * wide * narrow)
            share = wp.where(c > 0.0, 1.0 - cut, cut)
    return share
