"""Hard shadows from maps that jitter, remembered per pixel, weighted by confidence (Scherzer, Jeschke, Wimmer 2007).

Every frame draws one map, shifted by a fraction of a texel (and turned, if wanted) behind any projection. The hard test
s of each pixel is blended with what its point already knows, h = c s + (1 - c) h_prev, where the confidence
c = (1 - 2 max(|dx|, |dy|))^m says how near to the centre of its texel the point lies: there alone the map is right. The
last frame is read by reprojection; a texel of it counts if it saw the same surface, |1 - d / d_prev| < epsilon
(Schwaerzler 2009, equation 5.18). A still image converges to the exact hard shadow, smoothed over 1 / (m + 3) texels,
and the swimming of maps that follow the eye averages out: warped ones have no other remedy (Stingl 2011, sections 3.5
and 8.2.1).

Deviations; the original was not at hand, the formulas are our reading of those who cite it:
- h = c s + (1 - c) h_prev never settles: a confident test overrides all that came before. By default h is the mean of
  all tests weighted by c / E(c), E(c) = 2 / ((m + 1) (m + 2)), over at most ``memory`` frames; m grows with the root of
  the frames that are known, so that a new point takes its first tests as they are and an old one those at texel
  centres only. ``blend: published`` is the recursion with a constant m.
- A slope bias allows for half a texel of the receiver's plane. ``scale_bias`` allows only for the point's own distance
  from the centre of its texel: shadows of smooth casters on smooth receivers begin where they should (docs/parts.md),
  but coarse facets that cast upon each other get acne in their creases, so it is off by default.
- Four history texels are interpolated, each with its own depth test on the receiver's plane: the point's own depth
  would reject slanted ground. Every read blurs; the variance of all reads behind a sum is kept beside it, and frames
  are forgotten as ``blur`` demands.
- Pixels shadowed by a moving caster show this frame's test and remember nothing: a shadow that leaves is gone in the
  next frame. ``movers: keep`` blends them like all others: darker than the truth where a shadow was, lighter where it
  is, half of it gone after ``memory`` frames and nine tenths after three times as many.
- The first frame of the plain R2 set has no shift: it is ``shadow_map``.

Known artefacts: noise where little is known (disocclusion, screen border, shadows of moving casters, which alias like
shadow_map's); edges are smoothed over a fraction of a texel, and over ``blur`` pixels while the eye moves, where
details smaller than that fade; a bias displaces shadows as in shadow_map; all lag on surfaces that rise by less than
epsilon a frame, as points are followed by the camera's motion alone. Soft lights are reduced to their centre. Lights
that move are refused: their shadows would trail by the frames that are remembered.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from algorithms.technique import Frame, Limit, MapParams, Needs, Technique, setting
from wkernels.device.structs import filled
from wkernels.projections.jitter import frame_jitter
from wkernels.temporal.confidence.blending import Blending
from wkernels.temporal.confidence.history import ConfidentSettings
from wkernels.temporal.confidence.history_lanes import ADD_CONFIDENT_TEST
from wkernels.temporal.forgetting import forget_changes
from wkernels.temporal.shadow_buffer.record import BILINEAR, NEAREST
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What a scene without movers saves."""

    UNTAGGED = "tags of moving casters", Because.NO_CASTER_MOVES


class TcHard(Technique):
    """One jittered map a frame, hard tests weighted by their confidence, a history per pixel."""

    name = "tc_hard"
    family = "temporal"
    paper = ("scherzer2007", "schwaerzler2009", "stingl2011")
    products = (Product.G_BUFFER, Product.LIGHT_MAP, Product.HISTORY)
    needs = Needs(history=True, still_light=True)
    hard = True
    bias_sign = "none"
    may_leave_out = (Skip.UNTAGGED,)
    limits = (
        Limit(equals="shadow_map", params={"jitter": 0.0, "overscan": 0.0}, frames=8),
        # the first frame: nothing is known, no jitter yet
        Limit(equals="shadow_map", params={"overscan": 0.0}),
    )

    class Params(MapParams):
        """Jitter, weights and history."""

        jitter: float = setting(
            1.0,
            "width of the square that the map's shifts fill; 0: no shift, and nothing converges",
            unit="texels",
            source="Scherzer, Jeschke and Wimmer 2007; the range is our own specification",
            ge=0.0,
            le=1.0,
        )
        rotation: float = setting(
            0.0,
            "range of the angles that the map is turned by, about the light's direction; texels grow by up to sqrt(2)",
            unit="degrees",
            source="Scherzer, Jeschke and Wimmer 2007; the range is our own specification",
            ge=0.0,
            le=90.0,
        )
        sample_set: Literal["halton", "r2", "poisson_disc", "random"] = setting(
            "r2", "point set of the jitter; r2 starts without any", unit="name"
        )
        power: int = setting(
            9,
            "m: exponent of the confidence, constant where published, else its greatest",
            unit="1",
            source="Scherzer, Jeschke and Wimmer 2007; 3 to 15 is our reading",
            ge=0,
            le=64,
        )
        growth: float = setting(
            1.5,
            "m + 1 per square root of the frames that a point remembers",
            unit="frames^-1/2",
            ge=0.0,
            le=1000.0,
        )
        scale_bias: bool = setting(
            False,
            "biases slope and slope_back_face: no more than a point's distance from its texel's centre needs",
            unit="yes/no",
        )
        blend: Literal["mean", "published"] = setting(
            "mean",
            "weighted mean of what is remembered, or h = c s + (1 - c) h_prev",
            unit="name",
            source="Scherzer 2007",
        )
        memory: float = setting(
            256.0,
            "frames that are remembered; published: the confidence is at least 1 / (memory + 1)",
            unit="frames",
            ge=0.0,
            le=1e6,
        )
        movers: Literal["reset", "keep"] = setting(
            "reset",
            "shadows of moving casters: shown and not remembered, or blended like all others",
            unit="name",
            source="Scherzer 2009, sec. 3.4",
        )
        depth_epsilon: float = setting(
            1e-3,
            "largest relative depth difference of a point and its history",
            unit="1",
            source="Schwaerzler 2009, eq. 5.18",
            gt=0.0,
            le=1.0,
        )
        history: Literal["bilinear", "nearest"] = setting("bilinear", "how the last frame is read", unit="name")
        blur: float = setting(
            1.0,
            "standard deviation that repeated reads may blur history by; older frames are forgotten sooner instead",
            unit="pixels",
            gt=0.0,
            le=1000.0,
        )
        overscan: float = setting(
            0.05,
            "how much larger than the frame the history is",
            unit="frame sizes",
            source="Schwaerzler 2009, sec. 5.3",
            ge=0.0,
            le=1.0,
        )

    def render(self, frame: Frame) -> wp.array:
        if (lit := frame.lit_without_casters()) is not None:
            return lit
        p = self.params
        gbuffer = frame.gbuffer(overscan=p.overscan)
        visibility = frame.visibility_buffer(gbuffer)
        shape = visibility.shape
        history = frame.history(
            "hard shadows", lambda: wp.zeros(shape, dtype=wp.vec4, device=frame.device), frame.margin(p.overscan)
        )
        forget_changes(frame, history, [frame.light])
        tags = p.movers == "reset"
        if tags and not frame.geometry.casters_move:
            tags = not frame.leave_out(Skip.UNTAGGED)
        seed = 0 if frame.seed == 1 else frame.seed + 1
        jitter = frame_jitter(p.sample_set, frame.count, p.jitter, np.radians(p.rotation), seed)
        light_map = frame.light_map(p.resolution, cull=p.cull, tag_moving_casters=tags, jitter=jitter)
        with frame.timed("hard shadows over time"):
            inputs = [gbuffer, light_map.map, self._settings(history.valid)]
            inputs += [history.previous_view or gbuffer.view, history.previous]
            frame.launch(ADD_CONFIDENT_TEST, shape, inputs, [history.current, visibility])
        return visibility

    def _settings(self, has_history: bool) -> ConfidentSettings:
        p = self.params
        blending = filled(
            Blending,
            power=p.power,
            growth=p.growth,
            memory=p.memory,
            recursive=int(p.blend == "published"),
            blur=p.blur**2,
        )
        return filled(
            ConfidentSettings,
            bias=p.device_bias,
            scales_bias=int(p.scale_bias),
            blending=blending,
            has_history=int(has_history),
            depth_epsilon=p.depth_epsilon,
            texel_steps=BILINEAR if p.history == "bilinear" else NEAREST,
        )
