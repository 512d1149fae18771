"""Soft shadows by sampling the light over time, one map a frame (Scherzer, Schwaerzler, Mattausch and Wimmer 2009).

Every frame draws one depth map from the next point of the light (Halton). The hard test tau of each pixel is added to
what its point already knows: a screen-sized *shadow buffer* of rho (sum of tests), n (their number), linear eye depth
and mean blocker depth, found again by reprojection (equations 1 to 5), 5 % larger than the frame so that the border
has neighbours and history. Points that are new to the eye, or reached by the shadow of a moving caster, start from
percentage-closer soft shadows (Fernando 2005) with 4 x 4 blocker and 4 x 4 filter taps on the frame's own map,
counted as ``start_weight`` samples (section 3.3, which finds 4 faster). Pixels whose standard error,
sqrt(psi (1 - psi) / (n - 1)), exceeds t = 1/50, and new ones, are *shown* smoothed by 16 taps over neighbours of
similar depth, as wide as the penumbra of equation 6; the buffer keeps the unsmoothed sums. The mean blocker depth is
refined by one sample a frame (equation 7, k = 16).

Deviations, where the paper is silent or wrong:
- n = 1 has no standard error (equation 3 is 0/0): 1. The first frame, like any new point, starts from n = 0.
- The start is not followed by the same map's hard test: its taps have seen that map already.
- Equation 4 compares absolute depths, in what unit is not said: ``depth_epsilon`` is a share of the scene's diagonal
  (Schwaerzler 2009 compares relative depths). It is tested at the centre of each history texel, on the receiver's
  plane, and only texels that pass are interpolated: no surface is mixed with another. ``history: nearest`` reads one
  texel, but history then sticks to the screen under an eye that moves by less than half a pixel a frame.
- Equation 6 maps a length to the near plane only; here it is pixels, pw H / (2 depth tan(fov / 2)).
- A filter as wide as the penumbra keeps its bias until the error reaches t (psi = 1/2: n = 626), so that errors fall
  with the fourth root of n at best. From SE = 1/4 on its width is in proportion to SE, which follows the samples;
  ``filter_width: penumbra`` is the published filter.
- The Poisson disc of the neighbourhood filter is made of opposite taps, so that its depth range shifts no edge on
  slanted ground; the range itself is that of Schwaerzler 2009.
- Equation 7 counts frames, but only frames with a blocker add to its sum: shadowed samples are counted.
- n stops at 2048 in the published float16 buffer while rho goes on: ``buffer: float16`` halves both at 1024 (float32
  at 2^22).
- Under a mover's shadow the sums of a frame are shown, not stored, nor is a start whose blocker search met a mover: the
  next frame starts anew, so that nothing trails.

Known artefacts: noise and flicker while n is small and where moving and static penumbrae overlap; SE = 0 is false
certainty where all tests agree so far; the filter blurs penumbrae that are still above t;
history blurs a little with every frame in which the eye moves, and lags on surfaces that move by less than epsilon a
frame, as points are followed by the camera's motion alone.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import warp as wp
from pydantic import field_validator

from algorithms.technique import Limit, MapParams, Needs, Technique, setting
from wkernels.estimators import add_test, hidden_share, standard_error
from wkernels.filtering import (
    LightFootprint,
    check_tap_count,
    pcss_visibility,
    penumbra_ratio,
    penumbra_spread,
    pull_footprint,
    pull_taps,
    texels_per_ratio,
)
from wkernels.frame import Session as Frame
from wkernels.gbuffer import GBuffer
from wkernels.geometry import RECEIVES
from wkernels.light_map import Bias, LightMap, Receiver, locate, receiver_depth_at, stored_depth
from wkernels.neighbourhood_filter import filter_neighbourhood, pixels_per_length, pull_opposite_taps
from wkernels.shadow_buffer import (
    BILINEAR,
    NEAREST,
    TEXEL_TYPES,
    ShadowRecord,
    Storage,
    fetch_record,
    refine_blocker,
    shadow_test,
    storage_of,
    write_record,
)
from wkernels.views import View

FULL_WIDTH_ERROR = wp.constant(0.25)  # standard error of about five tests
UNROTATED = wp.constant(wp.mat22(1.0, 0.0, 0.0, 1.0))


@wp.struct
class Settings:
    """The technique's parameters and the frame's, as the kernel needs them."""

    bias: Bias
    storage: Storage
    weight: float  # of this frame's light sample
    light_size: float  # L: scene units, or 2 tan(angle / 2)
    has_history: int
    has_movers: int
    starts_with_pcss: int
    start_weight: float
    blocker_taps: wp.array(dtype=wp.vec2)
    filter_taps: wp.array(dtype=wp.vec2)
    first_blockers: float  # k of equation 7
    depth_epsilon: float  # scene units
    texel_steps: float  # BILINEAR or NEAREST
    smooths: int
    narrows: int
    error_threshold: float  # t


@wp.func
def search_meets_mover(
    light_map: LightMap,
    footprint: LightFootprint,
    receiver: Receiver,
    position_ws: wp.vec3,
    taps: wp.array(dtype=wp.vec2),
) -> int:
    """1 where the blocker search of ``pcss_visibility`` finds a blocker that moves, else 0."""
    axes = texels_per_ratio(light_map, footprint, receiver.layer, position_ws)
    spread = penumbra_spread(light_map, footprint, receiver, axes, footprint.nearest_depth[receiver.layer])
    result = int(0)
    for i in range(taps.shape[0]):
        offset = spread * taps[i]
        column = int(wp.floor(receiver.x + offset[0]))
        row = int(wp.floor(receiver.y + offset[1]))
        stored = stored_depth(light_map, receiver.layer, column, row)
        if stored < 0.0 and receiver_depth_at(receiver, offset[0], offset[1]) > -stored:
            result = 1
    return result


@wp.kernel
def update_shadow_buffer(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    settings: Settings,
    previous_view: View,
    previous: wp.array2d(dtype=Any),
    current_out: wp.array2d(dtype=Any),
    psi_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """One shadow test a pixel, added to its history; a start where there is none."""
    row, x = wp.tid()
    y = first + row
    record = ShadowRecord()
    psi = float(0.0)
    error = float(0.0)
    half_width = float(0.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        normal_ws = gbuffer.normal_ws[y, x]

        test = shadow_test(gbuffer, y, x, light_map, settings.bias)
        moves = test.moves
        if settings.has_history != 0 and moves == 0:
            record = fetch_record(
                previous,
                previous_view,
                position_ws,
                normal_ws,
                settings.depth_epsilon,
                settings.storage.rounding,
                settings.texel_steps,
            )
        is_new = record.n <= 0.0
        is_estimated = is_new and settings.starts_with_pcss != 0
        if is_estimated:
            visible = 1.0 - test.tau
            if test.receiver.layer >= 0:
                found = pcss_visibility(
                    light_map,
                    footprint,
                    test.receiver,
                    position_ws,
                    settings.blocker_taps,
                    settings.filter_taps,
                    UNROTATED,
                    0,
                )
                visible = found[0]
                if found[1] > 0.0:
                    record.blocker_rise = wp.clamp(1.0 - found[1] / test.receiver.plane_depth[2], 0.0, 1.0)
                if settings.has_movers != 0 and moves == 0:
                    moves = search_meets_mover(light_map, footprint, test.receiver, position_ws, settings.blocker_taps)
            record.n = settings.start_weight
            record.rho = (1.0 - visible) * settings.start_weight
        else:
            if test.blocker_rise > 0.0:
                record.blocker_rise = refine_blocker(
                    record.blocker_rise, test.blocker_rise, record.rho + settings.first_blockers
                )
            sums = add_test(record.rho, record.n, test.tau, settings.weight, settings.storage.limit)
            record.rho = sums[0]
            record.n = sums[1]
        record.depth = gbuffer.depth[y, x]

        psi = hidden_share(record.rho, record.n)
        error = standard_error(psi, record.n)
        if settings.smooths != 0 and (is_estimated or error > settings.error_threshold) and record.blocker_rise > 0.0:
            # equation 6, from the depth of the point itself: it may be turned away from this sample, if not from all
            receiver_depth = locate(light_map, position_ws)[2]
            ratio = penumbra_ratio(footprint.is_point, receiver_depth, receiver_depth * (1.0 - record.blocker_rise))
            width_px = settings.light_size * ratio * pixels_per_length(gbuffer.view, record.depth)
            half_width = 0.5 * width_px
            if settings.narrows != 0:
                half_width = half_width * wp.min(1.0, error / FULL_WIDTH_ERROR)
        if moves != 0:
            record.n = 0.0
            record.rho = 0.0
    write_record(current_out, y, x, record, gbuffer.view.far)
    psi_out[y, x] = psi
    error_out[y, x] = error
    half_width_out[y, x] = half_width


_UPDATE = {
    texel: wp.overload(
        update_shadow_buffer, {"previous": wp.array2d(dtype=texel), "current_out": wp.array2d(dtype=texel)}
    )
    for texel in TEXEL_TYPES.values()
}


class TcSoftPaper(Technique):
    """One light sample a frame, a shadow buffer, a start by PCSS and a filter for show."""

    name = "tc_soft_paper"
    family = "temporal"
    paper = ("scherzer2009tc", "schwaerzler2009", "fernando2005pcss")
    needs = Needs(area=True, history=True)
    bias_sign = "none"
    limits = (
        Limit(
            equals="multi_shadow_map",
            params={"start": "sample", "filter": False},
            other_params={"samples": 16},
            frames=16,
        ),
    )

    class Params(MapParams):
        """Start, filter and storage of the shadow buffer."""

        sample_set: Literal["halton", "r2", "poisson_disc", "random"] = setting(
            "halton", "point set on the light", unit="name", source="Scherzer 2009, sec. 4"
        )
        start: Literal["pcss", "sample"] = setting(
            "pcss",
            "what a new point starts from: soft shadows of one map, or its hard test",
            unit="name",
            source="sec. 3.3",
        )
        start_weight: float = setting(
            1.0,
            "samples that a start by pcss counts as; 4 converges faster",
            unit="samples",
            source="sec. 3.3",
            ge=1,
            le=64,
        )
        blocker_taps: int = setting(
            16, "taps of the start's blocker search, a square number", unit="taps", source="sec. 4", ge=1, le=4096
        )
        filter_taps: int = setting(
            16, "taps of the start's filter, a square number", unit="taps", source="sec. 4", ge=1, le=4096
        )
        filter: bool = setting(True, "smooth what is shown while its error is large", unit="yes/no", source="sec. 3.3")
        taps: int = setting(
            16,
            "taps of that neighbourhood filter, in pairs",
            unit="taps",
            source="sec. 4",
            ge=2,
            le=4096,
            multiple_of=2,
        )
        filter_width: Literal["error", "penumbra"] = setting(
            "error",
            "width of that filter: the penumbra's, or in proportion to the error that is left; published: penumbra",
            unit="name",
            source="sec. 3.3",
        )
        error_threshold: float = setting(
            0.02, "t: standard error down to which pixels are smoothed", unit="1", source="sec. 4", ge=0.0, le=1.0
        )
        filter_depth_range: float = setting(
            0.015,
            "largest depth difference of smoothed neighbours",
            unit="eye depths",
            source="Schwaerzler 2009",
            gt=0.0,
            le=1.0,
        )
        depth_epsilon: float = setting(
            1e-4, "largest depth difference of a point and its history", unit="scene diagonals", gt=0.0, le=1.0
        )
        history: Literal["bilinear", "nearest"] = setting(
            "bilinear", "how the shadow buffer of the last frame is read", unit="name"
        )
        overscan: float = setting(
            0.05,
            "how much larger than the frame the shadow buffer is",
            unit="frame sizes",
            source="sec. 4",
            ge=0.0,
            le=1.0,
        )
        buffer: Literal["float32", "float16"] = setting(
            "float32", "texel format of the shadow buffer; published: float16", unit="name", source="sec. 4"
        )

        @field_validator("blocker_taps", "filter_taps")
        @classmethod
        def _fit_box(cls, taps: int) -> int:
            return check_tap_count(taps, "box")

    def render(self, frame: Frame) -> wp.array:
        p = self.params
        gbuffer = frame.gbuffer(overscan=p.overscan)
        visibility = frame.visibility_buffer(gbuffer)
        shape = visibility.shape
        error = frame.standard_error = frame.buffer("standard error", shape, wp.float32)
        if frame.nothing_casts(visibility):
            error.zero_()
            return visibility
        texel = TEXEL_TYPES[p.buffer]
        history = frame.history(
            "shadow buffer", lambda: wp.zeros(shape, dtype=texel, device=frame.device), frame.margin(p.overscan)
        )
        psi, half_width = (frame.buffer(name, shape, wp.float32) for name in ("psi", "half filter width"))

        # 1: one map from the next point of the light
        has_movers = frame.geometry.moving or not frame.leave_out("tags of moving casters", "nothing moves")
        sample = frame.light_samples(1, p.sample_set, start=frame.count)
        light_map = frame.light_map(
            p.resolution, sample.host[0], slot="sample of the frame", cull=p.cull, tag_moving_casters=has_movers
        )

        # 2: its test, added to what each point already knows
        settings = self._settings(frame, float(sample.weights_host[0]), history.valid, has_movers)
        with frame.timed("shadow buffer"):
            inputs = [gbuffer, light_map, pull_footprint(frame, light_map), settings]
            inputs += [history.previous_view or gbuffer.view, history.previous]
            frame.launch(_UPDATE[texel], shape, inputs, [history.current, psi, error, half_width])

        # 3: smoothed where that is still uncertain
        with frame.timed("neighbourhood filter"):
            inputs = [gbuffer, psi, half_width, pull_opposite_taps(frame, p.taps), p.filter_depth_range]
            frame.launch(filter_neighbourhood, shape, inputs, [visibility])
        return visibility

    def _settings(self, frame: Frame, weight: float, has_history: bool, has_movers: bool) -> Settings:
        p = self.params
        out = Settings()
        out.bias, out.storage, out.weight = p.device_bias, storage_of(p.buffer), weight
        out.light_size = 2.0 * np.tan(0.5 * frame.light.size) if frame.light.is_directional else frame.light.size
        out.has_history, out.has_movers = int(has_history), int(has_movers)
        out.starts_with_pcss, out.start_weight = int(p.start == "pcss"), p.start_weight
        out.blocker_taps, out.filter_taps = (pull_taps(frame, "box", n) for n in (p.blocker_taps, p.filter_taps))
        out.first_blockers = float(p.blocker_taps) if p.start == "pcss" else 0.0
        out.depth_epsilon = p.depth_epsilon * frame.reach
        out.texel_steps = BILINEAR if p.history == "bilinear" else NEAREST
        out.smooths, out.error_threshold = int(p.filter), p.error_threshold
        out.narrows = int(p.filter_width == "error")
        return out
