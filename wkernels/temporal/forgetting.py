"""History is forgotten where a caster comes to rest, or leaves it.

What moves is kept out of history: its shadow is tagged, or has maps of its own. What rests is in history like all that
stands still (``scene.rest``). Where a caster goes from the one to the other, the sums of what it may have hidden, or
hides now, are those of another scene. They are dropped in that frame, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from wkernels.frame.history import History
from wkernels.frame.session import Session
from wkernels.scene.lights import Light
from wkernels.scene.views import View, pixel_along_ws, pixel_base_ws
from wkernels.temporal.reach import MoverReach, may_reach, mover_reach


@wp.func
def forgotten(texel: wp.vec4) -> wp.vec4:
    """A texel without its sums; its depth and what else it holds stay."""
    return wp.vec4(0.0, 0.0, texel[2], texel[3])


@wp.func  # type: ignore[no-redef]
def forgotten(texel: wp.vec4h) -> wp.vec4h:
    """The same of float16."""
    return wp.vec4h(wp.float16(0.0), wp.float16(0.0), texel[2], texel[3])


@wp.kernel
def forget_reached(
    first: int,
    view: View,
    depth_unit: float,
    reaches: wp.array(dtype=MoverReach),
    texels_out: wp.array2d(dtype=Any),
):
    """Clears the sums of texels that one of some casters may shadow.

    Args:
        first: Tile offset.
        view: The eye's view that the texels were written for.
        depth_unit: Of the stored depth, scene units.
        reaches: Where the casters' shadows may fall.
        texels_out: Sums first and second, linear eye depth third, its sign aside; (H, W).
    """
    row, x = wp.tid()
    y = first + row
    texel = texels_out[y, x]
    depth = wp.abs(float(texel[2])) * depth_unit
    column = float(x) + 0.5
    line = float(y) + 0.5
    position_ws = pixel_base_ws(view, column, line) + depth * pixel_along_ws(view, column, line)
    reached = bool(False)
    for i in range(reaches.shape[0]):
        reached = reached or may_reach(reaches[i], position_ws)
    if reached:
        texels_out[y, x] = forgotten(texel)


FORGET = {texel: wp.overload(forget_reached, {"texels_out": wp.array2d(dtype=texel)}) for texel in (wp.vec4, wp.vec4h)}


def reached_by_change(frame: Session, then: int, lights: Sequence[Light]) -> list[MoverReach]:
    """Where casters may cast, or cast then, that rest in one of two frames, or stand elsewhere in both.

    Args:
        frame: The session, at its frame.
        then: The earlier frame.
        lights: Whose shadows are asked for, rebased world.
    """
    geometry, out = frame.geometry, []
    for i, mesh in enumerate(geometry.meshes):
        if not (mesh.casts and mesh.moving):
            continue
        rested, rests = (geometry.poses.rests(i, index) for index in (then, frame.index))
        before, now = (geometry.poses.at(i, index) for index in (then, frame.index))
        if rested == rests and (not rests or np.array_equal(before, now)):
            continue
        boxes = [box for index in {then, frame.index} if (box := geometry.box(i, index)) is not None]
        out += [mover_reach(light, box[0], box[1]) for light in lights for box in boxes]
    return out


def forget_changes(frame: Session, history: History, lights: Sequence[Light], depth_unit: float | None = None) -> None:
    """Clears the last frame's sums where casters have come to rest since, or have left it.

    Args:
        frame: The session.
        history: Of vec4 or vec4h texels, as ``forget_reached`` has them.
        lights: Whose shadows the sums are of, rebased world.
        depth_unit: Of the stored depth; the far plane of the view it was written for unless given.
    """
    then, view = history.previous_index, history.previous_view
    if then is None or view is None or not frame.geometry.moving:
        return
    reaches = reached_by_change(frame, then, lights)
    if reaches:
        texels = history.previous
        with frame.timed("history of what rests"):
            on_device = wp.array(reaches, dtype=MoverReach, device=frame.device)
            inputs = [view, view.far if depth_unit is None else depth_unit, on_device]
            frame.launch(FORGET[texels.dtype], texels.shape, inputs, [texels])
