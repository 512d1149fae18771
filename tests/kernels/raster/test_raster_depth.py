"""Depth and clipping of the rasteriser against rays in float64."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
from drawing import assert_depth_equals_rays, draw, grid, pixel_owner_counts, pixel_rays

from wkernels.scene.views import HostView, eye_view


@pytest.mark.parametrize("seed", range(6))
def test_no_crack_where_triangles_cross_the_near_plane(seed: int, device: str) -> None:
    """The eye is inside a closed, finely divided box, so that the near plane cuts many triangles on all sides."""
    rng = np.random.default_rng(seed)
    xy, faces = grid(rng, 7, 7, -8.0, 8.0, jitter=0.7)
    ground = np.stack([xy[:, 0], np.full(len(xy), -0.02), xy[:, 1]], axis=1)
    sky = ground + np.array([0.0, 5.0, 0.0])
    points, faces = np.concatenate([ground, sky]), np.concatenate([faces, faces + len(ground)])
    heading = rng.uniform(-1.0, 1.0, 3) * np.array([1.0, 0.2, 1.0])
    eye = rng.uniform(-1.0, 1.0, 3) * np.array([3.0, 0.0, 3.0])
    view = eye_view(small_scenes.camera(tuple(eye), tuple(eye + heading), near=0.3, fov_deg=80.0), 48, 40, np.zeros(3))
    counts = pixel_owner_counts(points, faces, view, device)
    depth, _ = draw(points, faces, view, device)
    rays = pixel_rays(view)
    t, _ = small_scenes.ray_hits(*rays, points[faces])
    reachable = ((t >= view.near) & np.isfinite(t)).sum(axis=1).reshape(counts.shape)
    assert (counts > 0).any()
    for shift in ((0, 1), (1, 0)):  # rays that graze the rim of the near plane's cut may fall either way
        reachable_near = np.roll(reachable, shift, axis=(0, 1))
        reachable = np.where(reachable_near == reachable, reachable, -1)
    sure = reachable >= 0
    assert sure.mean() > 0.7
    np.testing.assert_array_equal(counts[sure], reachable[sure])
    np.testing.assert_array_equal(np.isfinite(depth)[sure], reachable[sure] > 0)


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_depth_is_perspective_correct(seed: int, perspective: bool, device: str) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform((-3.0, -3.0, -9.0), (3.0, 3.0, -2.0), (45, 3))
    window = (-0.6, 0.5, -0.4, 0.5) if perspective else (-3.0, 2.5, -2.0, 2.5)
    axes = np.eye(3)
    view = HostView(np.zeros(3), axes[0], axes[1], -axes[2], window, 0.5, 50.0, 47, 35, perspective)
    assert_depth_equals_rays(points, np.arange(45).reshape(-1, 3), view, device)


@pytest.mark.parametrize("seed", range(8))
def test_clipping_at_the_near_plane_equals_rays(seed: int, device: str) -> None:
    """Triangles all around the eye: most cross the near plane, many lie wholly behind it."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3)) * rng.choice([0.5, 2.0, 8.0], (60, 1))
    view = eye_view(
        small_scenes.camera((0, 0, 0), tuple(rng.normal(size=3)), near=0.05, fov_deg=90.0), 48, 36, np.zeros(3)
    )
    assert_depth_equals_rays(points, np.arange(60).reshape(-1, 3), view, device)


@pytest.mark.parametrize("reach", [1e2, 1e3, 1e4, 1e6, 1e7])
def test_huge_triangles_far_outside_the_guard_band_equal_rays(reach: float, device: str) -> None:
    """A ground whose corners project hundreds of thousands of pixels away, and a wall through the eye's side."""
    ground = np.array([(-reach, -1.0, -reach), (reach, -1.0, -reach), (0.0, -1.0, reach)])
    wall = np.array([(1.0, -reach, -reach), (1.0, reach, -reach), (1.0, 0.0, reach)])
    points, faces = np.concatenate([ground, wall]), np.arange(6).reshape(-1, 3)
    view = eye_view(small_scenes.camera((0, 0, 0), (0.2, -0.3, -1.0), near=0.1, far=2 * reach), 60, 44, np.zeros(3))
    assert_depth_equals_rays(points, faces, view, device, min_hit=0.4)


def test_depth_keeps_its_precision_at_far_over_near_of_a_million(device: str) -> None:
    rng = np.random.default_rng(0)
    view = eye_view(small_scenes.camera((0, 0, 0), (0, 0, -1), near=1e-3, far=1e3, fov_deg=90.0), 48, 48, np.zeros(3))
    quad = np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
    for distance in (2e-3, 1.0, 900.0):
        nearer = quad * 2.0 * distance - np.array([0.0, 0.0, distance])
        farther = quad * 2.0 * distance - np.array([0.0, 0.0, distance * (1.0 + 1e-5)])
        points = np.concatenate([farther, nearer])
        faces = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
        depth, owner = draw(points, faces, view, device)
        np.testing.assert_allclose(depth, distance, rtol=2e-6)
        assert (owner >= 2).all()
    tilted = rng.uniform((-300.0, -300.0, -990.0), (300.0, 300.0, -1e-2), (30, 3))
    assert_depth_equals_rays(tilted, np.arange(30).reshape(-1, 3), view, device)


def test_surfaces_outside_near_and_far_are_not_drawn(device: str) -> None:
    view = eye_view(small_scenes.camera((0, 0, 0), (0, 0, -1), near=1.0, far=10.0), 16, 16, np.zeros(3))
    quad = 100.0 * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    for distance, seen in ((0.99, False), (1.01, True), (9.99, True), (10.01, False), (-5.0, False)):
        depth, owner = draw(quad - np.array([0.0, 0.0, distance]), faces, view, device)
        assert np.isfinite(depth).all() == seen and (owner >= 0).all() == seen
        assert np.isfinite(depth).any() == seen and (owner >= 0).any() == seen
