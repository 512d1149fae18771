"""Numbers per pixel of a light map in use: its texel grid and its sampling rate. NumPy, float64."""

from __future__ import annotations

import numpy as np

from experiments.views.subject import Shot, Subject
from wkernels.analysis.perspective_error import texels_per_pixel
from wkernels.scene.views import HostView

STOPS = (0.0, 1.0 / 7.75, 1.0 / 3.25, 1.0, 3.25, 7.75, 10.0)
STOP_COLORS = ((0.2, 0, 0), (1, 0.2, 0), (1, 1, 0), (0, 1, 0), (0.3, 0.8, 1), (0, 0, 1), (0, 0, 0.4))
"""Map texels per pixel and their colours (Stingl 2011, listing A.3; the figure's caption has the ratio upside down)."""

MAJOR = 8  # fine cells per side of a coarse one
LEAST_CELL = 4.0  # pixels: finer grids fade out, they would only be grey
GOOD_CELL = 12.0  # pixels: what the grid's step is chosen for
EDGE_ON = 1e-6  # sine of the angle between sight and surface: below it a surface has no extent on the screen


def map_positions(subject: Subject, shot: Shot) -> np.ndarray:
    """Place in the layer that each pixel reads, texels to the right and down, (H, W, 2); NaN where none is read."""
    out = np.full((*shot.depth.shape, 2), np.nan)
    for i, view in enumerate(subject.views):
        mine = shot.layer == i
        rows = view.ws_to_ss
        h = shot.position[mine] @ rows[:, :3].T + rows[:, 3]
        ndc = h[:, :2] / h[:, 3:]
        out[mine] = np.column_stack([0.5 + 0.5 * ndc[:, 0], 0.5 - 0.5 * ndc[:, 1]]) * subject.resolution
    return out


def jacobians(subject: Subject, shot: Shot, screen: HostView, where: np.ndarray) -> np.ndarray:
    """Texels per pixel of ``screen`` at the surfaces that a shot sees, (H, W, 2, 2): [texel axis, pixel axis].

    Args:
        subject: Whose maps.
        shot: Whose surfaces.
        screen: Whose pixels: the shot's own view, or the eye's.
        where: Pixels to look at (H, W); the others are NaN.
    """
    out = np.full((*shot.depth.shape, 2, 2), np.nan)
    sight = (
        shot.position - screen.eye_ws if screen.perspective else np.broadcast_to(screen.forward_ws, shot.position.shape)
    )
    sine = np.abs(np.einsum("...i,...i", shot.normal, sight)) / np.maximum(np.linalg.norm(sight, axis=-1), 1e-30)
    for i, view in enumerate(subject.views):
        mine = where & (shot.layer == i) & (sine > EDGE_ON)
        if mine.any():
            size = screen.width, screen.height
            args = view.ws_to_ss, subject.resolution, screen.ws_to_ss, size, shot.position[mine], shot.normal[mine]
            out[mine] = texels_per_pixel(*args)
    return out


def sampling_rate(jacobian: np.ndarray, mode: str) -> np.ndarray:
    """Map texels per pixel: x or y of the map, or ``det``, the root of the area ratio, so that all have one scale.

    Args:
        jacobian: (..., 2, 2) as ``jacobians`` gives it.
        mode: ``det``, ``x`` or ``y``.
    """
    if mode == "det":
        det = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        out: np.ndarray = np.sqrt(np.abs(det))
        return out
    return np.linalg.norm(jacobian[..., "xy".index(mode), :], axis=-1)


def rate_colors(rate: np.ndarray) -> np.ndarray:
    """Colours of sampling rates, linear between ``STOPS``; (..., 3) in [0, 1]."""
    stops = np.array(STOP_COLORS, float)
    return np.stack([np.interp(np.nan_to_num(rate), STOPS, stops[:, channel]) for channel in range(3)], axis=-1)


def grid_step(jacobian: np.ndarray) -> int:
    """The power of two of texels whose cells are large enough to be seen in half of the picture; at least 1."""
    lengths = np.linalg.norm(jacobian, axis=-1).max(axis=-1)  # texels per pixel, the denser axis
    lengths = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    if not len(lengths):
        return 1
    return int(2 ** max(0, int(np.ceil(np.log2(GOOD_CELL * float(np.median(lengths)))))))


def grid_lines(place: np.ndarray, jacobian: np.ndarray, step: int, width: float) -> np.ndarray:
    """How much of each pixel grid lines cover, (H, W) in [0, 1].

    A line lies where the distance to a multiple of ``step``, divided by its gradient on the screen, is less than half
    the width (Lloyd 2007 by Stingl 2011, listing A.4, whose lines begin at the border; these are centred on it).

    Args:
        place: Map positions in texels (H, W, 2).
        jacobian: Texels per pixel, (H, W, 2, 2).
        step: Texels per cell.
        width: Pixels.
    """
    rate = np.linalg.norm(jacobian, axis=-1) / step  # cells per pixel, (H, W, 2)
    cell = place / step
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(cell - np.round(cell)) / rate
        faded = np.clip((1.0 / rate - LEAST_CELL) / LEAST_CELL, 0.0, 1.0)
    cover = np.clip(0.5 * width + 0.5 - distance, 0.0, 1.0) * faded
    out: np.ndarray = np.nan_to_num(cover).max(axis=-1)
    return out
