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
- ``turned_away``: history spreads the lit rim of curved casters over their dark side and back, as both pass the depth
  test. What the whole light lies behind is dark at once, holds no history and gives none; ``tested`` is the
  published form.
- ``agreement``: a moving eye interpolates history anew in every frame. Where its texels differ n is limited to what the
  difference is worth (``temporal.sample_window``). ``largest_n`` is a fixed window in its place, and ``stop_error``
  ends the drawing of a still picture. docs/parts.md has what each of these parts is worth.
- Equation 6 maps a length to the near plane only; here it is pixels, pw H / (2 depth tan(fov / 2)).
- A filter as wide as the penumbra keeps its bias until the error reaches t (psi = 1/2: n = 626), so that errors fall
  with the fourth root of n at best. From SE = 1/4 on its width is in proportion to SE, which follows the samples;
  ``filter_width: penumbra`` is the published filter.
- The Poisson disc of the neighbourhood filter is made of opposite taps, so that its depth range shifts no edge on
  slanted ground; the range itself is that of Schwaerzler 2009.
- Equation 7 counts frames, but only frames with a blocker add to its sum: shadowed samples are counted.
- n stops at 2048 in the published float16 buffer while rho goes on: ``buffer: float16`` halves both at 1024 (float32
  at 2^22). ``cap: false`` leaves that out: a psi of 0.3 reaches 1 near frame 6800.
- ``kept_views``, shadow buffers of views that a cut may come back to, are beyond the paper, and off.
- Under a mover's shadow the sums of a frame are shown, not stored, nor is a start whose blocker search met a mover: the
  next frame starts anew, so that nothing trails. ``movers`` has the ways of Schwaerzler 2009 besides, and none at all.
- ``mover_map: centre`` is their proposal for moving objects (section 5): a second map that holds nothing else
  (``shadow_buffer.mover_shadow``). Movers' shadows then have the faults of percentage-closer soft shadows.
- ``lights`` is their proposal for several lights in one buffer, which sums all alike; here they are weighted by
  radiance (``shadow_buffer.many_lights``). The brightest light's start searches for blockers, the others' are their
  first tests. A mover that only another light sees enters one frame late.
- A light that moves is future work there, by age factors. ``ageing`` has them (``estimators.age_sums``); n is then the
  effective number of tests. By default the window follows the displacement; under a light that stands nothing ages.

Known artefacts: noise and flicker while n is small and where moving and static penumbrae overlap; SE = 0 is false
certainty where all tests agree so far; the filter blurs penumbrae that are still above t; shadows lag a little under a
light that moves; history blurs a little with every frame in which the eye moves, and lags
on surfaces that move by less than epsilon a frame, as points are followed by the camera's motion alone unless
``mover_surfaces`` is ``own_motion``.
"""

from __future__ import annotations

from typing import Literal

import warp as wp
from pydantic import field_validator

from algorithms.technique import Frame, Limit, setting
from algorithms.temporal._shadow_buffer import SKIPS, ShadowBufferTechnique
from algorithms.temporal._shadow_buffer_params import ShadowBufferParams
from wkernels.device.structs import filled
from wkernels.filters.neighbourhood_filter import filter_image
from wkernels.filters.penumbra import check_tap_count, pull_taps
from wkernels.temporal.shadow_buffer.rules import BlockerMean, Smoothing
from wkernels.temporal.shadow_buffer.start import START_PCSS, START_SAMPLE, Start, start_by
from wkernels.temporal.shadow_buffer.step import ShadowStep, count_unsmoothed
from wkernels.workspace.left_out import Because, Omission


class Skip(Omission):
    """What a light without an area saves."""

    TAPS_ALIKE = "taps of starts", Because.NO_AREA


class TcSoftPaper(ShadowBufferTechnique):
    """One light sample a frame, a shadow buffer, a start by PCSS and a filter for show."""

    name = "tc_soft_paper"
    paper = ("scherzer2009tc", "schwaerzler2009", "fernando2005pcss")
    may_leave_out = (*SKIPS, Skip.TAPS_ALIKE)
    limits = (
        Limit(
            equals="multi_shadow_map",
            params={"start": "sample", "filter": False},
            other_params={"samples": 16},
            frames=16,
        ),
    )

    class Params(ShadowBufferParams):
        """Start, filter and storage of the shadow buffer."""

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
        depth_epsilon: float = setting(
            1e-4, "largest depth difference of a point and its history", unit="scene diagonals", gt=0.0, le=1.0
        )
        history: Literal["bilinear", "nearest"] = setting(
            "bilinear", "how the shadow buffer of the last frame is read", unit="name"
        )
        buffer: Literal["float32", "float16"] = setting(
            "float32", "texel format of the shadow buffer; published: float16", unit="name", source="sec. 4"
        )

        @field_validator("blocker_taps", "filter_taps")
        @classmethod
        def _fit_box(cls, taps: int) -> int:
            return check_tap_count(taps, "box")

    def render(self, frame: Frame) -> wp.array:
        if (lit := frame.lit_without_casters(standard_error=0.0)) is not None:
            return lit
        p, step = self.params, self.begin(frame)
        if self.is_settled(frame, step):
            return step.visibility

        # 1. A point that is new starts from soft shadows of the frame's map (section 3.3), of k blockers (equation 7).
        start = self._start(frame, step)
        mean = filled(BlockerMean, first_blockers=float(p.blocker_taps) if p.start == "pcss" else 0.0, counts_tests=0)

        # 2. What is uncertain, by its standard error (equation 3), asks for a filter as wide as its penumbra (6).
        smoothing = filled(
            Smoothing,
            asks=int(p.filter),
            narrows=int(p.filter_width == "error"),
            half_widths=0.5,
            error_threshold=p.error_threshold,
            least_samples=0.0,
        )

        # 3. The test of the light's next point (equation 1) is added to what the point knows (2, 5), where the depth
        #    that was stored with that is its own (4).
        self.add_samples(frame, step, start=start, mean=mean, smoothing=smoothing, epsilon=p.depth_epsilon * frame.span)

        # 4. Shown is psi, smoothed where it was asked for (section 3.3).
        if p.filter:
            count_unsmoothed(frame, step)
        with frame.timed("neighbourhood filter"):
            filter_image(frame, step.psi_depth, step.half_width, p.taps, p.filter_depth_range, step.visibility)

        # 5. Movers may have a map of their own (section 5).
        self.add_movers(frame, step)
        return step.visibility

    def _start(self, frame: Frame, step: ShadowStep) -> Start:
        p = self.params
        if p.start == "sample":
            return start_by(START_SAMPLE)
        counts = [p.blocker_taps, p.filter_taps]
        fewer = 0 if frame.light.has_area else sum(counts) - 2
        if fewer and frame.leave_out(Skip.TAPS_ALIKE, count=fewer):
            counts = [1, 1]
        blocker_taps, filter_taps = (pull_taps(frame, "box", count) for count in counts)
        weight = p.start_weight * step.turns[0].weight
        return start_by(START_PCSS, weight=weight, blocker_taps=blocker_taps, filter_taps=filter_taps)
