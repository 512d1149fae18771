"""How much of a light is hidden, estimated from n shadow tests: a proportion, its variance, sums that never saturate.

Source: Scherzer et al. 2009, section 3.1, equations 2, 3 and 5. There tau is one hard shadow test (1: the light
sample is hidden), rho the sum of n tests and psi = rho / n the hidden share of the light; visibility is 1 - psi.
Lights with a texture weight their samples: then rho sums weight times tau, and n the weights.
"""

from __future__ import annotations

import warp as wp

FLOAT16_LIMIT = 1024.0
"""Largest n for sums kept in float16. Integers are exact to 2048; from there on rho still grows where n no longer
does."""

FLOAT32_LIMIT = 2.0**22
"""Largest n for sums kept in float32, a quarter of where integers stop being exact."""

NO_WINDOW = wp.constant(3.0e38)  # more tests than can be remembered

UNLIMITED = 3.0e38
"""No limit at all: what the papers' own buffers had."""


@wp.func
def hidden_share(rho: float, n: float) -> float:
    """Psi, equation 2, in [0, 1]; 0 where nothing is known (n = 0)."""
    result = float(0.0)
    if n > 0.0:
        result = wp.clamp(rho / n, 0.0, 1.0)
    return result


@wp.func
def share_variance(psi: float, n: float) -> float:
    """Unbiased estimate of the variance of psi, equation 3: psi (1 - psi) / (n - 1).

    One test says nothing (0 / 0; the paper's table prints 0): 1 stands for that, as for n = 0.
    """
    result = float(1.0)
    if n > 1.5:
        result = wp.max(psi * (1.0 - psi), 0.0) / (n - 1.0)
    return result


@wp.func
def standard_error(psi: float, n: float) -> float:
    """Square root of ``share_variance``: too large for low-discrepancy samples, 0 where all tests agree so far."""
    return wp.sqrt(share_variance(psi, n))


@wp.func
def add_test(rho: float, n: float, tau: float, weight: float, limit: float) -> wp.vec2:
    """(rho, n) after one more shadow test, equation 5.

    Before n would pass ``limit`` both sums are halved: psi stays, and halving only lowers an exponent, so that
    nothing is rounded. Older tests count half from then on. (Scaling rho down by n / (n + 1) in every frame instead
    would round it in every frame, which at float16 and n = 1024 draws psi off by up to 0.1.)

    Args:
        rho: Sum of weighted tests so far.
        n: Sum of weights so far, at least ``rho``.
        tau: The new test, 1 where the light sample is hidden.
        weight: The sample's relative radiance, 1 for a uniform light.
        limit: Largest n that the storage holds exactly.
    """
    scale = wp.where(n + weight > limit, 0.5, 1.0)
    return wp.vec2(scale * rho + weight * tau, scale * n + weight)


@wp.func
def age_sums(rho: float, n: float, tau: float, weight: float, window: float) -> wp.vec2:
    """(rho, n) to which ``add_test`` is to add a test so that older ones count less: all that moves with a light.

    What is remembered enters the new mean with a weight of at most ``window`` - weight: an exponential mean, rho and n
    times a = 1 - 1 / window before every test, once there is enough to forget, and the plain mean until then.

    After that n is not the sum of weights W but the *effective* number n = W^2 / Q, Q the sum of squared weights, so
    that psi (1 - psi) / (n - 1) stays what it says: a weighted mean of independent tests has the variance psi (1 - psi)
    Q / W^2. A test that enters a mean of effective n with the share g leaves sum of (normalised weights)^2 = (1 - g)^2
    / n + g^2 / weight, and the new n is its inverse, exactly so for any sequence of g; neither W nor Q has to be kept.
    With g = 1 / (n + 1) it is n + 1; with a constant g it tends to (2 - g) / g = (1 + a) / (1 - a).

    Args:
        rho: psi n so far.
        n: Effective number so far.
        tau: The new test.
        weight: Its weight, 1 for a uniform light.
        window: 1 / (1 - a), more than 1; 0 for no ageing.
    """
    result = wp.vec2(rho, n)
    room = wp.max(window - weight, 0.0)
    if window > 0.0 and n > room:
        share = weight / (room + weight)
        psi = (1.0 - share) * (rho / n) + share * tau
        count = 1.0 / ((1.0 - share) * (1.0 - share) / n + share * share / weight)
        result = wp.vec2(wp.max(psi * count - weight * tau, 0.0), wp.max(count - weight, 0.0))
    return result


@wp.func
def fade_out(rho: float, n: float, decrement: float) -> wp.vec2:
    """(rho, n) that count for ``decrement`` tests less, psi as before (Schwaerzler 2009, equations 5.15 to 5.17).

    (0, 0) once nothing is left.
    """
    left = wp.max(n - decrement, 0.0)
    return wp.vec2(wp.where(n > 0.0, left * rho / wp.max(n, 1.0e-30), 0.0), left)


@wp.func
def sampling_weight(error: float, least_error: float, largest_error: float) -> float:
    """Weight of the sampled psi against a smoothed one (Schwaerzler 2009, equation 5.13), 0 to 1.

    Args:
        error: Standard error s of psi.
        least_error: s_min; from there down the sampled psi stands alone.
        largest_error: s_max; from there up the smoothed one does. Where both bounds are the same it is a threshold.
    """
    range_ = wp.max(largest_error - least_error, 1.0e-20)
    return wp.clamp((largest_error - error) / range_, 0.0, 1.0)
