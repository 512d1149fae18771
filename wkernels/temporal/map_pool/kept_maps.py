"""Which maps of a pool are drawn in which frame: the host's side of ``pool``."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from wkernels.frame.map_keeper import MAP_BUDGET_BYTES, BesideViews
from wkernels.frame.session import Session
from wkernels.light_maps.host_map import LightLook
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView
from wkernels.temporal.map_pool.drawing import PoolPainter
from wkernels.temporal.map_pool.pool import MapPool, allocate_pool

ROOM = 0.5  # of its own size that the box of movers grows beyond one that left it


@dataclass(frozen=True)
class Schedule:
    """What becomes of the pool in one frame.

    Attributes:
        draws: Points of the light, by index in their sequence, and which layers of their maps are drawn; map i goes to
            slot i mod maps.
        added: Maps that are complete from this frame on.
        filled: Maps that may be read afterwards.
        head: One past the slot that is read first.
        fills: Whether the pool is being filled, so that only maps that were added are new to a pixel.
        refines: Whether the view has stood still long enough to have met every map, so that only new ones say more.
    """

    draws: tuple[tuple[int, range], ...]
    added: int
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
        maps: Maps wanted; fewer where they would take more than ``MAP_BUDGET_BYTES``.
        resolution: Texels per side.
    """

    def __init__(self, frame: Session, maps: int, resolution: int) -> None:
        self.resolution = resolution
        self._wanted = maps
        self.maps: int
        self.pool: MapPool
        self.points: np.ndarray  # of the light, by slot, float64 (maps, 4)
        self.restarted = False  # whether the pool was ever filled of other casters
        self._painter = self._paint(frame)
        self._movers: np.ndarray | None = None  # a box of where receivers that move have been, and may soon be
        self._start: int  # frame count from which on the pool is filled
        self._epoch: int  # the same of when it is drawn again, as a mover has left its maps
        self._still: tuple[Hashable, int] = (None, 0)  # what is seen, and the frame count from which on
        self._begun: tuple[int, list[HostView]]  # the map that was drawn last, whose other layers may follow
        self._taken: tuple[int, range]  # frame count of when new points of the light were last taken, and which
        self._hold(frame, 1)

    def _paint(self, frame: Session) -> PoolPainter:
        """What draws the casters that stand still now."""
        self._resting = frame.geometry.resting_at
        casters = frame.geometry.caster_buffers(moving=False)
        return PoolPainter(casters, self.resolution, frame.device, frame.threads, frame.skips)

    def follow(self, frame: Session) -> None:
        """Begins the pool anew where a caster has come to rest, or has left it."""
        if self._resting != frame.geometry.resting_at:
            self._painter = self._paint(frame)
            self.restarted = True
            self._hold(frame, self.pool.slots)

    def _hold(self, frame: Session, layers: int) -> None:
        """Makes room for maps of so many layers; what was drawn before is lost."""
        self.maps = max(1, min(self._wanted, MAP_BUDGET_BYTES // (4 * self.resolution**2 * layers)))
        self.pool = allocate_pool(self.maps, layers, self.resolution, frame.device)
        self.points = np.zeros((self.maps, 4))
        self._rows = np.zeros((self.maps * layers, 4, 4), dtype=np.float32)
        self._start = self._epoch = frame.count
        self._begun, self._taken = (-1, []), (-1, range(self.maps))

    def _receivers(self, frame: Session) -> Bounds:
        """Boxes of all receivers, those of movers wherever they have been so far.

        Where a mover leaves its box, that grows by half its size more than it must, but not beyond the scene.
        """
        geometry = frame.geometry
        still = geometry.bounds(receivers=True, moving=False, noticed=True)
        now = geometry.bounds(receivers=True, moving=True, noticed=True)
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

    def _take(self, frame: Session, count: int) -> range:
        """The points of the light that follow those used so far; the same ones if a frame is rendered again."""
        if self._taken[0] != frame.count:
            stop = self._taken[1].stop
            self._taken = frame.count, range(stop, stop + count)
        return self._taken[1]

    def schedule(self, frame: Session, seen: Hashable, draws: float, tests: int, follows_eye: bool) -> Schedule:
        """What this frame draws and reads.

        Args:
            frame: The session. seen: What the image depends on, camera and geometry, comparable. draws: Maps per frame
                until the pool is full, rounded up to whole layers; the first frame completes a map. tests: Maps that a
                pixel is tested against per frame. follows_eye: Whether the projection does, so that maps go out of date
                and are drawn whole, as are those that are drawn anew.
        """
        if self._still[0] != seen:
            self._still = seen, frame.count
        slots = self.pool.slots
        whole = min(int(np.ceil(draws)), self.maps)
        step = whole * slots if follows_eye else int(np.ceil(draws * slots))
        first, all_layers = max(step, slots), self.maps * slots
        frames = 1 + max(-(-(all_layers - first) // step), 0)  # to fill the pool
        since = frame.count - self._start
        if since < frames:
            begin, end = (first + (since - 1) * step, first + since * step) if since else (0, first)
            end = min(end, all_layers)
            filled = end // slots
            added = filled - begin // slots
            head = filled if added else since * tests % filled + 1
            return Schedule(_layers_between(begin, end, slots), added, filled, head, True, False)

        now = frame.geometry.bounds(receivers=True, moving=True, noticed=True)
        again = -(-self.maps // whole)  # frames to draw all maps anew
        if not now.empty and frame.count - self._epoch >= again and not self._holds(now.corners):
            self._epoch = frame.count
        changed = max(self._still[1], self._start + frames, self._epoch + again)
        refines = frame.count - changed >= -(-self.maps // tests) and not follows_eye
        if follows_eye or refines or (self._epoch > self._start and frame.count - self._epoch < again):
            own = self._take(frame, 1 if refines else whole)
            draws_whole = tuple((index, range(slots)) for index in own)
            return Schedule(draws_whole, len(own), self.maps, (own.stop - 1) % self.maps + 1, False, refines)
        return Schedule((), 0, self.maps, since * tests % self.maps + 1, False, False)

    def still_frames(self, frame: Session) -> int:
        """Frames since what is seen last changed."""
        return frame.count - self._still[1]

    def draw(self, frame: Session, draws: tuple[tuple[int, range], ...], sample_set: str, cull: int) -> bool:
        """Draws layers of the maps of some points of the light, as a schedule has them.

        Returns:
            False where a map needs more layers than there was room for: the pool is empty then, and ``schedule`` has a
            new answer.
        """
        if not draws:
            return True
        receivers = self._receivers(frame)
        for index, layers in draws:
            # the first ones as one product: they are asked for in as many frames as it takes to draw them
            begins = index < self.maps
            samples = frame.light_samples(self.maps if begins else 1, sample_set, start=0 if begins else index)
            at = index if begins else 0
            light_ws, weight, slot = samples.host[at], float(samples.weights_host[at]), index % self.maps
            if layers.start == 0:
                casters = frame.casters_towards(light_ws, moving=False)
                self._begun = index, frame.look_from_light(light_ws, receivers, casters, self.resolution)
            views = self._begun[1]
            if len(views) > self.pool.slots:
                self._hold(frame, len(views))
                return False
            self.points[slot] = light_ws
            own = self._rows[slot * self.pool.slots : (slot + 1) * self.pool.slots]
            own[:] = 0.0
            own[: len(views)] = [view.ws_to_ss for view in views]
            with frame.timed("light depth map"):
                chosen = range(layers.start, min(layers.stop, len(views)))
                beside = self._painter.draw(self.pool, slot, views, light_ws, weight, cull, chosen)
            if beside:
                frame.leave_out(BesideViews.BLOCKS, count=beside)
            frame.looks.append(LightLook(views=tuple(views), light_ws=light_ws, from_centre=False))
        return True


def _layers_between(begin: int, end: int, slots: int) -> tuple[tuple[int, range], ...]:
    """Map and layers of each, of all layers ``begin`` to ``end`` - 1 counted through maps of ``slots`` layers."""
    maps = range(begin // slots, -(-end // slots))
    return tuple((m, range(max(begin - m * slots, 0), min(end - m * slots, slots))) for m in maps)
