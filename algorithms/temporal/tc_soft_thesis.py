"""Soft shadows by temporal coherence as in the thesis: blended with a blur in the eye's view (Schwaerzler 2009).

Every frame draws one depth map from the next point of the light (Halton) and adds its hard test tau to what each
point's texel of the *shadow buffer* holds: rho (sum of tests), n (their number), linear eye depth and mean blocker
depth (equations 5.1 to 5.5). The point is found again by reprojection where the relative depth test |1 - d / d'| <
0.001 passes (5.18). A new point's mean blocker depth comes from 16 Poisson taps within 7 texels of the map and is
refined by one sample a frame (5.7, 5.8). Psi is *blurred* over 16 taps to neighbours in the eye's view, as wide as the
penumbra (5.6, 5.9 to 5.12). The standard error s, sqrt(psi (1 - psi) / (n - 1)) (5.3), says what is shown: the blur
while n < 16 or s > s_max, the sampled psi from s_min down, and in between the blend of equations 5.13 and 5.14. Where
the shadow of a moving caster has left, the sums fade out, eta' = eta - Delta (5.15 to 5.17); while it was there every
frame started anew.

The other published variant is ``tc_soft_paper`` (Scherzer et al. 2009). Choices and corrections, each a parameter where
the printed form is worth a look:
- n = 1 has no standard error (5.3 is 0/0): 1.
- ``start``: section 5.2.3 never stores the blur; the shader stores a new point's as 16 samples, rho = 8 (blur + tau)
  (``blur``). One map's blur then outweighs the next 16. docs/parts.md has what this and other parts are worth.
- ``pixel_size``: equations 5.9 and 5.10 give a length on the near plane, the shader divides 0.1 by the depth; both take
  the frame's height for 1. Here it is pixels. The published radius is a whole penumbra width (``filter_radius: 1``),
  which blurs twice as wide as the penumbra is.
- ``kernel``: opposite taps, as depth ranges cut the asymmetric published set to a shift of edges on slanted ground.
- ``zero_blur``: the shader takes a neighbourhood that is wholly lit for none.
- ``blocker_mean``: equation 5.7 counts all frames, where only those with a blocker add to the sum.
- ``movers``: ``gradual`` is the text's, with Delta net of the frame's own test, or n would stand still at the shader's
  Delta = 1; ``at_once`` is the shader, which drops everything in one frame.
- ``turned_away``: surfaces behind which the whole light lies are dark at once and take no part in history, which would
  spread the lit rim of curved casters over them.
- ``agreement``: n of history whose texels differ is limited to what that is worth (``temporal.sample_window``).
- ``history``: ``linear`` is the shader's; it mixes tags and sentinels of four texels. ``bilinear`` tests each texel, on
  the receiver's plane.
- ``mover_map: centre``: as in ``tc_soft_paper``.
- ``lights``: as in ``tc_soft_paper``.
- ``ageing``: light that moves is left open there (section 5.4.1); as in ``tc_soft_paper``.
- ``kept_views``: shadow buffers of earlier views; not published.
- s_min and s_max are the shader's, 1/50 and 1/5; the text's example has 1/32 and 1/8. The gate is the text's n < 16.
- Divisions by a depth or count of 0 (5.18 on the first frame) are guarded. The blur reads this frame's psi, as in the
  text; the shader reads the last frame's. A search that meets a moving blocker tags its pixel, too.

Known artefacts: with ``start: blur`` a bias of up to 16 |blur - psi| / n; false certainty (s = 0) where all tests agree
so far; noise where moving and static penumbrae overlap, as every frame there starts anew; a mover behind a static
caster, as the light sees it, leaves no tag; lag on surfaces that move by less than epsilon a frame.
"""

from __future__ import annotations

from typing import Any, Literal

import warp as wp
from pydantic import model_validator

from algorithms.technique import Frame, Limit, setting
from algorithms.temporal._shadow_buffer import SKIPS, ShadowBufferTechnique
from algorithms.temporal._shadow_buffer_params import Movers, ShadowBufferParams
from wkernels.device.structs import filled
from wkernels.filters.neighbourhood_filter import pull_opposite_taps
from wkernels.filters.penumbra import pull_taps
from wkernels.temporal.neighbourhood_blend import BLEND, BlendSettings
from wkernels.temporal.shadow_buffer.rules import BlockerMean, Smoothing
from wkernels.temporal.shadow_buffer.start import START_SAMPLE, START_SEARCH, Start, start_by
from wkernels.temporal.shadow_buffer.step import ShadowStep, count_unsmoothed
from wkernels.workspace.left_out import Because, Omission


class Skip(Omission):
    """What a light without an area saves."""

    POINTLESS = "blocker searches and neighbourhoods", Because.NO_AREA


class TcSoftThesis(ShadowBufferTechnique):
    """One light sample a frame, a shadow buffer, and a blur in the eye's view that gives way to the samples."""

    name = "tc_soft_thesis"
    paper = ("schwaerzler2009", "scherzer2009tc")
    may_leave_out = (*SKIPS, Skip.POINTLESS)
    limits = (Limit(equals="multi_shadow_map", params={"filter": False}, other_params={"samples": 16}, frames=16),)

    class Params(ShadowBufferParams):
        """Start, blending and storage of the shadow buffer."""

        start: Literal["sample", "blur"] = setting(
            "sample",
            "what a new point stores: its test alone (the text), or its mean with the neighbourhood's (the shader)",
            unit="name",
            source="sec. 5.2.3; app. A",
        )
        start_weight: float = setting(
            16.0, "samples that a start by blur counts as", unit="samples", source="app. A", ge=1, le=4096
        )
        blocker_taps: int = setting(
            16, "taps of a new point's blocker search", unit="taps", source="app. A", ge=1, le=4096
        )
        search_radius: float = setting(7.0, "reach of that search", unit="texels", source="app. A", ge=0.0, le=1024.0)
        blocker_mean: Literal["blockers", "frames"] = setting(
            "blockers",
            "what the mean blocker depth is divided by; published: frames",
            unit="name",
            source="eq. 5.7, 5.8",
        )
        taps: int = setting(
            16, "taps of the neighbourhood", unit="taps", source="sec. 5.2.3", ge=2, le=4096, multiple_of=2
        )
        kernel: Literal["opposite", "poisson"] = setting(
            "opposite", "how they lie: in opposite pairs, or as published: poisson", unit="name", source="app. A"
        )
        filter_radius: float = setting(
            0.5, "radius of the neighbourhood; published: 1", unit="penumbra widths", source="eq. 5.11", gt=0.0, le=10.0
        )
        pixel_size: Literal["projected", "near_plane", "shader"] = setting(
            "projected",
            "how a penumbra's width becomes pixels; published: near_plane (near / z of the frame's height) and, in the "
            "shader, 0.1 / z",
            unit="name",
            source="eq. 5.9, 5.10; app. A",
        )
        least_error: float = setting(
            0.02, "s_min: standard error from which down psi stands alone", unit="1", source="app. A", ge=0.0, le=1.0
        )
        largest_error: float = setting(
            0.2, "s_max: standard error from which up the blur does", unit="1", source="app. A", ge=0.0, le=1.0
        )
        least_samples: float = setting(
            16.0, "n below which the blur stands alone; the shader's: 17", unit="samples", source="sec. 5.2.4", ge=0.0
        )
        zero_blur: Literal["taken", "rejected"] = setting(
            "taken", "a neighbourhood that is wholly lit; published: rejected", unit="name", source="app. A"
        )
        depth_epsilon: float = setting(
            1e-3,
            "largest depth difference of a point and its history",
            unit="eye depths",
            source="app. A",
            gt=0.0,
            le=1.0,
        )
        history: Literal["bilinear", "nearest", "linear"] = setting(
            "bilinear", "how the last frame's shadow buffer is read; published: linear", unit="name", source="app. A"
        )
        buffer: Literal["float32", "float16"] = setting(
            "float32", "texel format of the shadow buffer", unit="name", source="sec. 5.3"
        )
        movers: Movers = setting(
            "gradual",
            "shadows of moving casters: faded out when they leave; dropped at once (the shader); never stored, every "
            "frame starts anew; or treated as any other",
            unit="name",
            source="sec. 5.2.5, app. A",
        )

        @model_validator(mode="after")
        def _order_errors(self) -> Any:
            if self.least_error > self.largest_error:
                raise ValueError(
                    f"least_error {self.least_error:g} is above largest_error {self.largest_error:g}: "
                    "the blend needs s_min <= s_max"
                )
            return self

    def render(self, frame: Frame) -> wp.array:
        if (lit := frame.lit_without_casters(standard_error=0.0)) is not None:
            return lit
        p, step = self.params, self.begin(frame)
        if self.is_settled(frame, step):
            return step.visibility

        # 1. A new point searches for blockers (section 5.2.3), whose mean is refined from frame to frame (5.7, 5.8).
        still = not frame.geometry.casters_move  # else the search tags pixels that a mover will shadow
        blurs = p.filter and not (still and not frame.light.has_area and frame.leave_out(Skip.POINTLESS))
        start = self._search(frame) if blurs else start_by(START_SAMPLE)
        mean = filled(
            BlockerMean,
            first_blockers=float(p.blocker_taps) if blurs else 0.0,
            counts_tests=int(p.blocker_mean == "frames"),
        )

        # 2. What is uncertain asks for a neighbourhood as wide as its penumbra (5.6, 5.9 to 5.12).
        smoothing = filled(
            Smoothing,
            asks=int(blurs),
            narrows=0,
            half_widths=p.filter_radius * self._width_error(frame),
            error_threshold=p.least_error,
            least_samples=p.least_samples,
        )
        if blurs:
            count_unsmoothed(frame, step)

        # 3. The test of the light's next point is added to what the point knows (5.1 to 5.5, 5.15 to 5.18).
        self.add_samples(frame, step, start=start, mean=mean, smoothing=smoothing, relative=p.depth_epsilon)

        # 4. Shown is a blend of psi and its neighbourhood's mean (5.13, 5.14).
        self._blend(frame, step)

        # 5. Movers may have a map of their own.
        self.add_movers(frame, step)
        return step.visibility

    def _search(self, frame: Frame) -> Start:
        p = self.params
        return start_by(
            START_SEARCH,
            blocker_taps=pull_taps(frame, "poisson", p.blocker_taps),
            search_radius=p.search_radius,
            stores_smoothed=p.start == "blur",
        )

    def _width_error(self, frame: Frame) -> float:
        """The factor by which a penumbra's width in pixels is wrong: 1, or as published."""
        view = frame.eye(frame.margin(self.params.overscan))
        height_at_1 = view.window[3] - view.window[2]
        near = {"projected": 1.0 / height_at_1, "near_plane": view.near, "shader": 0.1}[self.params.pixel_size]
        return near * height_at_1

    def _blend(self, frame: Frame, step: ShadowStep) -> None:
        p, texels = self.params, step.history.current
        settings = filled(
            BlendSettings,
            depth_range=p.filter_depth_range,
            least_error=p.least_error,
            largest_error=p.largest_error,
            least_samples=p.least_samples,
            start_weight=p.start_weight,
            rejects_lit=int(p.zero_blur == "rejected"),
        )
        with frame.timed("neighbourhood blend"):
            taps = pull_opposite_taps(frame, p.taps) if p.kernel == "opposite" else pull_taps(frame, "poisson", p.taps)
            inputs = [step.psi_depth, step.error, step.half_width, taps, settings]
            frame.launch(BLEND[texels.dtype], step.visibility.shape, inputs, [texels, step.visibility])
