"""Where a view's depth range is split (Stingl 2011, sections 3.3.2 and 4.2; Zhang et al. 2006). Host, float64."""

from __future__ import annotations

import numpy as np

SCHEMES = ("uniform", "log", "practical", "pseudo")


def split_borders(
    near: float,
    far: float,
    count: int,
    scheme: str = "practical",
    blend: float = 0.5,
    pseudo_near: float = 0.0,
    pseudo_far: float = 0.0,
) -> np.ndarray:
    """Depths of the split planes, nearest first.

    Args:
        near, far: Depth range, scene units, 0 < near < far.
        count: Number of splits, at least 1.
        scheme: ``uniform`` (equation 3.6), ``log`` (3.7), ``practical`` (3.8), or ``pseudo`` (4.1): practical between a
            pseudo-near and a pseudo-far plane.
        blend: The key ``lambda`` of ``practical`` and ``pseudo``: 0 = uniform, 1 = logarithmic.
        pseudo_near, pseudo_far: Shares of the depth range, 0 to 1, that lie before and behind the pseudo planes; their
            sum is less than 1. Only ``pseudo`` reads them.

    Returns:
        float64 (count + 1,), strictly ascending. The first is ``near`` and the last ``far`` under every scheme, so that
        the splits cover the range (with equation 4.1 as printed they would begin and end at the pseudo planes).
    """
    low, high = near, far
    if scheme == "pseudo":
        low, high = pseudo_planes(near, far, pseudo_near, pseudo_far)
    share = np.arange(count + 1) / count
    even = low + (high - low) * share
    logarithmic = low * (high / low) ** share
    weight = {"uniform": 0.0, "log": 1.0, "practical": blend, "pseudo": blend}[scheme]
    borders = (1.0 - weight) * even + weight * logarithmic
    borders[0], borders[-1] = near, far
    return borders


def pseudo_planes(near: float, far: float, pseudo_near: float, pseudo_far: float) -> tuple[float, float]:
    """Depths of the pseudo-near and the pseudo-far plane; see ``split_borders``."""
    return near + pseudo_near * (far - near), far - pseudo_far * (far - near)


def shares_of_split(borders: np.ndarray, index: int, planes: tuple[float, float]) -> tuple[float, float]:
    """The pseudo planes as shares of one split's depth range.

    The near one concerns the first split only and the far one the last (Stingl 2011, section 4.2); 0 for the others.
    """
    length = borders[index + 1] - borders[index] or 1.0  # without any length there is nothing before or behind
    before = (planes[0] - borders[index]) / length if index == 0 else 0.0
    behind = (borders[index + 1] - planes[1]) / length if index == len(borders) - 2 else 0.0
    return float(before), float(behind)
