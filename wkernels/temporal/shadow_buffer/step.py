"""One frame of a technique that samples its light over time: one map from the light's next point, and what it adds.

What such techniques share of their host's side; what they differ in is in ``UpdateSettings``.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import warp as wp

from wkernels.device.lanes import Floats, flat_floats, runs_of, runs_per_row, uses_lanes
from wkernels.filters.penumbra import pull_footprint
from wkernels.filters.penumbra_lanes import flat_half_axes
from wkernels.frame.history import History
from wkernels.frame.session import Session
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import Bias
from wkernels.light_maps.receiver_lanes import lane_views
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.sampling.estimators import FLOAT32_LIMIT, UNLIMITED
from wkernels.scene.light_motion import ageing_window, displacement
from wkernels.scene.lights import Light
from wkernels.temporal.light_importance import draw_important, learn
from wkernels.temporal.mesh_motion import pull_mesh_motion
from wkernels.temporal.shadow_buffer.kept_views import fill_shelf, keep_view, pull_view_shelf
from wkernels.temporal.shadow_buffer.many_lights import JOIN, Lights, drawn_light, light_weights
from wkernels.temporal.shadow_buffer.mover_shadow import add_mover_shadows, has_own_map
from wkernels.temporal.shadow_buffer.own_umbra import pull_light_corners
from wkernels.temporal.shadow_buffer.record import BILINEAR, LINEAR, NEAREST, TEXEL_TYPES, storage_of
from wkernels.temporal.shadow_buffer.stillness import count_still_frames
from wkernels.temporal.shadow_buffer.update import AT_ONCE, DISOCCLUDE, GRADUAL, UPDATE, UpdateSettings
from wkernels.temporal.shadow_buffer.update_lanes import update_shadow_buffer_lanes
from wkernels.workspace.left_out import Because, Omission

MOVERS = {"disocclude": DISOCCLUDE, "at_once": AT_ONCE, "gradual": GRADUAL, "ignore": DISOCCLUDE}
"""Treatment of moving casters' shadows by name; to ``ignore`` them no map is tagged."""


class StepSkip(Omission):
    """What a step saves."""

    UNTAGGED = "tags of moving casters", Because.NO_CASTER_MOVES
    UNSMOOTHED = "neighbourhoods of pixels", "their error or penumbra is small enough"
    SETTLED = "light sample", "nothing moves and no standard error exceeds stop_error"


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
    mover_map: str
    mover_taps: int
    mover_overlap: str
    lights: str
    ageing: str
    age_factor: float
    age_displacement: float
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
        psi_depth: Hidden share of the light and linear eye depth, vec2; (0, 0) where nothing receives.
        error: Its standard error.
        half_width: The neighbourhood that each pixel asks for, ``update_shadow_buffer``.
        apart: Whether moving casters have a map of their own and psi is of the others alone.
    """

    gbuffer: GBuffer
    history: History
    psi_depth: wp.array
    error: wp.array
    half_width: wp.array
    apart: bool


def begin_step(frame: Session, gbuffer: GBuffer, p: StepParams) -> tuple[ShadowStep, UpdateSettings]:
    """The frame's buffers, and those settings that parameters of the same name give every technique."""
    shape = gbuffer.depth.shape
    texel = TEXEL_TYPES[p.buffer]
    history = frame.history(
        "shadow buffer", lambda: wp.zeros(shape, dtype=texel, device=frame.device), frame.margin(p.overscan)
    )
    psi_depth = frame.buffer("psi and depth", shape, wp.vec2)
    error, half_width = (frame.buffer(name, shape, wp.float32) for name in ("standard error", "half filter width"))
    out = UpdateSettings()
    out.bias, out.storage = p.device_bias, storage_of(p.buffer, p.cap)
    out.light_size = light_size(frame)
    # what turns away from one light may face another: their tests tell
    if p.turned_away == "dark" and not several_lights(frame, p):
        out.light_corners = pull_light_corners(frame)
    out.window.largest = p.largest_n if p.largest_n < FLOAT32_LIMIT else UNLIMITED
    out.window.agreement, out.window.least = p.agreement, p.least_window
    out.has_history = int(history.valid)
    apart = has_own_map(frame, p)
    if keeps_views(frame, p):
        out.kept = fill_shelf(frame, pull_view_shelf(frame, seen_lights(frame, p)), history)
    out.has_movers = int(
        not apart and p.movers != "ignore" and (frame.geometry.casters_move or not frame.leave_out(StepSkip.UNTAGGED))
    )
    out.relative_epsilon, out.texel_steps = out.storage.rounding, HISTORY[p.history]
    out.half_widths, out.effective_share = 0.5, 1.0
    out.movers, out.decrement = int(MOVERS[p.movers]), p.mover_decrement
    if p.mover_surfaces == "own_motion" and frame.geometry.moving and history.previous_index is not None:
        motion = pull_mesh_motion(frame, history.previous_index)
        out.motion, out.normal_motion, out.followed_samples = motion.points, motion.normals, p.mover_samples
    if history.previous_index is not None:
        seen = range(len(frame.lights.lights)) if several_lights(frame, p) else [frame.lights.index]
        # sums of several lights age as the one that goes furthest wants it
        moved = max(displacement(frame.lights.lights[i], frame.lights.at(history.previous_index, i)) for i in seen)
        out.light_window = ageing_window(moved, p.ageing, p.age_factor, p.age_displacement)
    return ShadowStep(gbuffer, history, psi_depth, error, half_width, apart), out


def is_settled(frame: Session, step: ShadowStep, p: StepParams) -> bool:
    """Whether the picture of the last frame may stand, as nothing has changed and it is as good as was asked for.

    Every pixel holds ``stop_samples`` tests and a standard error of at most ``stop_error``. What was shown then is
    still in the technique's buffers; the shadow buffer is handed on.
    """
    if p.stop_error <= 0.0:
        return False
    settled = count_still_frames(frame) >= p.stop_samples and float(step.error.numpy().max()) <= p.stop_error
    if settled and frame.leave_out(StepSkip.SETTLED):
        wp.copy(step.history.current, step.history.previous)
        return True
    return False


def count_unsmoothed(frame: Session, step: ShadowStep) -> None:
    """Has the receivers counted that ask for no neighbourhood: their error is small, or their penumbra is."""

    def count() -> int:
        asks = np.abs(step.half_width.numpy()) >= 0.5
        return int(((step.psi_depth.numpy()[..., 1] > 0.0) & ~asks).sum())

    frame.tell(StepSkip.UNSMOOTHED, count=count)


def add_sample(frame: Session, step: ShadowStep, settings: UpdateSettings, p: StepParams) -> None:
    """Draws the map of the light's next point and adds its tests to the shadow buffer; or those of several lights."""
    if not several_lights(frame, p):
        _update(frame, step, settings, p)
    else:
        _update_by_several(frame, step, settings, p)
    if keeps_views(frame, p):
        with frame.timed("kept views"):
            shelf = pull_view_shelf(frame, seen_lights(frame, p))
            keep_view(frame, shelf, step.history, step.gbuffer.view, p.kept_views - 1, p.kept_overlap)


def keeps_views(frame: Session, p: StepParams) -> bool:
    """Whether buffers of earlier views are kept; not where they hold old shadows of movers that nothing tags."""
    untagged = p.movers == "ignore" and p.mover_map == "none" and frame.geometry.casters_move
    return p.kept_views > 1 and not untagged


def seen_lights(frame: Session, p: StepParams) -> list[Light]:
    """The lights that psi is of."""
    return list(frame.lights.lights) if several_lights(frame, p) else [frame.light]


def _update_by_several(frame: Session, step: ShadowStep, settings: UpdateSettings, p: StepParams) -> None:
    weights, asked = light_weights(frame.lights.lights), frame.lights.index
    try:
        if p.lights == "drawn":
            frame.lights.index = drawn_light(weights, frame.count)
            settings.light_size = light_size(frame)
            _update(frame, step, settings, p)
        else:
            _update_by_all(frame, step, settings, p, weights)
    finally:
        frame.lights.index = asked


def several_lights(frame: Session, p: StepParams) -> bool:
    """Whether psi is of all lights together; with one light there is no difference."""
    return p.lights != "asked" and len(frame.lights.lights) > 1


def light_size(frame: Session) -> float:
    """L of the penumbra formulas: scene units, or 2 tan(angle / 2)."""
    return float(2.0 * np.tan(0.5 * frame.light.size)) if frame.light.is_directional else frame.light.size


def _update_by_all(
    frame: Session, step: ShadowStep, settings: UpdateSettings, p: StepParams, weights: np.ndarray
) -> None:
    """The brightest light starts and fetches; the others join."""
    worth = 1.0 / float((weights**2).sum())
    order = [int(i) for i in np.argsort(-weights, kind="stable")]
    order = [i for i in order if weights[i] > 0.0 or not frame.leave_out(Lights.BLACK_LIGHT)]
    movers = settings.movers
    settings.start_weight = float(settings.start_weight) * float(weights[order[0]]) * worth
    settings.light_window = float(settings.light_window) * worth
    settings.decrement = float(settings.decrement) + worth * (1.0 - float(weights[order[0]]))  # net of all their tests
    if settings.movers == DISOCCLUDE:
        settings.movers = int(AT_ONCE)  # sums of this frame must last until all lights have joined
    for place, index in enumerate(order):
        frame.lights.index = index
        settings.light_size = light_size(frame)
        if place == 0:
            _update(frame, step, settings, p, float(weights[index]) * worth, index)
            settings.movers = movers
            continue
        light_map, sample_weight = _draw(frame, step, settings, p, index)
        settings.weight = sample_weight * float(weights[index]) * worth
        with frame.timed("shadow buffer"):
            inputs = [step.gbuffer, light_map.map, pull_footprint(frame, light_map), settings]
            outputs = [step.history.current, step.psi_depth, step.error, step.half_width]
            kernel = JOIN[TEXEL_TYPES[p.buffer]]
            frame.launch(kernel, step.error.shape, [*inputs, int(place == len(order) - 1)], outputs)


def _draw(
    frame: Session, step: ShadowStep, settings: UpdateSettings, p: StepParams, slot: Hashable
) -> tuple[HostMap, float]:
    """The map of the next point of the light that is asked for, and the point's weight."""
    if p.importance > 0.0:
        importance = draw_important(frame, p.sample_set, p.importance)
        host, weight, settings.effective_share = importance.host, importance.weight, importance.effective_share()
    else:
        sample = frame.light_samples(1, p.sample_set, start=frame.count)
        host, weight = sample.host[0], float(sample.weights_host[0])
    light_map = frame.light_map(
        p.resolution,
        host,
        slot=("sample of the frame", slot),
        cull=p.cull,
        tag_moving_casters=bool(settings.has_movers),
        casters="still" if step.apart else "all",
    )
    return light_map, weight


def _update(
    frame: Session,
    step: ShadowStep,
    settings: UpdateSettings,
    p: StepParams,
    weight: float = 1.0,
    slot: Hashable = "centre",
) -> None:
    light_map, sample_weight = _draw(frame, step, settings, p, slot)
    settings.weight = sample_weight * weight
    gbuffer, history, shape = step.gbuffer, step.history, step.error.shape
    with frame.timed("shadow buffer"):
        footprint = pull_footprint(frame, light_map)
        maps = [gbuffer, light_map.map, footprint]
        inputs = [settings, history.previous_view or gbuffer.view, history.previous]
        outputs = [history.current, step.psi_depth, step.error, step.half_width]
        in_lanes = p.buffer == "float32" and p.history != "linear"
        if uses_lanes(frame.device) and in_lanes:
            flat = [lane_views(gbuffer, light_map.map), runs_of(gbuffer.depth, Floats, PADDING)]
            flat.append(flat_floats(history.previous))
            inputs.insert(0, flat_half_axes(footprint))
            runs = (shape[0], runs_per_row(shape[1]))
            frame.launch(update_shadow_buffer_lanes, runs, [*flat, *maps, *inputs], outputs)
        else:
            frame.launch(UPDATE[TEXEL_TYPES[p.buffer]], shape, [*maps, *inputs], outputs)
    if p.importance > 0.0:
        learn(frame, gbuffer, light_map.map, settings.bias, step.psi_depth)


def end_step(frame: Session, step: ShadowStep, p: StepParams, visibility_out: wp.array) -> None:
    """Adds to what is shown what only the step knows of: the shadows of movers that have a map of their own."""
    if step.apart:
        add_mover_shadows(frame, step.gbuffer, p, visibility_out, step.error)
