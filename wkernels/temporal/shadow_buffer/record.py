"""The shadow buffer: a frame's shadow tests, what pixels remember of them, and how the next frame finds that again.

Sources: Scherzer et al. 2009, sections 3.2 and 4; Schwaerzler 2009, section 5.2. A texel holds rho, n, the linear eye
depth and the mean blocker depth. The last two are kept as shares, of the far plane and of the receiver's own depth
from the light: every light sample measures depth from its own origin, and float16 overflows at 65504 scene units. The
sign of the eye depth tags a shadow that a moving caster cast (Schwaerzler 2009, section 5.2.5).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import warp as wp

from wkernels.light_maps.light_map import Bias, LightMap, Receiver, locate_receiver, stored_depth
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.sampling.estimators import FLOAT16_LIMIT, FLOAT32_LIMIT, UNLIMITED
from wkernels.scene.views import View
from wkernels.temporal.reprojection import depth_on_plane, is_inside, is_same_depth, reproject

BILINEAR, NEAREST, LINEAR = wp.constant(256.0), wp.constant(1.0), wp.constant(0.0)
"""Steps a texel for ``fetch_record``. With the nearest texel history sticks to the screen under an eye that moves by
less than half a pixel a frame. None at all stands for ``fetch_linear``."""

NO_BLOCKER = wp.constant(-1.0e6)  # blocker depth that stands for none in the published shader, for ``fetch_linear``


@wp.struct
class ShadowRecord:
    """One pixel's history."""

    rho: float  # sum of weighted shadow tests, 0 to n
    n: float  # sum of their weights; 0: nothing is known
    depth: float  # linear eye depth, scene units
    blocker_rise: float  # 1 - z_b / z_r: how much nearer to the light the mean blocker is; 0: none was met
    of_mover: int  # 1: a caster that moves cast some of the shadow in rho
    spread: float  # variance of psi among the texels that this was interpolated from


@wp.struct
class ShadowTest:
    """What one map says of one pixel."""

    tau: float  # 1: hidden from the map's light sample, 0: lit
    blocker_rise: float  # as in ``ShadowRecord``; 0 where lit or turned away
    moves: int  # 1: the caster that hides it moves
    receiver: Receiver  # layer -1 where no lookup was needed or possible


class Storage(NamedTuple):
    """What a texel type can hold.

    Attributes:
        limit: Largest n, see ``estimators.add_test``.
        rounding: Relative error of a stored depth.
    """

    limit: float
    rounding: float


TEXEL_TYPES: dict[str, type] = {"float32": wp.vec4, "float16": wp.vec4h}
"""Texel type by the name of its format."""


def storage_of(format: str, cap: bool = True) -> Storage:
    """Limits of a format, a key of ``TEXEL_TYPES``; without ``cap`` n grows until the format sticks, as published."""
    limit, rounding = (FLOAT16_LIMIT, 2.0**-11) if format == "float16" else (FLOAT32_LIMIT, 2.0**-24)
    return Storage(limit if cap else UNLIMITED, rounding)


@wp.func
def put(texels: wp.array2d(dtype=wp.vec4), y: int, x: int, value: wp.vec4):
    """Stores a texel."""
    texels[y, x] = value


@wp.func  # type: ignore[no-redef]
def put(texels: wp.array2d(dtype=wp.vec4h), y: int, x: int, value: wp.vec4):
    """Stores a texel, rounded to nearest."""
    texels[y, x] = wp.vec4h(wp.float16(value[0]), wp.float16(value[1]), wp.float16(value[2]), wp.float16(value[3]))


@wp.func
def read_record(texels: wp.array2d(dtype=Any), y: int, x: int, far: float) -> ShadowRecord:
    """A pixel's history; ``far`` is the far plane of the view it was written for."""
    texel = texels[y, x]
    result = ShadowRecord()
    result.rho = float(texel[0])
    result.n = float(texel[1])
    result.depth = wp.abs(float(texel[2])) * far
    result.blocker_rise = float(texel[3])
    result.of_mover = wp.where(float(texel[2]) < 0.0, 1, 0)
    return result


@wp.func
def write_record(texels: wp.array2d(dtype=Any), y: int, x: int, record: ShadowRecord, far: float):
    """Stores a pixel's history for the next frame."""
    tag = wp.where(record.of_mover != 0, -1.0, 1.0)
    put(texels, y, x, wp.vec4(record.rho, record.n, tag * record.depth / far, record.blocker_rise))


@wp.func
def shadow_test(gbuffer: GBuffer, y: int, x: int, light_map: LightMap, bias: Bias) -> ShadowTest:
    """The hard shadow test of a receiving pixel, equation 1, as ``compare_nearest`` makes it, and who casts there."""
    result = ShadowTest()
    result.receiver.layer = -1
    position_ws = gbuffer.position_ws[y, x]
    if is_back_lit(gbuffer, y, x, to_light(light_map.light_ws, position_ws)):
        result.tau = 1.0
    else:
        receiver = locate_receiver(light_map, bias, position_ws, gbuffer.normal_ws[y, x])
        result.receiver = receiver
        if receiver.layer >= 0:
            stored = stored_depth(light_map, receiver.layer, int(wp.floor(receiver.x)), int(wp.floor(receiver.y)))
            if receiver.depth > wp.abs(stored):
                result.tau = 1.0
                result.blocker_rise = wp.clamp(1.0 - wp.abs(stored) / receiver.plane_depth[2], 0.0, 1.0)
                if stored < 0.0:
                    result.moves = 1
    return result


@wp.func
def held_record(
    previous: wp.array2d(dtype=Any),
    view: View,
    x: int,
    y: int,
    position_ws: wp.vec3,
    normal_ws: wp.vec3,
    depth: float,
    epsilon: float,
    relative: float,
) -> ShadowRecord:
    """The record of one texel if the receiver's surface was seen there, else n = 0; arguments as for ``fetch_record``.

    Equation 4, |d_k - d_(k-1)| < epsilon, at the texel's centre: the receiver's plane gives d_k there (``depth``
    where the plane is seen edge-on). The point's own depth would reject slanted ground as soon as the eye moves.
    """
    result = ShadowRecord()
    if x >= 0 and y >= 0 and x < view.width and y < view.height:
        held = read_record(previous, y, x, view.far)
        expected = depth_on_plane(view, float(x) + 0.5, float(y) + 0.5, position_ws, normal_ws, depth)
        if is_same_depth(expected, held.depth, epsilon + relative * held.depth):
            result = held
    return result


@wp.func
def fetch_record(
    previous: wp.array2d(dtype=Any),
    previous_view: View,
    position_ws: wp.vec3,
    normal_ws: wp.vec3,
    epsilon: float,
    relative: float,
    texel_steps: float,
) -> ShadowRecord:
    """History of a receiver point, from the texels around the place where the previous frame saw it.

    Of the four texels of a bilinear fetch only those count that saw the same surface and hold something: each is
    tested by its own depth, so that nothing is mixed with another surface or with a texel that knows nothing. Nor are
    shadows of moving casters mixed with others: what there is more of is taken.

    Args:
        previous: Texels of the previous frame, written for ``previous_view``. previous_view: The eye's view then.
        position_ws: The point, rebased world. normal_ws: Its unit normal. epsilon: Largest difference of depth, scene
            units. relative: The same as a share of the stored depth (equation 5.18 of Schwaerzler 2009), added to it;
            ``Storage.rounding`` at least. texel_steps: To how many steps a texel the place is rounded: ``BILINEAR`` as
            in texture units, so that a still eye hits texel centres exactly, or ``NEAREST``.

    Returns:
        The record, without its depth; n = 0 where the point is new.
    """
    result = ShadowRecord()
    at = reproject(previous_view, position_ws)
    if is_inside(previous_view, at[0], at[1]):
        x = wp.round((at[0] - 0.5) * texel_steps) / texel_steps
        y = wp.round((at[1] - 0.5) * texel_steps) / texel_steps
        column = int(wp.floor(x))
        row = int(wp.floor(y))
        share_x = x - wp.floor(x)
        share_y = y - wp.floor(y)
        # of shadows that stand still, and of movers'
        total = wp.vec2()
        known = wp.vec2()
        rho = wp.vec2()
        n = wp.vec2()
        rise = wp.vec2()
        psi = wp.vec2()
        square = wp.vec2()
        for dy in range(2):
            for dx in range(2):
                share = wp.where(dx == 1, share_x, 1.0 - share_x) * wp.where(dy == 1, share_y, 1.0 - share_y)
                held = ShadowRecord()
                if share > 0.0:
                    held = held_record(
                        previous, previous_view, column + dx, row + dy, position_ws, normal_ws, at[2], epsilon, relative
                    )
                if held.n > 0.0:
                    tag = held.of_mover
                    total[tag] = total[tag] + share
                    rho[tag] = rho[tag] + share * held.rho
                    n[tag] = n[tag] + share * held.n
                    held_psi = held.rho / held.n
                    psi[tag] = psi[tag] + share * held_psi
                    square[tag] = square[tag] + share * held_psi * held_psi
                    if held.blocker_rise > 0.0:
                        known[tag] = known[tag] + share
                        rise[tag] = rise[tag] + share * held.blocker_rise
        tag = wp.where(total[1] > total[0], 1, 0)
        if total[tag] > 0.0:
            result.rho = rho[tag] / total[tag]
            result.n = n[tag] / total[tag]
            result.blocker_rise = rise[tag] / wp.max(known[tag], 1.0e-6)
            result.of_mover = tag
            mean = psi[tag] / total[tag]
            result.spread = wp.max(square[tag] / total[tag] - mean * mean, 0.0)
    return result


@wp.func
def fetch_linear(
    previous: wp.array2d(dtype=Any), previous_view: View, position_ws: wp.vec3, epsilon: float, relative: float
) -> ShadowRecord:
    """History of a receiver point as a texture unit interpolates it (Schwaerzler 2009, appendix A); for study.

    All four texels are mixed before the depth test, tags and sentinels with them: beside a shadow of a moving caster
    depths of both signs cancel and the point counts as new; one neighbour without a blocker takes the others' away;
    slanted ground is tested by the point's own depth. Arguments and result as for ``fetch_record``.
    """
    result = ShadowRecord()
    at = reproject(previous_view, position_ws)
    if is_inside(previous_view, at[0], at[1]):
        x = wp.clamp(at[0] - 0.5, 0.0, float(previous_view.width - 1))
        y = wp.clamp(at[1] - 0.5, 0.0, float(previous_view.height - 1))
        column = int(x)
        row = int(y)
        share_x = x - float(column)
        share_y = y - float(row)
        depth = float(0.0)
        blocker = float(0.0)
        for dy in range(2):
            for dx in range(2):
                share = wp.where(dx == 1, share_x, 1.0 - share_x) * wp.where(dy == 1, share_y, 1.0 - share_y)
                texel_x = wp.min(column + dx, previous_view.width - 1)
                texel_y = wp.min(row + dy, previous_view.height - 1)
                held = read_record(previous, texel_y, texel_x, previous_view.far)
                result.rho += share * held.rho
                result.n += share * held.n
                depth += share * wp.where(held.of_mover != 0, -held.depth, held.depth)
                blocker += share * wp.where(held.blocker_rise > 0.0, 1.0 - held.blocker_rise, NO_BLOCKER)
        result.of_mover = wp.where(depth < 0.0, 1, 0)
        if blocker >= 0.0:
            result.blocker_rise = 1.0 - blocker
        if not is_same_depth(at[2], wp.abs(depth), epsilon + relative * wp.abs(depth)):
            result = ShadowRecord()
    return result


@wp.func
def refine_blocker(rise: float, new_rise: float, known: float) -> float:
    """Mean blocker depth after one more blocker, equation 7, as ``ShadowRecord.blocker_rise``.

    The equation divides by the frames; only frames with a blocker add to its sum, so it is those that must be counted.

    Args:
        rise: Mean so far, 0 for none.
        new_rise: The new blocker's.
        known: Samples behind ``rise``: shadowed tests so far plus taps of the first search. With all tests, shadowed
            or not, this is the published recursion, which holds on to its first blockers for too long.
    """
    result = new_rise
    if rise > 0.0:
        result = (new_rise + rise * known) / (known + 1.0)
    return result
