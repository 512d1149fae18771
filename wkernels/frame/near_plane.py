"""The eye's near plane, moved out to the nearest thing in sight (Stingl 2011, section 4.3, listing A.2).

Warps and splits spend most of a map's texels at the near plane, whether anything is there or not. So for projections
that ask for it the plane is raised to the least eye depth of the G-buffer before anything is fitted. The thesis halves
the depth image again and again with a wrapping sampler, which is right for sizes that are powers of two; here every
row is reduced on its own and then the column of results, whatever the size.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace

import numpy as np
import warp as wp

from wkernels.device.lanes import LANES, Floats, runs_of
from wkernels.device.twin import Twin, cell_by_cell
from wkernels.projections.clipping import frustum_planes
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView
from wkernels.workspace.left_out import Omission
from wkernels.workspace.workspace import Workspace

NEAR_PLANES = ("user", "auto", "auto_previous")
LEAST_DEPTH = "least depth"  # name of the pass


@wp.kernel
def find_row_depths(first: int, depth: wp.array2d(dtype=float), least_out: wp.array(dtype=float)):
    """Least depth of each row; NaN does not count."""
    y = first + wp.tid()
    least = float(wp.inf)
    for x in range(depth.shape[1]):
        value = depth[y, x]
        if value < least:
            least = value
    least_out[y] = least


@wp.kernel
def find_row_depths_lanes(first: int, depth: wp.array(dtype=Floats), width: int, least_out: wp.array(dtype=float)):
    """``find_row_depths`` of rows at least a run wide, whose last run begins early and repeats some pixels."""
    y = first + wp.tid()
    least = Floats(float(wp.inf))
    for x in range(0, width, LANES):
        held = depth[y * width + wp.min(x, width - LANES)]
        for k in range(LANES):
            least[k] = wp.where(held[k] < least[k], held[k], least[k])
    least_out[y] = wp.min(least)


@wp.kernel
def find_least(first: int, values: wp.array(dtype=float), least_out: wp.array(dtype=float)):
    """Least of all values; launched over one cell."""
    least = float(wp.inf)
    for i in range(values.shape[0]):
        least = wp.min(least, values[i])
    least_out[first + wp.tid()] = least


FIND_ROW_DEPTHS = Twin(
    find_row_depths,
    find_row_depths_lanes,
    inputs=lambda depth: [runs_of(depth, Floats, PADDING), depth.shape[1]],
    grid=cell_by_cell,
    fits=lambda depth, least: depth.shape[1] >= LANES,
)


class LeastDepth(Omission):
    """What saves the search for the nearest thing in sight."""

    CLIPPED = LEAST_DEPTH, "clipping the scene's box to the view gives the near plane already"


def least_depth(work: Workspace, gbuffer: GBuffer) -> float:
    """Least linear eye depth of a G-buffer, scene units; +inf where nothing is seen. NaN is ignored."""
    height = gbuffer.depth.shape[0]
    rows, least = work.buffer("row depths", (height,), wp.float32), work.buffer("least depth", (1,), wp.float32)
    work.launch(FIND_ROW_DEPTHS, height, [gbuffer.depth], [rows])
    work.launch(find_least, 1, [rows], [least])
    return float(least.numpy()[0])


class NearPlane:
    """Which near plane a session's projection gets to see.

    Args:
        rule: ``user``: the camera's own; ``auto``: no nearer than what is seen; ``auto_previous``: no nearer than what
            the last committed frame saw, which needs no pass before the map but clips what has come nearer since.
        work: Of the session.
        seen: What the eye sees: the G-buffer that is read where a rule needs one.
    """

    def __init__(self, rule: str, work: Workspace, seen: Callable[[], GBuffer]) -> None:
        self.rule = rule
        self.used: HostView | None = None
        self._work, self._seen = work, seen
        self._current: float | None = None
        self._previous: float | None = None

    def raised(self, eye: HostView, receivers: Bounds, stamp: Hashable) -> HostView:
        """The eye's view with its near plane raised, up to the far plane at most.

        Args:
            eye: The eye's view of the frame.
            receivers: Boxes of everything that light maps are to cover.
            stamp: What the G-buffer depends on besides the view, comparable.
        """
        least = None
        if self.rule == "auto_previous":
            least = self._previous
        elif self.rule == "auto" and not (_clip_says_all(eye, receivers) and self._work.leave_out(LeastDepth.CLIPPED)):
            least = self._least_depth(eye, stamp)
        if least is not None:
            eye = replace(eye, near=float(min(max(eye.near, least), eye.far)))
        self.used = eye
        return eye

    def look_back(self, eye: HostView, stamp: Hashable) -> None:
        """Notes the depth of a frame that has been rendered, for the next one."""
        if self.rule == "auto_previous":
            self._current = self._least_depth(eye, stamp)

    def advance(self) -> None:
        """Commits the frame."""
        self._previous = self._current

    def reset(self) -> None:
        """Forgets earlier frames."""
        self._current = self._previous = None

    def _least_depth(self, eye: HostView, stamp: Hashable) -> float:
        gbuffer = self._seen()
        inputs = (stamp, eye.ws_to_ss.tobytes(), eye.near, eye.far)
        key = (LEAST_DEPTH, gbuffer.depth.shape)
        least: float = self._work.product(LEAST_DEPTH, key, inputs, lambda old: least_depth(self._work, gbuffer))
        return least


def _clip_says_all(eye: HostView, receivers: Bounds) -> bool:
    """Whether nothing that receives can be in view, or all of it stands at one depth."""
    corners = receivers.corners
    planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
    if (corners @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=0).any():
        return True
    depth = (corners - eye.eye_ws) @ eye.forward_ws
    return float(np.ptp(depth)) <= 1e-9 * float(np.abs(depth).max())
