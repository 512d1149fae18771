"""Closed-form visibility of the analytic scenes A1 to A9 (docs/glossary.md), which the reference is held to.

Every function maps receiver points ``position_ws`` (float64, shape (..., 3), scene units) to visibility in [0, 1],
shape (...,): 1 = the whole light is visible. The keyword defaults are the numbers of ``configs/scenes/a*.yaml``.
Lights and occluders are parallel to the receiver plane y = 0 and centred on the y axis unless a keyword says
otherwise; heights are above y = 0, so distances from the light are ``zb = light_height - blocker_height`` and
``zr = light_height - y``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Interval2 = tuple[tuple[float, float], tuple[float, float]]
"""An axis-aligned rectangle ((x0, x1), (z0, z1))."""

A4_BLOCKER: Interval2 = ((-1.0, 1.0), (-0.75, 0.75))
A5_BLOCKERS: tuple[Interval2, Interval2] = (((-2.5, 0.25), (-1.5, 1.5)), ((-0.25, 3.0), (-2.0, 2.0)))


def a1_half_plane(
    position_ws: np.ndarray, *, light_size: float = 2.0, light_height: float = 10.0, blocker_height: float = 5.0
) -> np.ndarray:
    """A1, square light and the half-plane x < 0: ``clamp(1/2 + x/w)`` with ``w = L (zr - zb)/zb``."""
    x, w = _signed_distance(position_ws, light_size, light_height, blocker_height)
    return np.clip(0.5 + x / w, 0.0, 1.0)


def a2_half_plane_disc(
    position_ws: np.ndarray, *, light_radius: float = 1.0, light_height: float = 10.0, blocker_height: float = 5.0
) -> np.ndarray:
    """A2, disc light and the half-plane x < 0: ``1 - (acos h - h sqrt(1 - h^2))/pi`` with ``h = 2x/w``, ``L = 2R``."""
    x, w = _signed_distance(position_ws, 2.0 * light_radius, light_height, blocker_height)
    h = np.clip(2.0 * x / w, -1.0, 1.0)
    return 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi


def a3_coaxial_discs(
    position_ws: np.ndarray,
    *,
    light_radius: float = 1.0,
    blocker_radius: float = 1.5,
    light_height: float = 10.0,
    blocker_height: float = 5.0,
) -> np.ndarray:
    """A3, disc light and disc occluder on one axis: one minus the lens that light and projected occluder share.

    On y = 0 the umbra ends and the penumbra ends at the radii ``a3_radii``.
    """
    position = np.asarray(position_ws, np.float64)
    zr, zb = light_height - position[..., 1], light_height - blocker_height
    scale = zr / (zr - zb)  # of the occluder when it is projected from the receiver point onto the light's plane
    offset = np.hypot(position[..., 0], position[..., 2]) * (scale - 1.0)
    return 1.0 - _lens_area(offset, light_radius, blocker_radius * scale) / (np.pi * light_radius**2)


def a3_radii(
    *, light_radius: float = 1.0, blocker_radius: float = 1.5, light_height: float = 10.0, blocker_height: float = 5.0
) -> tuple[float, float, float]:
    """A3 on y = 0: radii of the umbra (negative: there is none), the hard shadow, and the penumbra's outer edge."""
    zr, zb = light_height, light_height - blocker_height
    hard, spread = blocker_radius * zr / zb, light_radius * (zr - zb) / zb
    return hard - spread, hard, hard + spread


def a4_rectangle(
    position_ws: np.ndarray,
    *,
    light_size: float = 2.0,
    light_height: float = 10.0,
    blocker: Interval2 = A4_BLOCKER,
    blocker_height: float = 6.0,
) -> np.ndarray:
    """A4, square light and axis-aligned rectangle: ``1 - o_x o_z``, o = the covered share of the light's side."""
    covered = _covered(position_ws, light_size, light_height, blocker, blocker_height)
    return 1.0 - _area(covered) / light_size**2


def a5_two_occluders(
    position_ws: np.ndarray,
    *,
    light_size: float = 2.0,
    light_height: float = 10.0,
    blockers: tuple[Interval2, Interval2] = A5_BLOCKERS,
    blocker_heights: tuple[float, float] = (7.0, 2.0),
) -> np.ndarray:
    """A5, two rectangles one above the other (zb = 3 and 8, zr = 10): one minus the union of what they cover.

    Neither alone hides the light where their projections meet, together they do (occluder fusion).
    """
    first = _covered(position_ws, light_size, light_height, blockers[0], blocker_heights[0])
    second = _covered(position_ws, light_size, light_height, blockers[1], blocker_heights[1])
    both = np.stack(
        [np.maximum(first[..., 0, :], second[..., 0, :]), np.minimum(first[..., 1, :], second[..., 1, :])], axis=-2
    )
    return 1.0 - (_area(first) + _area(second) - _area(both)) / light_size**2


def a6_empty(position_ws: np.ndarray) -> np.ndarray:
    """A6, no occluder: 1."""
    return np.ones(np.asarray(position_ws).shape[:-1])


def a7_full_occluder(position_ws: np.ndarray) -> np.ndarray:
    """A7, an occluder that hides the whole light: 0."""
    return np.zeros(np.asarray(position_ws).shape[:-1])


def a8_box(
    position_ws: np.ndarray, *, size: tuple[float, float, float] = (1.0, 2.0, 2.0), elevation_deg: float = 40.0
) -> np.ndarray:
    """A8, a box on y = 0 and directional light from -x at ``elevation_deg``: 0 where the ray hits the box, else 1.

    The shadow on y = 0 reaches ``a8_shadow_length`` beyond the box.
    """
    position = np.asarray(position_ws, np.float64)
    elevation = np.radians(elevation_deg)
    half_x, half_z = 0.5 * size[0], 0.5 * size[2]
    # The ray is (x - t cos e, y + t sin e, z); it is inside the box's x and y slabs for t in these intervals.
    x0, x1 = (position[..., 0] - half_x) / np.cos(elevation), (position[..., 0] + half_x) / np.cos(elevation)
    y0, y1 = -position[..., 1] / np.sin(elevation), (size[1] - position[..., 1]) / np.sin(elevation)
    enter, leave = np.maximum(np.maximum(x0, y0), 0.0), np.minimum(x1, y1)
    return np.where((np.abs(position[..., 2]) < half_z) & (enter < leave), 0.0, 1.0)


def a8_shadow_length(*, height: float = 2.0, elevation_deg: float = 40.0) -> float:
    """A8: how far the hard shadow reaches beyond the box on y = 0, ``h / tan e``."""
    return float(height / np.tan(np.radians(elevation_deg)))


def a9_tilted_plane(position_ws: np.ndarray) -> np.ndarray:
    """A9, a plane tilted against the light and nothing else: 1 wherever it faces the light (bias is what is tested)."""
    return np.ones(np.asarray(position_ws).shape[:-1])


CLOSED_FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    form.__name__: form
    for form in (
        a1_half_plane,
        a2_half_plane_disc,
        a3_coaxial_discs,
        a4_rectangle,
        a5_two_occluders,
        a6_empty,
        a7_full_occluder,
        a8_box,
        a9_tilted_plane,
    )
}
"""By the stem of the scene file that they belong to."""


def _signed_distance(
    position_ws: np.ndarray, light_size: float, light_height: float, blocker_height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the hard edge x = 0 into the light, and the width w of the penumbra, at the receivers' height."""
    position = np.asarray(position_ws, np.float64)
    zr, zb = light_height - position[..., 1], light_height - blocker_height
    return position[..., 0], light_size * (zr - zb) / zb


def _covered(
    position_ws: np.ndarray, light_size: float, light_height: float, blocker: Interval2, blocker_height: float
) -> np.ndarray:
    """The part of the square light that a rectangle hides: (..., 2, 2), lower and upper ends along x and z."""
    position = np.asarray(position_ws, np.float64)
    scale = (light_height - position[..., 1]) / (blocker_height - position[..., 1])
    here = position[..., None, ::2]
    ends = here + (np.array(blocker).T - here) * scale[..., None, None]
    return np.clip(ends, -0.5 * light_size, 0.5 * light_size)


def _area(ends: np.ndarray) -> np.ndarray:
    return np.prod(np.maximum(ends[..., 1, :] - ends[..., 0, :], 0.0), axis=-1)


def _lens_area(distance: np.ndarray, radius_a: float, radius_b: np.ndarray) -> np.ndarray:
    """Area shared by two discs whose centres are ``distance`` apart."""
    smaller = np.minimum(radius_a, radius_b)
    apart, inside = distance >= radius_a + radius_b, distance <= np.abs(radius_b - radius_a)
    d = np.where(apart | inside, np.maximum(radius_a, radius_b), distance)  # any value that keeps the formula defined
    cos_a = np.clip((d * d + radius_a**2 - radius_b**2) / (2.0 * d * radius_a), -1.0, 1.0)
    cos_b = np.clip((d * d + radius_b**2 - radius_a**2) / (2.0 * d * radius_b), -1.0, 1.0)
    segment_a = radius_a**2 * (np.arccos(cos_a) - cos_a * np.sqrt(1.0 - cos_a**2))
    segment_b = radius_b**2 * (np.arccos(cos_b) - cos_b * np.sqrt(1.0 - cos_b**2))
    return np.where(apart, 0.0, np.where(inside, np.pi * smaller**2, segment_a + segment_b))
