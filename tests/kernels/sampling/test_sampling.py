from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from scipy.stats import qmc

from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.sampling import point_sets as sampling
from wkernels.sampling.disc_sets import CANDIDATES, best_candidates

KINDS = sorted(sampling.LIGHT_SETS)
SPREAD_KINDS = [kind for kind in KINDS if kind != "random"]


def mirrored_digits(index: int, base: int) -> Fraction:
    value, place = Fraction(0), Fraction(1, base)
    while index:
        index, digit = divmod(index, base)
        value += digit * place
        place /= base
    return value


def torus_distance(points: np.ndarray) -> np.ndarray:
    """Distance of every point to its nearest neighbour, by brute force."""
    offset = np.abs(points[:, None] - points[None])
    squared = (np.minimum(offset, 1.0 - offset) ** 2).sum(axis=2)
    np.fill_diagonal(squared, np.inf)
    return np.sqrt(squared.min(axis=1))


def packed_distance(n: int) -> float:
    """Nearest-neighbour distance of the densest packing of n points on the unit torus."""
    return float(np.sqrt(2.0 / (np.sqrt(3.0) * n)))


def test_halton_mirrors_the_digits_of_its_index() -> None:
    points = sampling.halton(300, start=50)
    expected = [[float(mirrored_digits(i, base)) for base in (2, 3, 5)] for i in range(51, 351)]
    np.testing.assert_array_equal(points, expected)
    np.testing.assert_array_equal(sampling.halton(1)[0], [1 / 2, 1 / 3, 1 / 5])


def test_halton_is_exact_at_large_indices() -> None:
    start = 10_000_000
    expected = [[float(mirrored_digits(start + 1 + i, base)) for base in (2, 3, 5)] for i in range(5)]
    np.testing.assert_array_equal(sampling.halton(5, start=start), expected)


@pytest.mark.parametrize("kind", ["halton", "r2"])
def test_seeds_shift_the_whole_set_round_the_torus(kind: str) -> None:
    plain, none, one, two = (sampling.light_set(kind, 40, seed=seed) for seed in (0, None, 1, 2))
    np.testing.assert_array_equal(plain, none)
    shift = np.mod(one - plain, 1.0)
    gap = np.abs(shift - shift[0])
    assert np.minimum(gap, 1.0 - gap).max() < 1e-12
    assert np.abs(one - two).max() > 0.01
    assert np.abs(shift[0]).min() > 1e-3


def test_r2_is_the_recurrence_of_the_plastic_number() -> None:
    g = sampling.PLASTIC_NUMBER
    assert abs(g**3 - g - 1.0) < 1e-14
    points = sampling.r2(200)
    np.testing.assert_array_equal(points[0], [0.5, 0.5])
    expected = [[(0.5 + i / g) % 1.0, (0.5 + i / g**2) % 1.0] for i in range(200)]
    np.testing.assert_allclose(points, expected, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("kind", KINDS)
def test_sets_are_extensible(kind: str, seed: int) -> None:
    whole = sampling.light_set(kind, 700, 3, seed=seed)
    assert whole.shape == (700, 3) and whole.dtype == np.float64
    assert whole.min() >= 0.0 and whole.max() < 1.0
    assert len(np.unique(whole, axis=0)) == 700
    np.testing.assert_array_equal(sampling.light_set(kind, 100, 3, seed=seed), whole[:100])
    np.testing.assert_array_equal(sampling.light_set(kind, 300, 3, start=333, seed=seed), whole[333:633])
    for dims in (1, 2):
        np.testing.assert_array_equal(sampling.light_set(kind, 700, dims, seed=seed), whole[:, :dims])


@pytest.mark.parametrize("kind", SPREAD_KINDS)
@pytest.mark.parametrize("dims", [2, 3])
def test_spread_sets_have_lower_discrepancy_than_random_ones(kind: str, dims: int) -> None:
    seeds = range(1, 5)
    ours = np.mean([qmc.discrepancy(sampling.light_set(kind, 1024, dims, seed=s), method="L2-star") for s in seeds])
    theirs = np.mean(
        [qmc.discrepancy(sampling.light_set("random", 1024, dims, seed=s), method="L2-star") for s in seeds]
    )
    assert ours < 0.6 * theirs


@pytest.mark.parametrize("kind", SPREAD_KINDS)
def test_spread_sets_measure_half_planes_better_than_random_ones(kind: str) -> None:
    """What a light sees of an occluder's edge, in any direction."""
    angle = np.linspace(0.0, np.pi, 60, endpoint=False)
    normals = np.stack([np.cos(angle), np.sin(angle)])

    def root_mean_square_error(name: str) -> float:
        errors = [
            ((sampling.light_set(name, 256, 2, seed=s) - 0.5) @ normals > 0.0).mean(axis=0) - 0.5 for s in (1, 2, 3)
        ]
        return float(np.sqrt(np.mean(np.square(errors))))

    assert root_mean_square_error(kind) < 0.5 * root_mean_square_error("random")


@pytest.mark.parametrize("n", [16, 100, 1000])
def test_poisson_disc_points_keep_their_distance(n: int) -> None:
    assert torus_distance(sampling.poisson_disc_set(n, seed=3)).min() > 0.6 * packed_distance(n)
    assert torus_distance(sampling.random_set(n, seed=3)).min() < 0.4 * packed_distance(n)


@pytest.mark.parametrize("torus", [True, False])
def test_best_candidates_equal_the_brute_force_choice(torus: bool) -> None:
    pool = np.random.default_rng(5).random((3000, 2))
    if not torus:
        pool = (2.0 * pool - 1.0) * np.sqrt(0.5)
    n, rng = 200, np.random.default_rng(6)
    chosen: list[np.ndarray] = []
    for i in range(n):
        candidates = min(CANDIDATES * i + 1, len(pool))
        first = rng.integers(0, len(pool) - candidates + 1)
        group = pool[first : first + candidates]
        if chosen:
            offset = np.abs(group[:, None] - np.array(chosen)[None])
            if torus:
                offset = np.minimum(offset, 1.0 - offset)
            chosen.append(group[np.argmax((offset**2).sum(axis=2).min(axis=1))])
        else:
            chosen.append(group[0])
    np.testing.assert_array_equal(best_candidates(pool, n, np.random.default_rng(6), torus=torus), chosen)


def test_poisson_disc_set_goes_on_past_its_period() -> None:
    period = sampling.POISSON_PERIOD
    across = sampling.poisson_disc_set(40, seed=1, start=period - 20)
    np.testing.assert_array_equal(across[:20], sampling.poisson_disc_set(period, seed=1)[-20:])
    shift = np.mod(across[20:] - sampling.poisson_disc_set(20, seed=1), 1.0)
    np.testing.assert_allclose(shift, np.tile(sampling.R2_STEPS[:2], (20, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "haltn", "n": 4}, "Did you mean 'halton'"),
        ({"kind": "xyzzy", "n": 4}, "Valid names: halton, poisson_disc, r2, random"),
        ({"kind": "r2", "n": 0}, "at least 1 point"),
        ({"kind": "random", "n": 4, "dims": 4}, "1, 2 or 3 dimensions"),
        ({"kind": "poisson_disc", "n": 4, "start": -1}, "index 0 or later"),
        ({"kind": "halton", "n": 4, "seed": -1}, "a seed is 0 or a positive"),
    ],
)
def test_wrong_input_is_named(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sampling.light_set(**arguments)


def test_published_set_is_the_sixteen_tap_set() -> None:
    taps = sampling.poisson_disc_taps(16)
    np.testing.assert_array_equal(taps, sampling.PUBLISHED_POISSON_16)
    radius = np.linalg.norm(taps, axis=1)
    assert (radius > 1.0).sum() == 8
    assert radius.max() == pytest.approx(1.234, abs=5e-4)
    np.testing.assert_allclose(taps.mean(axis=0), [-0.006, -0.019], atol=5e-4)
    taps[:] = 0.0  # a caller's copy
    assert sampling.poisson_disc_taps(16).any()


@pytest.mark.parametrize("n", [1, 2, 5, 12, 25, 32, 64, 300])
def test_made_taps_cover_the_disc_evenly(n: int) -> None:
    taps = sampling.poisson_disc_taps(n)
    assert taps.shape == (n, 2)
    assert np.linalg.norm(taps, axis=1).max() <= 1.0
    np.testing.assert_allclose(taps.mean(axis=0), 0.0, atol=1e-12)
    if n >= 12:  # a disc's second moment is 1/4 on each axis; a tap's own area is missing, which is about 1/(4n) of it
        np.testing.assert_allclose((taps**2).mean(axis=0), 0.25, atol=0.05)
        offset = np.linalg.norm(taps[:, None] - taps[None], axis=2) + 9.0 * np.eye(n)
        assert offset.min() > 0.6 * np.sqrt(np.pi) * packed_distance(n)
        sector = np.floor(np.arctan2(taps[:, 1], taps[:, 0]) / (np.pi / 2.0))
        counts = np.unique(sector, return_counts=True)[1]
        assert len(counts) == 4 and np.abs(counts - n / 4).max() <= 2 + 0.06 * n


def test_thousand_taps_are_possible() -> None:
    taps = sampling.poisson_disc_taps(1024)
    assert len(np.unique(taps, axis=0)) == 1024


def test_box_taps_are_cell_centres() -> None:
    np.testing.assert_array_equal(sampling.box_taps(1), [[0.0, 0.0]])
    np.testing.assert_array_equal(sampling.box_taps(4), [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]])
    nine = sampling.box_taps(9)
    np.testing.assert_allclose(np.unique(nine[:, 0]), [-2 / 3, 0.0, 2 / 3])
    with pytest.raises(InputError, match="take 9 or 16"):
        sampling.box_taps(10)
    for n in (0, -3):
        with pytest.raises(InputError, match="take 1 or 4"):
            sampling.box_taps(n)
    with pytest.raises(InputError, match="at least 1 tap"):
        sampling.poisson_disc_taps(0)


@wp.kernel
def hash_pixels(first: int, seed: int, bits_out: wp.array2d[wp.uint32], uniform_out: wp.array2d[float]):
    row, x = wp.tid()
    y = first + row
    bits = sampling.hash_2d(x - 3, y, seed)
    bits_out[y, x] = bits
    uniform_out[y, x] = sampling.uniform_01(bits)


def pcg(value: np.ndarray) -> np.ndarray:
    state = value * np.uint32(747796405) + np.uint32(2891336453)
    word = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    return (word >> np.uint32(22)) ^ word


@pytest.mark.parametrize("seed", [0, 1, -5])
def test_hash_equals_its_numpy_twin_and_looks_uniform(seed: int) -> None:
    height, width = 128, 160
    bits, uniform = wp.empty((height, width), dtype=wp.uint32), wp.empty((height, width), dtype=float)
    launch(hash_pixels, (height, width), [seed], [bits, uniform], threads=2)
    x = np.arange(-3, width - 3, dtype=np.int64).astype(np.uint32)
    y = np.arange(height, dtype=np.uint32)[:, None]
    expected = pcg(x + pcg(y + pcg(np.array([seed], np.int64).astype(np.uint32))))
    np.testing.assert_array_equal(bits.numpy(), expected)
    u = uniform.numpy()
    np.testing.assert_array_equal(u, (expected >> np.uint32(8)).astype(np.float64) / 2.0**24)
    counts = np.histogram(u, bins=64, range=(0.0, 1.0))[0]
    mean = u.size / 64
    assert ((counts - mean) ** 2 / mean).sum() < 118.0  # chi squared of 63 degrees of freedom, p = 3e-5
    assert abs(np.corrcoef(u[:, :-1].ravel(), u[:, 1:].ravel())[0, 1]) < 4.0 / np.sqrt(u.size)
    assert abs(np.corrcoef(u[:-1].ravel(), u[1:].ravel())[0, 1]) < 4.0 / np.sqrt(u.size)


@wp.kernel
def largest_uniform(first: int, uniform_out: wp.array[float]):
    uniform_out[first + wp.tid()] = sampling.uniform_01(wp.uint32(4294967295))


def test_uniform_never_reaches_one() -> None:
    out = wp.empty(1, dtype=float)
    launch(largest_uniform, 1, [], [out])
    assert out.numpy()[0] == np.float32(1.0 - 2.0**-24)


@wp.kernel
def rotate_all(first: int, v: wp.array[wp.vec2], angle: wp.array[float], rotated_out: wp.array[wp.vec2]):
    i = first + wp.tid()
    rotated_out[i] = sampling.rotate_2d(v[i], wp.cos(angle[i]), wp.sin(angle[i]))


def test_rotation_equals_complex_multiplication() -> None:
    rng = np.random.default_rng(1)
    v, angle = rng.normal(size=(500, 2)), rng.uniform(-7.0, 7.0, 500)
    out = wp.empty(500, dtype=wp.vec2)
    launch(rotate_all, 500, [wp.array(v, dtype=wp.vec2), wp.array(angle, dtype=float)], [out])
    turned = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * angle)
    np.testing.assert_allclose(out.numpy(), np.stack([turned.real, turned.imag], axis=1), rtol=1e-5, atol=1e-5)


def test_strata_are_visited_once_a_lap_and_coarser_ones_in_turn() -> None:
    points = sampling.stratified_set(5 * 64, seed=3)
    for cells, side in ((4, 2), (16, 4), (64, 8)):
        for begin in range(0, len(points), cells):
            column, row = (points[begin : begin + cells] * side).astype(int).T
            assert len(set(zip(column, row, strict=True))) == cells, (side, begin)
    orders = (points.reshape(5, 64, 2) * 8).astype(int)
    assert len({order.tobytes() for order in orders}) > 1, "laps must not repeat each other's order"
    inside = np.mod(points * 8, 1.0)
    assert np.abs(inside.mean(axis=0) - 0.5).max() < 0.07 and inside.min() < 0.02 and inside.max() > 0.98
    one, two = sampling.stratified_set(64, seed=1), sampling.stratified_set(64, seed=2)
    assert (one != two).all()
