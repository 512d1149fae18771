"""Which maps of a pool are drawn in which frame: the host's side of ``map_pool``."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.frame import Session
from wkernels.geometry import Bounds
from wkernels.lights import Light
from wkernels.map_pool import MapPool, allocate_pool, draw_into_pool
from wkernels.raster import Rasteriser
from wkernels.views import HostView

MEMORY = 512 * 2**20  # bytes that a pool may take
ROOM = 0.1  # of its own size that a box of receivers grows beyond what left it


class KeptMaps:
    """A pool of maps of the casters that stand still, and what it was drawn for.

    Args:
        frame: The session.
        maps: Maps wanted; fewer where they would take more than ``MEMORY``.
        resolution: Texels per side.
    """

    def __init__(self, frame: Session, maps: int, resolution: int) -> None:
        self.resolution = resolution
        self.rasteriser = Rasteriser(frame.device, frame.threads)
        self.still = frame.geometry.casters(moving=False)
        self.moving = frame.geometry.casters(moving=True)
        self.wanted = maps
        self.points = np.zeros((0, 4))  # of the light, by map
        self.pool: MapPool | None = None
        self.maps = 0
        self._receivers: Bounds | None = None

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
            out = Bounds()
            low, high = np.minimum(box.low, moving.low), np.maximum(box.high, moving.high)
            out.add(np.stack([low, high]) + ROOM * (high - low) * np.array([[-1.0], [1.0]]))
            self._receivers = out
        return self._receivers

    def hold(self, frame: Session, layers: int) -> MapPool:
        """The pool, with room for maps of so many layers; a new one is empty."""
        if self.pool is None or layers > self.pool.slots:
            self.maps = max(1, min(self.wanted, MEMORY // (4 * self.resolution**2 * layers)))
            self.pool = allocate_pool(self.maps, layers, self.resolution, frame.device)
            self.points = np.zeros((self.maps, 4))
            self.drawn = wp.empty((self.resolution, self.resolution), dtype=float, device=frame.device)
        return self.pool

    def draw(self, frame: Session, slot: int, views: list[HostView], light_ws: np.ndarray, weight: float, cull: int) -> None:
        """Draws one map."""
        assert self.pool is not None
        self.points[slot] = light_ws
        draw_into_pool(self.pool, slot, views, light_ws, weight, self.still, self.rasteriser, cull, self.drawn)
