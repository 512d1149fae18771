"""Shadow buffers of earlier views, kept so that a cut back to them does not begin anew.

A buffer is put aside once the eye has left a share of what it holds: by a cut at once, or step by step by a turn or a
flight. Points that are new to the last frame's buffer are looked for in those, and what knows most of a point is taken.
A kept buffer takes 16 bytes a pixel. Nothing is read of moving casters' shadows, nor anything once the light has moved.
docs/parts.md has what they are worth.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from wkernels.device.structs import filled
from wkernels.frame.history import History
from wkernels.scene.lights import Light
from wkernels.scene.views import View, pixel_along_ws, pixel_base_ws
from wkernels.temporal.reprojection import is_inside, is_same_depth, reproject
from wkernels.temporal.shadow_buffer.earlier_buffers import EarlierBuffers
from wkernels.temporal.shadow_buffer.record import TEXEL_TYPES, read_record
from wkernels.workspace.workspace import Workspace

PROBES = (18, 32)  # rows and columns of points by which overlaps are measured
REDUNDANT = 0.75  # share of a kept buffer's points that another view sees, from which on one of both is enough
SAME_DEPTH = wp.constant(0.02)  # share of the depth within which a probe is taken for seen: it is a matter of shares
WELL_KNOWN = 64.0  # tests behind a point from which on more are no reason to keep it


@wp.kernel
def probe_points(first: int, texels: wp.array2d(dtype=Any), view: View, points_out: wp.array2d(dtype=wp.vec4)):
    """Points of a shadow buffer on a coarse grid, and what is known of each.

    Args:
        first: Tile offset.
        texels: The buffer, (H, W), written for ``view``.
        view: Where the eye was.
        points_out: Rebased world and n, ``PROBES``; n = 0 where nothing is known.
    """
    row, column = wp.tid()
    line = first + row
    y = (2 * line + 1) * texels.shape[0] // (2 * points_out.shape[0])
    x = (2 * column + 1) * texels.shape[1] // (2 * points_out.shape[1])
    held = read_record(texels, y, x, view.far)
    at_x = float(x) + 0.5
    at_y = float(y) + 0.5
    point = wp.vec3()
    if held.n > 0.0:
        point = pixel_base_ws(view, at_x, at_y) + held.depth * pixel_along_ws(view, at_x, at_y)
    points_out[line, column] = wp.vec4(point[0], point[1], point[2], held.n)


PROBE = {texel: wp.overload(probe_points, {"texels": wp.array2d(dtype=texel)}) for texel in TEXEL_TYPES.values()}


@wp.kernel
def put_aside(first: int, texels: wp.array2d(dtype=Any), slot: int, kept_out: wp.array3d(dtype=wp.vec4)):
    """Copies a shadow buffer, of whatever format, into a slot."""
    row, x = wp.tid()
    y = first + row
    held = texels[y, x]
    kept_out[slot, y, x] = wp.vec4(float(held[0]), float(held[1]), float(held[2]), float(held[3]))


PUT_ASIDE = {texel: wp.overload(put_aside, {"texels": wp.array2d(dtype=texel)}) for texel in TEXEL_TYPES.values()}


@wp.kernel
def see_points(
    first: int,
    points: wp.array2d(dtype=wp.vec4),
    texels: wp.array2d(dtype=Any),
    view: View,
    seen_out: wp.array2d(dtype=int),
):
    """Whether a shadow buffer shows ``probe_points`` of another: inside its view, and at its depth there.

    Args:
        first: Tile offset.
        points: Rebased world and n.
        texels: The buffer, (H, W), written for ``view``.
        view: Where the eye was.
        seen_out: 1 or 0; -1 where the point is none.
    """
    row, column = wp.tid()
    line = first + row
    point = points[line, column]
    seen = int(-1)
    if point[3] > 0.0:
        seen = 0
        at = reproject(view, wp.vec3(point[0], point[1], point[2]))
        if is_inside(view, at[0], at[1]):
            held = read_record(texels, int(at[1]), int(at[0]), view.far)
            if is_same_depth(at[2], held.depth, SAME_DEPTH * held.depth):
                seen = 1
    seen_out[line, column] = seen


SEE = {texel: wp.overload(see_points, {"texels": wp.array2d(dtype=texel)}) for texel in TEXEL_TYPES.values()}


def seen_share(work: Workspace, points: wp.array, texels: wp.array, view: View) -> float:
    """Share of ``probe_points`` that the buffer ``texels`` of ``view`` shows; 1 of none."""
    seen = work.buffer("seen probes", points.shape, wp.int32)
    work.launch(SEE[texels.dtype], points.shape, [points, texels, view], [seen])
    known = seen.numpy()[seen.numpy() >= 0]
    return float(known.mean()) if known.size else 1.0


def _knowledge(points: wp.array) -> float:
    return float(np.minimum(points.numpy()[..., 3], WELL_KNOWN).sum())


@dataclass
class PutAside:
    """A buffer that is to go into a slot before the next frame: the same frame, rendered again, must not find it.

    Attributes:
        slot: Where to. slots: Of the shelf.
        view: Of the buffer.
        points: Its probes, ``PROBES``.
    """

    slot: int
    slots: int
    view: View
    points: wp.array


@dataclass
class BufferShelf:
    """What is kept from frame to frame.

    Attributes:
        on_device: For kernels.
        views: Of each slot in use.
        points: Probes of each slot in use, ``PROBES``.
        anchor: Probes of the first frame since a buffer was put aside last; how much of them is still seen tells how
            far the eye has come.
        sums_of: Whose tests all sums are of: lights, and casters at rest; comparable.
        leaving: What the last frame decided to put aside.
        decided: Count of the frame that decided last.
    """

    on_device: EarlierBuffers = field(default_factory=EarlierBuffers)
    views: list[View] = field(default_factory=list)
    points: list[wp.array] = field(default_factory=list)
    anchor: wp.array | None = None
    sums_of: Hashable = ()
    leaving: PutAside | None = None
    decided: int = -1

    def choose(self, knowledge: float, overlaps: list[float], taken_over: list[float], slots: int) -> int | None:
        """The slot for a buffer that knows so much and shows ``overlaps`` of those in use; None if they know more.

        One that shows about the same makes room first, else a free one, else one of which this frame's buffer shows
        enough (``taken_over``), as that has read it, else the one that knows least.
        """
        known = [_knowledge(points) for points in self.points]
        if overlaps and max(overlaps) >= REDUNDANT:
            slot = int(np.argmax(overlaps))
        elif len(known) < slots:
            return len(known)
        elif max(taken_over) >= REDUNDANT:
            return int(np.argmax(taken_over))
        else:
            slot = int(np.argmin(known))
        return slot if knowledge >= known[slot] else None


def pull_shelf(work: Workspace, lights: Sequence[Light], resting: Hashable = ()) -> BufferShelf:
    """What earlier frames have put aside; nothing once a light has changed, or a caster comes to rest or leaves it."""
    sums_of = (*lights, resting)  # a light that moves becomes another

    def build(old: BufferShelf | None) -> BufferShelf:
        return old if old is not None and old.sums_of == sums_of else BufferShelf(sums_of=sums_of)

    shelf: BufferShelf = work.product("kept views", "kept views", (work.count, sums_of), build)
    return shelf


def fill_shelf(work: Workspace, shelf: BufferShelf, history: History) -> EarlierBuffers:
    """Puts aside what the last frame decided to, before this one writes to ``history.current``, where it still lies."""
    leaving, texels = shelf.leaving, history.current
    if leaving is not None and shelf.decided == work.count - 1:
        kept = work.buffer("kept views", (leaving.slots, *texels.shape), wp.vec4)
        work.launch(PUT_ASIDE[texels.dtype], texels.shape, [texels, leaving.slot], [kept])
        shelf.views[leaving.slot : leaving.slot + 1] = [leaving.view]
        shelf.points[leaving.slot : leaving.slot + 1] = [leaving.points]
        views = wp.array(shelf.views, dtype=View, device=work.device)
        shelf.on_device = filled(EarlierBuffers, count=len(shelf.views), texels=kept, views=views)
    if shelf.decided < work.count:
        shelf.leaving = None
    return shelf.on_device


def keep_buffer(work: Workspace, shelf: BufferShelf, history: History, view: View, slots: int, overlap: float) -> None:
    """Has the last frame's buffer put aside if this frame's, which must be written, shows too little of it.

    Reads some hundred numbers back from the device.

    Args:
        work: The frame that is rendered.
        shelf: Of the same frame.
        history: Its shadow buffer, a key of ``TEXEL_TYPES``.
        view: Of ``history.current``.
        slots: Buffers kept besides the last frame's, at least 1.
        overlap: Share of what was seen, by the last frame or since a buffer was put aside last, below which it is.
    """
    previous, before = history.previous, history.previous_view
    if not history.valid or before is None or shelf.decided == work.count:
        return
    shelf.decided = work.count
    points = work.buffer("probes of a view", PROBES, wp.vec4)
    work.launch(PROBE[previous.dtype], PROBES, [previous, before], [points])
    if shelf.anchor is None:
        shelf.anchor = wp.clone(points)
    seen = [seen_share(work, probes, history.current, view) for probes in (points, shelf.anchor)]
    if min(seen) >= overlap:
        return
    shelf.anchor = None
    overlaps = [seen_share(work, probes, previous, before) for probes in shelf.points]
    taken_over = [seen_share(work, probes, history.current, view) for probes in shelf.points]
    slot = shelf.choose(_knowledge(points), overlaps, taken_over, slots)
    if slot is not None:
        shelf.leaving = PutAside(slot, slots, before, wp.clone(points))
