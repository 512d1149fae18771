from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wkernels.device.launch import launch
from wkernels.scene.views import HostView, View
from wkernels.temporal import reprojection

WIDTH, HEIGHT = 96, 64


def look(eye: tuple[float, float, float], target: tuple[float, float, float], perspective: bool = True) -> HostView:
    eye_ws = np.array(eye)
    forward = np.array(target) - eye_ws
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    window = (-0.75, 0.75, -0.5, 0.5) if perspective else (-6.0, 6.0, -4.0, 4.0)
    return HostView(eye_ws, right, np.cross(right, forward), forward, window, 0.1, 100.0, WIDTH, HEIGHT, perspective)


def pixel_rays(view: HostView) -> tuple[np.ndarray, np.ndarray]:
    """Base and direction of the ray through each pixel centre, (H, W, 3); its parameter is linear depth."""
    left, right, bottom, top = view.window
    x = left + (np.arange(view.width) + 0.5) / view.width * (right - left)
    y = top + (np.arange(view.height) + 0.5) / view.height * (bottom - top)
    side = x[None, :, None] * view.right_ws + y[:, None, None] * view.up_ws
    if view.perspective:
        return np.broadcast_to(view.eye_ws, side.shape), view.forward_ws + side
    return view.eye_ws + side, np.broadcast_to(view.forward_ws, side.shape)


def trace(base: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth (inf: none) and surface id by ray casting: the floor y = 0 and a wall |x| < 1, 0 < y < 2.5, z = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = -base[..., 1] / along[..., 1]
        wall = -base[..., 2] / along[..., 2]
        hit = base + wall[..., None] * along
    on_wall = (np.abs(hit[..., 0]) < 1.0) & (hit[..., 1] > 0.0) & (hit[..., 1] < 2.5) & (wall > 0.0)
    depth_floor = np.where(floor > 0.0, floor, np.inf)
    depth_wall = np.where(on_wall, wall, np.inf)
    return np.minimum(depth_floor, depth_wall), np.where(depth_wall < depth_floor, 2, np.isfinite(depth_floor) * 1)


@wp.kernel
def reproject_pixels(
    first: int, previous: View, position_ws: wp.array2d[wp.vec3], stored_depth: wp.array2d[float], epsilon: float,
    screen_out: wp.array2d[wp.vec3], texel_out: wp.array2d[wp.vec2i], relative_out: wp.array2d[int],
    absolute_out: wp.array2d[int],
):  # fmt: skip
    row, x = wp.tid()
    y = first + row
    screen = reprojection.reproject(previous, position_ws[y, x])
    screen_out[y, x] = screen
    texel_out[y, x] = wp.vec2i(-1, -1)
    relative_out[y, x] = 0
    absolute_out[y, x] = 0
    if reprojection.is_inside(previous, screen[0], screen[1]):
        texel_out[y, x] = wp.vec2i(int(screen[0]), int(screen[1]))
        stored = stored_depth[int(screen[1]), int(screen[0])]
        relative_out[y, x] = wp.where(reprojection.is_same_depth(screen[2], stored, epsilon * stored), 1, 0)
        absolute_out[y, x] = wp.where(reprojection.is_same_depth(screen[2], stored, epsilon), 1, 0)


def run(
    previous: HostView, position_ws: np.ndarray, stored_depth: np.ndarray, epsilon: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    shape = position_ws.shape[:2]
    outputs = [wp.empty(shape, dtype=t) for t in (wp.vec3, wp.vec2i, int, int)]
    inputs = [
        previous.to_device(),
        wp.array(position_ws, dtype=wp.vec3),
        wp.array(stored_depth, dtype=float),
        epsilon,
    ]
    launch(reproject_pixels, shape, inputs, outputs, threads=2)
    screen, texel, relative, absolute = (out.numpy() for out in outputs)
    return screen, texel, relative, absolute


def project_twin(view: HostView, position_ws: np.ndarray) -> np.ndarray:
    """By the camera's axes, not by its matrix."""
    offset = position_ws - view.eye_ws
    depth = offset @ view.forward_ws
    scale = depth if view.perspective else np.ones_like(depth)
    left, right, bottom, top = view.window
    x = ((offset @ view.right_ws) / scale - left) / (right - left) * view.width
    y = (top - (offset @ view.up_ws) / scale) / (top - bottom) * view.height
    return np.stack([x, y, depth], axis=-1)


@pytest.mark.parametrize("perspective", [True, False])
def test_points_reproject_to_their_own_pixel(perspective: bool) -> None:
    view = look((3.0, 4.0, 8.0), (0.0, 0.5, 0.0), perspective)
    base, along = pixel_rays(view)
    depth = np.random.default_rng(1).uniform(0.2, 30.0, (HEIGHT, WIDTH))
    screen, texel, relative, absolute = run(view, base + depth[..., None] * along, depth, 1e-3)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    np.testing.assert_allclose(screen[..., 0], x + 0.5, atol=2e-3)
    np.testing.assert_allclose(screen[..., 1], y + 0.5, atol=2e-3)
    np.testing.assert_allclose(screen[..., 2], depth, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(texel, np.stack([x, y], axis=-1))
    assert relative.all() and absolute.all()


@pytest.mark.parametrize("perspective", [True, False])
def test_two_cameras_agree_where_both_see_the_same_surface(perspective: bool) -> None:
    previous = look((-2.5, 3.0, 7.0), (0.0, 0.8, 0.0), perspective)
    current = look((2.5, 3.2, 7.5), (0.3, 0.8, 0.0), perspective)
    stored_depth, stored_id = trace(*pixel_rays(previous))
    base, along = pixel_rays(current)
    depth, surface = trace(base, along)
    seen = np.isfinite(depth)
    position_ws = base + np.where(seen, depth, 1.0)[..., None] * along
    epsilon = 0.02
    screen, texel, relative, absolute = run(previous, position_ws, stored_depth, epsilon)

    twin = project_twin(previous, position_ws)
    np.testing.assert_allclose(screen[seen], twin[seen], atol=3e-4)
    inside = (twin[..., 0] >= 0) & (twin[..., 0] < WIDTH) & (twin[..., 1] >= 0) & (twin[..., 1] < HEIGHT)
    fraction = np.abs(twin[..., :2] - np.round(twin[..., :2]))
    clear = seen & (fraction > 1e-3).all(axis=-1)  # rounding may choose either texel on a border
    np.testing.assert_array_equal((texel[..., 0] >= 0)[clear], inside[clear])
    np.testing.assert_array_equal(texel[clear & inside], np.floor(twin[clear & inside][:, :2]).astype(int))
    assert (texel[clear & ~inside] == -1).all() and (clear & ~inside).sum() > 50

    column, row = (
        np.where(inside, np.floor(twin[..., 0]), 0).astype(int),
        np.where(inside, np.floor(twin[..., 1]), 0).astype(int),
    )
    there = stored_depth[row, column]
    with np.errstate(invalid="ignore"):
        error = np.abs(1.0 - twin[..., 2] / there)
        gap = np.abs(twin[..., 2] - there)
    checked = clear & inside
    decided = checked & (np.abs(error - epsilon) > 1e-4) & (np.abs(gap - epsilon) > 1e-4)
    assert decided.sum() > 0.9 * checked.sum()
    np.testing.assert_array_equal(relative[decided] == 1, error[decided] < epsilon)
    np.testing.assert_array_equal(absolute[decided] == 1, gap[decided] < epsilon)

    # Geometry, not formulas: what the previous camera did not see is rejected, what it saw of the wall is accepted.
    ray_base, ray_along = previous.eye_ws, position_ws - previous.eye_ws
    if not perspective:
        ray_base, ray_along = (
            position_ws - twin[..., 2:] * previous.forward_ws,
            np.broadcast_to(previous.forward_ws, position_ws.shape),
        )
    to_point, _ = trace(np.broadcast_to(ray_base, position_ws.shape), ray_along)
    target = 1.0 if perspective else twin[..., 2]
    hidden = checked & (to_point < 0.9 * target)
    other = hidden & (stored_id[row, column] != surface)
    assert other.sum() > 30
    assert not relative[other].any()
    same = checked & (to_point > 0.999 * target) & (stored_id[row, column] == surface) & (surface == 2)
    assert same.sum() > 30
    assert relative[same].mean() > 0.95


def test_points_behind_the_camera_are_outside() -> None:
    view = look((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    position_ws = np.array([[[0.0, 0.0, 6.0], [0.3, 0.2, 5.0], [0.0, 0.0, 4.0]]])
    screen, texel, relative, _ = run(view, position_ws, np.ones((HEIGHT, WIDTH)), 1e-3)
    np.testing.assert_allclose(screen[0, :, 2], [-1.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_array_equal(texel[0], [[-1, -1], [-1, -1], [WIDTH // 2, HEIGHT // 2]])
    np.testing.assert_array_equal(relative[0], [0, 0, 1])


def test_image_borders_are_half_open() -> None:
    view = HostView(
        np.zeros(3), np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], (0.0, 96.0, -64.0, 0.0), 0.1, 9.0, 96, 64, False
    )
    position_ws = np.array(
        [[[0.0, 0.0, -1.0], [95.75, -63.75, -1.0], [96.0, -1.0, -1.0], [1.0, -64.0, -1.0], [-0.25, -1.0, -1.0]]]
    )
    texel = run(view, position_ws, np.ones((HEIGHT, WIDTH)), 1e-3)[1]
    np.testing.assert_array_equal(texel[0], [[0, 0], [95, 63], [-1, -1], [-1, -1], [-1, -1]])


@wp.kernel
def accept_pairs(
    first: int, depth: wp.array[float], stored: wp.array[float], epsilon: float, relative_out: wp.array[int],
    absolute_out: wp.array[int],
):  # fmt: skip
    i = first + wp.tid()
    relative_out[i] = wp.where(reprojection.is_same_depth(depth[i], stored[i], epsilon * stored[i]), 1, 0)
    absolute_out[i] = wp.where(reprojection.is_same_depth(depth[i], stored[i], epsilon), 1, 0)


def test_depth_tests() -> None:
    cases = [  # depth, stored, relative, absolute, at epsilon 0.01
        (10.0, 10.0, 1, 1),
        (10.0, 10.05, 1, 0),
        (0.5, 0.508, 0, 1),
        (10.0, 10.2, 0, 0),
        (10.2, 10.0, 0, 0),
        (0.0, 0.0, 0, 0),
        (-3.0, -3.0, 0, 0),
        (3.0, -3.0, 0, 0),
        (3.0, np.inf, 0, 0),
        (np.inf, np.inf, 0, 0),
        (3.0, np.nan, 0, 0),
        (np.nan, 3.0, 0, 0),
    ]
    depth, stored, expected_relative, expected_absolute = np.array(cases).T
    outputs = [wp.empty(len(cases), dtype=int) for _ in range(2)]
    launch(accept_pairs, len(cases), [wp.array(depth, dtype=float), wp.array(stored, dtype=float), 0.01], outputs)
    np.testing.assert_array_equal(outputs[0].numpy(), expected_relative)
    np.testing.assert_array_equal(outputs[1].numpy(), expected_absolute)
