"""Coverage counts against integer coverage in NumPy, the plain twin, and what closed volumes and grids must add up to."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp
from drawing import draw, flat_view, from_pixels, grid, triangle_soup, twin_coverage, view_of

from wkernels.errors import InputError
from wkernels.raster import COUNT_ALL, COUNT_FARTHER, COUNT_NEARER, Rasteriser
from wkernels.scene.views import HostView, eye_view


def count(
    points: np.ndarray,
    faces: np.ndarray,
    view: HostView,
    device: str,
    seen: np.ndarray | None = None,
    rasteriser: Rasteriser | None = None,
    **options: int,
) -> np.ndarray:
    """Counts (H, W); against ``seen`` (H, W) unless that is None."""
    options.setdefault("test", COUNT_ALL if seen is None else COUNT_NEARER)
    out = wp.full((view.height, view.width), value=12345, dtype=int, device=device)
    (rasteriser or Rasteriser(device, 2)).count(
        wp.array(points.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
        view.to_device(),
        None if seen is None else wp.array(seen.astype(np.float32), dtype=float, device=device),
        out,
        **options,
    )
    return out.numpy()


@pytest.mark.parametrize("size", [(64, 32), (1, 1), (4, 128), (128, 2), (256, 64)])
@pytest.mark.parametrize("test", [COUNT_ALL, COUNT_NEARER, COUNT_FARTHER])
def test_counts_equal_the_integer_twin(size: tuple[int, int], test: int, device: str) -> None:
    """Vertices on the subpixel grid and whole triangles at one depth; some are very wide."""
    width, height = size
    rng = np.random.default_rng(width + test)
    span = np.array([width, height])
    xy = np.rint(rng.uniform(-0.4 * span, 1.4 * span, (180, 2)) * 16) / 16
    depth = np.repeat(rng.integers(1, 20, 60) / 2.0, 3)
    points, faces = from_pixels(xy[:, 0], xy[:, 1], depth), np.arange(180).reshape(-1, 3)
    seen = rng.integers(1, 20, (height, width)) / 2.0 + 0.25  # never equal to rounding
    seen[rng.random(seen.shape) < 0.2] = np.inf
    fronts, backs = np.zeros((height, width), int), np.zeros((height, width), int)
    for face in faces:
        (ax, ay), (bx, by), (cx, cy) = xy[face]
        covered = twin_coverage(np.rint(xy[face] * 256).astype(np.int64), width, height)
        nearer = depth[face[0]] < seen
        covered &= {COUNT_ALL: np.ones_like(nearer), COUNT_NEARER: nearer, COUNT_FARTHER: ~nearer}[test]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)  # rows run down: negative is counter-clockwise
        if area != 0:
            target = fronts if area < 0 else backs
            target += covered
    view = flat_view(width, height)
    assert size == (1, 1) or (fronts.any() and backs.any())
    for front, back in ((1, -1), (-1, 1), (1, 0), (0, 1), (1, 1), (1, 4096)):
        for path in ("lanes", "tiles"):
            got = count(
                points, faces, view, device, seen, Rasteriser(device, 2, path), test=test, front=front, back=back
            )
            np.testing.assert_array_equal(got, front * fronts + back * backs)


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("size", [0.3, 4.0, 60.0])
@pytest.mark.parametrize("shape", [(200, 150), (517, 131), (5, 3)])
def test_lanes_count_what_the_plain_twin_counts(perspective: bool, size: float, shape: tuple[int, int]) -> None:
    """Coverage is exact; the depth test may fall either way only where depths are equal to rounding."""
    rng = np.random.default_rng(int(10 * size) + shape[0])
    points, faces = triangle_soup(rng, 80 if size > 10 else 1500, size)
    view = view_of(perspective, *shape)
    lanes, tiles = Rasteriser("cpu", 2), Rasteriser("cpu", 2, "tiles")
    all_lanes = count(points, faces, view, "cpu", rasteriser=lanes)
    np.testing.assert_array_equal(all_lanes, count(points, faces, view, "cpu", rasteriser=tiles))
    seen = rng.uniform(1.0, 60.0, shape[::-1])
    nearer = [count(points, faces, view, "cpu", seen, r) for r in (lanes, tiles)]
    farther = count(points, faces, view, "cpu", seen, lanes, test=COUNT_FARTHER)
    np.testing.assert_array_equal(nearer[0] + farther, all_lanes)
    assert (nearer[0] != nearer[1]).mean() <= 1e-3
    assert nearer[0].any() and (shape == (5, 3) or farther.any())


@pytest.mark.parametrize("jitter", [0.0, 0.45])
@pytest.mark.parametrize("cells", [39, 199, 699])
def test_jittered_grids_cover_every_pixel_exactly_once(cells: int, jitter: float) -> None:
    """3 000, 79 000 and 977 000 triangles over the whole screen: no pixel is missed, none is hit twice."""
    rng = np.random.default_rng(cells)
    xy, faces = grid(rng, cells, cells, -13.0, 13.0, jitter)
    points = np.column_stack([xy, np.full(len(xy), -10.0)])
    np.testing.assert_array_equal(count(points, faces, view_of(False, 1024, 1024), "cpu", front=1, back=1), 1)


@pytest.mark.parametrize("perspective", [True, False])
def test_clipped_grids_cover_every_pixel_exactly_once(perspective: bool) -> None:
    """Ground under the eye: the near plane cuts it, and its rim lies far outside of the guard band."""
    rng = np.random.default_rng(2)
    xy, faces = grid(rng, 60, 60, -1.0, 1.0, jitter=0.45)
    # a power of each coordinate keeps columns and rows apart
    far_out = np.sign(xy) * np.abs(xy) ** 5 * 3e4
    points = np.stack(
        [far_out[:, 0], np.zeros(len(xy)), far_out[:, 1]], axis=1
    )  # flat, so that it hides nothing of itself
    if perspective:
        view = eye_view(small_scenes.camera((0.3, 1.0, 0.2), (0.5, 0.0, 0.1), near=0.01), 413, 307, np.zeros(3))
    else:
        axes = np.eye(3)
        window = (-2.0, 2.0, -1.5, 1.5)
        view = HostView(np.array([0, 1.0, 0]), axes[0], -axes[2], -axes[1], window, 0.0, 9.0, 413, 307, False)
    for path in ("lanes", "tiles"):
        got = count(points, faces, view, "cpu", rasteriser=Rasteriser("cpu", 2, path), front=1, back=1)
        np.testing.assert_array_equal(got, 1)


def test_closed_volumes_count_one_inside_and_none_outside(device: str) -> None:
    """A sphere: net 0 without a test; before or behind what is seen, 1 where the seen point is inside."""
    points, faces = small_scenes.sphere((0.0, 0.0, 0.0), 1.0)
    view = eye_view(small_scenes.camera((0.3, 0.5, 4.0), (0, 0, 0), near=0.1), 61, 47, np.zeros(3))
    first, _ = draw(points, faces, view, device)
    last, _ = draw(points, faces, view, device, cull=2)
    assert np.isfinite(first).mean() > 0.1
    np.testing.assert_array_equal(count(points, faces, view, device, front=1, back=-1), 0)
    hit = np.isfinite(first)
    for seen, inside in (
        (0.5 * first, 0),
        (0.5 * (first + last), 1),
        (1.5 * last, 0),
        (np.full_like(first, np.inf), 0),
    ):
        np.testing.assert_array_equal(count(points, faces, view, device, seen), np.where(hit, inside, 0))
        behind = count(points, faces, view, device, seen, test=COUNT_FARTHER, front=-1, back=1)
        np.testing.assert_array_equal(behind, np.where(hit, inside, 0))


def test_counting_behind_is_right_for_an_eye_inside_and_beyond_the_far_plane(device: str) -> None:
    """The volume holds the eye and all that is seen, and ends behind the far plane."""
    points, faces = small_scenes.box((0.0, 0.0, 0.0), (50.0, 50.0, 50.0))
    view = eye_view(small_scenes.camera((1.0, 0.5, 2.0), (0, 0, 0), near=0.1, far=10.0), 45, 33, np.zeros(3))
    seen = np.full((33, 45), 5.0)
    np.testing.assert_array_equal(count(points, faces, view, device, seen, test=COUNT_FARTHER, front=-1, back=1), 1)
    np.testing.assert_array_equal(count(points, faces, view, device, seen), 0)
    np.testing.assert_array_equal(count(points, faces, view, device, np.full((33, 45), 100.0)), -1)


def test_nothing_broken_or_missing_is_counted(device: str) -> None:
    view = view_of(True, 19, 7)
    np.testing.assert_array_equal(count(np.zeros((0, 3)), np.zeros((0, 3), int), view, device), 0)
    bad = np.array([(np.nan, 0, -2.0), (0, np.inf, -2.0), (1.0, 1.0, -2.0), (0, 0, -2.0)])
    faces = np.array([(0, 2, 3), (1, 2, 3), (2, 2, 3), (3, 3, 3)])
    np.testing.assert_array_equal(count(bad, faces, view, device, front=1, back=1), 0)
    with pytest.raises(InputError, match="needs the depth"):
        count(bad, faces, view, device, test=COUNT_NEARER)


def test_same_counts_for_any_number_of_threads() -> None:
    points, faces = triangle_soup(np.random.default_rng(5), 2000, 2.0)
    view = view_of(True, 333, 257)
    seen = np.random.default_rng(6).uniform(1.0, 60.0, (257, 333))
    images = [count(points, faces, view, "cpu", seen, Rasteriser("cpu", threads)) for threads in (1, 2, 3)]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
