"""Tap sets of filters: fixed offsets about a centre, scaled by the filter's radius where they are used."""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.spatial import cKDTree

from wkernels.errors import InputError

_PUBLISHED = (
    (-0.94201624, -0.39906216), (0.94558609, -0.76890725), (-0.09418410, -0.92938870), (0.34495938, 0.29387760),
    (-0.91588581, 0.45771432), (-0.81544232, -0.87912464), (-0.38277543, 0.27676845), (0.97484398, 0.75648379),
    (0.44323325, -0.97511554), (0.53742981, -0.47373420), (-0.26496911, -0.41893023), (0.79197514, 0.19090188),
    (-0.24188840, 0.99706507), (-0.81409955, 0.91437590), (0.19984126, 0.78641367), (0.14383161, -0.14100790),
)  # fmt: skip

PUBLISHED_POISSON_16 = np.array(_PUBLISHED)
"""The 16 taps of the shader in Schwaerzler 2009, appendix A (one of them restored, docs/errata.md), float64 (16, 2).

It is called a Poisson *disc* but fills the square [-1, 1]^2: 8 of its points lie outside the unit disc, the farthest at
1.234, so it filters wider than its nominal radius. Its centroid is (-0.006, -0.019), not 0.
"""
PUBLISHED_POISSON_16.flags.writeable = False

_POINTS_PER_TAP = 64  # of the dense set that stands for the disc's area
CANDIDATES = 8  # per point already placed; more of them give a more even, but also a more lattice-like set
_RELAXATIONS = 6  # enough to undo the crowding at the rim; many more would settle into a hexagonal lattice


def poisson_disc_taps(n: int) -> np.ndarray:
    """Blue-noise offsets in the unit disc.

    16 taps are ``PUBLISHED_POISSON_16``, the set of the sources. Any other number is made here: best candidates, then a
    few steps of Lloyd relaxation, so that every tap stands for about the same area, and the centroid moved to 0, so
    that the filter does not shift the edge it blurs. Deterministic. Early taps are spread over the whole disc.

    Args:
        n: Taps, at least 1. One tap is the centre.

    Returns:
        float64 (n, 2), in the closed unit disc (but for n = 16).

    Raises:
        InputError: ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"a filter needs at least 1 tap, not {n}")
    return PUBLISHED_POISSON_16.copy() if n == 16 else _relaxed_disc(n).copy()


def box_taps(n: int) -> np.ndarray:
    """The centres of k x k equal cells of the square [-1, 1]^2, row by row.

    Args:
        n: Taps, a square number k * k.

    Returns:
        float64 (n, 2).

    Raises:
        InputError: ``n`` is not a square number.
    """
    side = math.isqrt(max(n, 0))
    if n < 1 or side * side != n:
        low = max(side, 1)
        raise InputError(f"a box filter has k x k taps, so {n} is not possible: take {low * low} or {(low + 1) ** 2}")
    centres = (2.0 * np.arange(side) + 1.0) / side - 1.0
    y, x = np.meshgrid(centres, centres, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


@functools.lru_cache(maxsize=64)
def _relaxed_disc(n: int) -> np.ndarray:
    if n == 1:
        return np.zeros((1, 2))
    area = _sunflower(max(_POINTS_PER_TAP * n, 2048))
    rng = np.random.default_rng(n)
    taps = best_candidates(rng.permutation(area), n, rng, torus=False)
    for _ in range(_RELAXATIONS):
        owner = cKDTree(taps).query(area)[1]
        share = np.bincount(owner, minlength=n)
        taps = np.stack([np.bincount(owner, area[:, k], minlength=n) for k in (0, 1)], axis=1) / share[:, None]
    taps = taps - taps.mean(axis=0)
    return taps / max(1.0, np.linalg.norm(taps, axis=1).max())


def _sunflower(n: int) -> np.ndarray:
    """Vogel's spiral: ``n`` points of equal area in the unit disc, shape (n, 2)."""
    i = np.arange(n)
    radius, angle = np.sqrt((i + 0.5) / n), i * math.pi * (3.0 - math.sqrt(5.0))
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def best_candidates(pool: np.ndarray, n: int, rng: np.random.Generator, *, torus: bool) -> np.ndarray:
    """Picks ``n`` points one after the other, each the farthest from those before among more and more candidates.

    Args:
        pool: The points to choose from, shuffled, shape (m, 2): in [0, 1) on the torus, else in the unit disc.
        n: Points wanted, at most m.
        rng: Chooses the candidates. The first points do not depend on ``n``.
        torus: Whether distances wrap round at 1.

    Returns:
        float64 (n, 2).

    Source: Mitchell 1991, "Spectrally optimal sampling for distribution ray tracing".
    """
    tree = cKDTree(pool, boxsize=1.0 if torus else None)
    squared = np.full(len(pool), 0.5 if torus else 4.0)  # to the nearest point so far; at first the largest that can be
    chosen = np.empty(n, dtype=np.int64)
    reach = 2.0
    for i in range(n):
        # the pool is shuffled, so that any run of it is a random choice of candidates
        candidates = min(CANDIDATES * i + 1, len(pool))
        first = rng.integers(0, len(pool) - candidates + 1)
        best = first + int(np.argmax(squared[first : first + candidates]))
        chosen[i] = best
        # Nothing farther away than the emptiest spot is from its nearest point can change. The maximum is looked up
        # only now and then: an old one is too large, never too small.
        if i & (i - 1) == 0 or i % 64 == 0:
            reach = float(np.sqrt(squared.max()))
        near = np.asarray(tree.query_ball_point(pool[best], reach))
        offset = np.abs(pool[near] - pool[best])
        if torus:
            offset = np.minimum(offset, 1.0 - offset)
        squared[near] = np.minimum(squared[near], (offset * offset).sum(axis=1))
    return pool[chosen]
