"""The lattice tower of ``paris``: four curved legs that grow together, three platforms, arches and a mast."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from experiments.scenes.generators._shapes import CORNERS, beams, boxes, lofts, merge, polyline_beams
from experiments.scenes.primitives import Triangles

HEIGHT = 330.0
FOOTPRINT = 125.0
_PLATFORMS = (57.6, 115.7, 276.0)
_LEGS_MEET = 186.0

# Height against half the outer width, and against the width of one leg (both from the proportions of the real one).
_half_width = PchipInterpolator([0.0, 25.0, 57.6, 115.7, 186.0, 276.0, 300.0], [62.5, 48.0, 35.0, 19.5, 10.0, 5.2, 3.0])
_leg_width = PchipInterpolator([0.0, 57.6, 115.7, 186.0], [25.0, 15.5, 10.8, 9.6])


def tower(detail: float) -> Triangles:
    """The tower on y = 0 around the origin; ``detail`` scales the number of panels (1: about 45 000 triangles)."""
    parts = [_legs(detail), _shaft(detail), _arches(detail)]
    parts += [_platform(y, detail) for y in _PLATFORMS]
    parts.append(_mast())
    feet = CORNERS * (_half_width(0.0) - 0.5 * _leg_width(0.0))
    parts.append(boxes(np.stack([feet[:, 0], np.full(4, 1.5), feet[:, 1]], axis=1), np.array([[27.0, 3.0, 27.0]])))
    vertices, faces = merge(parts)
    vertices[:, 1] = np.maximum(vertices[:, 1], 0.0)  # the ends of slanted beams would dip into the ground
    return vertices, faces


def _levels(low: float, high: float, count: float) -> np.ndarray:
    """Panel heights shrink upwards with the width of the tower."""
    n = max(3, round(count))
    even = np.linspace(low, high, 200)
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(even) / (_half_width(even[:-1]) + 12.0))])
    return np.interp(np.linspace(0.0, travelled[-1], n + 1), travelled, even)


def _lattice(corners: np.ndarray, chord: float, brace: float) -> Triangles:
    """Chords, horizontals and crosses between four corner curves, ``corners`` (levels, 4, 3) in ring order."""
    low, high = corners[:-1], corners[1:]
    next_low, next_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    middle = 0.25 * (low + high + next_low + next_high)
    side, next_side = 0.5 * (low + high), 0.5 * (next_low + next_high)
    thick = [(low, high)]
    thin = [
        (high, next_high),
        (low, next_high),
        (next_low, high),
        (middle, 0.5 * (high + next_high)),
        (side, 0.5 * (low + next_low)),
        (next_side, 0.5 * (low + next_low)),
    ]

    def build(pairs: list[tuple[np.ndarray, np.ndarray]], width: float) -> Triangles:
        taper = 0.45 + 0.55 * _half_width(np.clip(low[..., 1], 0.0, 300.0)).ravel() / _half_width(0.0)
        return merge([beams(a.reshape(-1, 3), b.reshape(-1, 3), width * taper) for a, b in pairs])

    return merge([build(thick, chord), build(thin, brace)])


def _legs(detail: float) -> Triangles:
    parts = []
    y = np.unique(
        np.concatenate([_levels(0.0, _PLATFORMS[1], 17 * detail), _levels(_PLATFORMS[1], _LEGS_MEET, 8 * detail)])
    )
    outer, width = _half_width(y), _leg_width(y)
    inner = np.maximum(outer - width, 0.4)
    for sx, sz in CORNERS:
        x0, x1, z0, z1 = sx * inner, sx * outer, sz * inner, sz * outer
        corners = [np.stack([a, y, b], axis=1) for a, b in ((x0, z1), (x1, z1), (x1, z0), (x0, z0))]
        parts.append(_lattice(np.stack(corners, axis=1), 1.5, 0.62))
    return merge(parts)


def _shaft(detail: float) -> Triangles:
    y = _levels(_LEGS_MEET, 300.0, 17 * detail)
    half = _half_width(y)[:, None]
    corners = np.stack([half * CORNERS[:, 0], np.repeat(y[:, None], 4, axis=1), half * CORNERS[:, 1]], axis=2)
    return _lattice(corners, 1.6, 0.75)


def _arches(detail: float) -> Triangles:
    """A lattice arch between each pair of legs, in the slanted plane of the tower's side."""
    segments = max(8, round(26 * detail))
    angle = np.linspace(0.06 * np.pi, 0.94 * np.pi, segments + 1)
    parts = []
    for rise, span in ((39.0, 37.5), (43.5, 41.5)):
        y = 6.0 + rise * np.sin(angle)
        x = span * np.cos(angle)
        z = _half_width(y)
        parts.append(np.stack([x, y, z], axis=1))
    lower, upper = parts
    zigzag = np.stack([lower, upper], axis=1).reshape(-1, 3)
    out = []
    for quarter in range(4):
        cos, sin = round(np.cos(0.5 * np.pi * quarter)), round(np.sin(0.5 * np.pi * quarter))
        turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        out += [
            polyline_beams(lower @ turn, 1.1),
            polyline_beams(upper @ turn, 1.1),
            polyline_beams(zigzag @ turn, 0.45),
        ]
    return merge(out)


def _platform(y: float, detail: float) -> Triangles:
    """A deck with a hole, a lattice frieze below and a railing above."""
    outer = float(_half_width(y)) + 2.0
    hole = max(float(_half_width(y) - _leg_width(min(y, _LEGS_MEET))), 0.25 * outer)
    middle, depth = 0.5 * (outer + hole), outer - hole
    deck = [boxes(np.array([[0.0, y, s * middle]]), np.array([[2.0 * outer, 1.2, depth]])) for s in (-1.0, 1.0)] + [
        boxes(np.array([[s * middle, y, 0.0]]), np.array([[depth, 1.2, 2.0 * hole]])) for s in (-1.0, 1.0)
    ]
    bays = max(4, round(outer * 0.75 * detail))
    along = np.linspace(-outer, outer, bays + 1)
    bottom, top = y - min(5.0, 0.16 * outer + 2.0), y - 0.6
    parts = list(deck)
    for heading in range(4):
        cos, sin = round(np.cos(0.5 * np.pi * heading)), round(np.sin(0.5 * np.pi * heading))

        def at(s: np.ndarray, height: float, cos: int = cos, sin: int = sin) -> np.ndarray:
            edge = np.full_like(s, outer - 0.3)
            return np.stack([s * cos + edge * sin, np.full_like(s, height), edge * cos - s * sin], axis=1)

        low, high = at(along, bottom), at(along, top)
        parts += [
            polyline_beams(low[[0, -1]], 0.5),
            beams(low[:-1], high[1:], 0.28),
            beams(low[1:], high[:-1], 0.28),
            beams(low[1:-1], high[1:-1], 0.3),
            polyline_beams(at(along[[0, -1]], y + 1.9), 0.18),
            beams(at(along[1:-1], y + 0.6), at(along[1:-1], y + 1.8), 0.12),
        ]
    return merge(parts)


def _mast() -> Triangles:
    """Cabin, dome and antenna above the third platform, up to ``HEIGHT``."""
    half = np.array([4.2, 4.2, 3.0, 2.2, 0.9, 0.55, 0.55, 0.12])
    y = np.array([277.0, 282.0, 288.0, 300.0, 303.0, 305.0, 318.0, HEIGHT])
    rings = np.empty((1, len(y), 4, 3))
    rings[0, ..., 0], rings[0, ..., 2] = half[:, None] * CORNERS[:, 0], half[:, None] * CORNERS[:, 1]
    rings[0, ..., 1] = y[:, None]
    arms = np.linspace(306.0, 322.0, 6)
    reach = np.stack([np.full(6, 1.6), arms, np.zeros(6)], axis=1)
    across = np.stack([np.zeros(6), arms + 1.2, np.full(6, 1.6)], axis=1)
    flip = np.array([-1.0, 1.0, -1.0])
    return merge([lofts(rings), beams(reach * flip, reach, 0.25), beams(across * flip, across, 0.25)])
