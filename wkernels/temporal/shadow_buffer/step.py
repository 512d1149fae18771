"""One frame of a technique that samples its light over time: a map from the light's next point, and what it adds.

What such techniques share of their host's side; what they differ in is in ``rules``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.device.structs import filled
from wkernels.filters.penumbra import pull_footprint
from wkernels.frame.history import History
from wkernels.frame.session import Session
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.light_motion import own_width
from wkernels.temporal.forgetting import forget_changes
from wkernels.temporal.shadow_buffer.buffer_shelf import BufferShelf, fill_shelf, keep_buffer, pull_shelf
from wkernels.temporal.shadow_buffer.many_lights import JOIN, LightTurn, light_turns, seen_lights
from wkernels.temporal.shadow_buffer.record import TEXEL_TYPES
from wkernels.temporal.shadow_buffer.rules import SampledLight, UpdateRules
from wkernels.temporal.shadow_buffer.stillness import count_still_frames
from wkernels.temporal.shadow_buffer.update_lanes import UPDATE
from wkernels.workspace.left_out import Because, Omission


class StepSkip(Omission):
    """What a step saves."""

    UNTAGGED = "tags of moving casters", Because.NO_CASTER_MOVES
    UNSMOOTHED = "neighbourhoods of pixels", "their error or penumbra is small enough"
    SETTLED = "light sample", "nothing moves and no standard error exceeds stop_error"


@dataclass(frozen=True)
class ShadowStep:
    """What a frame has to do with, images of the G-buffer's shape (H, W).

    Attributes:
        gbuffer: What receives, overscanned.
        history: The shadow buffer; ``current`` is this frame's.
        shelf: Those of earlier views, if any are kept.
        seen: Indices of the lights that psi is of.
        turns: Whose maps are drawn.
        apart: Whether moving casters have a map of their own and psi is of the others alone.
        psi_depth: Hidden share of the light and linear eye depth, vec2; (0, 0) where nothing receives.
        error: Its standard error.
        half_width: The neighbourhood that each pixel asks for, ``update_shadow_buffer``.
        visibility: What is shown.
    """

    gbuffer: GBuffer
    history: History
    shelf: BufferShelf | None
    seen: list[int]
    turns: list[LightTurn]
    apart: bool
    psi_depth: wp.array
    error: wp.array
    half_width: wp.array
    visibility: wp.array


def begin_step(
    frame: Session, *, overscan: float, format: str, lights: str, apart: bool, keeps_buffers: bool
) -> ShadowStep:
    """The frame's buffers, and whose light it is about.

    Args:
        frame: The session.
        overscan: Of the G-buffer and all else.
        format: Of the shadow buffer, a key of ``TEXEL_TYPES``.
        lights: ``asked``, ``drawn`` or ``all``.
        apart, keeps_buffers: See ``ShadowStep``.
    """
    gbuffer = frame.gbuffer(overscan=overscan)
    visibility = frame.visibility_buffer(gbuffer)
    shape, texel = visibility.shape, TEXEL_TYPES[format]
    history = frame.history(
        "shadow buffer", lambda: wp.zeros(shape, dtype=texel, device=frame.device), frame.margin(overscan)
    )
    frame.standard_error = error = frame.buffer("standard error", shape, wp.float32)
    seen = seen_lights(frame, lights)
    sources = [frame.lights.lights[i] for i in seen]
    shelf = pull_shelf(frame, sources, frame.geometry.resting_at) if keeps_buffers else None
    if shelf is not None:
        fill_shelf(frame, shelf, history)
    forget_changes(frame, history, sources)
    return ShadowStep(
        gbuffer=gbuffer,
        history=history,
        shelf=shelf,
        seen=seen,
        turns=light_turns(frame, seen, lights),
        apart=apart,
        psi_depth=frame.buffer("psi and depth", shape, wp.vec2),
        error=error,
        half_width=frame.buffer("half filter width", shape, wp.float32),
        visibility=visibility,
    )


def is_settled(frame: Session, step: ShadowStep, stop_error: float, stop_samples: int) -> bool:
    """Whether the picture of the last frame may stand, as nothing has changed and it is as good as was asked for.

    Every pixel holds ``stop_samples`` tests and a standard error of at most ``stop_error``. What was shown then is
    still in the technique's buffers; the shadow buffer is handed on.
    """
    if stop_error <= 0.0:
        return False
    settled = count_still_frames(frame) >= stop_samples and float(step.error.numpy().max()) <= stop_error
    if settled and frame.leave_out(StepSkip.SETTLED):
        wp.copy(step.history.current, step.history.previous)
        return True
    return False


def add_samples(
    frame: Session, step: ShadowStep, rules: UpdateRules, *, resolution: int, sample_set: str, cull: int
) -> None:
    """Draws the map of the next point of each light whose turn it is, and adds its tests to the shadow buffer.

    The first light recalls, starts and adds; the others join.

    Args:
        frame: The session. step: The frame's. rules: What is done.
        resolution, cull: Of the maps. sample_set: Points of the lights.
    """
    gbuffer, history = step.gbuffer, step.history
    texel, tags = history.current.dtype, bool(rules.movers.tagged)
    for turn in step.turns:
        sample = frame.light_samples(1, sample_set, start=frame.count, light=turn.light)
        light_map = frame.light_map(
            resolution,
            sample.host[0],
            slot=("sample of the frame", turn.slot),
            cull=cull,
            tag_moving_casters=tags,
            caster_set="still" if step.apart else "all",
            light=turn.light,
        )
        light = filled(
            SampledLight,
            weight=float(sample.weights_host[0]) * turn.weight,
            size=own_width(turn.light),
            is_last=int(turn is step.turns[-1]),
        )
        with frame.timed("shadow buffer"):
            inputs = [gbuffer, light_map.map, pull_footprint(frame, light_map), rules, light]
            outputs = [history.current, step.psi_depth, step.error, step.half_width]
            if turn is step.turns[0]:
                before = [history.previous_view or gbuffer.view, history.previous]
                frame.launch(UPDATE[texel], step.error.shape, [*inputs, *before], outputs)
            else:
                frame.launch(JOIN[texel], step.error.shape, inputs, outputs)


def keep_views(frame: Session, step: ShadowStep, views: int, overlap: float) -> None:
    """Has shadow buffers put aside, ``views`` at most, as ``keep_buffer`` says, where any are kept."""
    if step.shelf is not None:
        with frame.timed("kept views"):
            keep_buffer(frame, step.shelf, step.history, step.gbuffer.view, views, overlap)


def count_unsmoothed(frame: Session, step: ShadowStep) -> None:
    """Has the receivers counted that ask for no neighbourhood: their error is small, or their penumbra is."""

    def count() -> int:
        asks = np.abs(step.half_width.numpy()) >= 0.5
        return int(((step.psi_depth.numpy()[..., 1] > 0.0) & ~asks).sum())

    frame.tell(StepSkip.UNSMOOTHED, count=count)
