"""What both counts of hard shadow volumes share: from a light's centre to visibility."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import warp as wp

from algorithms.technique import Frame, Limit, Technique
from wkernels.casters.volume_counts import Uncounted, VolumeRule, count_volumes
from wkernels.device.lanes import LANES, Floats, Ints, Vectors, runs_of, store_run
from wkernels.device.twin import Twin
from wkernels.raster.gbuffer import PADDING, GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import CASTS, RECEIVES
from wkernels.workspace.left_out import Omission
from wkernels.workspace.products import Product


@wp.kernel
def light_outside_volumes(
    first: int,
    gbuffer: GBuffer,
    counts: wp.array2d(dtype=int),
    light_ws: wp.vec4,
    negative_hides: int,
    visibility_out: wp.array2d(dtype=float),
):
    """1 where a receiver is turned to the light and in no volume, else 0."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        count = counts[y, x]
        hidden = count > 0 or (count < 0 and negative_hides != 0)
        if hidden or is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
    visibility_out[y, x] = visible


@wp.kernel
def light_outside_volumes_lanes(
    first: int,
    position_ws: wp.array(dtype=Vectors),  # a run from every component on
    normal_ws: wp.array(dtype=Vectors),
    flags: wp.array(dtype=Ints),
    counts: wp.array2d(dtype=int),
    light_ws: wp.vec4,
    negative_hides: int,
    visibility_out: wp.array2d(dtype=float),
):
    """``light_outside_volumes`` of a run of pixels."""
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    begin = y * visibility_out.shape[1] + x0
    positions = position_ws[3 * begin]
    normals = normal_ws[3 * begin]
    flag = flags[begin]
    l_x, l_y, l_z, l_w = light_ws[0], light_ws[1], light_ws[2], light_ws[3]
    least = wp.where(negative_hides != 0, -1, 1)  # counts of this sign hide, and those above 0
    found = Ints(0)
    visible = Floats(0.0)
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        found[k] = counts[y, x0 + k]
    for k in range(LANES):
        to_x = l_x - positions[3 * k] * l_w
        to_y = l_y - positions[3 * k + 1] * l_w
        to_z = l_z - positions[3 * k + 2] * l_w
        toward = normals[3 * k] * to_x + normals[3 * k + 1] * to_y + normals[3 * k + 2] * to_z
        dark = wp.where(found[k] > 0, 1, 0) | wp.where(found[k] * least > 0, 1, 0)
        dark = dark | (wp.where((flag[k] & CASTS) != 0, 1, 0) & wp.where(toward <= 0.0, 1, 0))
        visible[k] = wp.where((dark & wp.where((flag[k] & RECEIVES) != 0, 1, 0)) != 0, 0.0, 1.0)
    store_run(visible, x0, y, visibility_out)


def _in_lanes(gbuffer: GBuffer, *others: object) -> list:
    images = [runs_of(image, Vectors, 3 * PADDING) for image in (gbuffer.position_ws, gbuffer.normal_ws)]
    return [*images, runs_of(gbuffer.flags, Ints, PADDING), *others]


LIGHT = Twin(light_outside_volumes, light_outside_volumes_lanes, inputs=_in_lanes, flips=1e-4)


class HardVolumes(Technique):
    """Counts the faces of the volumes behind all casters, as seen from the light's centre."""

    family = "volumes"
    hard = True
    products = (Product.G_BUFFER, Product.CASTER_EDGES, Product.SILHOUETTES, Product.VOLUMES)
    may_leave_out: ClassVar[tuple[Omission, ...]] = (Uncounted.BESIDE,)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="ray_cast_point_shadow", tolerance=1e-6, flips=0.002),)

    @property
    @abstractmethod
    def rule(self) -> VolumeRule:
        """How faces are counted."""

    @property
    def negative_hides(self) -> bool:
        """Whether counts below 0, which a z-pass with the eye in shadow has, are taken for shadow."""
        return False

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        light_ws = frame.light.centre
        counts = count_volumes(frame, frame.rasteriser, frame.geometry, gbuffer, frame.eye(), light_ws, self.rule)
        with frame.timed("stencil"):
            inputs = [gbuffer, counts, wp.vec4(*light_ws), int(self.negative_hides)]
            frame.launch(LIGHT, visibility.shape, inputs, [visibility])
        return visibility
