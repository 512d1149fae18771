"""Closed forms of Stingl 2011 (chapters 2 to 4) and what follows from them, to 1e-6 relative."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from algorithms.projections.projection import WarpShape
from algorithms.projections.table import warps
from algorithms.projections.warps.lispsm_nrepar import strength
from wkernels.analysis.perspective_error import (
    TiltedFrustum,
    err_accurate,
    partitioned_errors,
    storage_factor,
    texels_per_pixel,
)
from wkernels.projections.splits import pseudo_planes, shares_of_split, split_borders

THETA = np.radians(30.0)
TAN = np.tan(THETA)
EXACT = 1e-6


def n_warp(name: str, near: float, far: float, gamma_deg: float = 90.0, **more: float) -> float:
    frustum = TiltedFrustum(near, far, THETA, np.radians(gamma_deg))
    shape = WarpShape(near, far, *frustum.end_depths, frustum.extent, THETA, frustum.gamma, **more)
    return warps()[name]().distance(shape)


def overhead(z: Any, near: float, far: float, distance: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """m_x and m_z along the view vector under overhead light."""
    return TiltedFrustum(near, far, THETA).errors(z, distance)


def test_the_published_example() -> None:
    """n = 1, f = 40, th = 30 (Stingl 2011, sections 2.3.2 and 3.2.1), recomputed from the formulas to all digits."""
    distance = n_warp("lispsm_nopt", 1.0, 40.0)
    assert distance == pytest.approx(1.0 + np.sqrt(40.0), rel=EXACT) == pytest.approx(7.3246, abs=5e-5)
    m_x, m_z = overhead(np.array([1.0, np.sqrt(40.0), 40.0]), 1.0, 40.0, distance)
    assert m_z[0] == pytest.approx(39.0 / (2.0 * TAN * np.sqrt(40.0)), rel=EXACT) == pytest.approx(5.3403, abs=5e-5)
    assert m_z[2] == pytest.approx(m_z[0], rel=EXACT)
    least = 2.0 * 39.0 / (TAN * (1.0 + np.sqrt(40.0)) ** 2)
    assert m_z[1] == pytest.approx(least, rel=EXACT) == pytest.approx(2.5182, abs=5e-5)
    assert m_x[0] == pytest.approx(np.sqrt(40.0), rel=EXACT) == pytest.approx(6.3246, abs=5e-5)
    assert m_x[2] == pytest.approx(1.0, rel=EXACT)
    u_x, u_z = overhead(1.0, 1.0, 40.0)
    assert u_z == pytest.approx(39.0 / (2.0 * TAN), rel=EXACT) == pytest.approx(33.775, abs=5e-4)
    assert u_x == pytest.approx(40.0, rel=EXACT)


@pytest.mark.parametrize("distance", [1.0, 3.0, 7.3246, 1e3, 1e9])
def test_warped_errors_are_equations_2_3_and_2_4(distance: float) -> None:
    near, far, z = 1.0, 40.0, np.geomspace(1.0, 40.0, 33)
    m_x, m_z = overhead(z, near, far, distance)
    ahead = distance + z - near
    np.testing.assert_allclose(m_x, far * ahead / (z * (distance + far - near)), rtol=EXACT)
    expected = (far - near) / (2.0 * TAN) * ahead**2 / (z * distance * (distance + far - near))
    np.testing.assert_allclose(m_z, expected, rtol=EXACT)


def test_limits_are_equations_2_5_to_2_8() -> None:
    near, far, z = 0.5, 90.0, np.geomspace(0.5, 90.0, 33)
    assert n_warp("psm", near, far) == pytest.approx(near, rel=EXACT)
    m_x, m_z = overhead(z, near, far, near)
    np.testing.assert_allclose(m_x, 1.0, rtol=EXACT)
    np.testing.assert_allclose(m_z, (far - near) / (2.0 * TAN) * z / (near * far), rtol=EXACT)
    for distance in (np.inf, 1e15):
        m_x, m_z = overhead(z, near, far, distance)
        np.testing.assert_allclose(m_x, far / z, rtol=EXACT)
        np.testing.assert_allclose(m_z, (far - near) / (2.0 * TAN * z), rtol=EXACT)


# found once from the formulas, to three digits; th = 30, n = 1, f = 100, greatest m_x over the frustum (uniform 100)
M_X = {5: 200, 10: 226, 20: 200, 25: 160, 30: 106, 40: 45, 90: 10}
M_X_REPAR = {5: 100, 10: 100, 20: 111, 25: 112, 30: 103}


@pytest.mark.parametrize(("gamma", "printed"), M_X.items())
def test_nopt_under_slanted_light(gamma: float, printed: float) -> None:
    frustum = TiltedFrustum(1.0, 100.0, THETA, np.radians(gamma))
    distance = n_warp("lispsm_nopt", 1.0, 100.0, gamma)
    sine = np.sin(np.radians(gamma))
    assert distance == pytest.approx((1.0 + np.sqrt(1.0 + frustum.extent * sine)) / sine, rel=EXACT)
    old = 1.0 + np.sqrt(1.0 + frustum.extent * sine)
    assert distance * sine == pytest.approx(old, rel=EXACT)
    assert frustum.max_m_x(distance) == pytest.approx(printed, abs=0.5)
    assert frustum.max_m_x() == pytest.approx(100.0, rel=EXACT)
    assert frustum.max_m_x(distance) == pytest.approx(_sampled_max_m_x(frustum, distance), rel=EXACT)


@pytest.mark.parametrize(("gamma", "printed"), M_X_REPAR.items())
def test_nrepar_gives_way_where_nopt_is_worse_than_uniform(gamma: float, printed: float) -> None:
    frustum = TiltedFrustum(1.0, 100.0, THETA, np.radians(gamma))
    assert frustum.max_m_x(n_warp("lispsm_nrepar", 1.0, 100.0, gamma)) == pytest.approx(printed, abs=0.5)


def _sampled_max_m_x(frustum: TiltedFrustum, distance: float) -> float:
    """From points of the frustum alone: its corners must be among them."""
    z, side = np.meshgrid(np.geomspace(frustum.near, frustum.far, 41), np.linspace(-1.0, 1.0, 41), indexing="ij")
    v = z * np.sin(frustum.gamma) - side * z * TAN * np.cos(frustum.gamma)
    ahead = v - v.min() + distance
    half_width = z * TAN
    return float((half_width / ahead).max() * (ahead / half_width).max())


@pytest.mark.parametrize(("gamma", "width"), [(0.0, 115.47), (20.0, 108.51), (45.0, 111.24), (90.0, 99.0)])
def test_projected_width(gamma: float, width: float) -> None:
    extent = TiltedFrustum(1.0, 100.0, THETA, np.radians(gamma)).extent
    g = np.radians(gamma)
    formula = 2.0 * TAN * np.cos(g) + 99.0 / np.cos(THETA) * (np.sin(THETA + g) + max(np.sin(THETA - g), 0.0))
    assert extent == pytest.approx(formula, rel=EXACT) == pytest.approx(width, abs=5e-3)


def test_eta_is_continuous_and_reaches_its_published_values() -> None:
    gamma_c = THETA + 0.3 * (0.5 * np.pi - THETA)
    for gamma, eta in ((0.0, -1.0), (THETA / 3.0, -1.0), (THETA, -0.2), (gamma_c, 0.0), (0.5 * np.pi, 0.0)):
        for side in (-1e-9, 1e-9):
            assert strength(gamma + side, THETA) == pytest.approx(eta, abs=1e-7)
    assert n_warp("lispsm_nrepar", 1.0, 100.0, 5.0) == np.inf
    assert n_warp("lispsm_nrepar", 1.0, 40.0) == pytest.approx(1.0 + np.sqrt(40.0), rel=EXACT)
    assert n_warp("lispsm_nrepar", 1.0, 100.0, 20.0) == pytest.approx(192.9, abs=0.05)


@pytest.mark.parametrize("gamma", [20.0, 45.0, 90.0, 130.0])
@pytest.mark.parametrize("warp", ["none", "psm", "lispsm_nopt", "lispsm_nrepar"])
def test_no_error_exceeds_the_uniform_maps_by_more_than_the_warps_own_ratio(gamma: float, warp: str) -> None:
    """(n' + d) / n' bounds both ratios, wherever the light is."""
    frustum = TiltedFrustum(1.0, 100.0, THETA, np.radians(gamma))
    distance = n_warp(warp, 1.0, 100.0, gamma)
    z = np.geomspace(1.0, 100.0, 65)
    for warped, uniform in zip(frustum.errors(z, distance), frustum.errors(z), strict=True):
        assert (warped <= uniform * (1.0 + frustum.extent / distance) * (1.0 + 1e-9)).all()


def test_pseudo_planes() -> None:
    """Stingl 2011, section 4.2: n = 1, f = 300, shares 0.1: 3.465 at both planes, from 14.95 without, but 61.1 at n."""
    near, far = 1.0, 300.0
    planes = pseudo_planes(near, far, 0.1, 0.1)
    distance = n_warp("lispsm_nopt", near, far, pseudo_near=0.1, pseudo_far=0.1)
    _, m_z = overhead(np.array([near, *planes]), near, far, distance)
    assert m_z[1] == pytest.approx(m_z[2], rel=EXACT) == pytest.approx(3.465, abs=5e-4)
    assert m_z[0] == pytest.approx(61.1, abs=0.05)
    _, plain = overhead(near, near, far, n_warp("lispsm_nopt", near, far))
    assert plain == pytest.approx(14.95, abs=5e-3)
    borders = split_borders(near, far, 4, "pseudo", 0.5, 0.1, 0.1)
    low, high = planes
    share = np.arange(1, 4) / 4
    inner = 0.5 * (low + (high - low) * share) + 0.5 * low * (high / low) ** share
    np.testing.assert_allclose(borders, [near, *inner, far], rtol=EXACT)
    first, last = shares_of_split(borders, 0, planes), shares_of_split(borders, 3, planes)
    assert first[0] * (borders[1] - near) == pytest.approx(low - near) and first[1] == 0.0
    assert last[1] * (far - borders[3]) == pytest.approx(far - high) and last[0] == 0.0


def test_split_positions() -> None:
    for scheme, expected in {
        "uniform": (250.75, 500.5, 750.25),
        "log": (10.0**0.75, 10.0**1.5, 10.0**2.25),
        "practical": tuple(0.5 * (1 + 999 * i / 4) + 0.5 * 10 ** (0.75 * i) for i in (1, 2, 3)),
    }.items():
        np.testing.assert_allclose(split_borders(1.0, 1000.0, 4, scheme), [1.0, *expected, 1000.0], rtol=EXACT)
    np.testing.assert_allclose(split_borders(1.0, 1000.0, 4)[1:4], (128.19, 266.06, 464.04), atol=5e-3)
    np.testing.assert_allclose(split_borders(1.0, 1000.0, 4, "log")[1:4], (5.623, 31.62, 177.83), atol=5e-3)
    for count in range(1, 17):
        for scheme in ("uniform", "log", "practical"):
            borders = split_borders(1e-3, 1e3, count, scheme)
            assert len(borders) == count + 1 and (np.diff(borders) > 0.0).all()


def test_partitioned_errors_halve_with_every_doubling_of_the_splits() -> None:
    """Stingl 2011, section 3.3.4, f/n = 40 and lambda = 0.5: the greatest m_x for 1, 2, 4, 8 and 16 splits, at the eye."""
    for count, greatest in zip((1, 2, 4, 8, 16), (40.0, 13.4, 6.63, 3.73, 2.35), strict=True):
        borders = split_borders(1.0, 40.0, count)
        z, m_x, _ = partitioned_errors(borders, THETA, [np.inf] * count)
        assert m_x.max() == pytest.approx(float((borders[1:] / borders[:-1]).max()), rel=EXACT)
        assert m_x.max() == pytest.approx(greatest, rel=4e-3)  # printed digits
        assert z[0] == 1.0 and z[-1] == 40.0 and len(z) == 64 * count
        # both sides of each border
        np.testing.assert_array_equal(z[63:-1:64], z[64::64])
        if count > 1:
            assert (m_x[64::64] > m_x[63:-1:64]).all()
    ratio = 40.0**0.25
    _, m_x, m_z = partitioned_errors(split_borders(1.0, 40.0, 4, "log"), THETA, [np.inf] * 4)
    np.testing.assert_allclose(
        (m_x[::64], m_z[::64]), (np.full(4, ratio), np.full(4, (ratio - 1) / (2 * TAN))), rtol=EXACT
    )


def test_storage_factors() -> None:
    """Lloyd et al. 2006, f/n = 1000, th = 30: numbers found once, and the closed forms that they come from."""
    near, far = 1.0, 1000.0
    tables = {
        ("log", "none"): (8.65e5, 1677, 90.1, 22.5, 11.5),
        ("log", "lispsm_nopt"): (865, 53.0, 16.0, 9.50, 7.48),
        ("practical", "none"): (8.65e5, 1.22e5, 5.65e4, 2.80e4, 1.42e4),
        ("practical", "lispsm_nopt"): (865, 459, 441, 437, 436),
    }
    for (scheme, warp), printed in tables.items():
        for count, expected in zip((1, 2, 4, 8, 16), printed, strict=True):
            borders = split_borders(near, far, count, scheme)
            distances = [n_warp(warp, a, b) for a, b in itertools.pairwise(borders)]
            factor = storage_factor(borders, THETA, distances)
            assert factor == pytest.approx(expected, rel=4e-3)  # three printed digits
            if scheme == "log":
                r = (far / near) ** (1.0 / count)
                closed = count * (r - 1.0) / (2.0 * TAN) * (r if warp == "none" else 1.0)
                assert factor == pytest.approx(closed, rel=EXACT)
    whole = np.array([near, far])
    for distance in (near, 5.0, near + np.sqrt(near * far)):  # any warp from psm to n_opt
        assert storage_factor(whole, THETA, [distance]) == pytest.approx((far - near) / (2 * near * TAN), rel=EXACT)


@pytest.mark.parametrize("seed", range(4))
def test_accurate_error_is_one_direction_of_the_jacobian(seed: int) -> None:
    """Equation 2.2 in the plane x = 0, with the light's and the eye's geometry drawn at random."""
    rng = np.random.default_rng(seed)
    eye, light = np.array([0.0, 0.0, 0.0]), np.array([0.0, rng.uniform(6, 9), rng.uniform(2, 5)])
    point, tilt = np.array([0.0, rng.uniform(-1, 0.5), rng.uniform(3, 6)]), rng.uniform(-0.5, 0.5)
    normal = np.array([0.0, np.cos(tilt), np.sin(tilt)])
    forward = {"e": np.array([0.0, 0.0, 1.0]), "l": np.array([0.0, -1.0, 0.2])}
    forward["l"] /= np.linalg.norm(forward["l"])
    half = {"e": 0.5, "l": 0.8}
    rows, position = {}, {"e": eye, "l": light}
    for key in "el":
        up = np.cross(np.array([1.0, 0.0, 0.0]), forward[key])
        axes = np.stack([np.array([1.0, 0.0, 0.0]) / half[key], up / half[key], forward[key], forward[key]])
        rows[key] = np.column_stack([axes, -axes @ position[key]])
    jacobian = texels_per_pixel(rows["l"], 512, rows["e"], (480, 480), point[None], normal[None])[0]
    way = {key: position[key] - point for key in "el"}
    length = {key: float(np.linalg.norm(way[key])) for key in "el"}
    depth = {key: float(-way[key] @ forward[key]) for key in "el"}
    cos_phi = tuple(float(-way[key] @ forward[key]) / length[key] for key in "le")
    cos_psi = tuple(abs(float(way[key] @ normal)) / length[key] for key in "le")
    # near planes at distance 1 are 2 * half wide; the uniform parametrisation spans its plane once
    m = err_accurate(480 / 512, 1.0, half["l"] / half["e"], 1.0, depth["l"] / depth["e"], cos_phi, cos_psi)
    assert 1.0 / abs(jacobian[1, 1]) == pytest.approx(m, rel=EXACT)
    assert abs(jacobian[1, 0]) < 1e-9


def test_jacobian_equals_finite_differences() -> None:
    rng = np.random.default_rng(7)
    to_map, to_image = (rng.normal(size=(4, 4)) for _ in range(2))
    points, normals = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    to_map[3, 3], to_image[3, 3] = 9.0, 9.0  # in front of both
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    jacobian = texels_per_pixel(to_map, 256, to_image, (640, 360), points, normals)

    def screen(rows: np.ndarray, at: np.ndarray, half: np.ndarray) -> np.ndarray:
        h = rows[:, :3] @ at + rows[:, 3]
        return np.asarray(h[:2] / h[3] * half)

    half_image = np.array([320.0, 180.0])
    for point, normal, found in zip(points, normals, jacobian, strict=True):
        for direction in (np.cross(normal, [1.0, 0, 0]), np.cross(normal, [0, 1.0, 0])):
            ends = [point - 1e-5 * direction, point + 1e-5 * direction]
            texels = screen(to_map, ends[1], np.full(2, 128.0)) - screen(to_map, ends[0], np.full(2, 128.0))
            pixels = screen(to_image, ends[1], half_image) - screen(to_image, ends[0], half_image)
            np.testing.assert_allclose(found @ pixels, texels, rtol=1e-5, atol=1e-9)
