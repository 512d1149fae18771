"""What one frame of a technique leaves for the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from wkernels.scene.views import View


@dataclass
class History:
    """Two buffers that change places from frame to frame.

    Attributes:
        previous: What the last frame wrote; meaningless unless ``valid``.
        current: For this frame to write, completely.
        valid: Whether there was a last frame.
        previous_view: The eye's view of that frame, at the buffer's size.
        previous_index: That frame's index.
    """

    previous: Any
    current: Any
    valid: bool = False
    previous_view: View | None = None
    previous_index: int | None = None
