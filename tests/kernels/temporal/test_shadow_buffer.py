"""Estimators, the shadow buffer's storage and fetch, and the neighbourhood filter, each against a NumPy twin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from compare import assert_twin
from seen_ground import EYE, HEIGHT, WIDTH, fetch_twin, ground_depth, ray

from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.filters.neighbourhood_filter import filter_neighbourhood, opposite_taps, pixels_per_length
from wkernels.sampling.disc_sets import PUBLISHED_POISSON_16
from wkernels.sampling.estimators import FLOAT16_LIMIT, add_test, hidden_share, share_variance, standard_error
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.views import View
from wkernels.temporal.shadow_buffer.record import (
    BILINEAR,
    NEAREST,
    TEXEL_TYPES,
    ShadowRecord,
    fetch_record,
    read_record,
    refine_blocker,
    storage_of,
    write_record,
)

TABLE_1 = (1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0)  # tau of Scherzer et al. 2009, table 1


# ---- estimators ---------------------------------------------------------------------------------------------------------


@wp.kernel
def estimate(
    first: int, tau: wp.array(dtype=float), psi_out: wp.array(dtype=float), variance_out: wp.array(dtype=float),
    error_out: wp.array(dtype=float),
):  # fmt: skip
    sums = wp.vec2(0.0, 0.0)
    for i in range(tau.shape[0]):
        sums = add_test(sums[0], sums[1], tau[i], 1.0, 1.0e6)
        psi = hidden_share(sums[0], sums[1])
        psi_out[i] = psi
        variance_out[i] = share_variance(psi, sums[1])
        error_out[i] = standard_error(psi, sums[1])


def test_table_1_of_the_paper(device: str) -> None:
    out = [wp.empty(7, dtype=float, device=device) for _ in range(3)]
    launch(estimate, 1, [wp.array(TABLE_1, dtype=float, device=device)], out, device=device)
    psi, variance, error = (array.numpy() for array in out)
    np.testing.assert_array_equal(np.round(psi, 2), np.float32([1.00, 0.50, 0.67, 0.75, 0.80, 0.67, 0.71]))
    np.testing.assert_array_equal(np.round(variance[1:], 2), np.float32([0.25, 0.11, 0.06, 0.04, 0.04, 0.03]))
    np.testing.assert_array_equal(np.round(error[1:], 2), np.float32([0.50, 0.33, 0.25, 0.20, 0.21, 0.18]))
    assert variance[0] == error[0] == 1.0  # printed as 0, but one test says nothing
    n = np.arange(1, 8)
    exact = np.cumsum(TABLE_1) / n
    assert_twin(psi, exact)
    assert_twin(variance[1:], (exact * (1.0 - exact))[1:] / (n[1:] - 1))


@wp.kernel
def estimate_nothing(first: int, out: wp.array(dtype=float)):
    out[0] = hidden_share(0.0, 0.0)
    out[1] = standard_error(0.0, 0.0)


def test_nothing_known_is_lit_and_uncertain(device: str) -> None:
    out = wp.empty(2, dtype=float, device=device)
    launch(estimate_nothing, 1, [], [out], device=device)
    np.testing.assert_array_equal(out.numpy(), [0.0, 1.0])


@wp.kernel
def accumulate_in_texel(first: int, tau: wp.array2d(dtype=float), limit: float, texels: wp.array2d(dtype=Any)):
    row, i = wp.tid()
    y = first + row
    for k in range(tau.shape[0]):
        record = read_record(texels, y, i, 10.0)
        sums = add_test(record.rho, record.n, tau[k, i], 1.0, limit)
        record.rho = sums[0]
        record.n = sums[1]
        write_record(texels, y, i, record, 10.0)


wp.overload(accumulate_in_texel, {"texels": wp.array2d(dtype=wp.vec4h)})


def accumulate_half(tau: np.ndarray, limit: float, device: str) -> tuple[np.ndarray, np.ndarray]:
    """(psi, n) after all tests, summed in a float16 buffer."""
    texels = wp.zeros((1, tau.shape[1]), dtype=wp.vec4h, device=device)
    inputs = [wp.array(tau, dtype=float, device=device), limit]
    launch(accumulate_in_texel, (1, tau.shape[1]), inputs, [texels], device=device)
    rho, n = texels.numpy()[0, :, 0].astype(float), texels.numpy()[0, :, 1].astype(float)
    return rho / n, n


def test_float16_sums_neither_saturate_nor_drift(device: str) -> None:
    truth = np.array([0.0, 0.05, 0.3, 0.5, 0.9, 1.0])
    tau = (np.random.default_rng(1).random((6800, len(truth))) < truth).astype(np.float32)
    psi, n = accumulate_half(tau, FLOAT16_LIMIT, device)
    assert n.min() > 0.5 * FLOAT16_LIMIT and n.max() <= FLOAT16_LIMIT
    rho_twin, n_twin = np.zeros(len(truth)), np.zeros(len(truth))
    for row in tau.astype(float):
        scale = np.where(n_twin + 1.0 > FLOAT16_LIMIT, 0.5, 1.0)
        rho_twin, n_twin = scale * rho_twin + row, scale * n_twin + 1.0
    np.testing.assert_array_equal(n, n_twin)
    np.testing.assert_allclose(psi, rho_twin / n_twin, atol=1e-3)  # against sums in float64: one rounding a halving
    assert (np.abs(psi - truth) <= 3.5 * np.sqrt(truth * (1.0 - truth) / n)).all()
    assert psi[0] == 0.0 and psi[-1] == 1.0
    uncapped, stuck = accumulate_half(tau, 1.0e9, device)
    assert (stuck == 2048).all() and uncapped[2] > 0.9, "without the limit float16 must fail as published"


@wp.kernel
def refine_all(first: int, rises: wp.array(dtype=float), taps: float, out: wp.array(dtype=float)):
    rise = rises[0]
    for i in range(1, rises.shape[0]):
        rise = refine_blocker(rise, rises[i], taps + float(i - 1))
    out[0] = rise
    out[1] = refine_blocker(0.0, 0.25, 16.0)


def test_blocker_depth_is_the_mean_of_all_blockers(device: str) -> None:
    """Equation 7: k depths of the first search count as one mean, then one depth a frame."""
    k, rises = 16.0, np.random.default_rng(2).uniform(0.1, 0.9, 40)
    out = wp.empty(2, dtype=float, device=device)
    launch(refine_all, 1, [wp.array(rises, dtype=float, device=device), k], [out], device=device)
    assert_twin(out.numpy()[:1], np.array([(k * rises[0] + rises[1:].sum()) / (k + len(rises) - 1)]))
    assert out.numpy()[1] == 0.25  # no blocker was known: the first one counts alone


# ---- storage and fetch --------------------------------------------------------------------------------------------------


@wp.kernel
def round_trip(
    first: int, values: wp.array(dtype=wp.vec4), far: float, texels: wp.array2d(dtype=Any), out: wp.array(dtype=wp.vec4)
):
    i = first + wp.tid()
    record = ShadowRecord()
    record.rho = values[i][0]
    record.n = values[i][1]
    record.depth = values[i][2]
    record.blocker_rise = values[i][3]
    write_record(texels, 0, i, record, far)
    back = read_record(texels, 0, i, far)
    out[i] = wp.vec4(back.rho, back.n, back.depth, back.blocker_rise)


for _texel in TEXEL_TYPES.values():
    wp.overload(round_trip, {"texels": wp.array2d(dtype=_texel)})


@pytest.mark.parametrize("format", sorted(TEXEL_TYPES))
@pytest.mark.parametrize("far", [10.0, 1.0e6])
def test_records_survive_storage(format: str, far: float, device: str) -> None:
    rng = np.random.default_rng(3)
    n = rng.integers(1, 1025, 500).astype(float)
    values = np.stack(
        [np.floor(n * rng.random(500)), n, far * rng.uniform(1e-3, 1.0, 500), rng.uniform(0.01, 1.0, 500)], axis=1
    )
    texels = wp.zeros((1, 500), dtype=TEXEL_TYPES[format], device=device)
    out = wp.empty(500, dtype=wp.vec4, device=device)
    launch(round_trip, 500, [wp.array(values, dtype=wp.vec4, device=device), far], [texels, out], device=device)
    np.testing.assert_array_equal(out.numpy()[:, :2], values[:, :2])
    # one rounding of the texel on top of float32 arithmetic
    assert_twin(out.numpy()[:, 2:], values[:, 2:], rtol=storage_of(format).rounding + 3e-7)
    assert texels.numpy().itemsize == (2 if format == "float16" else 4)


@wp.kernel
def fetch_all(
    first: int,
    previous: wp.array2d(dtype=wp.vec4),
    view: View,
    positions: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    epsilon: float,
    steps: float,
    out: wp.array(dtype=wp.vec4),
):
    i = first + wp.tid()
    record = fetch_record(previous, view, positions[i], normals[i], epsilon, 0.0, steps)
    out[i] = wp.vec4(record.rho, record.n, record.depth, record.blocker_rise)


@pytest.mark.parametrize("steps", [BILINEAR, NEAREST])
def test_fetch_takes_only_texels_of_the_same_surface(steps: float, device: str) -> None:
    rng = np.random.default_rng(4)
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    depth = ground_depth(column, row)
    epsilon = 0.01
    other = rng.random(depth.shape) < 0.3  # another surface, at least 3 epsilon away
    depth = depth + np.where(other, rng.choice([-1.0, 1.0], depth.shape) * rng.uniform(0.03, 2.0, depth.shape), 0.0)
    n = rng.integers(0, 30, depth.shape) * (rng.random(depth.shape) < 0.8)
    rise = rng.uniform(0.1, 0.9, depth.shape) * (rng.random(depth.shape) < 0.7)
    previous = np.stack([np.floor(n * rng.random(depth.shape)), n, depth / EYE.far, rise], axis=-1).astype(np.float32)

    # a third of a step off every 1/256 of a texel, so that float32 rounds as float64 does; some points lie outside
    places = (
        rng.integers(-256, 256 * np.array([WIDTH + 1, HEIGHT + 1]), (800, 2)) + rng.uniform(-0.3, 0.3, (800, 2))
    ) / 256
    fraction = np.mod(places, 1.0)
    places = places[(np.abs(fraction) > 0.01).all(axis=1) & (np.abs(fraction - 1.0) > 0.01).all(axis=1)]
    positions = EYE.eye_ws + ground_depth(*places.T)[:, None] * ray(*places.T)
    normals = np.tile([0.0, 1.0, 0.0], (len(places), 1))
    out = wp.empty(len(places), dtype=wp.vec4, device=device)
    inputs: list[Any] = [wp.array(previous, dtype=wp.vec4, device=device), EYE.to_device()]
    inputs += [wp.array(a, dtype=wp.vec3, device=device) for a in (positions, normals)] + [epsilon, steps]
    launch(fetch_all, len(places), inputs, [out], device=device)

    expected = np.array([fetch_twin(previous, x, y, epsilon, int(steps)) for x, y in places])
    assert 0.1 < (expected[:, 1] == 0.0).mean() < 0.6 and len(places) > 600
    assert_twin(out.numpy()[:, [0, 1, 3]], expected, rtol=1e-4, atol=1e-5)


# ---- neighbourhood filter -----------------------------------------------------------------------------------------------


def test_neighbourhood_filter_equals_its_twin(device: str) -> None:
    rng = np.random.default_rng(5)
    shape, depth_range = (23, 31), 0.05
    psi = rng.random(shape).astype(np.float32)
    half_width = (rng.random(shape) * 9.0 * (rng.random(shape) < 0.6)).astype(np.float32)
    depth = rng.choice([4.0, 4.1, 6.0], shape).astype(np.float32)
    flags = np.where(rng.random(shape) < 0.85, int(RECEIVES), 0).astype(np.int32)
    psi[flags == 0] = 0.0
    half_width[flags == 0] = 0.0
    taps = rng.uniform(-1.0, 1.0, (16, 2)).astype(np.float32)
    depth[flags == 0] = 0.0
    out = wp.empty(shape, dtype=float, device=device)
    packed = wp.array(np.stack([psi, depth], axis=-1), dtype=wp.vec2, device=device)
    inputs: list[Any] = [packed, wp.array(half_width, device=device)]
    inputs += [wp.array(taps, dtype=wp.vec2, device=device), depth_range]
    launch(filter_neighbourhood, shape, inputs, [out], device=device, threads=2)

    expected = 1.0 - psi.astype(float)
    smoothed = 0
    for y, x in np.argwhere(half_width >= 0.5):
        values = [psi[y, x]]
        for tap in taps:
            at = np.array([x, y], np.float32) + half_width[y, x] * tap
            column, row = (int(np.floor(abs(v) + 0.5) * np.sign(v)) for v in at)
            inside = 0 <= column < shape[1] and 0 <= row < shape[0]
            if inside and flags[row, column] and abs(depth[row, column] - depth[y, x]) < depth_range * depth[y, x]:
                values.append(psi[row, column])
        expected[y, x] = 1.0 - np.mean(values)
        smoothed += len(values) > 4
    assert smoothed > 100
    assert_twin(out.numpy(), expected, atol=1e-6)


def smooth_slanted_ground(taps: np.ndarray, device: str) -> tuple[np.ndarray, np.ndarray]:
    """Psi that rises linearly down a slanted plane, before and after a filter whose depth range cuts it to a few rows."""
    shape = (60, 40)
    row = np.repeat(np.arange(60.0)[:, None], 40, axis=1)
    psi, depth = (row / 59.0).astype(np.float32), (10.0 - 0.05 * row).astype(np.float32)
    out = wp.empty(shape, dtype=float, device=device)
    packed = wp.array(np.stack([psi, depth], axis=-1), dtype=wp.vec2, device=device)
    inputs: list[Any] = [packed, wp.full(shape, 9.3, dtype=float, device=device)]
    inputs += [wp.array(taps, dtype=wp.vec2, device=device), 0.02]
    launch(filter_neighbourhood, shape, inputs, [out], device=device)
    middle = np.s_[15:-15, 15:-15]
    return psi[middle], 1.0 - out.numpy()[middle]


def test_opposite_taps_shift_no_edge_on_slanted_ground(device: str) -> None:
    before, after = smooth_slanted_ground(opposite_taps(16), device)
    assert_twin(after, before, atol=2e-6)
    before, after = smooth_slanted_ground(PUBLISHED_POISSON_16, device)
    assert np.abs(after - before).mean() > 0.5 / 59.0, "a set without symmetry must shift by at least half a row"


def test_opposite_taps_are_a_symmetric_disc() -> None:
    for count in (2, 16, 24):
        taps = opposite_taps(count)
        assert taps.shape == (count, 2) and len(np.unique(taps, axis=0)) == (count if count > 2 else 1)
        np.testing.assert_array_equal(taps[: count // 2], -taps[count // 2 :])
        assert np.linalg.norm(taps, axis=1).max() <= 1.0
    for count in (0, 7, -2):
        with pytest.raises(InputError, match="even number"):
            opposite_taps(count)


@wp.kernel
def measure_pixels(first: int, view: View, depth: wp.array(dtype=float), out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = pixels_per_length(view, depth[i])


def test_pixels_per_length_is_the_projected_size(device: str) -> None:
    """Equation 6 with the window's size: H / (2 z tan(fov / 2))."""
    depth = np.array([0.5, 3.0, 30.0])
    out = wp.empty(3, dtype=float, device=device)
    launch(measure_pixels, 3, [EYE.to_device(), wp.array(depth, dtype=float, device=device)], [out], device=device)
    assert_twin(out.numpy(), HEIGHT / (2.0 * depth * 0.45))
