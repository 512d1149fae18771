"""Percentage-closer filtering: comparisons over a neighbourhood in the light map, fixed or as wide as a penumbra.

A filter is a set of taps, offsets about 0 that fill the disc or square of radius 1, and a *spread*: the 2 x 2 matrix
that takes a tap to texels. A fixed filter has the spread r I. A penumbra has the light's own shape, as the similar
triangles of percentage-closer soft shadows cast it on the plane through the receiver, parallel to the map (Fernando
2005; Schwaerzler 2009, equation 5.6): the light's half-axes, times ``penumbra_ratio``, times texels per length at the
receiver. The search for blockers looks at the penumbra that the nearest caster in the map would cast: in a
perspective map that is the light seen from the receiver through the plane of that caster, R_s = L (z_r - near) / z_r,
with the near plane as tight as the map's content allows; a nearer one would only thin out the taps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, runs_of
from wkernels.device.twin import Twin, cell_by_cell
from wkernels.errors import InputError, nearest
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import (
    BORDER,
    LightMap,
    Receiver,
    compare_bilinear,
    receiver_depth_at,
    texels_per_length,
    to_texel,
)
from wkernels.sampling.disc_sets import box_taps, poisson_disc_taps
from wkernels.sampling.point_sets import hash_2d, uniform_01
from wkernels.scene.light_extent import light_half_axes
from wkernels.workspace.workspace import Workspace

TAP_SETS: dict[str, Callable[[int], np.ndarray]] = {"poisson": poisson_disc_taps, "box": box_taps}
"""Filter kernels by name: number of taps -> float64 (n, 2)."""

NEAREST_BLOCKER = wp.constant(1.0e-6)  # share of the receiver's depth: a blocker at the light would divide by 0


@wp.struct
class LightFootprint:
    """What penumbra formulas know of a light, for each layer of one of its maps."""

    half_axes: wp.array(dtype=wp.mat22)  # (layers,) columns: half-axes on the map's (right, up); lengths or tangents
    nearest_depth: wp.array(dtype=float)  # (layers,) least depth in the map, scene units; +inf where nothing casts
    is_point: float  # 1 half-axes are lengths at the light, 0 tangents of a directional light


def tap_set(kernel: str, count: int) -> np.ndarray:
    """Taps of a filter.

    Args:
        kernel: A key of ``TAP_SETS``: ``poisson`` or ``box``.
        count: Taps, at least 1; a square number for ``box``.

    Returns:
        float64 (count, 2), about within the unit disc (poisson) or square (box).

    Raises:
        InputError: No such kernel, or it has no set of this size.
    """
    if kernel not in TAP_SETS:
        raise InputError(f"there is no filter kernel '{kernel}'.{nearest(kernel, TAP_SETS)}")
    return TAP_SETS[kernel](count)


def check_tap_count(count: int, kernel: str) -> int:
    """Returns ``count``, for validators of parameters.

    Raises:
        ValueError: The kernel has no set of this size (pydantic takes no other exception for a wrong value).
    """
    if kernel == "box":
        try:
            box_taps(count)
        except InputError as error:
            raise ValueError(error.message) from None
    return count


def pull_taps(work: Workspace, kernel: str, count: int) -> wp.array:
    """``tap_set`` as a product, vec2 (count,)."""

    def build(old: wp.array | None) -> wp.array:
        return old or wp.array(tap_set(kernel, count).astype(np.float32), dtype=wp.vec2, device=work.device)

    taps: wp.array = work.product("filter taps", ("filter taps", kernel, count), (), build)
    return taps


def pull_footprint(work: Workspace, light_map: HostMap) -> LightFootprint:
    """The footprint of a map's light in the map, as a product that lasts as long as map and light do."""

    def build(old: LightFootprint | None) -> LightFootprint:
        map_, light = light_map.map, light_map.light
        right, up = map_.right_ws.numpy(), map_.up_ws.numpy()
        axes = np.stack([light_half_axes(light, right[k], up[k]) for k in range(map_.layers)])
        out = LightFootprint()
        out.half_axes = wp.array(axes.astype(np.float32), dtype=wp.mat22, device=work.device)
        out.is_point = 0.0 if light.is_directional else 1.0
        out.nearest_depth = wp.empty(map_.layers, dtype=float, device=work.device)
        rows = work.buffer("row minima", (map_.layers, map_.resolution), wp.float32)
        work.launch(FIND_ROW_MINIMA, rows.shape[::-1], [map_], [rows])
        work.launch(find_minima, map_.layers, [rows], [out.nearest_depth])
        return out

    inputs = (light_map.map, light_map.light)
    footprint: LightFootprint = work.product("nearest blocker", ("light footprint", light_map.slot), inputs, build)
    return footprint


@wp.kernel
def find_row_minima(first: int, light_map: LightMap, minima_out: wp.array2d(dtype=float)):
    """Least depth in each row of each layer; the sign that tags moving casters does not count."""
    row, layer = wp.tid()
    y = first + row
    least = float(wp.inf)
    for x in range(light_map.resolution):
        least = wp.min(least, wp.abs(light_map.depth[to_texel(light_map, layer, x, y)]))
    minima_out[layer, y] = least


@wp.kernel
def find_row_minima_lanes(
    first: int,
    depth: wp.array(dtype=Floats),
    layer_begin: wp.array(dtype=int),
    pitch: int,
    resolution: int,
    minima_out: wp.array2d(dtype=float),
):
    """``find_row_minima`` of maps at least a run wide."""
    row, layer = wp.tid()
    y = first + row
    least = Floats(float(wp.inf))
    begin = layer_begin[layer] + y * pitch
    for x in range(0, resolution, LANES):
        held = depth[begin + wp.min(x, resolution - LANES)]
        for k in range(LANES):
            least[k] = wp.min(least[k], wp.abs(held[k]))
    minima_out[layer, y] = wp.min(least)


FIND_ROW_MINIMA = Twin(
    find_row_minima,
    find_row_minima_lanes,
    inputs=lambda m: [runs_of(m.depth, Floats), m.layer_begin, m.pitch, m.resolution],
    grid=cell_by_cell,
    fits=lambda m, minima: m.resolution >= LANES,
)


@wp.kernel
def find_minima(first: int, values: wp.array2d(dtype=float), minima_out: wp.array(dtype=float)):
    """Least value of each row."""
    row = first + wp.tid()
    least = float(wp.inf)
    for x in range(values.shape[1]):
        least = wp.min(least, values[row, x])
    minima_out[row] = least


@wp.func
def tap_rotation(x: int, y: int, seed: int, rotate: int):
    """The matrix that turns a pixel's taps: by a random angle with ``rotate``, else not at all."""
    result = wp.mat22(1.0, 0.0, 0.0, 1.0)
    if rotate != 0:
        angle = 2.0 * wp.pi * uniform_01(hash_2d(x, y, seed))
        result = wp.mat22(wp.cos(angle), -wp.sin(angle), wp.sin(angle), wp.cos(angle))
    return result


@wp.func
def tap_position(light_map: LightMap, receiver: Receiver, offset: wp.vec2, border: float):
    """Where a tap lies in the map [texels]; one beyond the map moves to its border, ``border`` texels inside."""
    last = float(light_map.resolution) - border
    return wp.vec2(wp.clamp(receiver.x + offset[0], border, last), wp.clamp(receiver.y + offset[1], border, last))


@wp.func
def depth_at(light_map: LightMap, layer: int, position: wp.vec2):
    """Depth in the texel at a position inside the map, without the tag of moving casters."""
    return wp.abs(light_map.depth[to_texel(light_map, layer, int(position[0]), int(position[1]))])


@wp.func
def tap_depth(receiver: Receiver, dx: float, dy: float):
    """Depth of the receiver's plane under a tap [texels], for a comparison with the texel that the tap falls into.

    The plane's slope, and the bias that one texel needs, grow with 1/scale^2 towards the plane's horizon (exactly so in
    a perspective map). Where the bias outgrows the rise, and beyond the horizon, the receiver's own depth is taken.
    """
    scale = receiver.plane_scale[0] * dx + receiver.plane_scale[1] * dy + 1.0
    depth = receiver.depth
    if scale >= 1.0:
        depth = receiver_depth_at(receiver, dx, dy)
    elif scale > 0.0:
        rise = receiver.plane_depth[0] * dx + receiver.plane_depth[1] * dy + receiver.plane_depth[2]
        depth = wp.max(depth, (rise - receiver.bias / scale) / scale)
    return depth


@wp.func
def penumbra_filter(
    light_map: LightMap, receiver: Receiver, spread: wp.mat22, taps: wp.array(dtype=wp.vec2), bilinear: int
):
    """Mean of the comparisons at all taps, each of the receiver's plane with the map; visibility in [0, 1].

    Args:
        light_map: The map. Taps beyond it move to its border.
        receiver: Of ``locate_receiver``, on a layer.
        spread: Takes a tap to texels. With 0 (and not bilinear) this is ``compare_nearest``, to the bit.
        taps: vec2 (n,), ``pull_taps``.
        bilinear: 1: each tap is the bilinear mean of four comparisons; 0: one comparison with the nearest texel.
    """
    total = float(0.0)
    for i in range(taps.shape[0]):
        if bilinear != 0:
            at = tap_position(light_map, receiver, spread * taps[i], 0.5)
            total += compare_bilinear(light_map, receiver, at[0] - receiver.x, at[1] - receiver.y)
        else:
            at = tap_position(light_map, receiver, spread * taps[i], BORDER)
            depth = tap_depth(receiver, at[0] - receiver.x, at[1] - receiver.y)
            total += wp.where(depth <= depth_at(light_map, receiver.layer, at), 1.0, 0.0)
    return total / float(taps.shape[0])


@wp.func
def mean_blocker_depth(light_map: LightMap, receiver: Receiver, spread: wp.mat22, taps: wp.array(dtype=wp.vec2)):
    """The blocker search: (mean linear depth of the texels at the taps that hide the receiver's plane, how many do).

    The mean is 0 where none does. Arguments as for ``penumbra_filter``.
    """
    total = float(0.0)
    count = float(0.0)
    for i in range(taps.shape[0]):
        at = tap_position(light_map, receiver, spread * taps[i], BORDER)
        stored = depth_at(light_map, receiver.layer, at)
        if tap_depth(receiver, at[0] - receiver.x, at[1] - receiver.y) > stored:
            total += stored
            count += 1.0
    return wp.vec2(total / wp.max(count, 1.0), count)


@wp.func
def penumbra_ratio(is_point: float, receiver_depth: float, blocker_depth: float):
    """Penumbra width on the receiver per width of the light: (z_r - z_b) / z_b, or z_r - z_b for tangents; at least 0.

    Args:
        is_point: As in ``LightFootprint``.
        receiver_depth: Linear depth from the light, scene units, bias not included.
        blocker_depth: Likewise; +inf where there is no blocker.
    """
    behind = wp.max(receiver_depth - blocker_depth, 0.0)
    if is_point > 0.0:
        behind = behind / wp.max(blocker_depth, NEAREST_BLOCKER * receiver_depth)
    return behind


@wp.func
def texels_per_ratio(light_map: LightMap, footprint: LightFootprint, layer: int, position_ws: wp.vec3):
    """Half-axes of the penumbra at a position, in texels (x to the right, y down), for a ``penumbra_ratio`` of 1."""
    density = texels_per_length(light_map, layer, position_ws)
    axes = footprint.half_axes[layer]
    x = density[0]
    y = -density[1]
    return wp.mat22(x * axes[0, 0], x * axes[0, 1], y * axes[1, 0], y * axes[1, 1])


@wp.func
def penumbra_spread(
    light_map: LightMap, footprint: LightFootprint, receiver: Receiver, axes: wp.mat22, blocker_depth: float
):
    """The spread of a penumbra round the receiver, whose caster has this depth: at most the side of the map.

    Args:
        light_map: The map.
        footprint: The light's, in that map.
        receiver: Of ``locate_receiver``, on a layer.
        axes: ``texels_per_ratio`` at the receiver.
        blocker_depth: Linear, scene units; that of the nearest caster in the map gives the region of the search.
    """
    spread = axes * penumbra_ratio(footprint.is_point, receiver.plane_depth[2], blocker_depth)
    across = wp.max(wp.abs(spread[0, 0]), wp.abs(spread[0, 1]))
    down = wp.max(wp.abs(spread[1, 0]), wp.abs(spread[1, 1]))
    return spread * wp.min(1.0, float(light_map.resolution) / wp.max(wp.max(across, down), 1.0))


@wp.func
def penumbra_box(spread: wp.mat22):
    """Half-sides (x, y) in texels of the box with a spread's second moments, at least 1/2: less filters nothing."""
    return wp.vec2(
        wp.max(wp.length(wp.vec2(spread[0, 0], spread[0, 1])), 0.5),
        wp.max(wp.length(wp.vec2(spread[1, 0], spread[1, 1])), 0.5),
    )


@wp.func
def pcss_visibility(
    light_map: LightMap,
    footprint: LightFootprint,
    receiver: Receiver,
    position_ws: wp.vec3,
    blocker_taps: wp.array(dtype=wp.vec2),
    filter_taps: wp.array(dtype=wp.vec2),
    rotation: wp.mat22,
    bilinear: int,
):
    """Percentage-closer soft shadows of one receiver on a layer: (visibility, mean blocker depth).

    The depth is 0 where the search finds no blocker; visibility is 1 there. ``rotation`` is ``tap_rotation``.
    """
    axes = texels_per_ratio(light_map, footprint, receiver.layer, position_ws) * rotation
    search = penumbra_spread(light_map, footprint, receiver, axes, footprint.nearest_depth[receiver.layer])
    blocker = mean_blocker_depth(light_map, receiver, search, blocker_taps)
    visible = float(1.0)
    if blocker[1] > 0.0:
        spread = penumbra_spread(light_map, footprint, receiver, axes, blocker[0])
        visible = penumbra_filter(light_map, receiver, spread, filter_taps, bilinear)
    return wp.vec2(visible, blocker[0])
