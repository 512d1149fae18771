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
ROOM = 0.5  # of its own size that the box of movers grows beyond one that left it


@dataclass(frozen=True)
class Schedule:
    """What becomes of the pool in one frame.

    Attributes:
        draws: Points of the light, by index in their sequence, whose maps are drawn; map i goes to slot i mod maps.
        filled: Maps that may be read afterwards.
        head: One past the slot that is read first.
        fills: Whether the pool is being filled, so that only what is drawn is new to a pixel.
        refines: Whether the view has stood still long enough to have met every map, so that only new ones say more.
    """

    draws: range
    filled: int
    head: int
    fills: bool
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
        self._wanted = maps
        self.maps: int
        self.pool: MapPool
        self.points: np.ndarray  # of the light, by slot, float64 (maps, 4)
        self._rasteriser = Rasteriser(frame.device, frame.threads)
        self._drawn = wp.empty((resolution, resolution), dtype=float, device=frame.device)
        self._movers: np.ndarray | None = None  # a box of where receivers that move have been, and may soon be
        self._start: int  # frame count from which on the pool is filled
        self._epoch: int  # the same of when it is drawn again, as a mover has left its maps
        self._still: tuple[Hashable, int] = (None, 0)  # what is seen, and the frame count from which on
        self._hold(frame, 1)

    def _hold(self, frame: Session, layers: int) -> None:
        """Makes room for maps of so many layers; what was drawn before is lost."""
        self.maps = max(1, min(self._wanted, MEMORY // (4 * self.resolution**2 * layers)))
        self.pool = allocate_pool(self.maps, layers, self.resolution, frame.device)
        self.points = np.zeros((self.maps, 4))
        self._rows = np.zeros((self.maps * layers, 4, 4), dtype=np.float32)
        self._start = self._epoch = frame.count

    def receivers(self, frame: Session) -> Bounds:
        """Boxes of all receivers, those of movers wherever they have been so far.

        Where a mover leaves its box, that grows by half its size more than it must, but not beyond the scene.
        """
        geometry = frame.geometry
        still = geometry.bounds(receivers=True, moving=False)
        now = geometry.bounds(receivers=True, moving=True)
        if now.empty:
            if still.empty:
                still = geometry.bounds(casters=True)
            if still.empty:  # no meshes at all: any view will do
                still.add(np.zeros((1, 3)))
            return still
        low, high = (now.low, now.high) if self._movers is None else self._movers
        if self._movers is None or (now.low < low).any() or (now.high > high).any():
            low, high = np.minimum(low, now.low), np.maximum(high, now.high)
            room = ROOM * float((high - low).max())
            low = np.minimum(low, np.maximum(low - room, still.low))
            high = np.maximum(high, np.minimum(high + room, still.high))
            self._movers = np.stack([low, high])
        still.add(self._movers)
        return still

    def _holds(self, corners: np.ndarray) -> bool:
        """Whether every map drawn so far holds these points, (N, 3), each in one of its layers."""
        used = self._rows.any(axis=(1, 2))
        h = self._rows @ np.concatenate([corners, np.ones((len(corners), 1))], axis=1).T
        inside = (h[:, 3] > 0.0) & (np.abs(h[:, 0]) <= h[:, 3]) & (np.abs(h[:, 1]) <= h[:, 3])
        maps = used.reshape(self.maps, -1).any(axis=1)
        return bool(inside.reshape(self.maps, -1, len(corners)).any(axis=1)[maps].all())

    def schedule(self, frame: Session, seen: Hashable, draws: int, tests: int, follows_eye: bool) -> Schedule:
        """What this frame draws and reads.

        Args:
            frame: The session. seen: What the image depends on, camera and geometry, comparable. draws: Maps per frame
                while the pool is not full. tests: Maps that a pixel is tested against per frame. follows_eye: Whether
                the projection does, so that maps go out of date.
        """
        if self._still[0] != seen:
            self._still = seen, frame.count
        frames = -(-self.maps // draws)  # to fill the pool
        since = frame.count - self._start
        now = frame.geometry.bounds(receivers=True, moving=True)
        if not now.empty and frame.count - self._epoch >= frames and not self._holds(now.corners):
            self._epoch = frame.count
        if since < frames:
            own = range(since * draws, min((since + 1) * draws, self.maps))
            return Schedule(own, own.stop, own.stop, True, False)
        changed = max(self._still[1], self._start + frames, self._epoch + frames)
        refines = frame.count - changed >= -(-self.maps // tests) and not follows_eye
        if follows_eye or refines or (self._epoch > self._start and frame.count - self._epoch < frames):
            # one a frame as well has to step by one: every second point of a Halton set lies in one half of the light
            first = self.maps + since if refines else since * draws
            own = range(first, first + (1 if refines else min(draws, self.maps)))
            return Schedule(own, self.maps, (own.stop - 1) % self.maps + 1, False, refines)
        return Schedule(range(0), self.maps, (since * tests) % self.maps + 1, False, False)

    def still_frames(self, frame: Session) -> int:
        """Frames since what is seen last changed."""
        return frame.count - self._still[1]

    def draw(self, frame: Session, which: range, sample_set: str, cull: int) -> bool:
        """Draws the maps of some points of the light.

        Returns:
            False where they need more layers than there was room for: nothing is drawn, the pool is empty, and
            ``schedule`` has a new answer.
        """
        samples = frame.light_samples(len(which), sample_set, start=which.start)
        receivers, casters = self.receivers(frame), frame.geometry.bounds(casters=True, moving=False)
        eye = frame.eye()
        views = [frame.projection(light, receivers, casters, self.resolution, eye) for light in samples.host]
        layers = max(len(own) for own in views)
        if layers > self.pool.slots:
            self._hold(frame, layers)
            return False
        for i, index in enumerate(which):
            slot, light_ws, weight = index % self.maps, samples.host[i], float(samples.weights_host[i])
            self.points[slot] = light_ws
            own = self._rows[slot * self.pool.slots : (slot + 1) * self.pool.slots]
            own[:] = 0.0
            own[: len(views[i])] = [view.ws_to_ss for view in views[i]]
            with frame.timed("light depth map"):
                options = self._rasteriser, cull, self._drawn
                draw_into_pool(self.pool, slot, views[i], light_ws, weight, self.casters, *options)
            if frame.light_views is None:
                frame.light_views = (views[i], light_ws)
        return True
