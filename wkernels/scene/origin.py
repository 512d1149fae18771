"""What is around the eye, and where float32 work has its origin, however far a scene goes on.

A position that is kept as float32 is known to 2^-24 of its distance from the origin, and what is relative to the size
of the scene to that. The middle of a scene is a good origin for ordinary scenes, and its diagonal a good size. They are
none where one object stands a million units away, or where the eye stands at one end of a ground of a hundred
kilometres: then both are those of what is around the eye.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wkernels.scene.model import Scene

SURROUNDINGS = 8.0
"""What lies farther away than this, in diagonals of all that is nearer to the eye, is not around it."""
PRECISION = 2.0**12
"""Distance of the origin, in distances at which things are seen, at which float32 still tells 1/4096 of the latter."""
LEAST_ANGLE = 1.0 / 500.0
"""Size over distance of what is too small to be seen: a pixel of a picture of 400 rows at 45 degrees."""
LOOKS = 64
"""Frames of a path that are looked at, at most."""


def looked_at(frames: int) -> np.ndarray:
    """Up to ``LOOKS`` of the frames of a path, evenly spaced, the first and the last among them; int (n,)."""
    count = max(frames, 1)
    return np.unique(np.linspace(0, count - 1, min(count, LOOKS)).round().astype(int))


def gaps(low: np.ndarray, high: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Distance of boxes (n, 2, 3) from the box of two corners (3,); 0 where they meet; (n,)."""
    apart = np.maximum(0.0, np.maximum(boxes[:, 0] - high, low - boxes[:, 1]))
    distance: np.ndarray = np.linalg.norm(apart, axis=1)
    return distance


@dataclass(frozen=True, eq=False)
class EyeBox:
    """Where the eye comes on its path.

    Attributes:
        low, high: Corners of the box, world space, float64 (3,).
        near: Near plane at frame 0, scene units.
    """

    low: np.ndarray
    high: np.ndarray
    near: float

    def around(self, boxes: np.ndarray) -> np.ndarray:
        """Which boxes are around the eye: the nearest, and all that are near beside those found before.

        Args:
            boxes: Low and high corners, world space, float64 (n, 2, 3), n at least 1.

        Returns:
            bool (n,), true at least once.
        """
        apart = gaps(self.low, self.high, boxes)
        kept: np.ndarray = apart <= apart.min()
        while not kept.all():
            low = np.minimum(self.low, boxes[kept, 0].min(axis=0))
            high = np.maximum(self.high, boxes[kept, 1].max(axis=0))
            more = kept | (gaps(low, high, boxes) <= SURROUNDINGS * float(np.linalg.norm(high - low)))
            if (more == kept).all():
                break
            kept = more
        return kept

    def noticed(self, boxes: np.ndarray) -> np.ndarray:
        """Which boxes are around the eye, or large enough to be seen from it; as ``around``."""
        size = (boxes[:, 1] - boxes[:, 0]).max(axis=1)
        seen: np.ndarray = size >= LEAST_ANGLE * gaps(self.low, self.high, boxes)
        return self.around(boxes) | seen

    def sight(self, low: np.ndarray, high: np.ndarray) -> float:
        """The distance from which things in a box are seen, at least."""
        return max(self.near, float(gaps(self.low, self.high, np.stack([low, high])[None])[0]))


def eye_box(scene: Scene) -> EyeBox:
    """The box of a scene's camera path."""
    eyes = np.array([np.asarray(scene.camera(int(frame)).eye, np.float64) for frame in looked_at(scene.frames)])
    return EyeBox(eyes.min(axis=0), eyes.max(axis=0), float(scene.camera(0).near))


def origin_of(boxes: np.ndarray, eyes: EyeBox) -> np.ndarray:
    """The origin of the rebased world, float64 (3,), the same for all frames.

    The middle of what is around the eye; where that goes on so far that float32 loses what is seen from near by, the
    point of it that is nearest to the eye.

    Args:
        boxes: Low and high corner of each mesh at frame 0, world space, float64 (n, 2, 3).
        eyes: Of the path.
    """
    if not len(boxes):
        return np.zeros(3)
    held = boxes[eyes.around(boxes)]
    low, high = held[:, 0].min(axis=0), held[:, 1].max(axis=0)
    middle: np.ndarray = 0.5 * (low + high)
    nearest: np.ndarray = np.clip(0.5 * (eyes.low + eyes.high), low, high)
    lost = float(np.linalg.norm(nearest - middle)) > PRECISION * eyes.sight(low, high)
    return nearest if lost else middle
