from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from compare import assert_twin
from small_scenes import camera

from wkernels.device.launch import launch
from wkernels.raster import to_homogeneous_pixels
from wkernels.scene.views import HostView, View, eye_view, pixel_along_ws, pixel_base_ws

ORIGIN = np.zeros(3)


def random_view(seed: int, perspective: bool) -> HostView:
    rng = np.random.default_rng(seed)
    right, up, back = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    window = (-rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.8), -rng.uniform(0.1, 0.9), rng.uniform(0.3, 1.1))
    return HostView(rng.uniform(-2, 2, 3), right, up, -back, window, 0.1, 50.0, 61, 37, perspective)


@wp.kernel
def point_on_ray(first: int, view: View, pixel: wp.array(dtype=wp.vec3), position_out: wp.array(dtype=wp.vec3)):
    i = first + wp.tid()
    p = pixel[i]
    position_out[i] = pixel_base_ws(view, p[0], p[1]) + p[2] * pixel_along_ws(view, p[0], p[1])


@wp.kernel
def project(first: int, view: View, position_ws: wp.array(dtype=wp.vec3), pixel_out: wp.array(dtype=wp.vec4)):
    i = first + wp.tid()
    pixel_out[i] = to_homogeneous_pixels(view, position_ws[i])


def run(kernel: wp.Kernel, view: HostView, points: np.ndarray, dtype: type, device: str) -> np.ndarray:
    out = wp.empty(len(points), dtype=dtype, device=device)
    inputs = [view.to_device(), wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)]
    launch(kernel, len(points), inputs, [out], device=device)
    return out.numpy()


def twin_position(view: HostView, pixel: np.ndarray) -> np.ndarray:
    """Straight from the definition of the window, in float64."""
    left, right, bottom, top = view.window
    x = left + (right - left) * pixel[:, 0] / view.width
    y = top + (bottom - top) * pixel[:, 1] / view.height
    spread = pixel[:, 2] if view.perspective else np.ones(len(pixel))
    across = (x * spread)[:, None] * view.right_ws + (y * spread)[:, None] * view.up_ws
    return view.eye_ws + pixel[:, 2:] * view.forward_ws + across


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_pixels_and_positions_are_inverse(seed: int, perspective: bool, device: str) -> None:
    view = random_view(seed, perspective)
    rng = np.random.default_rng(seed + 100)
    pixel = rng.uniform((0.0, 0.0, 0.2), (view.width, view.height, 40.0), (500, 3)).astype(np.float32)
    position = run(point_on_ray, view, pixel, wp.vec3, device)
    assert_twin(position, twin_position(view, pixel.astype(float)), atol=2e-5)
    h = run(project, view, position, wp.vec4, device)
    assert_twin(h[:, :2] / h[:, 3:], pixel[:, :2], atol=2e-3)  # float32 positions at depth 0.2 hold no more
    assert_twin(h[:, 2], pixel[:, 2], atol=1e-5)
    assert_twin(h[:, 3], pixel[:, 2] if perspective else np.ones(500), atol=1e-5)


def test_row_0_is_the_top_and_column_0_the_left(device: str) -> None:
    view = eye_view(camera((0, 0, 5), (0, 0, 0)), 40, 30, ORIGIN)
    h = run(project, view, np.array([(-1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 0.0, 0.0)]), wp.vec4, device)
    x, y = (h[:, :2] / h[:, 3:]).T
    assert x[0] < 20 < x[1] and y[0] < 15 < y[1]
    np.testing.assert_allclose([x[2], y[2]], [20, 15], atol=1e-4)


def test_fov_is_vertical_and_aspect_comes_from_the_pixels() -> None:
    view = eye_view(camera(fov_deg=90.0), 200, 100, ORIGIN)
    np.testing.assert_allclose(view.window, (-2.0, 2.0, -1.0, 1.0))


def test_axes_are_orthonormal_and_right_handed_even_straight_down() -> None:
    for eye, target in [
        ((0, 5, 0), (0, 0, 0)),
        ((0, -5, 0), (0, 0, 0)),
        ((3, 2, 1), (0, 0, 0)),
        ((0, 5, 1e-9), (0, 0, 0)),
    ]:
        view = eye_view(camera(eye, target), 8, 8, ORIGIN)
        axes = np.stack([view.right_ws, view.up_ws, -view.forward_ws])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize("margin", [(1, 1), (3, 2), (0, 5)])
def test_overscan_keeps_the_middle_of_the_frame(margin: tuple[int, int]) -> None:
    plain = eye_view(camera(), 33, 21, ORIGIN)
    wide = eye_view(camera(), 33, 21, ORIGIN, margin)
    assert (wide.width, wide.height) == (33 + 2 * margin[0], 21 + 2 * margin[1])
    pixel = np.array([(0.5, 0.5, 3.0), (32.5, 20.5, 7.0), (16.0, 10.0, 1.0)])
    moved = pixel + np.array([*margin, 0.0])
    np.testing.assert_allclose(twin_position(wide, moved), twin_position(plain, pixel), atol=1e-12)


def test_the_rebased_eye_carries_no_world_offset() -> None:
    far_away = np.array([1e6, -2e6, 3e6])
    here, there = camera(), camera()
    there = type(there)(there.eye + far_away, there.target + far_away, there.up, there.fov_deg, there.near, there.far)
    near_view, far_view = eye_view(here, 8, 8, ORIGIN), eye_view(there, 8, 8, far_away)
    np.testing.assert_allclose(far_view.ws_to_ss, near_view.ws_to_ss, atol=1e-8)
