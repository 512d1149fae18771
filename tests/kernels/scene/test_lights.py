from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest
from small_scenes import light

from wkernels.errors import InputError
from wkernels.sampling.point_sets import light_set
from wkernels.scene.lights import (
    LIGHT_KINDS,
    DiscLight,
    Light,
    LinearLight,
    PolygonLight,
    RectangleLight,
    orthonormal_frame,
)

KINDS = sorted(LIGHT_KINDS)
CENTRE, SIZE = (1.0, 8.0, -2.0), 1.6
U = light_set("halton", 4096)
EXTREME = np.array(
    [(a, b, c) for a in (0.0, 0.5, 1.0 - 1e-12) for b in (0.0, 0.5, 1.0 - 1e-12) for c in (0.0, 1.0 - 1e-12)]
)


def directions(count: int, seed: int = 0) -> np.ndarray:
    towards = np.random.default_rng(seed).normal(size=(count, 3))
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", KINDS)
def test_samples_are_points_or_unit_directions_inside_the_hull(kind: str) -> None:
    lamp = light(kind, CENTRE, SIZE)
    for u in (U, EXTREME):
        samples = lamp.sample(u)
        assert samples.shape == (len(u), 4) and samples.dtype == np.float64 and np.isfinite(samples).all()
        assert (samples[:, 3] == (0.0 if lamp.is_directional else 1.0)).all()
        points, corners = samples[:, :3], lamp.hull[:, :3]
        if lamp.is_directional:
            np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-12)
            axis = lamp.centre[:3]
            points, corners = points / (points @ axis)[:, None], corners / (corners @ axis)[:, None]
        for towards in directions(200):
            assert (points @ towards).max() <= (corners @ towards).max() + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_centre_is_the_mean_of_the_samples_and_size_their_extent(kind: str) -> None:
    lamp = light(kind, CENTRE, SIZE)
    samples = lamp.sample(U)[:, :3]
    np.testing.assert_allclose(samples.mean(axis=0), lamp.centre[:3], atol=5e-3)
    assert lamp.has_area == (kind != "point") and lamp.size >= 0.0
    extent = max(np.ptp(samples @ towards) for towards in directions(300))
    if kind == "polygon":  # an area's square root, between the inner and the outer diameter
        assert 0.5 * extent < lamp.size < extent
    elif kind == "rectangle":
        assert lamp.size == pytest.approx(SIZE)
    elif kind == "directional":
        assert 2.0 * np.tan(0.5 * lamp.size) == pytest.approx(extent, rel=0.02)
    else:
        assert lamp.size == pytest.approx(extent, rel=0.02, abs=1e-12)


def moments_in_plane(lamp: Light, u_axis: np.ndarray, v_axis: np.ndarray) -> np.ndarray:
    offset = lamp.sample(U)[:, :3] - lamp.centre[:3]
    return np.cov(np.stack([offset @ u_axis, offset @ v_axis]), bias=True)


def test_rectangles_are_filled_evenly() -> None:
    edge_u, edge_v = np.array([2.0, 0.0, 0.5]), np.array([0.0, 1.0, 0.3])
    lamp = RectangleLight(center=np.array(CENTRE), edge_u=edge_u, edge_v=edge_v)
    offset = lamp.sample(U)[:, :3] - lamp.center
    inverse = np.linalg.pinv(np.stack([edge_u, edge_v], axis=1))
    a, b = inverse @ offset.T
    for coordinate in (a, b):
        assert kstest(coordinate + 0.5, "uniform").statistic < 0.01
    np.testing.assert_allclose(np.cov(a, b, bias=True), np.eye(2) / 12.0, atol=5e-4)


def test_discs_are_filled_evenly() -> None:
    normal = np.array([1.0, 2.0, -0.5])
    lamp = DiscLight(center=np.array(CENTRE), normal=normal, radius=0.7)
    e_u, e_v = orthonormal_frame(normal / np.linalg.norm(normal))
    offset = lamp.sample(U)[:, :3] - lamp.center
    assert np.abs(offset @ normal).max() < 1e-12
    assert kstest((np.linalg.norm(offset, axis=1) / 0.7) ** 2, "uniform").statistic < 0.01
    angle = np.arctan2(offset @ e_v, offset @ e_u)
    assert kstest(angle / (2.0 * np.pi) + 0.5, "uniform").statistic < 0.01
    np.testing.assert_allclose(moments_in_plane(lamp, e_u, e_v), 0.7**2 / 4.0 * np.eye(2), atol=1e-3)


def test_suns_are_even_discs_of_directions() -> None:
    lamp = light("directional", CENTRE, SIZE)
    axis = lamp.centre[:3]
    e_u, e_v = orthonormal_frame(axis)
    samples = lamp.sample(U)[:, :3]
    tangents = np.stack([samples @ e_u, samples @ e_v]) / (samples @ axis)
    radius = np.tan(0.5 * lamp.size)
    assert kstest((np.linalg.norm(tangents, axis=0) / radius) ** 2, "uniform").statistic < 0.01
    np.testing.assert_allclose(np.cov(tangents, bias=True), radius**2 / 4.0 * np.eye(2), atol=1e-4)


@pytest.mark.parametrize("towards", [*np.eye(3), *directions(5, seed=3)])
def test_a_sphere_looks_like_an_even_disc_from_any_side(towards: np.ndarray) -> None:
    lamp = light("sphere", CENTRE, SIZE)
    offset = (lamp.sample(light_set("halton", 20000))[:, :3] - lamp.centre[:3]) / (0.5 * SIZE)
    assert np.linalg.norm(offset, axis=1).max() <= 1.0 + 1e-12
    e_u, e_v = orthonormal_frame(towards)
    seen = np.stack([offset @ e_u, offset @ e_v])
    assert kstest((seen**2).sum(axis=0), "uniform").statistic < 0.012
    np.testing.assert_allclose(np.cov(seen, bias=True), 0.25 * np.eye(2), atol=5e-3)


def test_segments_are_filled_evenly() -> None:
    lamp = LinearLight(a=np.array([0.0, 1.0, 2.0]), b=np.array([3.0, 1.0, -2.0]))
    along = (lamp.sample(U)[:, :3] - lamp.a) @ (lamp.b - lamp.a) / 25.0
    assert kstest(along, "uniform").statistic < 0.005
    np.testing.assert_allclose(lamp.sample(U)[:, :3], lamp.a + along[:, None] * (lamp.b - lamp.a), atol=1e-12)


def test_polygons_are_filled_evenly() -> None:
    """Each triangle of an uneven polygon gets its share of the area, and is filled evenly itself."""
    flat = np.array([(0.0, 0.0), (4.0, 0.0), (5.0, 2.0), (4.5, 3.0), (1.0, 3.5)])
    lamp = PolygonLight(vertices=np.stack([flat[:, 0], np.full(5, 9.0), flat[:, 1]], axis=1))
    x, _, z, _ = lamp.sample(light_set("halton", 20000)).T
    rng = np.random.default_rng(1)
    trial = rng.uniform(0.0, 5.0, (400000, 2))
    following = np.roll(flat, -1, axis=0)
    edge = following - flat

    def inside(p: np.ndarray, slack: float = 0.0) -> np.ndarray:
        way = p[:, None] - flat
        return (edge[:, 0] * way[..., 1] - edge[:, 1] * way[..., 0] >= -slack).all(axis=1)

    truth = trial[inside(trial)]
    points = np.stack([x, z], axis=1)
    assert inside(points, 1e-9).all()
    for power_x, power_z in [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (0, 3)]:
        expected = (truth[:, 0] ** power_x * truth[:, 1] ** power_z).mean()
        assert (x**power_x * z**power_z).mean() == pytest.approx(expected, rel=0.01)
    np.testing.assert_allclose(lamp.centre[[0, 2]], truth.mean(axis=0), rtol=5e-3)
    shoelace = 0.5 * abs((flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum())
    assert lamp.size == pytest.approx(np.sqrt(shoelace))


@pytest.mark.parametrize("kind", KINDS)
def test_moving_a_light_moves_its_samples(kind: str) -> None:
    lamp, offset = light(kind, CENTRE, SIZE), np.array([5.0, -3.0, 2.0])
    moved = lamp.moved(offset)
    shift = offset * (0.0 if lamp.is_directional else 1.0)
    np.testing.assert_allclose(moved.sample(U)[:, :3], lamp.sample(U)[:, :3] + shift, atol=1e-12)
    np.testing.assert_allclose(moved.hull[:, :3], lamp.hull[:, :3] + shift, atol=1e-12)
    assert moved.size == pytest.approx(lamp.size) and moved.radiance == lamp.radiance


@pytest.mark.parametrize("kind", KINDS)
def test_weights_are_ones_without_a_texture(kind: str) -> None:
    np.testing.assert_array_equal(light(kind).weights(U), np.ones(len(U)))


def test_textures_weight_the_samples_that_fall_on_them() -> None:
    texture = np.array([[0.0, 3.0], [1.0, 0.0]])
    lamp = RectangleLight(
        center=np.zeros(3), edge_u=np.array([2.0, 0, 0]), edge_v=np.array([0, 0, 2.0]), texture=texture
    )
    weights, points = lamp.weights(U), lamp.sample(U)
    assert weights.mean() == pytest.approx(1.0, abs=0.01)
    column, row = (points[:, 0] >= 0.0).astype(int), (points[:, 2] >= 0.0).astype(int)
    np.testing.assert_allclose(weights, texture[row, column])
    square = np.array([(-1.0, 0.0, -1.0), (1.0, 0.0, -1.0), (1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)])
    polygon = PolygonLight(vertices=square, texture=texture)
    points = polygon.sample(U)
    column, row = (points[:, 0] >= 0.0).astype(int), (points[:, 2] >= 0.0).astype(int)
    clear = np.minimum(np.abs(points[:, 0]), np.abs(points[:, 2])) > 1e-6
    np.testing.assert_allclose(polygon.weights(U)[clear], texture[row, column][clear])


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), *directions(20)])
def test_frames_are_right_handed_and_orthonormal(axis: np.ndarray) -> None:
    frame = np.stack([*orthonormal_frame(axis), axis])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_unknown_sets_of_light_samples_are_refused() -> None:
    with pytest.raises(InputError, match="halton"):
        light_set("haltom", 4)
