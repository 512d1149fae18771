"""Which pixels the rasteriser gives to which triangle, against integer arithmetic; culling, ties and odd input."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp
from drawing import SUB, draw, flat_view, from_pixels, grid, pixel_owner_counts, twin_coverage, twin_draw
from scipy.spatial import Delaunay

from wkernels.raster import CULL_BACK, CULL_FRONT, Rasteriser
from wkernels.scene.views import eye_view

EXACT_SIZES = [(64, 32), (32, 64), (1, 1), (4, 128), (128, 2)]  # powers of two: projection is exact in float32


@pytest.mark.parametrize("size", EXACT_SIZES)
@pytest.mark.parametrize("grain", [1, 16, 128, 256])
def test_coverage_depth_and_owner_equal_the_integer_twin(size: tuple[int, int], grain: int, device: str) -> None:
    """Coarse grains put many edges and vertices exactly on pixel centres."""
    width, height = size
    rng = np.random.default_rng(width * 1000 + grain)
    count = 40
    span = np.array([width, height])
    xy = rng.uniform(-0.4 * span, 1.4 * span, (3 * count, 2))
    xy = np.rint(xy * SUB / grain) * grain / SUB
    depth = rng.integers(1, 1000, 3 * count) / 16.0
    points, faces = from_pixels(xy[:, 0], xy[:, 1], depth), np.arange(3 * count).reshape(-1, 3)
    view = flat_view(width, height)
    got_depth, got_owner = draw(points, faces, view, device)
    want_depth, want_owner = twin_draw(points, faces, view)
    assert (want_owner >= 0).any()
    np.testing.assert_array_equal(np.isfinite(got_depth), np.isfinite(want_depth))
    hit = want_owner >= 0
    np.testing.assert_allclose(got_depth[hit], want_depth[hit], rtol=1e-5)
    differs = hit & (got_owner != want_owner)  # only where two surfaces have the same depth
    for y, x in zip(*np.nonzero(differs), strict=True):
        alone, _ = twin_draw(points, faces[got_owner[y, x]][None], view)
        assert alone[y, x] == pytest.approx(want_depth[y, x], rel=2e-6)
    assert differs.sum() <= 0.01 * hit.sum()


def test_pixel_centres_on_edges_belong_to_the_top_left_triangle(device: str) -> None:
    """A square of two triangles whose every edge runs through pixel centres."""
    x, y = np.array([2.5, 6.5, 6.5, 2.5]), np.array([1.5, 1.5, 5.5, 5.5])
    view = flat_view(8, 8)
    for faces in ([(0, 1, 2), (0, 2, 3)], [(0, 2, 1), (3, 2, 0)], [(1, 2, 3), (3, 0, 1)]):
        counts = pixel_owner_counts(from_pixels(x, y, 1.0), np.array(faces), view, device)
        expected = np.zeros((8, 8), int)
        expected[1:5, 2:6] = 1  # left and top edges are in, right and bottom ones out
        np.testing.assert_array_equal(counts, expected)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("grain", [0, 128, 256])
def test_grids_cover_every_pixel_once(seed: int, grain: int, device: str) -> None:
    rng = np.random.default_rng(seed)
    width, height = 64, 32
    xy, faces = grid(rng, 6, 5, -9.0, 75.0, jitter=0.8)
    if grain:
        xy = np.rint(xy * SUB / grain) * grain / SUB
    points = from_pixels(xy[:, 0], xy[:, 1], rng.uniform(1.0, 2.0, len(xy)))
    view = flat_view(width, height)
    np.testing.assert_array_equal(pixel_owner_counts(points, faces, view, device), 1)
    depth, owner = draw(points, faces, view, device)
    assert np.isfinite(depth).all()
    twin = sum(twin_coverage(np.rint(xy[face] * SUB).astype(np.int64), width, height).astype(int) for face in faces)
    np.testing.assert_array_equal(twin, 1)
    if not grain:
        return
    for t in np.unique(owner):
        np.testing.assert_array_equal(
            owner == t, twin_coverage(np.rint(xy[faces[t]] * SUB).astype(np.int64), width, height)
        )


@pytest.mark.parametrize("centre", [(13.37, 9.91), (16.5, 8.5), (16.0, 8.0), (0.5, 0.5)])
def test_fans_cover_every_pixel_once(centre: tuple[float, float], device: str) -> None:
    """Slivers that meet in one point, on and off a pixel centre."""
    spokes = 61
    angle = 2.0 * np.pi * np.arange(spokes) / spokes
    x, y = centre[0] + 60.0 * np.cos(angle), centre[1] + 60.0 * np.sin(angle)
    points = from_pixels(np.append(x, centre[0]), np.append(y, centre[1]), 1.0)
    faces = np.stack([np.arange(spokes), (np.arange(spokes) + 1) % spokes, np.full(spokes, spokes)], axis=1)
    np.testing.assert_array_equal(pixel_owner_counts(points, faces, flat_view(32, 16), device), 1)


@pytest.mark.parametrize("seed", range(3))
def test_delaunay_meshes_in_perspective_cover_every_pixel_once(seed: int, device: str) -> None:
    """Tilted ground that fills the screen; some triangles cross the near plane and the guard band."""
    rng = np.random.default_rng(seed)
    flat = np.concatenate(
        [rng.uniform(-1.0, 1.0, (50, 2)) * 3.0, 40.0 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])]
    )
    faces = Delaunay(flat).simplices
    points = np.stack([flat[:, 0], rng.uniform(0.0, 0.02, len(flat)), flat[:, 1]], axis=1)
    view = eye_view(small_scenes.camera((0.3, 1.0, 0.2), (0.5, -1.0, 0.1), near=0.01), 50, 40, np.zeros(3))
    np.testing.assert_array_equal(pixel_owner_counts(points, faces, view, device), 1)
    assert np.isfinite(draw(points, faces, view, device)[0]).all()


# ---- culling, ties, odd input ---------------------------------------------------------------------------------------


def test_cull_modes_split_a_closed_surface(device: str) -> None:
    points, faces = small_scenes.sphere((0.0, 0.0, 0.0), 1.0)
    view = eye_view(small_scenes.camera((0.3, 0.5, 4.0), (0, 0, 0)), 40, 32, np.zeros(3))
    both, owner = draw(points, faces, view, device)
    front, front_owner = draw(points, faces, view, device, cull=CULL_BACK)
    back, back_owner = draw(points, faces, view, device, cull=CULL_FRONT)
    seen = owner >= 0
    assert 0.1 < seen.mean() < 0.9
    np.testing.assert_array_equal(both, front)
    np.testing.assert_array_equal(owner, front_owner)
    np.testing.assert_array_equal(np.isfinite(back), seen)
    assert (back[seen] > both[seen]).all()
    a, b, c = (points[faces[:, i]] for i in range(3))
    facing = np.einsum("ij,ij->i", np.cross(b - a, c - a), view.eye_ws - a) > 0
    assert facing[front_owner[seen]].all() and not facing[back_owner[seen]].any()


def test_culling_holds_for_clipped_triangles(device: str) -> None:
    points = np.array([(-50.0, -1.0, -50.0), (50.0, -1.0, -50.0), (0.0, -1.0, 60.0)])
    view = eye_view(small_scenes.camera((0, 0, 0), (0, -0.5, -1.0)), 16, 16, np.zeros(3))
    up, down = np.array([(2, 1, 0)]), np.array([(0, 1, 2)])
    assert np.isfinite(draw(points, up, view, device, cull=CULL_BACK)[0]).all()
    assert not np.isfinite(draw(points, up, view, device, cull=CULL_FRONT)[0]).any()
    assert not np.isfinite(draw(points, down, view, device, cull=CULL_BACK)[0]).any()
    assert np.isfinite(draw(points, down, view, device, cull=CULL_FRONT)[0]).all()


@pytest.mark.parametrize("clipped", [False, True])
def test_ties_go_to_the_lowest_index(clipped: bool, device: str) -> None:
    points = np.array([(-1.0, -1.0, -3.0), (1.0, -1.0, -3.0), (0.0, 1.0, -3.0)])
    if clipped:
        points = np.array([(-50.0, -1.0, -50.0), (50.0, -1.0, -50.0), (0.0, -1.0, 60.0)])
    view = eye_view(small_scenes.camera((0, 0, 0), (0, -0.2, -1.0)), 70, 70, np.zeros(3))
    _, owner = draw(points, np.tile([0, 1, 2], (100, 1)), view, device)
    assert set(np.unique(owner)) == {-1, 0}
    far_copy = np.concatenate([points - np.array([0.0, 0.5, 0.0]), points])
    _, owner = draw(far_copy, np.array([(0, 1, 2), (3, 4, 5), (3, 4, 5), (3, 4, 5)]), view, device)
    assert 1 in owner and not {2, 3} & set(np.unique(owner))


def test_broken_triangles_are_ignored(device: str) -> None:
    good = np.array([(-1.0, -1.0, -3.0), (1.0, -1.0, -3.0), (0.0, 1.0, -3.0)])
    nan, inf = np.nan, np.inf
    bad = np.array(
        [(nan, 0.0, -2.0), (inf, 0.0, -2.0), (0.0, -inf, -2.0), (0.0, 0.0, nan), (0.2, 0.1, -2.0), (0.4, 0.2, -2.0)]
    )
    points = np.concatenate([good, bad, good * 1e-30 - np.array([0.0, 0.0, 2.0])])
    faces = [(3, 0, 1), (0, 4, 1), (5, 1, 2), (0, 1, 6), (3, 4, 5)]  # with coordinates that are no numbers
    faces += [(7, 7, 7), (7, 8, 7), (7, 8, 8), (9, 10, 11)]  # without area
    view = eye_view(small_scenes.camera((0, 0, 0), (0, 0, -1)), 40, 30, np.zeros(3))
    alone, _ = draw(points, np.array([(0, 1, 2)]), view, device)
    depth, owner = draw(points, np.array([*faces, (0, 1, 2)]), view, device)
    np.testing.assert_array_equal(depth, alone)
    assert set(np.unique(owner)) == {-1, len(faces)}
    nothing, owner = draw(points, np.array(faces), view, device)
    assert np.isposinf(nothing).all() and (owner == -1).all()


def test_nothing_to_draw_clears_the_target(device: str) -> None:
    view = flat_view(37, 5)
    depth, owner = draw(np.zeros((0, 3)), np.zeros((0, 3), int), view, device)
    assert np.isposinf(depth).all() and (owner == -1).all()
    depth, owner = draw(np.zeros((3, 3)), np.zeros((0, 3), int), view, device)
    assert np.isposinf(depth).all() and (owner == -1).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 65), (65, 1), (33, 31), (7, 5), (8192, 3), (3, 8192)])
def test_any_size_is_filled_to_its_last_pixel(size: tuple[int, int], device: str) -> None:
    width, height = size
    x, y = np.array([-9.0, width + 9.0, width + 9.0, -9.0]), np.array([-9.0, -9.0, height + 9.0, height + 9.0])
    depth, owner = draw(from_pixels(x, y, 2.0), np.array([(0, 1, 2), (2, 3, 0)]), flat_view(width, height), device)
    np.testing.assert_array_equal(depth, 2.0)
    assert set(np.unique(owner)) <= {0, 1}


def test_depth_is_the_same_without_triangles(device: str) -> None:
    points, faces = small_scenes.random_boxes(8, seed=2)
    view = eye_view(small_scenes.camera(), 50, 37, np.zeros(3))
    with_owner, _ = draw(points, faces, view, device)
    alone = wp.empty((37, 50), dtype=float, device=device)
    rasteriser = Rasteriser(device, 2)
    rasteriser.draw(
        wp.array(points.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.ravel(), dtype=int, device=device),
        view.to_device(),
        alone,
    )
    np.testing.assert_array_equal(alone.numpy(), with_owner)


def test_same_bits_for_any_number_of_threads_and_reused_scratch(device: str) -> None:
    rng = np.random.default_rng(7)
    points = rng.normal(size=(9000, 3)) * 2.0
    faces = np.arange(9000).reshape(-1, 3)
    view = eye_view(small_scenes.camera((0, 0.1, 1.0), (0, 0, 0)), 130, 97, np.zeros(3))
    depth, owner = draw(points, faces, view, device, threads=1)
    reused = Rasteriser(device, 3)
    draw(points[:600], faces[:200], flat_view(64, 32), device, rasteriser=reused)
    for rasteriser in (Rasteriser(device, 2), Rasteriser(device, 3), reused):
        for _ in range(2):
            again, again_owner = draw(points, faces, view, device, rasteriser=rasteriser)
            np.testing.assert_array_equal(again, depth)
            np.testing.assert_array_equal(again_owner, owner)
