"""The lane rasteriser against its plain twin: the same pixels, the same triangles, depths to rounding."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from drawing import draw, flat_view, from_pixels, triangle_soup, view_of

from wkernels.raster import CULL_BACK, CULL_FRONT, CULL_NONE, Rasteriser
from wkernels.raster.lanes import depth_key
from wkernels.scene.views import HostView, View


def both(
    points: np.ndarray, faces: np.ndarray, view: HostView, cull: int = CULL_NONE
) -> list[tuple[np.ndarray, np.ndarray]]:
    paths = ("lanes", "tiles")
    return [draw(points, faces, view, "cpu", cull=cull, rasteriser=Rasteriser("cpu", 2, path)) for path in paths]


def assert_same_image(lanes: tuple[np.ndarray, np.ndarray], tiles: tuple[np.ndarray, np.ndarray]) -> None:
    np.testing.assert_array_equal(np.isfinite(lanes[0]), np.isfinite(tiles[0]))
    seen = np.isfinite(tiles[0])
    assert seen.any() or seen.size < 20  # a pixel or two may see nothing
    np.testing.assert_allclose(lanes[0][seen], tiles[0][seen], rtol=3e-6)
    # where two triangles are equally deep to rounding either may win
    differs = lanes[1] != tiles[1]
    assert differs.mean() <= 2e-4
    np.testing.assert_array_equal((lanes[1] >= 0), seen)


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("size", [0.05, 0.5, 4.0, 60.0])
@pytest.mark.parametrize("shape", [(200, 150), (517, 131), (5, 3), (1, 1)])
def test_it_draws_what_the_plain_twin_draws(perspective: bool, size: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(int(size * 100) + shape[0])
    points, faces = triangle_soup(rng, 60 if size > 10 else 3000, size)
    lanes, tiles = both(points, faces, view_of(perspective, *shape))
    assert_same_image(lanes, tiles)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("both_sides", [True, False])
@pytest.mark.parametrize("down", [1, -1, 3, -40])
def test_wide_triangles_with_an_edge_nearly_parallel_to_rows(down: int, both_sides: bool, clockwise: bool) -> None:
    """Such an edge meets a row up to 2^33 pixels away: a floor that reaches behind the eye has one where it is cut."""
    below = 12000.0
    corners = [[-9000.0, below], [40.0, 6.5], [9000.0 if both_sides else -300.0, below + down / 256.0]]
    pixels = np.array(corners[::-1] if clockwise else corners)
    for points in (pixels, np.array([0.0, 54.0]) + [1.0, -1.0] * pixels):  # the edge below, and above
        lanes, tiles = both(from_pixels(*points.T, 2.0), np.array([[0, 1, 2]]), flat_view(96, 54))
        assert (tiles[1] == 0).sum() > 100
        np.testing.assert_array_equal(lanes[1], tiles[1])


@pytest.mark.parametrize("cull", [CULL_BACK, CULL_FRONT])
@pytest.mark.parametrize("size", [0.5, 30.0])
def test_culling_is_the_twins(cull: int, size: float) -> None:
    points, faces = triangle_soup(np.random.default_rng(3), 400, size)
    view = view_of(True, 240, 160)
    lanes, tiles = both(points, faces, view, cull)
    assert_same_image(lanes, tiles)
    assert (lanes[1] != both(points, faces, view)[0][1]).any()


def test_same_bits_for_any_number_of_threads() -> None:
    points, faces = triangle_soup(np.random.default_rng(5), 2000, 2.0)
    images = [draw(points, faces, view_of(True, 333, 257), "cpu", threads=threads) for threads in (1, 2, 3)]
    for depth, triangle in images[1:]:
        np.testing.assert_array_equal(depth, images[0][0])
        np.testing.assert_array_equal(triangle, images[0][1])


def test_a_rasteriser_can_be_used_again_for_another_mesh_and_size() -> None:
    """Its scratch holds the last mesh's corners and grows behind them when triangles are clipped."""
    rng = np.random.default_rng(8)
    rasteriser = Rasteriser("cpu", 2)
    for count, size, shape in (
        (50, 1.0, (64, 64)),
        (3000, 9.0, (300, 200)),
        (10, 40.0, (128, 16)),
        (3000, 0.3, (300, 200)),
    ):
        points, faces = triangle_soup(rng, count, size)
        view = view_of(True, *shape)
        again = draw(points, faces, view, "cpu", rasteriser=rasteriser)
        fresh = draw(points, faces, view, "cpu", rasteriser=Rasteriser("cpu", 2))
        np.testing.assert_array_equal(again[0], fresh[0])
        np.testing.assert_array_equal(again[1], fresh[1])


@pytest.mark.parametrize("jitter", [0.0, 0.45])
@pytest.mark.parametrize("cells", [39, 199, 699])
def test_jittered_grids_have_no_crack(cells: int, jitter: float) -> None:
    """3 000, 79 000 and 977 000 triangles over the whole screen, without a single uncovered pixel."""
    rng = np.random.default_rng(cells)
    line = np.linspace(-13.0, 13.0, cells + 1)
    x, y = np.meshgrid(line, line)
    step = 26.0 / cells
    points = np.stack([x, y, np.full_like(x, -10.0)], axis=-1)
    points[..., :2] += rng.uniform(-jitter, jitter, (cells + 1, cells + 1, 2)) * step
    index = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    view = view_of(False, 1024, 1024)
    depth, triangle = draw(points.reshape(-1, 3), faces, view, "cpu")
    assert np.isfinite(depth).all() and (triangle >= 0).all()


def warp(view: HostView, towards: float) -> View:
    """A view whose texels become denser along its y axis: a perspective frustum laid across the light's rays."""
    rows = view.ws_to_ss
    new = rows.copy()
    # y in [-1, 1] to w in [1, 1 + towards], and y' / w' through the same two ends
    new[3] = rows[3] * (1.0 + 0.5 * towards) + rows[1] * 0.5 * towards
    new[1] = rows[1] * (1.0 + 0.5 * towards) + rows[3] * 0.5 * towards
    out = view.to_device()
    out.ws_to_ss = wp.mat44(*new.astype(np.float32).ravel())
    return out


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("towards", [0.3, 20.0])
@pytest.mark.parametrize("size", [0.5, 4.0, 60.0])
def test_warped_views_are_drawn_as_the_twin_draws_them(perspective: bool, towards: float, size: float) -> None:
    host = view_of(perspective, 203, 157)
    view, plain = warp(host, towards), host.to_device()
    assert depth_key(view).warped and not depth_key(plain).warped
    points, faces = triangle_soup(np.random.default_rng(11), 60 if size > 10 else 3000, size)
    images = [draw(points, faces, view, "cpu", rasteriser=Rasteriser("cpu", 2, path)) for path in ("lanes", "tiles")]
    seen = np.isfinite(images[0][0]) & np.isfinite(images[1][0])
    assert seen.mean() > 0.1
    # w is down to 1/21 of the sum of its terms, and so is the factor: their rounding weighs 40 times as much
    np.testing.assert_allclose(images[0][0][seen], images[1][0][seen], rtol=5e-6 if towards < 1.0 else 3e-4)
    assert (images[0][1] != images[1][1]).mean() <= 1e-4
    assert (np.isfinite(images[0][0]) != np.isfinite(images[1][0])).mean() <= 1e-4
    assert (images[1][0] != draw(points, faces, plain, "cpu")[0]).mean() > 0.1


def test_a_matrix_that_no_light_has_is_left_to_the_plain_path() -> None:
    rows = view_of(False, 64, 64).ws_to_ss
    rows[3] += rows[2] * 0.01  # w grows along the rays of a directional light
    view = view_of(False, 64, 64).to_device()
    view.ws_to_ss = wp.mat44(*rows.astype(np.float32).ravel())
    assert depth_key(view) is None
    points, faces = triangle_soup(np.random.default_rng(2), 500, 2.0)
    images = [draw(points, faces, view, "cpu", rasteriser=Rasteriser("cpu", 2, path)) for path in ("lanes", "tiles")]
    np.testing.assert_array_equal(images[0][0], images[1][0])
