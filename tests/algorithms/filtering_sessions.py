"""What the tests of the filters share: sessions on the device under test, rendered by name."""

from __future__ import annotations

from typing import Any

import numpy as np
from sessions import open_session, technique

from wkernels.frame.session import FrameResult, Session
from wkernels.scene.lights import PointLight
from wkernels.scene.model import Scene

INSIDE = PointLight(position=np.array([0.2, 3.2, 1.5]))  # among the casters of `cluttered`: six faces
AREA_KINDS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")
TECHNIQUES = (("pcf", {}), ("pcss", {}), ("vsm", {}), ("vsm", {"width": "pcss"}))

OPTIONS: dict[str, Any] = {}
"""What every session here is opened with; ``conftest.py`` puts the device in."""


def session(scene: Scene, *, size: tuple[int, int] = (64, 48), **options: Any) -> Session:
    return open_session(scene, OPTIONS["device"], size=size, **options)


def render(scene: Scene, name: str, *, size: tuple[int, int] = (64, 48), **params: Any) -> FrameResult:
    return session(scene, size=size).render(technique(name, **params))
