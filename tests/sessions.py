"""What most tests of techniques begin with: a session on a small scene, a technique by name, a walk, the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from algorithms.plugins import find
from algorithms.projections.composition import compose
from algorithms.technique import Technique
from experiments.rendering.reference import ReferenceRenderer
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Scene

SIZE = (96, 72)
SMALL_MAP = 256


def open_session(
    scene: Scene,
    device: str,
    *,
    size: tuple[int, int] = SIZE,
    projection: Mapping[str, Any] | None = None,
    **options: Any,
) -> Session:
    """A fresh session on fresh geometry.

    Args:
        scene: What is seen.
        device: Warp device.
        size: Width and height of the frame in pixels.
        projection: Keys of a projection as in experiment files; None for the session's own.
        **options: As in ``Session``.
    """
    if projection is not None:
        options["projection"] = compose(dict(projection))
    geometry = Geometry(scene, device, options.get("threads"))
    return Session(geometry, width=size[0], height=size[1], device=device, **options)


def technique(name: str, **params: Any) -> Technique:
    """A technique with its own defaults."""
    plugin = find(name)
    return plugin(plugin.Params.model_validate(params))


def small_technique(name: str, **params: Any) -> Technique:
    """A technique that draws maps of ``SMALL_MAP`` texels unless told otherwise."""
    small = {"resolution": SMALL_MAP} if "resolution" in find(name).Params.model_fields else {}
    return technique(name, **{**small, **params})


def render(
    scene: Scene, device: str, name: str, options: Mapping[str, Any] | None = None, **params: Any
) -> FrameResult:
    """Frame 0 of a fresh session, with the technique's own defaults; arguments as in ``walk``."""
    return open_session(scene, device, **(options or {})).render(technique(name, **params))


def render_frames(session: Session, made: Technique, frames: int, first: int = 0) -> list[FrameResult]:
    """Renders ``frames`` frames in a row, at least one."""
    assert frames >= 1
    results = []
    for index in range(first, first + frames):
        session.begin(index)
        results.append(session.render(made))
        session.advance()
    return results


def walk(
    scene: Scene, device: str, name: str, frames: int, options: Mapping[str, Any] | None = None, **params: Any
) -> list[FrameResult]:
    """Frames 0 to ``frames`` - 1 of a fresh session, with a small technique.

    Args:
        scene: What is walked through.
        device: Warp device.
        name: The technique's name.
        frames: How many frames.
        options: As in ``open_session``.
        **params: The technique's parameters.
    """
    return render_frames(open_session(scene, device, **(options or {})), small_technique(name, **params), frames)


def true_visibility(
    scene: Scene,
    device: str,
    frame: int = 0,
    *,
    samples: int = 256,
    size: tuple[int, int] = SIZE,
    light: int = 0,
    centre: bool = False,
) -> np.ndarray:
    """The ray-cast reference of a frame, float32 (H, W); traced once for all tests of a run.

    Args:
        scene: What is seen.
        device: Warp device.
        frame: Frame of the scene's path.
        samples: Points on the light.
        size: Width and height of the frame in pixels.
        light: Index of the light.
        centre: Whether to ask for the light's centre alone: what hard shadows should be.
    """
    width, height = size
    options = {"width": width, "height": height, "light": light, "centre": centre, "device": device}
    return ReferenceRenderer(Geometry(scene, device), samples=samples, **options).render(frame).visibility
