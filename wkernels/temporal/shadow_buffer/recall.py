"""What a point's pixel remembers: found in the last frame's shadow buffer, or else in those of earlier views."""

from __future__ import annotations

from typing import Any

import warp as wp

from wkernels.device.lanes import Ints
from wkernels.device.structs import filled
from wkernels.frame.history import History
from wkernels.frame.session import Session
from wkernels.light_maps.point_lanes import PointRun
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import MOVES
from wkernels.scene.views import View
from wkernels.temporal.mesh_motion import pull_mesh_motion
from wkernels.temporal.shadow_buffer.earlier_buffers import EarlierBuffers, fetch_earlier, fetch_earlier_run
from wkernels.temporal.shadow_buffer.record import (
    BILINEAR,
    LINEAR,
    NEAREST,
    ShadowRecord,
    fetch_linear,
    fetch_record,
)
from wkernels.temporal.shadow_buffer.record_lanes import fetch_run, place_run

READINGS = {"bilinear": BILINEAR, "nearest": NEAREST, "linear": LINEAR}


@wp.struct
class Recall:
    """Where a point's history is looked for, and what is taken for it."""

    has_history: int
    depth_epsilon: float  # scene units
    relative_epsilon: float  # share of the stored depth, its rounding included
    texel_steps: float  # BILINEAR, NEAREST or LINEAR
    earlier: EarlierBuffers  # where points that are new to the last frame are looked for
    followed_samples: float  # largest n on moving surfaces, whose history follows them; 0: they are not followed
    motion: wp.array(dtype=wp.mat44)  # (meshes,) from this frame's rebased world to the last frame's; when followed
    normal_motion: wp.array(dtype=wp.mat33)  # the same for normals, not normalised


def recall_from(
    frame: Session,
    history: History,
    earlier: EarlierBuffers | None,
    *,
    reading: str,
    epsilon: float,
    relative: float,
    followed_samples: float,
) -> Recall:
    """How this frame recalls.

    Args:
        frame: The session. history: Its shadow buffer. earlier: Further ones, if any.
        reading: A key of ``READINGS``.
        epsilon: Largest difference of depth, scene units. relative: The same as a share of the stored depth, at least
            its rounding.
        followed_samples: Largest n on surfaces that are followed by their own motion; 0: by the eye's alone.
    """
    then = history.previous_index
    follows = followed_samples > 0.0 and frame.geometry.moving and then is not None
    motion = pull_mesh_motion(frame, then) if follows and then is not None else None
    return filled(
        Recall,
        has_history=int(history.valid),
        depth_epsilon=epsilon,
        relative_epsilon=relative,
        texel_steps=READINGS[reading],
        earlier=earlier or EarlierBuffers(),
        followed_samples=followed_samples if follows else 0.0,
        motion=motion.points if motion else None,
        normal_motion=motion.normals if motion else None,
    )


@wp.func
def fetch_last(
    previous: wp.array2d(dtype=Any), previous_view: View, gbuffer: GBuffer, y: int, x: int, recall: Recall
) -> ShadowRecord:
    """What the last frame knew of a pixel's point, by its own motion where moving surfaces are followed."""
    position_ws = gbuffer.position_ws[y, x]
    normal_ws = gbuffer.normal_ws[y, x]
    is_followed = recall.followed_samples > 0.0 and (gbuffer.flags[y, x] & MOVES) != 0
    if is_followed:
        mesh = gbuffer.mesh[y, x]
        position_ws = wp.transform_point(recall.motion[mesh], position_ws)
        normal_ws = wp.normalize(recall.normal_motion[mesh] * normal_ws)
    result = ShadowRecord()
    if recall.texel_steps > 0.0:
        result = fetch_record(
            previous,
            previous_view,
            position_ws,
            normal_ws,
            recall.depth_epsilon,
            recall.relative_epsilon,
            recall.texel_steps,
        )
    else:
        result = fetch_linear(previous, previous_view, position_ws, recall.depth_epsilon, recall.relative_epsilon)
    if is_followed and result.n > recall.followed_samples:
        # light and shadows pass over a surface that moves: older tests say less and less of it
        result.rho = result.rho * (recall.followed_samples / result.n)
        result.n = recall.followed_samples
    return result


@wp.func
def recall_pixel(
    previous: wp.array2d(dtype=Any), previous_view: View, gbuffer: GBuffer, y: int, x: int, recall: Recall
) -> ShadowRecord:
    """What is known of a pixel's point; n = 0 where it is new."""
    result = fetch_last(previous, previous_view, gbuffer, y, x, recall)
    if result.n <= 0.0 and recall.earlier.count > 0 and (gbuffer.flags[y, x] & MOVES) == 0:
        before = fetch_earlier(
            recall.earlier,
            gbuffer.position_ws[y, x],
            gbuffer.normal_ws[y, x],
            recall.depth_epsilon,
            recall.relative_epsilon,
            wp.where(recall.texel_steps > 0.0, recall.texel_steps, BILINEAR),
        )
        if before.n > 0.0:
            result = before
    return result


@wp.func
def recall_run(
    flat_previous: wp.array(dtype=float),
    previous_view: View,
    gbuffer: GBuffer,
    points: PointRun,
    wanted: Ints,
    x0: int,
    y: int,
    held: int,
    recall: Recall,
):
    """``recall_pixel`` of the lanes that are wanted (1), of ``held`` pixels from (x0, y) on; no surface is followed.

    ``flat_previous`` is flat (4 H W,).
    """
    places = place_run(previous_view, points, wanted, recall.texel_steps)
    history = fetch_run(flat_previous, previous_view, points, places, recall.depth_epsilon, recall.relative_epsilon)
    if recall.earlier.count > 0:
        history = fetch_earlier_run(
            recall.earlier,
            gbuffer,
            x0,
            y,
            held,
            wanted,
            history,
            recall.texel_steps,
            recall.depth_epsilon,
            recall.relative_epsilon,
        )
    return history
