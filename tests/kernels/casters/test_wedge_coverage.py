"""The formula of penumbra wedges: its NumPy twin against clipped polygons, the kernels against the twin."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from wedge_maths import beyond, clip, clipped_area, hidden_by_loops, seen, winding

from wkernels.casters.wedges import coverage
from wkernels.casters.wedges.light_shapes import DISC, FACING, SQUARE, LightShape, Sight, see_light
from wkernels.casters.wedges.light_shapes import seen as seen_on_device
from wkernels.device.launch import launch

SHAPES = {"disc": int(DISC), "square": int(SQUARE)}


@wp.func
def below(p: wp.vec3):
    """How p sees the light of half size 1 in the plane z = 0."""
    out = Sight()
    out.depth = -p[2]
    out.row_u = wp.vec3(-p[2], 0.0, p[0])
    out.row_v = wp.vec3(0.0, -p[2], p[1])
    out.row_w = wp.vec3(0.0, 0.0, 1.0)
    out.offset = wp.vec3(0.0, 0.0, -p[2])
    out.nearest = 1e-6 * out.depth
    return out


@wp.kernel
def find_beyond(
    first: int,
    shape: int,
    p: wp.array(dtype=wp.vec3),
    ends: wp.array2d(dtype=wp.vec3),
    beyond_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    sight = below(p[i])
    p0 = seen_on_device(sight, ends[i, 0])
    p1 = seen_on_device(sight, ends[i, 1])
    span = coverage.clip_to_light(shape, sight, p0, p1)
    beyond_out[i] = 0.0
    if span[0] < span[1]:
        beyond_out[i] = coverage.beyond(shape, coverage.on_light(p0, p1, span))


def kernel_beyond(shape: str, p: np.ndarray, ends: np.ndarray, device: str) -> np.ndarray:
    out = wp.empty(len(p), dtype=float, device=device)
    arrays = [wp.array(p.astype(np.float32), dtype=wp.vec3, device=device)]
    arrays.append(wp.array(ends.astype(np.float32), dtype=wp.vec3, device=device))
    launch(find_beyond, len(p), [SHAPES[shape], *arrays], [out], device=device)
    return np.asarray(out.numpy(), np.float64)


def a_convex_loop(rng: np.random.Generator, size: float) -> np.ndarray:
    """A convex polygon in a tilted plane between light and receivers, counter-clockwise from above."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 9)))
    xy = rng.uniform(-1.0, 1.0, 2) + size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tilt = rng.uniform(-0.3, 0.3, 2)
    return np.column_stack([xy, -1.5 + xy @ tilt])


def on_plane(p: np.ndarray, loop: np.ndarray) -> np.ndarray:
    uvw = seen(p, loop)
    return uvw[:, :2] / uvw[:, 2:]


@pytest.mark.parametrize("shape", SHAPES)
def test_one_convex_loop_is_exact_everywhere(shape: str, device: str) -> None:
    """The light inside, outside and across it: the clipped polygon's area to 1e-4, by the twin and by the kernels."""
    rng = np.random.default_rng(1)
    found, receivers, pairs, owner = [], [], [], []
    for _ in range(80):
        loop = a_convex_loop(rng, rng.uniform(0.1, 1.5))
        p = rng.uniform((-4.0, -4.0, -8.0), (4.0, 4.0, -3.0))
        flat = on_plane(p, loop)
        exact = clipped_area(flat, None if shape == "square" else 256)
        assert abs(hidden_by_loops(shape, p, [loop], winding(flat)) - exact) < 5e-5
        owner += [len(found)] * len(loop)
        found.append((winding(flat), exact))
        receivers += [p] * len(loop)
        pairs.append(np.stack([loop, np.roll(loop, -1, axis=0)], axis=1))
    centre, area = np.array(found).T
    assert ((area > 0.01) & (area < 0.99)).sum() > 20
    of_edges = kernel_beyond(shape, np.array(receivers), np.concatenate(pairs), device)
    np.testing.assert_allclose(centre - np.bincount(owner, of_edges), area, atol=1e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_five_squares_that_do_not_overlap(shape: str, device: str) -> None:
    """Random squares, as seen side by side on the light: against a million points to 1e-3."""
    rng = np.random.default_rng(5)
    p = np.array([0.3, -0.2, -6.0])
    loops, flats, halves = [], [], []
    while len(loops) < 5:
        turn, half = rng.uniform(0.0, np.pi), rng.uniform(0.15, 0.35)
        angle = turn + np.pi / 4.0 + np.pi / 2.0 * np.arange(4)
        middle, height = rng.uniform(-0.9, 0.9, 2), rng.uniform(0.2, 0.6)
        flat = middle + half * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        if all(np.linalg.norm(middle - other.mean(axis=0)) > half + h for other, h in zip(flats, halves, strict=True)):
            flats.append(flat)
            halves.append(half)
            on_light = np.column_stack([flat, np.zeros(4)])
            loops.append(p + height * (on_light - p))
    grid = np.linspace(-1.0, 1.0, 1000, endpoint=False) + 1e-3
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    points = points[(points**2).sum(axis=1) < 1.0] if shape == "disc" else points
    hidden = np.zeros(len(points))
    for flat in flats:
        along = np.roll(flat, -1, axis=0) - flat
        away = points[:, None] - flat
        hidden += (along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0] > 0.0).all(axis=1)
    centre = sum(winding(flat) for flat in flats)
    assert 0.1 < hidden.mean() < 0.9
    assert abs(hidden_by_loops(shape, p, loops, centre) - hidden.mean()) < 1e-3
    pairs = np.concatenate([np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in loops])
    of_edges = kernel_beyond(shape, np.tile(p, (len(pairs), 1)), pairs, device)
    assert abs(centre - of_edges.sum() - hidden.mean()) < 1e-3


@pytest.mark.parametrize("shape", SHAPES)
def test_any_edge_is_what_the_twin_says(shape: str, device: str) -> None:
    """Ends behind the receiver, beyond the light, far beside it: never anything but a finite share."""
    rng = np.random.default_rng(9)
    p = rng.uniform((-3.0, -3.0, -9.0), (3.0, 3.0, -1.0), (4000, 3)).astype(np.float32).astype(float)
    ends = rng.uniform((-4.0, -4.0, -12.0), (4.0, 4.0, 3.0), (4000, 2, 3)).astype(np.float32).astype(float)
    toward = rng.uniform(0.05, 0.9, (4000, 2, 1))
    target = np.concatenate([rng.uniform(-1.2, 1.2, (4000, 2, 2)), np.zeros((4000, 2, 1))], axis=2)
    ends[::2] = (p[:, None] + toward * (target - p[:, None]))[::2].astype(np.float32)
    expected = np.zeros(len(p))
    for i in range(len(p)):
        clipped = clip(shape, *seen(p[i], ends[i]), -p[i, 2])
        expected[i] = 0.0 if clipped is None else beyond(shape, clipped)
    found = kernel_beyond(shape, p, ends, device)
    assert np.isfinite(found).all() and (expected != 0.0).mean() > 0.3
    # an edge that passes the centre has a half on either side of it
    sign_is_open = np.abs(np.abs(found) - 0.5) < 2e-3
    assert (np.abs(found - expected) < 2e-4)[~sign_is_open].all()
    assert np.allclose(np.abs(found), np.abs(expected), atol=2e-4)


def test_a_half_plane_leaves_the_share_of_a_segment(device: str) -> None:
    """An edge across the whole disc at a distance h of its centre: (acos h - h sqrt(1 - h^2)) / pi; 0.3119 at h = 0.3."""
    h = np.linspace(-0.99, 0.99, 67)
    h = h[np.abs(h) > 1e-3]
    p = np.tile([0.0, 0.0, -2.0], (len(h), 1))
    ends = np.stack(
        [np.stack([h / 2, -5.0 + 0 * h, -1.0 + 0 * h], 1), np.stack([h / 2, 5.0 + 0 * h, -1.0 + 0 * h], 1)], 1
    )
    a = np.abs(h)
    exact = np.sign(h) * (np.arccos(a) - a * np.sqrt(1.0 - a * a)) / np.pi
    np.testing.assert_allclose(kernel_beyond("disc", p, ends, device), exact, atol=2e-6)
    np.testing.assert_allclose(kernel_beyond("square", p, ends, device), np.sign(h) * 0.5 * (1.0 - a), atol=2e-6)
    at = np.array([[0.0, 0.0, -2.0]])
    one = np.array([[[0.15, -5.0, -1.0], [0.15, 5.0, -1.0]]])
    assert abs(kernel_beyond("disc", at, one, device)[0] - 0.3119) < 1e-4


@wp.kernel
def see_from(
    first: int, light: LightShape, p: wp.array(dtype=wp.vec3), end: wp.vec3, seen_out: wp.array(dtype=wp.vec3)
):
    i = first + wp.tid()
    seen_out[i] = seen_on_device(see_light(light, p[i]), end)


def test_a_sphere_is_the_disc_that_faces_the_receiver(device: str) -> None:
    """Its frame is square, of one size, and turns with the receiver: the distance from the middle is the angle's."""
    light = LightShape()
    light.kind, light.radius = int(FACING), 0.5
    light.axis_u, light.axis_v, light.axis_n = wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0), wp.vec3(0.0, 0.0, 1.0)
    p = np.random.default_rng(2).normal(size=(500, 3)) * 6.0
    end = np.array([0.4, -0.3, 0.2])
    out = wp.empty(len(p), dtype=wp.vec3, device=device)
    launch(see_from, len(p), [light, wp.array(p, dtype=wp.vec3, device=device), wp.vec3(*end)], [out], device=device)
    u, v, w = out.numpy().astype(float).T
    distance = np.linalg.norm(p, axis=1)
    along = ((end - p) * -p).sum(axis=1) / distance
    aside = np.sqrt(((end - p) ** 2).sum(axis=1) - along**2)
    np.testing.assert_allclose(w, along, rtol=1e-4)
    np.testing.assert_allclose(np.hypot(u, v) / w, aside / along * distance / 0.5, rtol=1e-3)


@wp.kernel
def find_above(first: int, shape: int, line: wp.array(dtype=wp.vec3), above_out: wp.array(dtype=float)):
    i = first + wp.tid()
    above_out[i] = coverage.share_above(shape, line[i][0], line[i][1], line[i][2])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_share_above_a_horizon(shape: str, device: str) -> None:
    rng = np.random.default_rng(3)
    lines = rng.uniform(-1.0, 1.0, (60, 3))
    lines[:20, 1] = 0.0
    lines[10:20, 0] = 0.0
    grid = np.linspace(-1.0, 1.0, 700, endpoint=False) + 1.0 / 700.0
    x, y = np.meshgrid(grid, grid)
    inside = x * x + y * y < 1.0 if shape == "disc" else np.ones_like(x, bool)
    exact = [((a * x + b * y + c > 0.0) & inside).sum() / inside.sum() for a, b, c in lines]
    out = wp.empty(len(lines), dtype=float, device=device)
    launch(find_above, len(lines), [SHAPES[shape], wp.array(lines, dtype=wp.vec3, device=device)], [out], device=device)
    np.testing.assert_allclose(out.numpy(), exact, atol=2e-3)
