"""Many views in one call, which path a device gets, and inputs at the rasteriser's limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import small_scenes
import warp as wp
from drawing import (
    assert_depth_equals_rays,
    cube_faces,
    draw,
    flat_view,
    from_pixels,
    on_device,
    sun_samples,
    triangle_soup,
    view_of,
)

import wkernels.raster as raster
from wkernels.raster import CULL_BACK, CULL_FRONT, CULL_NONE, Rasteriser
from wkernels.scene.views import eye_view


@pytest.mark.parametrize("cull", [CULL_NONE, CULL_BACK, CULL_FRONT])
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("path", ["lanes", "tiles"])
def test_many_views_are_the_bits_of_single_ones(cull: int, threads: int, path: Any, device: str) -> None:
    """Closed meshes, from inside and outside, with and without triangles."""
    points, faces = small_scenes.random_boxes(12, seed=3)
    points_ws, indices = on_device(points, faces, device)
    many = Rasteriser(device, threads, path)
    for views in (cube_faces(45), sun_samples(7, 33)[:1], sun_samples(9, 70)):
        side = views[0].width
        depth = wp.full((len(views), side, side), value=-7.0, dtype=float, device=device)
        alone = wp.full((len(views), side, side), value=-7.0, dtype=float, device=device)
        owner = wp.full((len(views), side, side), value=-7, dtype=int, device=device)
        device_views = [view.to_device() for view in views]
        many.draw_many(points_ws, indices, device_views, depth, owner, cull)
        many.draw_many(points_ws, indices, device_views, alone, cull=cull)
        np.testing.assert_array_equal(alone.numpy(), depth.numpy())
        for layer, view in enumerate(views):
            single = Rasteriser(device, 1, path)
            want, want_owner = draw(points, faces, view, device, cull=cull, rasteriser=single)
            np.testing.assert_array_equal(depth.numpy()[layer], want)
            np.testing.assert_array_equal(owner.numpy()[layer], want_owner)
        assert np.isfinite(depth.numpy()).any()
    many.draw_many(points_ws, indices, [], wp.empty((0, 4, 4), dtype=float, device=device))


def test_an_error_in_any_view_reaches_the_caller() -> None:
    points_ws, indices = on_device(*small_scenes.random_boxes(2, seed=3), "cpu")
    views: list[Any] = [view.to_device() for view in sun_samples(3, 8)]
    with pytest.raises(AttributeError):
        Rasteriser("cpu", 2).draw_many(points_ws, indices, [*views, None], wp.empty((4, 8, 8), dtype=float))


# ---- which path -----------------------------------------------------------------------------------------------------


def test_cuda_gets_the_plain_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a GPU: the rasteriser is told that its device is not the CPU, and launches are only written down."""
    launched: list[str] = []
    points_ws, indices = on_device(*small_scenes.random_boxes(2, seed=3), "cpu")
    views = [view.to_device() for view in sun_samples(2, 8)]
    depths, count = wp.empty((2, 8, 8), dtype=float), wp.empty((8, 8), dtype=int)
    rasteriser, projected = Rasteriser("cpu", 2), raster.ScreenTriangles()
    projected.width, projected.height = 8, 8
    monkeypatch.setattr(Rasteriser, "_project", lambda *_: (projected, 24))
    monkeypatch.setattr(raster.Scratch, "launch", lambda _self, kernel, *_a, **_k: launched.append(kernel.key))
    get_device = wp.get_device
    monkeypatch.setattr(
        wp, "get_device", lambda name=None: SimpleNamespace(is_cpu=False) if name == "cpu" else get_device(name)
    )
    drawn = ["draw_stripe", "split_key"]
    rasteriser.draw(points_ws, indices, views[0], depths[0])
    assert launched == drawn
    rasteriser.draw_many(points_ws, indices, views, depths)
    assert launched == 3 * drawn
    rasteriser.count(points_ws, indices, views[0], depths[0], count)
    assert launched == [*(3 * drawn), "count_stripe"]


def test_more_triangles_than_a_float_can_name_are_left_to_the_plain_path(monkeypatch: pytest.MonkeyPatch) -> None:
    points, faces = triangle_soup(np.random.default_rng(1), 300, 3.0)
    view = view_of(True, 90, 70)
    want = draw(points, faces, view, "cpu", rasteriser=Rasteriser("cpu", 2, "tiles"))
    monkeypatch.setattr(raster, "MAX_TRIANGLES", 300)
    limited = Rasteriser("cpu", 2)
    monkeypatch.setattr(limited._lanes, "draw", lambda *_: pytest.fail("too many triangles for lanes"))
    got = draw(points, faces, view, "cpu", rasteriser=limited)
    np.testing.assert_array_equal(got[0], want[0])
    np.testing.assert_array_equal(got[1], want[1])


# ---- limits ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["lanes", "tiles"])
def test_the_largest_target_is_filled(path: Any) -> None:
    side = 8192
    x, y = np.array([-9.0, side + 9.0, side + 9.0, -9.0]), np.array([-9.0, -9.0, side + 9.0, side + 9.0])
    points_ws, indices = on_device(from_pixels(x, y, 2.0), np.array([(0, 1, 2), (2, 3, 0)]), "cpu")
    depth = wp.empty((side, side), dtype=float)
    Rasteriser("cpu", 2, path).draw(points_ws, indices, flat_view(side, side).to_device(), depth)
    values = depth.numpy()
    assert values.min() == 2.0 and values.max() == 2.0


def test_vertices_of_any_garbage_do_not_hurt_their_neighbours(device: str) -> None:
    """A random third of the vertices is NaN, infinite or huge; triangles without them are drawn as if alone."""
    rng = np.random.default_rng(4)
    points, faces = triangle_soup(rng, 500, 2.0)
    bad = rng.random(len(points)) < 0.1
    garbage = rng.choice([np.nan, np.inf, -np.inf, 3.4e38, -3.4e38], points.shape)
    broken = np.where(bad[:, None] & (rng.random(points.shape) < 0.7), garbage, points)
    finite = np.isfinite(broken).all(axis=1) & (np.abs(broken) < 1e38).all(axis=1)
    good = finite[faces].all(axis=1)
    assert 0.3 < good.mean() < 0.95
    not_numbers = ~np.isfinite(broken).all(axis=1)
    keep = good | not_numbers[faces].any(axis=1)  # huge but finite triangles may truly cover pixels
    view = view_of(True, 200, 150)
    depth, _ = draw(broken, faces[keep], view, device)
    want, _ = draw(points, faces[good], view, device)
    np.testing.assert_array_equal(depth, want)


# ---- clipping -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_triangles_across_all_six_planes_equal_rays(seed: int, device: str) -> None:
    """Each reaches beyond all four sides, and from behind the eye to behind the far plane."""
    rng = np.random.default_rng(seed)
    directions = np.array([(-8.0, -6.0), (8.0, -6.0), (0.0, 9.0)])
    depth = np.array([(-6.0, 9.0, 40.0), (40.0, -6.0, 9.0), (3.0, 60.0, -9.0)])
    corners = [np.column_stack([directions * rng.uniform(3, 9), -(row + rng.uniform(-1, 1, 3))]) for row in depth]
    points = np.concatenate(corners)
    view = eye_view(small_scenes.camera((0, 0, 0), (0, 0, -1), near=0.5, far=12.0, fov_deg=70.0), 64, 48, np.zeros(3))
    assert_depth_equals_rays(points, np.arange(9).reshape(-1, 3), view, device)


@pytest.mark.parametrize("vertices", [1, 2])
def test_vertices_exactly_on_the_eye_plane_equal_rays(vertices: int, device: str) -> None:
    """w = 0, at the side and at the eye itself."""
    for first in ((1.5, -0.5, 0.0), (0.0, 0.0, 0.0)):
        points = np.array([first, (-2.0, -1.0, 0.0 if vertices == 2 else -3.0), (0.5, 2.0, -8.0)])
        view = eye_view(small_scenes.camera((0, 0, 0), (0, 0, -1), near=0.1, fov_deg=80.0), 64, 48, np.zeros(3))
        if first == (0.0, 0.0, 0.0):  # the plane holds the eye: seen edge-on, at most a line of pixels
            depth, _ = draw(points, np.array([(0, 1, 2)]), view, device)
            assert np.isfinite(depth).mean() < 0.05
        else:
            assert_depth_equals_rays(points, np.array([(0, 1, 2)]), view, device, min_hit=0.02)
