"""One frame's hard shadow tests, added to what pixels remember by their confidence (see ``blending``).

Texels are those of a shadow buffer (``shadow_buffer.record``): rho is the weighted sum of tests, n the frames they
count for, and in place of the mean blocker they keep the blur of their reads. The plain kernel; ``history_lanes`` has
the CPU's.
"""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.light_map import Bias, LightMap, stored_depth
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.estimators import hidden_share
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.confidence.blending import (
    Blending,
    blend_shares,
    chosen_power,
    confidence_of,
    kept_frames,
    read_blur,
    spare_bias,
)
from wkernels.temporal.reprojection import reproject
from wkernels.temporal.shadow_buffer.record import ShadowRecord, ShadowTest, fetch_record, shadow_test, write_record


@wp.struct
class ConfidentSettings:
    """How a frame's tests are added."""

    bias: Bias
    scales_bias: int  # 1: no more slope bias than a point's place in its texel needs
    blending: Blending
    has_history: int
    depth_epsilon: float  # relative
    texel_steps: float  # BILINEAR or NEAREST


@wp.func
def centred_test(gbuffer: GBuffer, y: int, x: int, light_map: LightMap, settings: ConfidentSettings) -> ShadowTest:
    """``shadow_test``, without ``spare_bias``."""
    result = shadow_test(gbuffer, y, x, light_map, settings.bias)
    receiver = result.receiver
    if settings.scales_bias != 0 and result.tau == 0.0 and receiver.layer >= 0:
        stored = stored_depth(light_map, receiver.layer, int(wp.floor(receiver.x)), int(wp.floor(receiver.y)))
        if receiver.depth + spare_bias(receiver, settings.bias) > wp.abs(stored):
            result.tau = 1.0
            if stored < 0.0:
                result.moves = 1
    return result


@wp.func
def blur_of_read(view: View, position_ws: wp.vec3, texel_steps: float) -> float:
    """``read_blur`` of the read that ``fetch_record`` makes."""
    at = reproject(view, position_ws)
    x = wp.round((at[0] - 0.5) * texel_steps) / texel_steps
    y = wp.round((at[1] - 0.5) * texel_steps) / texel_steps
    return read_blur(x - wp.floor(x), y - wp.floor(y))


@wp.kernel
def add_confident_test(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    settings: ConfidentSettings,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
):
    """One hard test a pixel, added to what its point remembers."""
    row, x = wp.tid()
    y = first + row
    record = ShadowRecord()
    psi = float(0.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        test = centred_test(gbuffer, y, x, light_map, settings)
        blur = float(0.0)
        if settings.has_history != 0 and test.moves == 0:
            epsilon = settings.depth_epsilon
            steps = settings.texel_steps
            normal_ws = gbuffer.normal_ws[y, x]
            record = fetch_record(previous, previous_view, position_ws, normal_ws, 0.0, epsilon, steps)
            blur = record.blocker_rise + blur_of_read(previous_view, position_ws, steps)
        kept = kept_frames(record.n, blur, settings.blending)
        power = chosen_power(kept, settings.blending)
        confidence = confidence_of(test.receiver, power)
        shares = blend_shares(kept, blur, confidence, power, settings.blending)
        record.rho = hidden_share(record.rho, record.n) * shares.kept + shares.weight * test.tau
        record.n = shares.kept + shares.weight
        record.blocker_rise = shares.blur
        record.depth = gbuffer.depth[y, x]
        psi = hidden_share(record.rho, record.n)
        if test.moves != 0:
            record.n = 0.0
            record.rho = 0.0
    write_record(current_out, y, x, record, gbuffer.view.far)
    visibility_out[y, x] = 1.0 - psi
