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

from typing import ClassVar, Literal

import numpy as np
import warp as wp
from pydantic import field_validator

from algorithms.technique import Limit, MapParams, Needs, Technique, setting
from wkernels.filtering import check_tap_count, pull_footprint, pull_taps
from wkernels.frame import Session as Frame
from wkernels.gbuffer import PADDING
from wkernels.lanes import Floats, flat_floats, runs_of, runs_per_row, uses_lanes
from wkernels.neighbourhood_filter import filter_neighbourhood, filter_neighbourhood_lanes, pull_opposite_taps
from wkernels.receiver_lanes import lane_views
from wkernels.shadow_buffer import BILINEAR, NEAREST, TEXEL_TYPES, storage_of
from wkernels.shadow_buffer_lanes import update_shadow_buffer_lanes
from wkernels.shadow_buffer_update import UPDATE, UpdateSettings


class TcSoftPaper(Technique):
    """One light sample a frame, a shadow buffer, a start by PCSS and a filter for show."""

    name = "tc_soft_paper"
    family = "temporal"
    paper = ("scherzer2009tc", "schwaerzler2009", "fernando2005pcss")
    needs = Needs(area=True, history=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "no texel falls on a receiver in whose plane the light lies"
    }
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
            outputs = [history.current, psi, error, half_width]
            if uses_lanes(frame.device) and p.buffer == "float32":
                flat = [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING)]
                flat.append(flat_floats(history.previous))
                runs = (shape[0], runs_per_row(shape[1]))
                frame.launch(update_shadow_buffer_lanes, runs, [*flat, *inputs], outputs)
            else:
                frame.launch(UPDATE[texel], shape, inputs, outputs)

        # 3: smoothed where that is still uncertain
        with frame.timed("neighbourhood filter"):
            filtered = [psi, half_width]
            options = [pull_opposite_taps(frame, p.taps), p.filter_depth_range]
            if uses_lanes(frame.device):
                images = [gbuffer.flags.flatten(), *(flat_floats(image) for image in (gbuffer.depth, *filtered))]
                runs = (shape[0], runs_per_row(shape[1]))
                frame.launch(filter_neighbourhood_lanes, runs, [*images, *options], [visibility])
            else:
                frame.launch(filter_neighbourhood, shape, [gbuffer, *filtered, *options], [visibility])
        return visibility

    def _settings(self, frame: Frame, weight: float, has_history: bool, has_movers: bool) -> UpdateSettings:
        p = self.params
        out = UpdateSettings()
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
