"""Lights that move: a light after a rigid or scaling motion, and how far it went in units of its own size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    PolygonLight,
    RectangleLight,
    SphereLight,
)

BALANCE = 0.5
"""Window of the ageing ``balanced`` at a displacement d of 1: BALANCE d^(-2/3).

A mean over the last N frames lags by d N penumbra widths, and its visibility by about as much; its noise is sqrt(psi
(1 - psi) / 2 N), where psi (1 - psi) is 1/6 in the mean over a penumbra. The sum of their squares is least at N = (24
d^2)^(-1/3) = 0.35 d^(-2/3). Low-discrepancy samples and filters leave less noise; 0.5 is measured, on ``moving_light``.
"""
LEAST_WINDOW = 1.01


def light_at(light: Light, frame: int) -> Light:
    """The light where its motion has it at a frame; the light itself where it has none."""
    return light if light.motion is None else transformed(light, light.motion(frame))


def transformed(light: Light, matrix: np.ndarray) -> Light:
    """A light after a motion, without further motion.

    Args:
        light: Any light.
        matrix: float64 (4, 4), affine, not singular. Of discs and spheres only the mean scale counts, of directional
            lights only the rotation.
    """
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    scale = float(np.cbrt(abs(np.linalg.det(linear))))

    def point(p: np.ndarray) -> np.ndarray:
        return np.asarray(p) @ linear.T + offset

    moved: dict[str, object] = {"motion": None}
    match light:
        case PointLight():
            moved["position"] = point(light.position)
        case DirectionalLight():
            moved["direction"] = linear @ light.direction / scale
        case RectangleLight():
            moved |= {"center": point(light.center), "edge_u": linear @ light.edge_u, "edge_v": linear @ light.edge_v}
        case DiscLight():
            moved |= {"center": point(light.center), "normal": linear @ light.normal / scale}
            moved["radius"] = light.radius * scale
        case SphereLight():
            moved |= {"center": point(light.center), "radius": light.radius * scale}
        case LinearLight():
            moved |= {"a": point(light.a), "b": point(light.b)}
        case PolygonLight():
            moved["vertices"] = point(light.vertices)
    out: Light = replace(light, **moved)  # type: ignore[arg-type]
    return out


def own_width(light: Light) -> float:
    """L of penumbra formulas: the light's size in scene units, or 2 tan(angle / 2) of a directional one."""
    return float(2.0 * np.tan(0.5 * light.size)) if light.is_directional else light.size


def displacement(now: Light, then: Light) -> float:
    """How far a light went, in its own sizes: the largest distance of a corner of its hull to where corners were.

    A penumbra is as wide as the light times (z_r - z_b) / z_b, and moves with the light by the displacement times the
    same ratio, so that this is also how far shadows went in widths of their penumbrae, whatever casts and receives.
    Infinite where a light without size moves.
    """
    corners, before = now.hull[:, :3], then.hull[:, :3]
    apart = float(np.linalg.norm(corners[:, None] - before[None], axis=2).min(axis=1).max())
    if apart == 0.0:
        return 0.0
    size = own_width(now)
    return apart / size if size > 0.0 else float("inf")


def ageing_window(displacement: float, ageing: str, factor: float, reach: float) -> float:
    """How many light samples a mean over time should count while the light moves, 1 / (1 - a); 0 for all of them.

    Args:
        displacement: Of the light since the last frame, in its own sizes.
        ageing: ``none``; ``frames``: the age factor a is ``factor``; ``displacement``: exp(-displacement / ``reach``);
            ``balanced``: ``BALANCE`` displacement^(-2/3).
        factor: 0 to below 1.
        reach: Light sizes.
    """
    if ageing == "none" or displacement == 0.0:
        return 0.0
    if ageing == "balanced":
        return max(BALANCE * displacement ** (-2.0 / 3.0), LEAST_WINDOW) if np.isfinite(displacement) else LEAST_WINDOW
    age = factor if ageing == "frames" else float(np.exp(-displacement / reach))
    return max(1.0 / max(1.0 - age, 1e-12), LEAST_WINDOW)


class FrameLights:
    """A scene's lights at a session's frame, rebased, and which of them is asked for.

    Args:
        lights: Of the scene.
        index: The one that is asked for.
        origin_ws: Of the rebased world, (3,).

    Attributes:
        current: The light that is asked for.
        index: Its index.
        lights: All of them.
        stamp: What products depend on that depend on the light: its index and how often it has moved.
    """

    def __init__(self, lights: tuple[Light, ...], index: int, origin_ws: np.ndarray) -> None:
        self._own, self._origin_ws, self.index = lights, origin_ws, index
        self._poses: list[np.ndarray | None] = [None] * len(lights)
        self._versions = [0] * len(lights)
        self.lights = [light.moved(-origin_ws) for light in lights]

    @property
    def current(self) -> Light:
        return self.lights[self.index]

    @property
    def stamp(self) -> tuple[int, int]:
        return self.index, self._versions[self.index]

    def begin(self, frame: int) -> None:
        """Moves the lights to a frame."""
        for i, light in enumerate(self._own):
            motion: Callable[[int], np.ndarray] | None = light.motion
            if motion is None:
                continue
            pose = motion(frame)
            held = self._poses[i]
            if held is None or not np.array_equal(pose, held):
                # a light that pauses leaves everything as it was
                self._poses[i] = pose
                self._versions[i] += 1
                self.lights[i] = transformed(light, pose).moved(-self._origin_ws)

    def at(self, frame: int, index: int | None = None) -> Light:
        """The light that is asked for, or another, at another frame."""
        own = self._own[self.index if index is None else index]
        return light_at(own, frame).moved(-self._origin_ws)
