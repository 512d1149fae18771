"""Hard shadows from maps that jitter, remembered per pixel, weighted by confidence (Scherzer, Jeschke, Wimmer 2007).

Every frame draws one map, shifted by a fraction of a texel (and turned, if wanted) behind any projection. The hard test
s of each pixel is blended with what its point already knows, h = c s + (1 - c) h_prev, where the confidence
c = (1 - 2 max(|dx|, |dy|))^m says how near to the centre of its texel the point lies: there alone the map is right. The
last frame is read by reprojection; a texel of it counts if it saw the same surface, |1 - d / d_prev| < epsilon
(Schwaerzler 2009, equation 5.18). A still image converges to the exact hard shadow, smoothed over 1 / (m + 3) texels,
and the swimming of maps that follow the eye averages out: warped ones have no other remedy (Stingl 2011, sections 3.5
and 8.2.1).

Deviations; the original was not at hand, the formulas are those of the catalogue:
- h = c s + (1 - c) h_prev never settles: a confident test overrides all that came before. By default h is the mean of
  all tests weighted by c / E(c), E(c) = 2 / ((m + 1) (m + 2)), over at most ``memory`` frames; m grows with the root of
  the frames that are known, so that a new point takes its first tests as they are and an old one those at texel
  centres only. ``blend: published`` is the recursion with a constant m.
- Four history texels are interpolated, each with its own depth test on the receiver's plane: the point's own depth
  would reject slanted ground. Every read blurs; the variance of all reads behind a sum is kept beside it, and frames
  are forgotten as ``blur`` demands.
- Pixels shadowed by a moving caster show this frame's test and remember nothing: a shadow that leaves is gone in the
  next frame. ``movers: keep`` blends them like all others: darker than the truth where a shadow was, lighter where it
  is, half of it gone after ``memory`` frames and nine tenths after three times as many.
- The first frame of the plain R2 set has no shift: it is ``shadow_map``.

Known artefacts: noise where little is known (disocclusion, screen border, shadows of moving casters, which alias like
shadow_map's); edges are smoothed over a fraction of a texel, and over ``blur`` pixels while the eye moves, where
details smaller than that fade; a bias displaces shadows as in shadow_map; shadows lag on surfaces that rise by less
than epsilon a frame, as points are followed by the camera's motion alone. Soft lights are reduced to their centre.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from algorithms.technique import Limit, MapParams, Needs, Technique, setting
from wkernels.confidence import (
    LEAST_CONFIDENCE,
    Blending,
    blend_shares,
    chosen_power,
    confidence_of,
    kept_frames,
    read_blur,
)
from wkernels.estimators import hidden_share
from wkernels.frame import Session as Frame
from wkernels.gbuffer import PADDING, GBuffer
from wkernels.geometry import RECEIVES
from wkernels.history_lanes import HistoryRun, PlaceRun, fetch_run, place_run, points_of_run
from wkernels.jitter import frame_jitter
from wkernels.lanes import LANES, Floats, Ints, flat_floats, runs_of, runs_per_row, uses_lanes
from wkernels.light_map import BY_MARGIN, Bias, LightMap
from wkernels.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.reprojection import reproject
from wkernels.shadow_buffer import BILINEAR, NEAREST, ShadowRecord, fetch_record, shadow_test, write_record
from wkernels.views import View


@wp.struct
class HardSettings:
    """How a frame's tests are added."""

    bias: Bias
    blending: Blending
    has_history: int
    depth_epsilon: float  # relative
    texel_steps: float  # BILINEAR or NEAREST


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
    settings: HardSettings,
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
        test = shadow_test(gbuffer, y, x, light_map, settings.bias)
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


@wp.kernel
def add_confident_test_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    flat_previous: wp.array(dtype=float),
    gbuffer: GBuffer,
    light_map: LightMap,
    settings: HardSettings,
    previous_view: View,
    previous: wp.array2d(dtype=wp.vec4),
    current_out: wp.array2d(dtype=wp.vec4),
    visibility_out: wp.array2d(dtype=float),
):
    """``add_confident_test`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    points = points_of_run(views, eye_depth, x0, y)
    receives = points.receives
    receivers = locate_run(views, light_map, settings.bias, x0, y)
    layers = receivers.layer
    own = receivers.depth
    visible = receivers.visible
    xs = receivers.x
    ys = receivers.y

    depth = views.depth
    resolution = light_map.resolution
    tau = Floats(0.0)
    moves = Ints(0)
    wanted = Ints(0)
    nearness = Floats(0.0)
    for k in range(LANES):
        left = wp.floor(xs[k])
        upper = wp.floor(ys[k])
        inside_x = wp.clamp(int(left), 0, resolution - 1)
        inside_y = wp.clamp(int(upper), 0, resolution - 1)
        beyond = wp.where(inside_x != int(left), 1, wp.where(inside_y != int(upper), 1, 0))
        tagged = depth[(wp.max(layers[k], 0) * resolution + inside_y) * resolution + inside_x]
        stored = wp.where(beyond != 0, float(wp.inf), wp.abs(tagged))
        hidden = wp.where(layers[k] >= 0, wp.where(own[k] > stored, 1, 0), 0)
        tau[k] = wp.where(layers[k] >= 0, float(hidden), 1.0 - visible[k])
        moves[k] = wp.where(tagged < 0.0, hidden, 0)
        wanted[k] = wp.where(moves[k] != 0, 0, receives[k])
        off_centre = wp.max(wp.abs(xs[k] - left - 0.5), wp.abs(ys[k] - upper - 0.5))
        nearness[k] = wp.where(layers[k] >= 0, 1.0 - 2.0 * off_centre, 1.0)
    history = HistoryRun()
    places = PlaceRun()
    if settings.has_history != 0:
        places = place_run(previous_view, points, wanted, settings.texel_steps)
        history = fetch_run(flat_previous, previous_view, points, places, 0.0, settings.depth_epsilon)
    held_rho = history.rho
    held_n = history.n
    held_blur = history.blocker_rise
    share_x = places.share_x
    share_y = places.share_y

    memory = settings.blending.memory
    recursive = settings.blending.recursive
    most = settings.blending.blur
    growth = settings.blending.growth
    greatest = settings.blending.power
    kept = Floats(0.0)
    blurs = Floats(0.0)
    powers = Ints(0)
    for k in range(LANES):
        # ``kept_frames`` and ``chosen_power``
        blur = held_blur[k] + 0.5 * (share_x[k] * (1.0 - share_x[k]) + share_y[k] * (1.0 - share_y[k]))
        above = wp.where(blur > most, blur - most, 0.0)
        by_memory = wp.min(held_n[k], memory)
        kept[k] = wp.where(above > 0.0, wp.min(by_memory, most / wp.where(above > 0.0, above, 1.0)), by_memory)
        grown = wp.clamp(int(growth * wp.sqrt(kept[k])) - 1, 0, greatest)
        powers[k] = wp.where(recursive != 0, greatest, grown)
        blurs[k] = blur
    confidence = Floats(1.0)
    for i in range(greatest):
        for k in range(LANES):
            confidence[k] = wp.where(i < powers[k], confidence[k] * nearness[k], confidence[k])

    rho = Floats(0.0)
    n = Floats(0.0)
    psi = Floats(0.0)
    for k in range(LANES):
        # ``blend_shares``
        sure = wp.max(confidence[k], LEAST_CONFIDENCE)
        known = wp.where(kept[k] > 0.0, 1, 0)
        share = wp.where(known != 0, held_rho[k] / wp.where(known != 0, held_n[k], 1.0), 0.0)
        m = float(powers[k])
        least = wp.max(sure, 1.0 / (memory + 1.0))
        weight = wp.where(recursive != 0, least, sure / (2.0 / ((m + 1.0) * (m + 2.0))))
        old = wp.where(recursive != 0, wp.where(known != 0, 1.0 - weight, 0.0), kept[k])
        n[k] = old + weight
        blurs[k] = blurs[k] * old / n[k]
        rho[k] = wp.clamp(share, 0.0, 1.0) * old + weight * tau[k]
        psi[k] = wp.where(receives[k] != 0, wp.clamp(rho[k] / n[k], 0.0, 1.0), 0.0)

    far = gbuffer.view.far
    eye_depths = points.depth
    for k in range(wp.min(LANES, visibility_out.shape[1] - x0)):
        keeps = wp.where(moves[k] != 0, 0.0, float(receives[k]))
        current_out[y, x0 + k] = wp.vec4(
            rho[k] * keeps, n[k] * keeps, eye_depths[k] / far, blurs[k] * float(receives[k])
        )
        visibility_out[y, x0 + k] = 1.0 - psi[k]


class TcHard(Technique):
    """One jittered map a frame, hard tests weighted by their confidence, a history per pixel."""

    name = "tc_hard"
    family = "temporal"
    paper = ("scherzer2007", "schwaerzler2009", "stingl2011")
    needs = Needs(history=True)
    bias_sign = "none"
    limits = (
        Limit(equals="shadow_map", params={"jitter": 0.0, "overscan": 0.0}, frames=8),
        Limit(equals="shadow_map", params={"overscan": 0.0}),  # the first frame: nothing is known, no jitter yet
    )

    class Params(MapParams):
        """Jitter, weights and history."""

        jitter: float = setting(
            1.0,
            "width of the square that the map's shifts fill; 0: no shift, and nothing converges",
            unit="texels",
            source="CATALOGUE tc_hard",
            ge=0.0,
            le=1.0,
        )
        rotation: float = setting(
            0.0,
            "range of the angles that the map is turned by, about the light's direction; texels grow by up to sqrt(2)",
            unit="degrees",
            source="CATALOGUE tc_hard",
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
            source="CATALOGUE tc_hard, 3 to 15",
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
        p = self.params
        gbuffer = frame.gbuffer(overscan=p.overscan)
        visibility = frame.visibility_buffer(gbuffer)
        shape = visibility.shape
        if frame.nothing_casts(visibility):
            return visibility
        history = frame.history(
            "hard shadows", lambda: wp.zeros(shape, dtype=wp.vec4, device=frame.device), frame.margin(p.overscan)
        )
        tags = p.movers == "reset"
        tags = tags and (frame.geometry.moving or not frame.leave_out("tags of moving casters", "nothing moves"))
        seed = 0 if frame.seed == 1 else frame.seed + 1
        jitter = frame_jitter(p.sample_set, frame.count, p.jitter, np.radians(p.rotation), seed)
        light_map = frame.light_map(p.resolution, cull=p.cull, tag_moving_casters=tags, jitter=jitter)
        with frame.timed("hard shadows over time"):
            inputs = [gbuffer, light_map, self._settings(history.valid)]
            inputs += [history.previous_view or gbuffer.view, history.previous]
            outputs = [history.current, visibility]
            if uses_lanes(frame.device) and light_map.selection == BY_MARGIN:
                flat = [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING)]
                flat.append(flat_floats(history.previous))
                runs = (shape[0], runs_per_row(shape[1]))
                frame.launch(add_confident_test_lanes, runs, [*flat, *inputs], outputs)
            else:
                frame.launch(add_confident_test, shape, inputs, outputs)
        return visibility

    def _settings(self, has_history: bool) -> HardSettings:
        p = self.params
        out = HardSettings()
        out.bias, out.has_history, out.depth_epsilon = p.device_bias, int(has_history), p.depth_epsilon
        out.texel_steps = BILINEAR if p.history == "bilinear" else NEAREST
        blending = Blending()
        blending.power, blending.growth = p.power, p.growth
        blending.memory, blending.blur = p.memory, p.blur**2
        blending.recursive = int(p.blend == "published")
        out.blending = blending
        return out
