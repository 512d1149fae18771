"""Point sets on the unit square and cube, from which lights and filters are sampled, and hashed numbers for kernels.

Host sets are float64 in [0, 1), one row per sample, and *extensible*: asking for more points, or for a later ``start``,
never changes a point that was given before, so a temporal method may take one sample a frame out of the same set that
another method takes at once. Filter taps live in ``wkernels.sampling.disc_sets`` and are offered here too.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import warp as wp

from wkernels.errors import InputError, nearest
from wkernels.sampling.disc_sets import PUBLISHED_POISSON_16, best_candidates, box_taps, poisson_disc_taps

__all__ = [
    "LIGHT_SETS",
    "PUBLISHED_POISSON_16",
    "box_taps",
    "halton",
    "hash_2d",
    "light_set",
    "poisson_disc_set",
    "poisson_disc_taps",
    "r2",
    "random_set",
    "rotate_2d",
    "stratified_set",
    "uniform_01",
]

HALTON_BASES = (2, 3, 5)
PLASTIC_NUMBER = 1.324717957244746  # real root of x^3 = x + 1
R2_STEPS = (1.0 / PLASTIC_NUMBER, 1.0 / PLASTIC_NUMBER**2, 0.5 * (5.0**0.5 - 1.0))
POISSON_PERIOD = 4096  # points before the blue-noise sequence repeats, shifted
_STRATA_SIDE = 8  # of the grid of ``stratified_set``, a power of 2
_POOL_SIDE = 256  # the sequence is drawn from one candidate in each cell of a grid of this size


def _check(n: int, dims: int, start: int, seed: int | None) -> None:
    if n < 1:
        raise InputError(f"a sample set needs at least 1 point, not {n}")
    if not 1 <= dims <= 3:
        raise InputError(f"a sample set has 1, 2 or 3 dimensions, not {dims}")
    if start < 0:
        raise InputError(f"a sample set starts at index 0 or later, not {start}")
    if seed is not None and seed < 0:
        raise InputError(f"a seed is 0 or a positive number, not {seed}")


def _rotated(points: np.ndarray, seed: int | None) -> np.ndarray:
    """Cranley-Patterson rotation: one shift of the torus, drawn from ``seed``; none for 0 and None."""
    if not seed:
        return points
    # three numbers are drawn whatever the dimension, so that a set in 2-D is the projection of the set in 3-D
    return np.mod(points + np.random.default_rng(seed).random(3)[: points.shape[1]], 1.0)


def _radical_inverse(index: np.ndarray, base: int) -> np.ndarray:
    """Mirrors the digits of ``index`` in ``base`` at the radix point; exact integers until the one division."""
    rest, mirrored, scale = index.copy(), np.zeros_like(index), np.ones_like(index)
    while rest.any():
        more = rest > 0
        rest, digit = np.divmod(rest, base)
        mirrored = np.where(more, mirrored * base + digit, mirrored)
        scale = np.where(more, scale * base, scale)
    return mirrored / scale


def halton(n: int, dims: int = 3, start: int = 0, seed: int | None = 0) -> np.ndarray:
    """The Halton sequence in the bases 2, 3 and 5.

    Point i is the radical inverse of ``start + i + 1``: index 0 is the origin, a corner of the light, and is left out.

    Args:
        n: Points, at least 1.
        dims: 1 to 3. The first two columns do not depend on it.
        start: Index of the first point, at least 0.
        seed: 0 or None for the plain sequence; any other seed shifts it round the torus (Cranley-Patterson rotation).

    Returns:
        float64 (n, dims) in [0, 1).

    Raises:
        InputError: A number is out of range.

    Source: Halton 1960; Cranley and Patterson 1976.
    """
    _check(n, dims, start, seed)
    index = np.arange(start + 1, start + n + 1, dtype=np.int64)
    return _rotated(np.stack([_radical_inverse(index, base) for base in HALTON_BASES[:dims]], axis=1), seed)


def r2(n: int, start: int = 0, dims: int = 2, seed: int | None = 0) -> np.ndarray:
    """The R2 sequence: the additive recurrence of the plastic number.

    A third dimension takes the golden ratio, which is rationally independent of the first two steps. (R3 is the even
    choice for three dimensions, but its first two columns are not R2, and those are all that most lights use.)

    Args:
        n: Points, at least 1.
        start: Index of the first point, at least 0.
        dims: 1 to 3.
        seed: 0 or None for the plain sequence, which starts at the centre; any other seed shifts it round the torus.

    Returns:
        float64 (n, dims) in [0, 1).

    Raises:
        InputError: A number is out of range.

    Source: Roberts 2018, "The unreasonable effectiveness of quasirandom sequences".
    """
    _check(n, dims, start, seed)
    index = np.arange(start, start + n, dtype=np.float64)[:, None]
    return _rotated(np.mod(0.5 + index * np.array(R2_STEPS[:dims]), 1.0), seed)


def random_set(n: int, seed: int | None = 0, dims: int = 2, start: int = 0) -> np.ndarray:
    """Independent uniform points, float64 (n, dims) in [0, 1); the baseline that every other set has to beat.

    Raises:
        InputError: A number is out of range.
    """
    _check(n, dims, start, seed)
    return np.random.default_rng(seed or 0).random((start + n, 3))[start:, :dims]


def poisson_disc_set(n: int, seed: int | None = 0, dims: int = 2, start: int = 0) -> np.ndarray:
    """Blue noise on the torus: each point is the one of many candidates that is farthest from all before it.

    Any run from index 0 keeps a Poisson-disc distance of its own. The sequence repeats after ``POISSON_PERIOD`` points,
    each time shifted by the next point of R2. A third dimension is not blue noise but the golden-ratio recurrence.

    Args:
        n: Points, at least 1.
        seed: Chooses the sequence.
        dims: 1 to 3. The first two columns do not depend on it.
        start: Index of the first point, at least 0.

    Returns:
        float64 (n, dims) in [0, 1).

    Raises:
        InputError: A number is out of range.

    Source: Mitchell 1991, "Spectrally optimal sampling for distribution ray tracing" (best candidate).
    """
    _check(n, dims, start, seed)
    index = np.arange(start, start + n)
    lap, place = np.divmod(index, POISSON_PERIOD)
    longest = min(start + n, POISSON_PERIOD)
    sequence = _best_candidate_sequence(seed or 0, 1 << max(8, (longest - 1).bit_length()))
    planar = np.mod(sequence[place] + lap[:, None] * np.array(R2_STEPS[:2]), 1.0)
    third = np.mod(0.5 + index * R2_STEPS[2], 1.0)
    return np.column_stack([planar, third])[:, :dims]


@functools.lru_cache(maxsize=16)
def _best_candidate_sequence(seed: int, length: int) -> np.ndarray:
    """The first ``length`` points of the sequence of ``seed``, float64 (length, 2)."""
    rng = np.random.default_rng([seed, 0xB10E])
    row, col = np.divmod(rng.permutation(_POOL_SIDE**2), _POOL_SIDE)
    pool = (np.stack([col, row], axis=1) + rng.random((_POOL_SIDE**2, 2))) / _POOL_SIDE
    pool = np.minimum(pool, np.nextafter(1.0, 0.0))
    points = best_candidates(pool, length, rng, torus=True)
    points.flags.writeable = False
    return points


def stratified_set(n: int, seed: int | None = 0, dims: int = 2, start: int = 0) -> np.ndarray:
    """Jittered strata: one random point in each cell of an 8 x 8 grid a lap, cells in the order of a Bayer matrix.

    Every 4, 16 and 64 points from a multiple of 4, 16 or 64 on visit each of as many coarser cells once. Each lap has
    an order of its own (another cell first, axes mirrored alike) and jitter of its own. A third dimension is the
    golden-ratio recurrence.

    Args:
        n: Points, at least 1.
        seed: Chooses the jitter.
        dims: 1 to 3. The first two columns do not depend on it.
        start: Index of the first point, at least 0.

    Returns:
        float64 (n, dims) in [0, 1).

    Raises:
        InputError: A number is out of range.

    Source: Cook 1986, "Stochastic sampling in computer graphics"; the order is Bayer's of 1973.
    """
    _check(n, dims, start, seed)
    index = np.arange(start, start + n)
    lap, place = np.divmod(index, _STRATA_SIDE**2)
    laps = np.arange(lap[0], lap[-1] + 1)
    drawn = [np.random.default_rng([seed or 0, 0x57A7, int(k)]) for k in laps]
    flips = np.stack([rng.integers(0, _STRATA_SIDE, 2) for rng in drawn])
    jitter = np.stack([rng.random((_STRATA_SIDE**2, 2)) for rng in drawn])
    cell = np.stack(_bayer_cell(place), axis=1) ^ flips[lap - lap[0]]
    planar = (cell + jitter[lap - lap[0], place]) / _STRATA_SIDE
    third = np.mod(0.5 + index * R2_STEPS[2], 1.0)
    return np.column_stack([np.minimum(planar, np.nextafter(1.0, 0.0)), third])[:, :dims]


def _bayer_cell(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of the cell that the Bayer matrix of ``_STRATA_SIDE`` visits at a place in its order."""
    column, row = np.zeros_like(place), np.zeros_like(place)
    half = _STRATA_SIDE // 2
    while half:
        place, digit = np.divmod(place, 4)
        # of four cells the two on one diagonal come first
        column += half * (digit & 1)
        row += half * ((digit & 1) ^ (digit >> 1))
        half //= 2
    return column, row


LIGHT_SETS: dict[str, Callable[[int, int, int, int | None], np.ndarray]] = {
    "halton": halton,
    "r2": lambda n, dims, start, seed: r2(n, start, dims, seed),
    "poisson_disc": lambda n, dims, start, seed: poisson_disc_set(n, seed, dims, start),
    "stratified": lambda n, dims, start, seed: stratified_set(n, seed, dims, start),
    "random": lambda n, dims, start, seed: random_set(n, seed, dims, start),
}


def light_set(kind: str, n: int, dims: int = 3, start: int = 0, seed: int | None = 0) -> np.ndarray:
    """Points ``start`` to ``start + n - 1`` of the set called ``kind``, as ``Light.sample`` takes them.

    Args:
        kind: A key of ``LIGHT_SETS``: ``halton``, ``r2``, ``poisson_disc``, ``stratified`` or ``random``.
        n: Points, at least 1.
        dims: 1 to 3.
        start: Index of the first point, at least 0.
        seed: Chooses the set; 0 or None is the plain sequence of halton and r2.

    Returns:
        float64 (n, dims) in [0, 1).

    Raises:
        InputError: No such kind, or a number out of range.
    """
    if kind not in LIGHT_SETS:
        raise InputError(f"there is no sample set '{kind}'.{nearest(kind, LIGHT_SETS)}")
    return LIGHT_SETS[kind](n, dims, start, seed)


_PCG_STEP = wp.constant(wp.uint32(2891336453))  # as a literal in the function it would be compiled as a signed number


@wp.func
def _pcg(value: wp.uint32) -> wp.uint32:
    """One step of PCG and its output permutation (Jarzynski and Olano 2020, "Hash functions for GPU rendering")."""
    state = value * wp.uint32(747796405) + _PCG_STEP
    word = ((state >> ((state >> wp.uint32(28)) + wp.uint32(4))) ^ state) * wp.uint32(277803737)
    return (word >> wp.uint32(22)) ^ word


@wp.func
def hash_2d(x: int, y: int, seed: int) -> wp.uint32:
    """32 well mixed bits for a pixel and a seed; the same on every device. Change the seed for a second number."""
    return _pcg(wp.uint32(x) + _pcg(wp.uint32(y) + _pcg(wp.uint32(seed))))


@wp.func
def uniform_01(bits: wp.uint32) -> float:
    """The upper 24 bits as a number in [0, 1); all of these are exact in float32, so that 1 never occurs."""
    return float(bits >> wp.uint32(8)) * 5.9604644775390625e-08


@wp.func
def rotate_2d(v: wp.vec2, cosine: float, sine: float) -> wp.vec2:
    """``v`` turned counter-clockwise (x to the right, y up) by the angle with this cosine and sine."""
    return wp.vec2(cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1])
