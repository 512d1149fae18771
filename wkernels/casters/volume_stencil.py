"""Counts of volumes to light and shadow."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, Vectors, runs_of, store_run
from wkernels.device.twin import Twin
from wkernels.raster.gbuffer import PADDING, GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import CASTS, RECEIVES
from wkernels.workspace.workspace import Workspace


@wp.kernel
def darken_volumes(
    first: int,
    gbuffer: GBuffer,
    counts: wp.array2d(dtype=int),
    light_ws: wp.vec4,
    negative_hides: int,
    visibility_out: wp.array2d(dtype=float),
):
    """Takes all light from receivers that are in a volume or turned away from the light, and none from others."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        visible = visibility_out[y, x]
        count = counts[y, x]
        hidden = count > 0 or (count < 0 and negative_hides != 0)
        if hidden or is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
    visibility_out[y, x] = visible


@wp.kernel
def darken_volumes_lanes(
    first: int,
    position_ws: wp.array(dtype=Vectors),  # a run from every component on
    normal_ws: wp.array(dtype=Vectors),
    flags: wp.array(dtype=Ints),
    counts: wp.array2d(dtype=int),
    light_ws: wp.vec4,
    negative_hides: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``darken_volumes`` of a run of pixels."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    begin = y * visibility_out.shape[1] + x0
    positions = position_ws[3 * begin]
    normals = normal_ws[3 * begin]
    flag = flags[begin]
    l_x, l_y, l_z, l_w = light_ws[0], light_ws[1], light_ws[2], light_ws[3]
    other = wp.where(negative_hides != 0, -1, 1)  # counts of this sign hide too
    found = Ints(0)
    visible = Floats(1.0)
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        found[k] = counts[y, x0 + k]
        visible[k] = visibility_out[y, x0 + k]
    for k in range(LANES):
        to_x = l_x - positions[3 * k] * l_w
        to_y = l_y - positions[3 * k + 1] * l_w
        to_z = l_z - positions[3 * k + 2] * l_w
        toward = normals[3 * k] * to_x + normals[3 * k + 1] * to_y + normals[3 * k + 2] * to_z
        dark = wp.where(found[k] > 0, 1, 0) | wp.where(found[k] * other > 0, 1, 0)
        dark = dark | (wp.where((flag[k] & CASTS) != 0, 1, 0) & wp.where(toward <= 0.0, 1, 0))
        lit = wp.where(dark != 0, 0.0, visible[k])
        visible[k] = wp.where((flag[k] & RECEIVES) != 0, lit, 1.0)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, *others: object) -> list:
    images = [runs_of(image, Vectors, 3 * PADDING) for image in (gbuffer.position_ws, gbuffer.normal_ws)]
    return [*images, runs_of(gbuffer.flags, Ints, PADDING), *others]


DARKEN = Twin(darken_volumes, darken_volumes_lanes, inputs=_in_lanes, flips=1e-4)


def darken_in_volumes(
    work: Workspace,
    gbuffer: GBuffer,
    counts: wp.array,
    light_ws: np.ndarray,
    visibility_out: wp.array,
    negative_hides: bool = False,
) -> None:
    """Sets visibility to 0 in volumes and where a surface's own back hides the light, to 1 where nothing receives.

    Args:
        work: Where to run.
        gbuffer: The receivers, (H, W).
        counts: int32 (H, W), ``count_volumes``.
        light_ws: Light point (4,).
        visibility_out: float32 (H, W), which keeps what it holds everywhere else.
        negative_hides: Whether counts below 0, which a z-pass with the eye in shadow has, are taken for shadow.
    """
    with work.timed("stencil"):
        inputs = [gbuffer, counts, wp.vec4(*light_ws), int(negative_hides)]
        work.launch(DARKEN, visibility_out.shape, inputs, [visibility_out])
