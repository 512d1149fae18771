"""Which maps of a pool are drawn in which frame: the host's side of ``map_pool``."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.frame import Session
from wkernels.geometry import Bounds
from wkernels.map_pool import MapPool, allocate_pool, draw_into_pool
from wkernels.raster import Rasteriser

MEMORY = 512 * 2**20  # bytes that a pool may take
ROOM = 0.1  # of its own size that the box of receivers grows beyond a mover that left it


@dataclass(frozen=True)
class Schedule:
    """What becomes of the pool in one frame.

    Attributes:
        draws: Points of the light, by index in their sequence, whose maps are drawn; map i goes to slot i mod maps.
        filled: Maps that may be read afterwards.
        head: One past the slot that is read first.
        refines: Whether the view has stood still long enough to have met every map, so that only new ones say more.
    """

    draws: range
    filled: int
    head: int
    refines: bool


class KeptMaps:
    """A pool of maps of the casters that stand still, and when they are drawn.

    What is drawn follows from the frames counted since the session's reset alone, so that a frame that is rendered
    again draws and reads the same maps again.

    Args:
        frame: The session.
        maps: Maps wanted; fewer where they would take more than ``MEMORY``.
        resolution: Texels per side.
    """

    def __init__(self, frame: Session, maps: int, resolution: int) -> None:
        self.resolution = resolution
        self.casters = frame.geometry.casters(moving=False)
        self.maps = self._wanted = maps
        self.pool: MapPool | None = None
        self.points = np.zeros((0, 4))  # of the light, by slot
        self._rasteriser = Rasteriser(frame.device, frame.threads)
        self._drawn = wp.empty((resolution, resolution), dtype=float, device=frame.device)
        self._receivers: Bounds | None = None
        self._epoch = 0  # frame count from which on maps cover the receivers' box
        self._still: tuple[Hashable, int] = (None, 0)  # what is seen, and the frame count from which on
        self._hold(frame, 1)

    def _hold(self, frame: Session, layers: int) -> None:
        """Makes room for maps of so many layers; what was drawn before is lost."""
        self.maps = max(1, min(self._wanted, MEMORY // (4 * self.resolution**2 * layers)))
        self.pool = allocate_pool(self.maps, layers, self.resolution, frame.device)
        self.points = np.zeros((self.maps, 4))

    def receivers(self, frame: Session) -> Bounds:
        """Boxes of all receivers, those of movers wherever they have been so far."""
        geometry = frame.geometry
        if self._receivers is None:
            self._receivers = geometry.bounds(receivers=True, moving=False)
            if self._receivers.empty:
                self._receivers = geometry.bounds(casters=True, receivers=True)
        box = self._receivers
        moving = geometry.bounds(receivers=True, moving=True)
        if not moving.empty and ((moving.low < box.low).any() or (moving.high > box.high).any()):
            low, high = np.minimum(box.low, moving.low), np.maximum(box.high, moving.high)
            self._receivers = Bounds()
            self._receivers.add(np.stack([low, high]) + ROOM * (high - low) * np.array([[-1.0], [1.0]]))
            self._epoch = frame.count
        return self._receivers

    def schedule(self, frame: Session, seen: Hashable, draws: int, tests: int, follows_eye: bool) -> Schedule:
        """What this frame draws and reads.

        Args:
            frame: The session. seen: What the image depends on, camera and geometry, comparable. draws: Maps per frame
                while the pool is not full. tests: Maps that a pixel is tested against per frame. follows_eye: Whether
                the projection does, so that maps go out of date.
        """
        self.receivers(frame)
        if self._still[0] != seen:
            self._still = seen, frame.count
        since = frame.count - self._epoch
        to_fill = -(-self.maps // draws)
        filled = self.maps if self._epoch else min(self.maps, (since + 1) * draws)
        met_all = frame.count - max(self._still[1], self._epoch + to_fill) >= -(-self.maps // tests)
        if since < to_fill or follows_eye or met_all:
            first = frame.count * draws
            whole = range(first, min(first + draws, first + self.maps))
            if not self._epoch and since < to_fill:
                whole = range(first, min(first + draws, self.maps))
            return Schedule(whole, filled, (whole[-1] % self.maps) + 1, met_all and not follows_eye)
        return Schedule(range(0), filled, (frame.count * tests) % self.maps + 1, False)

    def still_frames(self, frame: Session) -> int:
        """Frames since what is seen last changed."""
        return frame.count - self._still[1]

    def draw(self, frame: Session, which: range, sample_set: str, cull: int) -> None:
        """Draws the maps of some points of the light."""
        samples = frame.light_samples(len(which), sample_set, start=which.start)
        receivers, casters = self.receivers(frame), frame.geometry.bounds(casters=True, moving=False)
        for i, index in enumerate(which):
            light_ws = samples.host[i]
            views = frame.projection(light_ws, receivers, casters, self.resolution, frame.eye())
            if self.pool is None or len(views) > self.pool.slots:
                self._hold(frame, len(views))
            assert self.pool is not None
            slot = index % self.maps
            self.points[slot] = light_ws
            with frame.timed("light depth map"):
                draw_into_pool(
                    self.pool, slot, views, light_ws, float(samples.weights_host[i]), self.casters,
                    self._rasteriser, cull, self._drawn,
                )  # fmt: skip
            if frame.light_views is None:
                frame.light_views = (views, light_ws)
