from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from wkernels.projections.light_views import FACE_TANGENT, MAX_TANGENT, perspective_aliasing, scene_views
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Bounds:
    out = Bounds()
    out.add(np.array([low, high], dtype=float))
    return out


def boxes(*corners: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Bounds:
    out = Bounds()
    for low, high in corners:
        out.add(np.array([low, high], dtype=float))
    return out


def project(view: HostView, points: np.ndarray) -> np.ndarray:
    """(x / w, y / w, linear depth, w) of points (N, 3)."""
    h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([h[:, :2] / h[:, 3:], h[:, 2:]])


RECEIVERS = [
    box((-6, 0, -6), (6, 2, 6)),
    box((-6, 0, -6), (6, 0, 6)),  # flat
    box((1, 2, 3), (1, 2, 3)),  # a point
    box((-0.01, 0, -0.01), (0.01, 50, 0.01)),  # a pole
    boxes(((-6, 0, -6), (6, 0, 6)), ((1, 0, 1), (2, 5, 2))),  # a floor and a tower
]
CASTERS = [Bounds(), box((-1, 3, -1), (1, 4, 1)), box((-1, -40, -1), (1, 40, 1))]


@pytest.mark.parametrize("resolution", [1, 2, 7, 1024])
@pytest.mark.parametrize("casters", CASTERS)
@pytest.mark.parametrize("receivers", RECEIVERS)
@pytest.mark.parametrize("towards", [(0, 1, 0), (0.3, 0.9, -0.2), (1, 0, 0), (-1, -1, 1)])
def test_a_directional_map_holds_all_receivers_and_casters_before_them(
    towards: tuple, receivers: Bounds, casters: Bounds, resolution: int
) -> None:
    light = np.append(np.array(towards, float) / np.linalg.norm(towards), 0.0)
    (view,) = scene_views(light, receivers, casters, resolution)
    assert not view.perspective and (view.width, view.height) == (resolution, resolution)
    inside = project(view, receivers.corners)
    assert np.abs(inside[:, :2]).max() <= 1.0 + 1e-9
    if resolution > 4:  # a texel of margin all round, for lookups at the rim
        assert np.abs(inside[:, :2]).max() <= 1.0 - 1.9 / resolution
    assert (inside[:, 2] >= view.near).all() and (inside[:, 2] <= view.far).all()
    if not casters.empty:
        depth = project(view, casters.corners)[:, 2]
        assert depth.min() >= view.near, "casters towards the light must not be clipped away"
    np.testing.assert_allclose(view.forward_ws, -light[:3], atol=1e-12)


@pytest.mark.parametrize("receivers", [*RECEIVERS[:2], RECEIVERS[-1]])
def test_a_point_outside_uses_one_map_that_holds_all_receivers(receivers: Bounds) -> None:
    views = scene_views(np.array([1.0, 12.0, -2.0, 1.0]), receivers, CASTERS[1], 256)
    assert len(views) == 1
    (view,) = views
    inside = project(view, receivers.corners)
    assert np.abs(inside[:, :2]).max() <= 1.0 - 1.9 / 256
    assert (inside[:, 3] > 0).all() and inside[:, 2].max() <= view.far and view.near < 1e-3
    assert max(np.abs(view.window)) <= MAX_TANGENT * 1.1


def test_a_floor_is_looked_at_straight_down_so_that_no_texel_is_wasted() -> None:
    (view,) = scene_views(np.array([3.0, 9.0, -4.0, 1.0]), RECEIVERS[1], CASTERS[0], 256)
    np.testing.assert_allclose(view.forward_ws, (0.0, -1.0, 0.0), atol=1e-12)
    used = project(view, RECEIVERS[1].corners)[:, :2]
    assert np.ptp(used, axis=0).min() > 2.0 * (1.0 - 4.0 / 256)


@pytest.mark.parametrize(
    "position", [(0.0, 1.0, 0.0), (6.0, 1.0, 0.0), (0.0, 2.05, 0.0), (0.0, 0.0, 0.0), (5.9, 1.9, 5.9)]
)
def test_a_point_amid_the_receivers_uses_six_faces_that_leave_no_gap(position: tuple) -> None:
    receivers = RECEIVERS[0]
    views = scene_views(np.array([*position, 1.0]), receivers, CASTERS[1], 64)
    assert len(views) == 6
    rng = np.random.default_rng(1)
    points = rng.uniform(receivers.low, receivers.high, (3000, 3))
    projected = [project(view, points) for view in views]
    held = np.stack([(p[:, 3] > 0) & (np.abs(p[:, :2]).max(axis=1) <= 1.0) for p in projected])
    assert (held.sum(axis=0) >= 1).all()
    central = np.stack([(p[:, 3] > 0) & (np.abs(p[:, :2]).max(axis=1) <= 1.0 / FACE_TANGENT) for p in projected])
    assert (central.sum(axis=0) >= 1).all(), "faces must overlap, so that filters do not run off them"
    for view, p, inside in zip(views, projected, held, strict=True):
        assert p[inside, 2].max(initial=0.0) <= view.far
        axes = np.stack([view.right_ws, view.up_ws, -view.forward_ws])
        assert np.linalg.det(axes) == pytest.approx(1.0)


# ---- perspective aliasing -------------------------------------------------------------------------------------------

NEAR, FAR, FOV = 1.0, 40.0, 60.0
PIXELS, TEXELS = 480, 512


def level_eye() -> HostView:
    """An eye at the origin that looks along +Z, with a square frame."""
    tangent = np.tan(np.radians(0.5 * FOV))
    axes = (np.array([-1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]))
    return HostView(np.zeros(3), *axes, (-tangent, tangent, -tangent, tangent), NEAR, FAR, PIXELS, PIXELS)


def overhead_rows(n_warp: float) -> np.ndarray:
    """Rows x, y, depth, w of a map seen from straight above that just holds the eye's frustum.

    ``n_warp`` is the distance n' from the projection reference point of the warp to the frustum's near plane (Lloyd et al.
    2006); infinite for none. Map y runs along the view.
    """
    half_width = FAR * np.tan(np.radians(0.5 * FOV))
    rows = np.zeros((4, 4))
    rows[2] = (0.0, -1.0, 0.0, 100.0)
    if np.isinf(n_warp):
        rows[0, 0] = 1.0 / half_width
        rows[1] = (0.0, 0.0, 2.0 / (FAR - NEAR), -(FAR + NEAR) / (FAR - NEAR))
        rows[3, 3] = 1.0
        return rows
    f_warp = n_warp + FAR - NEAR
    rows[0, 0] = f_warp / half_width
    # y = (f' + n')/(f' - n') - 2 f' n' / ((f' - n') w) with w = n' + z - n
    a, b = (f_warp + n_warp) / (f_warp - n_warp), 2.0 * f_warp * n_warp / (f_warp - n_warp)
    rows[3] = (0.0, 0.0, 1.0, n_warp - NEAR)
    rows[1] = (0.0, 0.0, a, a * (n_warp - NEAR) - b)
    return rows


@pytest.mark.parametrize("n_warp", [NEAR, (NEAR * FAR) ** 0.5, 100.0, np.inf])
@pytest.mark.parametrize("light", [(0.0, 1.0, 0.0, 0.0), (0.0, 1e9, 0.0, 1.0)])
def test_aliasing_error_equals_the_published_equations_for_overhead_light(n_warp: float, light: tuple) -> None:
    """Stingl 2011, equations 2.3 and 2.4 (Lloyd et al. 2006)."""
    view = SimpleNamespace(ws_to_ss=overhead_rows(n_warp), width=TEXELS, height=TEXELS)
    z, m_x, m_z = perspective_aliasing([view], np.array(light), level_eye(), steps=64)  # type: ignore[list-item]
    ratio = PIXELS / TEXELS
    over_tangent = (FAR - NEAR) / (2.0 * np.tan(np.radians(0.5 * FOV)))
    if np.isinf(n_warp):
        expected_x, expected_z = ratio * FAR / z, ratio * over_tangent / z
    else:
        scale = n_warp + FAR - NEAR
        expected_x = ratio * FAR * (n_warp + z - NEAR) / (z * scale)
        expected_z = ratio * over_tangent * (n_warp + z - NEAR) ** 2 / (z * n_warp * scale)
    assert z[0] == pytest.approx(NEAR) and z[-1] == pytest.approx(FAR)
    inner = slice(1, -1)  # rounding may put the first and the last point outside the map
    np.testing.assert_allclose(m_x[inner], expected_x[inner], rtol=1e-6)
    np.testing.assert_allclose(m_z[inner], expected_z[inner], rtol=1e-6)


def test_aliasing_error_is_missing_where_no_map_looks() -> None:
    rows = overhead_rows(np.inf)
    rows[1] *= 2.0  # the middle half only
    view = SimpleNamespace(ws_to_ss=rows, width=TEXELS, height=TEXELS)
    z, m_x, m_z = perspective_aliasing([view], np.array([0.0, 1.0, 0.0, 0.0]), level_eye())  # type: ignore[list-item]
    held = np.abs(z - 0.5 * (NEAR + FAR)) <= 0.25 * (FAR - NEAR)
    np.testing.assert_array_equal(np.isfinite(m_x), held)
    np.testing.assert_array_equal(np.isfinite(m_z), held)
    _, nothing, _ = perspective_aliasing([], np.array([0.0, 1.0, 0.0, 0.0]), level_eye())
    assert np.isnan(nothing).all()


def test_aliasing_error_of_a_plain_map_for_slanted_light_is_the_ratio_of_lengths() -> None:
    """Texel over pixel, both measured in the world by stepping from one to the next."""
    light = np.array([0.4, 0.8, -0.3])
    light /= np.linalg.norm(light)
    (view,) = scene_views(np.append(light, 0.0), box((-30, -10, -1), (30, 10, 45)), Bounds(), TEXELS)
    eye = level_eye()
    z, m_x, m_z = perspective_aliasing([view], np.append(light, 0.0), eye, steps=16)
    along = eye.forward_ws - (light @ eye.forward_ws) * light
    across = np.cross(light, along)
    for i in range(16):
        point = eye.eye_ws + z[i] * eye.forward_ws
        pixel = 2.0 * z[i] * np.tan(np.radians(0.5 * FOV)) / PIXELS
        for m, direction in ((m_x[i], across), (m_z[i], along)):
            step = 1e-4 * direction / np.linalg.norm(direction)
            moved = project(view, np.stack([point - step, point + step]))[:, :2]
            texels_per_length = np.linalg.norm(moved[1] - moved[0]) * 0.5 * TEXELS / 2e-4
            assert m == pytest.approx(1.0 / (texels_per_length * pixel), rel=1e-5)
