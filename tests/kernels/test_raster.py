"""The rasteriser against brute force: integer coverage in NumPy, and rays in float64."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp
from scipy.spatial import Delaunay

from wkernels.raster import CULL_BACK, CULL_FRONT, CULL_NONE, Rasteriser
from wkernels.views import HostView, eye_view

SUB = 256
EXACT_SIZES = [(64, 32), (32, 64), (1, 1), (4, 128), (128, 2)]  # powers of two: projection is exact in float32


# ---- drawing and twins ----------------------------------------------------------------------------------------------


def flat_view(width: int, height: int, far: float = 100.0) -> HostView:
    """World (x, y, -depth) = pixel (x, -y): an orthographic view in which a vertex's pixel position is read off."""
    eye, right, up, forward = np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0])
    return HostView(eye, right, up, forward, (0.0, width, -height, 0.0), 0.0, far, width, height, perspective=False)


def from_pixels(x: np.ndarray, y: np.ndarray, depth: np.ndarray | float) -> np.ndarray:
    """World positions for ``flat_view``."""
    return np.stack([x, -np.asarray(y), -np.broadcast_to(depth, np.shape(x))], axis=-1).astype(float)


def draw(
    points: np.ndarray,
    faces: np.ndarray,
    view: HostView,
    device: str,
    *,
    cull: int = CULL_NONE,
    threads: int | None = 2,
    rasteriser: Rasteriser | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and triangle images (H, W)."""
    rasteriser = rasteriser or Rasteriser(device, threads)
    depth = wp.empty((view.height, view.width), dtype=float, device=device)
    triangle = wp.empty((view.height, view.width), dtype=int, device=device)
    rasteriser.draw(
        wp.array(points.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
        view.to_device(),
        depth,
        triangle,
        cull,
    )
    return depth.numpy(), triangle.numpy()


def pixel_owner_counts(points: np.ndarray, faces: np.ndarray, view: HostView, device: str) -> np.ndarray:
    """How many triangles, each drawn alone, cover a pixel."""
    counts = np.zeros((view.height, view.width), int)
    rasteriser = Rasteriser(device, 1)
    for face in faces:
        counts += np.isfinite(draw(points, face[None], view, device, rasteriser=rasteriser)[0])
    return counts


def twin_coverage(subpixel: np.ndarray, width: int, height: int) -> np.ndarray:
    """Whether a triangle covers each pixel centre: integers, and a centre moved by an infinitesimal right and less down.

    That move is the top-left rule: it carries a centre on a left or top edge into the triangle and one on a right or
    bottom edge out of it.
    """
    a, b, c = (np.array(v, dtype=object) for v in subpixel.tolist())
    if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0:
        b, c = c, b
    px = (np.arange(width, dtype=np.int64) * SUB + SUB // 2)[None, :]
    py = (np.arange(height, dtype=np.int64) * SUB + SUB // 2)[:, None]
    inside = np.ones((height, width), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        dx, dy = int(q[0] - p[0]), int(q[1] - p[1])
        side = dx * (py - int(p[1])) - dy * (px - int(p[0]))
        first_move, second_move = -dy, dx
        inside &= (side > 0) | ((side == 0) & ((first_move > 0) | ((first_move == 0) & (second_move > 0))))
    return inside


def twin_draw(points: np.ndarray, faces: np.ndarray, view: HostView) -> tuple[np.ndarray, np.ndarray]:
    """What ``draw`` makes of vertices on the 1/256-pixel grid of a ``flat_view``: depth (float64) and triangle."""
    depth = np.full((view.height, view.width), np.inf)
    owner = np.full((view.height, view.width), -1)
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    for t, face in enumerate(faces):
        corners = points[face] * np.array([1.0, -1.0, -1.0])
        subpixel = np.rint(corners[:, :2] * SUB).astype(np.int64)
        (ax, ay), (bx, by), (cx, cy) = subpixel.tolist()
        if (bx - ax) * (cy - ay) == (by - ay) * (cx - ax):
            continue
        weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), np.stack([x.ravel(), y.ravel(), np.ones(x.size)]))
        here = (corners[:, 2] @ weights).reshape(x.shape)
        nearer = twin_coverage(subpixel, view.width, view.height) & (here < depth) & (here <= view.far)
        depth[nearer], owner[nearer] = here[nearer], t
    return depth, owner


def grid(rng: np.random.Generator, columns: int, rows: int, low: float, high: float, jitter: float) -> small_scenes.Triangles:
    """A jittered grid in pixels (x, y), larger than the screen, with diagonals in both directions."""
    x, y = np.meshgrid(np.linspace(low, high, columns + 1), np.linspace(low, high, rows + 1))
    step = np.array([(high - low) / columns, (high - low) / rows])
    points = np.stack([x.ravel(), y.ravel()], axis=1) + jitter * step * rng.uniform(-0.5, 0.5, (x.size, 2))
    faces = small_scenes.grid_faces(columns, rows).reshape(2, -1, 3)
    corner, right, below, opposite = faces[0][:, 0], faces[0][:, 2], faces[0][:, 1], faces[1][:, 2]
    turned = rng.random(len(corner)) < 0.5
    first = np.where(turned[:, None], np.stack([corner, below, opposite], 1), np.stack([corner, below, right], 1))
    second = np.where(turned[:, None], np.stack([corner, opposite, right], 1), np.stack([right, below, opposite], 1))
    return points, np.concatenate([first, second])


# ---- coverage -------------------------------------------------------------------------------------------------------


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
    flat = np.concatenate([rng.uniform(-1.0, 1.0, (50, 2)) * 3.0, 40.0 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])])
    faces = Delaunay(flat).simplices
    points = np.stack([flat[:, 0], rng.uniform(0.0, 0.02, len(flat)), flat[:, 1]], axis=1)
    view = eye_view(small_scenes.camera((0.3, 1.0, 0.2), (0.5, -1.0, 0.1), near=0.01), 50, 40, np.zeros(3))
    np.testing.assert_array_equal(pixel_owner_counts(points, faces, view, device), 1)
    assert np.isfinite(draw(points, faces, view, device)[0]).all()


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


# ---- depth against rays -----------------------------------------------------------------------------------------------


def pixel_rays(view: HostView, dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (scaled to linear depth) of the rays of all pixel centres, moved by (dx, dy) pixels."""
    left, right, bottom, top = view.window
    x, y = np.meshgrid(np.arange(view.width) + 0.5 + dx, np.arange(view.height) + 0.5 + dy)
    across = (left + (right - left) * x.ravel() / view.width)[:, None] * view.right_ws
    across = across + (top + (bottom - top) * y.ravel() / view.height)[:, None] * view.up_ws
    if view.perspective:
        return np.broadcast_to(view.eye_ws, across.shape), across + view.forward_ws
    return view.eye_ws + across, np.broadcast_to(view.forward_ws, across.shape)


def nearest_hits(view: HostView, corners: np.ndarray, dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the nearest hit within [near, far], +inf where there is none, and its triangle; (H, W)."""
    t, _ = small_scenes.ray_hits(*pixel_rays(view, dx, dy), corners)
    t = np.where((t >= view.near) & (t <= view.far), t, np.inf)
    owner = np.where(np.isfinite(t).any(axis=1), t.argmin(axis=1), -1)
    return t.min(axis=1).reshape(view.height, view.width), owner.reshape(view.height, view.width)


def assert_depth_equals_rays(points: np.ndarray, faces: np.ndarray, view: HostView, device: str, min_hit: float = 0.2) -> None:
    """Where rays moved by a little more than the snapping agree on the triangle, so must the rasteriser, to that little."""
    points = points.astype(np.float32).astype(float)
    corners = points[faces]
    want_depth, want_owner = nearest_hits(view, corners)
    lowest, highest, sure = want_depth.copy(), want_depth.copy(), np.ones(want_depth.shape, bool)
    step = 2.0 / SUB
    for dx, dy in ((-step, -step), (step, -step), (-step, step), (step, step)):
        depth, owner = nearest_hits(view, corners, dx, dy)
        sure &= owner == want_owner
        lowest, highest = np.minimum(lowest, depth), np.maximum(highest, depth)
    depth, owner = draw(points, faces, view, device)
    assert sure.mean() > 0.6
    assert (want_owner[sure] >= 0).mean() >= min_hit
    np.testing.assert_array_equal(owner[sure], want_owner[sure])
    hit = sure & (want_owner >= 0)
    slack = 1e-5 * want_depth[hit]
    assert (depth[hit] >= lowest[hit] - slack).all() and (depth[hit] <= highest[hit] + slack).all()


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
    view = eye_view(small_scenes.camera((0, 0, 0), tuple(rng.normal(size=3)), near=0.05, fov_deg=90.0), 48, 36, np.zeros(3))
    assert_depth_equals_rays(points, np.arange(60).reshape(-1, 3), view, device)


@pytest.mark.parametrize("reach", [1e2, 1e3, 1e4])  # times near: beyond that float32 is too coarse to clip in
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


# ---- culling, ties, odd input -----------------------------------------------------------------------------------------


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
    bad = np.array([(nan, 0.0, -2.0), (inf, 0.0, -2.0), (0.0, -inf, -2.0), (0.0, 0.0, nan), (0.2, 0.1, -2.0), (0.4, 0.2, -2.0)])
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
