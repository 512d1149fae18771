"""When a mesh that may move rests.

What has stood still for a while is as good as what never moves: its shadow is gathered over time like any other, and
maps of what stands still hold it. Whether it rests is a matter of the frame alone, not of what was rendered before.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

REST_FRAMES = 8
"""Frames for which a pose must have stayed the same: films of 24 frames shown at 60 stop at every other frame."""


class Poses:
    """Poses of meshes at frames, and whether they have stayed the same.

    Args:
        object_to_ws: Pose at a frame, float64 (4, 4), of each mesh that may move, by its index; of one that changes its
            shape whatever array says how it stands.
    """

    def __init__(self, object_to_ws: dict[int, Callable[[int], np.ndarray]]) -> None:
        self._object_to_ws = object_to_ws
        self._held: dict[tuple[int, int], np.ndarray] = {}

    def at(self, mesh: int, frame: int) -> np.ndarray:
        """The pose of a mesh at a frame, (4, 4), or what stands for it."""
        key = (mesh, frame)
        if key not in self._held:
            self._held[key] = self._object_to_ws[mesh](frame)
        return self._held[key]

    def rests(self, mesh: int, frame: int) -> bool:
        """Whether the pose of a mesh is the same at this frame and the ``REST_FRAMES`` before it; never before that."""
        if frame < REST_FRAMES:
            return False
        now = self.at(mesh, frame)
        return all(np.array_equal(now, self.at(mesh, frame - back)) for back in range(1, REST_FRAMES + 1))

    def resting(self, frame: int) -> frozenset[int]:
        """The meshes that may move but rest at a frame."""
        out = frozenset(mesh for mesh in self._object_to_ws if self.rests(mesh, frame))
        oldest = frame - 2 * REST_FRAMES
        self._held = {key: pose for key, pose in self._held.items() if oldest <= key[1] <= frame}
        return out
