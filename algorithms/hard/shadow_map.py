"""Hard shadows from one depth map (Williams 1978; Segal et al. 1992), with every common bias.

The scene is drawn once from the light into a map of linear depth; a receiver is in shadow where the texel it falls into
holds something nearer to the light: shadow iff z > SM + b (Schwaerzler 2009, section 2.3.1; Stingl 2011, section 2.1).
Points outside the map are lit. Soft lights are reduced to their centre.

Deviations: depth is linear under every projection, so a constant bias means the same length everywhere; ``slope`` uses
the exact gradient of the receiver's plane instead of screen-space differences.
Known artefacts: perspective aliasing (jagged edges near the eye), projection aliasing where N.L is near 0, moire acne
with ``none``, a gap between caster and shadow with a large ``constant`` (b / tan(elevation) for a vertical lift b,
b cos(elevation) for b along the light), leaks through open and thin meshes with the back-face kinds.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Frame, Limit, MapTechnique
from wkernels.device.lanes import LANES, store_run
from wkernels.device.twin import Twin
from wkernels.light_maps.comparison_lanes import compare_nearest_run
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest
from wkernels.light_maps.receiver_lanes import LaneViews, in_lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer


@wp.kernel
def compare_depth(
    first: int, gbuffer: GBuffer, light_map: LightMap, bias: Bias, visibility_out: wp.array2d(dtype=float)
):
    """One depth comparison per pixel."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        visible = compare_nearest(light_map, receiver)
    visibility_out[y, x] = visible


@wp.kernel
def compare_depth_lanes(
    first: int, views: LaneViews, light_map: LightMap, bias: Bias, visibility_out: wp.array2d(dtype=float)
):
    """``compare_depth`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = compare_nearest_run(views, light_map, receivers)
    store_run(visible, x0, y, visibility_out)


COMPARE = Twin(compare_depth, compare_depth_lanes, inputs=in_lane_views, flips=1e-3)


class ShadowMap(MapTechnique):
    """One map, one comparison a pixel."""

    name = "shadow_map"
    family = "hard"
    paper = ("williams1978", "schwaerzler2009", "stingl2011")
    bias_sign = "none"
    limits = (
        Limit(equals="ray_cast_point_shadow", params={"resolution": 4096}, tolerance=1e-6, flips=0.02),
        Limit(equals="multi_shadow_map", other_params={"samples": 1}, light_scale=0.0),
    )

    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        with frame.timed("compare depth"):
            inputs = [gbuffer, light_map.map, self.params.device_bias]
            frame.launch(COMPARE, visibility_out.shape, inputs, [visibility_out])
