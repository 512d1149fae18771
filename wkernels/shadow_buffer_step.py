"""One frame of a technique that samples its light over time: one map from the light's next point, and what it adds.

What such techniques share of their host's side; what they differ in is in ``UpdateSettings``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from wkernels.estimators import FLOAT32_LIMIT, UNLIMITED
from wkernels.filtering import pull_footprint
from wkernels.frame import Session
from wkernels.gbuffer import PADDING, GBuffer
from wkernels.history import History
from wkernels.kept_views import keep_views, pull_view_shelf
from wkernels.lanes import Floats, flat_floats, runs_of, runs_per_row, uses_lanes
from wkernels.light_importance import RECENT, learn, pull_importance, warp_point
from wkernels.light_map import Bias
from wkernels.mesh_motion import pull_mesh_motion
from wkernels.own_umbra import pull_light_corners
from wkernels.receiver_lanes import lane_views
from wkernels.sampling import light_set
from wkernels.shadow_buffer import BILINEAR, LINEAR, NEAREST, TEXEL_TYPES, storage_of
from wkernels.shadow_buffer_lanes import update_shadow_buffer_lanes
from wkernels.shadow_buffer_update import AT_ONCE, DISOCCLUDE, GRADUAL, UPDATE, UpdateSettings
from wkernels.stillness import count_still_frames

MOVERS = {"disocclude": DISOCCLUDE, "at_once": AT_ONCE, "gradual": GRADUAL, "ignore": DISOCCLUDE}
"""Treatment of moving casters' shadows by name; to ``ignore`` them no map is tagged."""

HISTORY = {"bilinear": BILINEAR, "nearest": NEAREST, "linear": LINEAR}


class StepParams(Protocol):
    """Parameters that every step reads."""

    resolution: int
    sample_set: str
    buffer: str
    cap: bool
    history: str
    overscan: float
    movers: str
    mover_decrement: float
    mover_surfaces: str
    mover_samples: float
    turned_away: str
    largest_n: float
    agreement: float
    least_window: float
    stop_error: float
    stop_samples: int
    importance: float
    kept_views: int
    kept_overlap: float

    @property
    def device_bias(self) -> Bias: ...

    @property
    def cull(self) -> int: ...


@dataclass
class ShadowStep:
    """A frame's images, of the G-buffer's shape (H, W).

    Attributes:
        gbuffer: What receives, overscanned.
        history: The shadow buffer; ``current`` is this frame's.
        psi: Hidden share of the light, float32.
        error: Its standard error.
        half_width: The neighbourhood that each pixel asks for, ``update_shadow_buffer``.
    """

    gbuffer: GBuffer
    history: History
    psi: wp.array
    error: wp.array
    half_width: wp.array


def begin_step(frame: Session, gbuffer: GBuffer, p: StepParams) -> tuple[ShadowStep, UpdateSettings]:
    """The frame's buffers, and those settings that parameters of the same name give every technique."""
    shape = gbuffer.depth.shape
    texel = TEXEL_TYPES[p.buffer]
    history = frame.history(
        "shadow buffer", lambda: wp.zeros(shape, dtype=texel, device=frame.device), frame.margin(p.overscan)
    )
    psi, error, half_width = (
        frame.buffer(name, shape, wp.float32) for name in ("psi", "standard error", "half filter width")
    )
    out = UpdateSettings()
    out.bias, out.storage = p.device_bias, storage_of(p.buffer, p.cap)
    out.light_size = 2.0 * np.tan(0.5 * frame.light.size) if frame.light.is_directional else frame.light.size
    if p.turned_away == "dark":
        out.light_corners = pull_light_corners(frame)
    out.window.largest = p.largest_n if p.largest_n < FLOAT32_LIMIT else UNLIMITED
    out.window.agreement, out.window.least = p.agreement, p.least_window
    if p.kept_views > 1:
        out.kept = pull_view_shelf(frame).on_device
    out.has_history = int(history.valid)
    out.has_movers = int(
        p.movers != "ignore"
        and (frame.geometry.moving or not frame.leave_out("tags of moving casters", "nothing moves"))
    )
    out.relative_epsilon, out.texel_steps = out.storage.rounding, HISTORY[p.history]
    out.half_widths, out.effective_share = 0.5, 1.0
    out.movers, out.decrement = int(MOVERS[p.movers]), p.mover_decrement
    if p.mover_surfaces == "own_motion" and frame.geometry.moving and history.previous_index is not None:
        motion = pull_mesh_motion(frame, history.previous_index)
        out.motion, out.normal_motion, out.followed_samples = motion.points, motion.normals, p.mover_samples
    return ShadowStep(gbuffer, history, psi, error, half_width), out


def is_settled(frame: Session, step: ShadowStep, p: StepParams) -> bool:
    """Whether the picture of the last frame may stand, as nothing has changed and it is as good as was asked for.

    Every pixel holds ``stop_samples`` tests and a standard error of at most ``stop_error``. What was shown then is
    still in the technique's buffers; the shadow buffer is handed on.
    """
    if p.stop_error <= 0.0:
        return False
    settled = count_still_frames(frame) >= p.stop_samples and float(step.error.numpy().max()) <= p.stop_error
    if settled and frame.leave_out("light sample", "nothing moves and no standard error exceeds stop_error"):
        wp.copy(step.history.current, step.history.previous)
        return True
    return False


def add_sample(frame: Session, step: ShadowStep, settings: UpdateSettings, p: StepParams) -> None:
    """Draws the map of the light's next point and adds its tests to the shadow buffer."""
    importance = pull_importance(frame)
    if p.importance > 0.0:
        u = light_set(p.sample_set, 1, 3, frame.count, 0 if frame.seed == 1 else frame.seed + 1)
        point, weight, importance.stratum = warp_point(u[0], importance.density(p.importance))
        host = frame.light.sample(point[None])[0]
        settings.weight = weight * float(frame.light.weights(point[None])[0])
    else:
        sample = frame.light_samples(1, p.sample_set, start=frame.count)
        host, settings.weight = sample.host[0], float(sample.weights_host[0])
    importance.weights = [*importance.weights[-RECENT:], settings.weight]
    settings.effective_share = importance.effective_share()
    light_map = frame.light_map(
        p.resolution,
        host,
        slot="sample of the frame",
        cull=p.cull,
        tag_moving_casters=bool(settings.has_movers),
    )
    gbuffer, history, shape = step.gbuffer, step.history, step.psi.shape
    with frame.timed("shadow buffer"):
        inputs = [gbuffer, light_map, pull_footprint(frame, light_map), settings]
        inputs += [history.previous_view or gbuffer.view, history.previous]
        outputs = [history.current, step.psi, step.error, step.half_width]
        in_lanes = p.buffer == "float32" and p.history != "linear"
        if uses_lanes(frame.device) and in_lanes:
            flat = [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING)]
            flat.append(flat_floats(history.previous))
            runs = (shape[0], runs_per_row(shape[1]))
            frame.launch(update_shadow_buffer_lanes, runs, [*flat, *inputs], outputs)
        else:
            frame.launch(UPDATE[TEXEL_TYPES[p.buffer]], shape, inputs, outputs)
        if p.importance > 0.0:
            learn(frame, gbuffer, light_map, settings.bias, step.psi)
        if p.kept_views > 1:
            keep_views(frame, history, gbuffer.view, p.kept_views - 1, p.kept_overlap)
