"""Where a reference is umbra, penumbra and lit, and how far from one another; ``shadow_scores`` are told apart by it.

Distances are in pixels of the picture, in which errors are seen. They are Euclidean and take no notice of depth edges;
pixels without a receiver belong to no class and end nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from experiments.metrics.measured import Measured

SURE = 1.2
"""A reference is umbra or lit up to so many of its standard errors: one light sample of n that disagrees is not told
from none (it is 1.0 away), two are (1.41). More would be too generous: the binomial error is 2 to 5 times too large."""

DEEP_PX = 4.0
"""What is no further from another class is its neighbourhood: a 5 x 5 filter of pixel-sized texels reaches 2.5 pixels
over an edge, and a biased depth test puts the edge a texel off."""


@dataclass(frozen=True, eq=False)
class ShadowClasses:
    """Masks over a reference's pixels, all bool (H, W).

    Attributes:
        umbra, penumbra, lit: The class of each receiver pixel; no pixel is in two.
        deep_umbra, deep_lit: Those further from every pixel of another class than ``DEEP_PX`` and than the penumbra at
            the nearest such pixel is wide. A shadow whose edge is too soft or too hard, by no more than making its
            penumbra three times as wide, is in error outside of them.
        edge: All other receiver pixels: penumbrae and what is around them.
    """

    umbra: np.ndarray
    penumbra: np.ndarray
    lit: np.ndarray
    deep_umbra: np.ndarray
    deep_lit: np.ndarray
    edge: np.ndarray


def classify(reference: np.ndarray, standard_error: np.ndarray | None = None) -> ShadowClasses:
    """The classes of a reference.

    Args:
        reference: Visibility (H, W), NaN where no receiver is seen.
        standard_error: (H, W), goes with it; None for one without error.
    """
    error = 0.0 if standard_error is None else SURE * np.nan_to_num(standard_error)
    with np.errstate(invalid="ignore"):
        umbra, lit = reference <= error, reference >= 1.0 - error
    umbra, lit = umbra & ~lit, lit & ~umbra
    receiver = np.isfinite(reference)
    penumbra = receiver & ~umbra & ~lit
    width = _widths(umbra, penumbra, lit)
    deep_umbra, deep_lit = _deep(umbra, receiver, width), _deep(lit, receiver, width)
    return ShadowClasses(umbra, penumbra, lit, deep_umbra, deep_lit, receiver & ~deep_umbra & ~deep_lit)


def _widths(umbra: np.ndarray, penumbra: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """How wide the penumbra is at each of its pixels, in pixels; 1 elsewhere.

    From the nearest umbra through the pixel to the nearest lit one, and where a penumbra has no umbra (or nothing
    lit) in it, twice the way to the middle of the widest.
    """
    out = np.ones(umbra.shape)
    if penumbra.any():
        to_umbra, to_lit = _distance(umbra)[penumbra], _distance(lit)[penumbra]
        nearer = np.minimum(to_umbra, to_lit)
        most = 2.0 * float(nearer.max()) - 1.0
        out[penumbra] = np.minimum(to_umbra + to_lit - 1.0, most)
    return out


def _deep(own: np.ndarray, receiver: np.ndarray, width: np.ndarray) -> np.ndarray:
    other = receiver & ~own
    if not other.any():
        return own
    distance, nearest = ndimage.distance_transform_edt(~other, return_indices=True)
    return own & (distance > np.maximum(DEEP_PX, width[nearest[0], nearest[1]]))


def _distance(to: np.ndarray) -> np.ndarray:
    """Distance of each pixel to the nearest of those, in pixels; infinite without any."""
    return ndimage.distance_transform_edt(~to) if to.any() else np.full(to.shape, np.inf)


_last: tuple[np.ndarray, np.ndarray | None, ShadowClasses] | None = None


def classes_of(measured: Measured) -> ShadowClasses | None:
    """The classes of a frame's reference, None without one; made once for all labels and scores of a frame."""
    global _last
    reference, error = measured.reference, measured.reference_standard_error
    if reference is None:
        return None
    if _last is None or _last[0] is not reference or _last[1] is not error:
        _last = (reference, error, classify(reference, error))
    return _last[2]
