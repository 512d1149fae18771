"""How many shadow tests a pixel may count: an exponential window, fixed or as short as its history is in doubt.

Sums that may count N tests at most lose a share of 1 / N of what they hold with every test that is added:
psi_k = psi_(k-1) (1 - 1 / N) + tau / N. What was true k frames ago weighs (1 - 1 / N)^k, so that it leaves where the
scene changes, and so does what interpolation has mixed in. Its standard error is that of N independent tests at most:
the window's are worth 2 N - 1.
"""

from __future__ import annotations

import warp as wp

SAME = wp.constant(1.0e-6)  # variance below which texels agree: float32 rounding of sums


@wp.struct
class SampleWindow:
    """Limits of n before a frame's test is added."""

    largest: float  # n after it, at most
    agreement: float  # multiple of psi (1 - psi) / variance of the texels that n may reach; 0: not limited so
    least: float  # to which that may fall


@wp.func
def window_of(psi: float, spread: float, window: SampleWindow) -> float:
    """The n that history may bring, for a psi that was interpolated from texels of variance ``spread``.

    The error of interpolation returns with every frame in which the eye moves, and is the larger the less the texels
    agree. To count more tests than make the statistical error as small, psi (1 - psi) / n, gains nothing.
    """
    result = window.largest - 1.0
    if window.agreement > 0.0:
        share = wp.clamp(psi, 0.0, 1.0)
        by_agreement = window.agreement * share * (1.0 - share) / wp.max(spread, SAME)
        result = wp.where(spread > SAME, wp.min(result, wp.max(by_agreement, window.least)), result)
    return result


@wp.func
def shorten(rho: float, n: float, longest: float) -> wp.vec2:
    """(rho, n) that count for ``longest`` tests at most, psi as before."""
    keeps = wp.where(n > longest, longest / wp.max(n, 1.0e-30), 1.0)
    return wp.vec2(rho * keeps, n * keeps)
