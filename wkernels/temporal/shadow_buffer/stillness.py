"""How long nothing has changed that a sum over frames depends on: once its error is small enough it may stop."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

from wkernels.frame.session import Session
from wkernels.light_maps.map_look import views_stamp


@dataclass
class Stillness:
    """Frames in a row in which geometry, eye and light were those of the frame before; see ``count_still_frames``."""

    stamp: Hashable = None
    frames: int = 0
    counted: int = -1


def count_still_frames(frame: Session) -> int:
    """How many frames before this one showed exactly the same; to be asked for once a frame."""

    def build(old: Stillness | None) -> Stillness:
        out = old or Stillness()
        if out.counted == frame.count:  # the same frame once more
            return out
        stamp = (frame.geometry.version, views_stamp([frame.eye()]), *frame.lights.lights)
        out.frames = out.frames + 1 if stamp == out.stamp else 0
        out.stamp, out.counted = stamp, frame.count
        return out

    held: Stillness = frame.product("still frames", "still frames", frame.count, build)
    return held.frames
