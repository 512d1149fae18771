"""Filters, blocker search and penumbra geometry against NumPy twins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from filtering_sessions import AREA_KINDS, INSIDE, render, session
from pydantic import ValidationError

from algorithms.plugins import find
from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.filters.penumbra import (
    TAP_SETS,
    LightFootprint,
    mean_blocker_depth,
    penumbra_filter,
    penumbra_ratio,
    pull_footprint,
    tap_set,
    texels_per_ratio,
)
from wkernels.light_maps.light_map import Bias, LightMap, Receiver, depths_on_host, locate, locate_receiver
from wkernels.sampling.point_sets import halton
from wkernels.scene.light_extent import light_half_axes
from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    PointLight,
    RectangleLight,
    SphereLight,
)

# ---- kernels against twins ----------------------------------------------------------------------------------------------


@wp.kernel
def run_filters(
    first: int,
    light_map: LightMap,
    x: wp.array(dtype=float),
    y: wp.array(dtype=float),
    plane_depth: wp.array(dtype=wp.vec3),
    plane_scale: wp.array(dtype=wp.vec3),
    bias: float,
    spread: wp.array(dtype=wp.mat22),
    taps: wp.array(dtype=wp.vec2),
    nearest_out: wp.array(dtype=float),
    bilinear_out: wp.array(dtype=float),
    blocker_out: wp.array(dtype=wp.vec2),
):
    i = first + wp.tid()
    receiver = Receiver()
    receiver.x = x[i]
    receiver.y = y[i]
    receiver.plane_depth = plane_depth[i]
    receiver.plane_scale = plane_scale[i]
    receiver.bias = bias
    receiver.depth = plane_depth[i][2] - bias
    nearest_out[i] = penumbra_filter(light_map, receiver, spread[i], taps, 0)
    bilinear_out[i] = penumbra_filter(light_map, receiver, spread[i], taps, 1)
    blocker_out[i] = mean_blocker_depth(light_map, receiver, spread[i], taps)


def flat_map(depth: np.ndarray, device: str) -> LightMap:
    """A map whose texel (column i, row j) covers [i, i + 1] x [j, j + 1] of the plane x, -y, with depth along z."""
    size = depth.shape[-1]
    out = LightMap()
    layers = np.asarray(depth, np.float32).reshape(-1, size, size)
    matrix = np.array([[2.0 / size, 0, 0, -1], [0, 2.0 / size, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]], np.float32)
    out.depth, out.pitch = wp.array(layers.ravel(), dtype=float, device=device), size
    out.layer_begin = wp.array(np.arange(len(layers), dtype=np.int32) * size * size, dtype=int, device=device)
    out.ws_to_ls = wp.array(np.tile(matrix, (len(layers), 1, 1)), dtype=wp.mat44, device=device)
    out.right_ws = wp.array(np.tile(np.float32([1, 0, 0]), (len(layers), 1)), dtype=wp.vec3, device=device)
    out.up_ws = wp.array(np.tile(np.float32([0, 1, 0]), (len(layers), 1)), dtype=wp.vec3, device=device)
    out.layers, out.resolution, out.light_ws = len(layers), size, wp.vec4(0.0, 0.0, -1.0, 0.0)
    return out


class Twin:
    """Filters in float64, and how far the closest decision was from going the other way."""

    def __init__(self, depth: np.ndarray, bias: float) -> None:
        self.depth, self.bias, self.margin = depth, bias, np.inf

    def plane(self, rows: tuple[np.ndarray, np.ndarray], o: np.ndarray) -> float:
        rise, scale = rows[0] @ (*o, 1.0), rows[1] @ (*o, 1.0)
        own = rows[0][2] - self.bias
        if scale <= 0.0:
            return own
        return rise / scale - self.bias if scale >= 1.0 else max(own, rise / scale - self.bias / scale**2)

    def lit(self, depth: float, at: np.ndarray) -> tuple[bool, float]:
        column, row = np.floor(at).astype(int)
        stored = abs(self.depth[row, column])
        self.margin = min(self.margin, abs(stored - depth), *np.abs(at - np.round(at)))
        return depth <= stored, stored

    def run(self, here: np.ndarray, rows: Any, spread: np.ndarray, taps: np.ndarray) -> tuple[float, float, float]:
        size = len(self.depth)
        lit, blockers = 0.0, []
        for tap in taps:
            at = np.clip(here + spread @ tap, 1e-3, size - 1e-3)
            is_lit, stored = self.lit(self.plane(rows, at - here), at)
            lit += is_lit
            if not is_lit:
                blockers.append(stored)
        return lit / len(taps), float(np.mean(blockers)) if blockers else 0.0, len(blockers)

    def run_bilinear(self, here: np.ndarray, rows: Any, spread: np.ndarray, taps: np.ndarray) -> float:
        total = 0.0
        for tap in taps:
            at = np.clip(here + spread @ tap, 0.5, len(self.depth) - 0.5)
            corner = np.floor(at - 0.5)
            f = at - 0.5 - corner
            for i in (0, 1):
                for j in (0, 1):
                    texel = np.minimum(corner + (i, j) + 0.5, len(self.depth) - 0.5)
                    rise, scale = rows[0] @ (*(texel - here), 1.0), rows[1] @ (*(texel - here), 1.0)
                    depth = rise / scale - self.bias if scale > 0.0 else np.inf
                    total += self.lit(depth, texel)[0] * (f[0] if i else 1.0 - f[0]) * (f[1] if j else 1.0 - f[1])
        return total / len(taps)


@pytest.mark.parametrize("kernel", sorted(TAP_SETS))
def test_filters_and_search_agree_with_numpy(kernel: str, device: str) -> None:
    rng = np.random.default_rng(1)
    n, size, bias = 60, 24, 0.6
    depth = rng.uniform(2.0, 8.0, (size, size)).astype(np.float32)
    depth[rng.random((size, size)) < 0.2] = np.inf
    depth[rng.random((size, size)) < 0.2] *= -1.0  # tagged as moving, which must not matter here
    here = rng.uniform(0.0, size, (n, 2)).astype(np.float32)
    spread = rng.normal(size=(n, 2, 2), scale=3.0).astype(np.float32)
    middle = rng.uniform(3.0, 7.0, n)
    plane_depth = np.column_stack([rng.normal(size=(n, 2), scale=0.05), middle]).astype(np.float32)
    plane_scale = np.column_stack([rng.normal(size=(n, 2), scale=0.08), np.ones(n)]).astype(np.float32)
    plane_scale[:, :2] *= np.arange(n)[:, None] % 3 > 0  # every third plane is affine, as in orthographic maps
    taps = tap_set(kernel, 9)
    nearest, bilinear = (wp.zeros(n, dtype=float, device=device) for _ in range(2))
    blocker = wp.zeros(n, dtype=wp.vec2, device=device)
    inputs = [
        flat_map(depth, device),
        wp.array(here[:, 0].copy(), dtype=float, device=device),
        wp.array(here[:, 1].copy(), dtype=float, device=device),
        wp.array(plane_depth, dtype=wp.vec3, device=device),
        wp.array(plane_scale, dtype=wp.vec3, device=device),
        bias,
        wp.array(spread, dtype=wp.mat22, device=device),
        wp.array(taps.astype(np.float32), dtype=wp.vec2, device=device),
    ]
    launch(run_filters, n, inputs, [nearest, bilinear, blocker], device=device)
    decided = 0
    for i in range(n):
        twin = Twin(depth.astype(float), bias)
        where = (here[i].astype(float), (plane_depth[i].astype(float), plane_scale[i].astype(float)), spread[i], taps)
        lit, mean, count = twin.run(*where)
        if twin.margin > 1e-4:  # else float32 may decide otherwise, rightly
            decided += 1
            assert nearest.numpy()[i] == pytest.approx(lit, abs=1e-6)
            assert blocker.numpy()[i] == pytest.approx([mean, count], rel=1e-5)
        twin = Twin(depth.astype(float), bias)
        smooth = twin.run_bilinear(*where)
        if twin.margin > 1e-4:
            decided += 1
            assert bilinear.numpy()[i] == pytest.approx(smooth, abs=1e-4)
    assert decided > 1.6 * n


@wp.kernel
def filter_along_row(
    first: int,
    light_map: LightMap,
    position_ws: wp.array(dtype=wp.vec3),
    spread: wp.mat22,
    taps: wp.array(dtype=wp.vec2),
    bilinear: int,
    visibility_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    receiver = locate_receiver(light_map, Bias(), position_ws[i], wp.vec3(0.0, 0.0, -1.0))
    visibility_out[i] = penumbra_filter(light_map, receiver, spread, taps, bilinear)


def filtered_edge(x: np.ndarray, radius: float, taps: np.ndarray, bilinear: bool, device: str) -> np.ndarray:
    """Visibility at depth 2 along a row of a 32^2 map whose texels left of column 16 hold a caster at depth 1."""
    depth = np.full((32, 32), np.inf)
    depth[:, :16] = 1.0
    out = wp.zeros(len(x), dtype=float, device=device)
    position = np.column_stack([x, np.full_like(x, -16.3), np.full_like(x, 2.0)])
    inputs = [
        flat_map(depth, device),
        wp.array(position.astype(np.float32), dtype=wp.vec3, device=device),
        wp.mat22(radius, 0.0, 0.0, radius),
        wp.array(taps.astype(np.float32), dtype=wp.vec2, device=device),
        int(bilinear),
    ]
    launch(filter_along_row, len(x), inputs, [out], device=device)
    return out.numpy()


@pytest.mark.parametrize("radius", [1, 2, 3])
def test_bilinear_box_over_a_straight_edge_is_a_linear_ramp(radius: int, device: str) -> None:
    x = np.linspace(10.0, 22.0, 301)
    ramp = np.clip(0.5 + (x - 16.0) / (2.0 * radius), 0.0, 1.0)
    np.testing.assert_allclose(
        filtered_edge(x, radius, tap_set("box", (2 * radius) ** 2), True, device), ramp, atol=1e-5
    )
    dense = filtered_edge(x, radius, tap_set("box", 64**2), False, device)
    np.testing.assert_allclose(dense, ramp, atol=1.0 / 64.0 + 1e-5)


def test_taps_beyond_the_map_repeat_its_border(device: str) -> None:
    taps = tap_set("poisson", 64)
    for bilinear in (False, True):
        inside = filtered_edge(np.array([0.2, 31.8]), 12.0, taps, bilinear, device)
        np.testing.assert_array_equal(inside, [0.0, 1.0])


def test_tap_sets_are_named_and_sized() -> None:
    for kernel in TAP_SETS:
        assert tap_set(kernel, 25).shape == (25, 2)
    with pytest.raises(InputError, match="take 9 or 16"):
        tap_set("box", 15)
    with pytest.raises(InputError, match="'poisson'"):
        tap_set("poison", 16)


@pytest.mark.parametrize(
    ("name", "params", "message"),
    [
        ("pcf", {"kernel": "box", "taps": 15}, "k x k taps, so 15 is not possible: take 9 or 16"),
        ("pcss", {"kernel": "box", "blocker_taps": 5}, "take 4 or 9"),
        ("pcss", {"kernel": "box", "filter_taps": 17}, "take 16 or 25"),
        ("vsm", {"taps": 4}, "odd number of taps, so 4 is not possible: take 5"),
        ("vsm", {"bleeding": 1.0}, "bleeding"),
        ("pcf", {"radius": float("nan")}, "radius"),
    ],
)
def test_parameters_that_cannot_be_are_refused(name: str, params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        find(name).Params(**params)


# ---- penumbra geometry --------------------------------------------------------------------------------------------------


@wp.kernel
def run_ratio(
    first: int,
    is_point: float,
    receiver: wp.array(dtype=float),
    blocker: wp.array(dtype=float),
    ratio_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    ratio_out[i] = penumbra_ratio(is_point, receiver[i], blocker[i])


@pytest.mark.parametrize("is_point", [1.0, 0.0])
def test_penumbra_ratio_is_that_of_similar_triangles(is_point: float, device: str) -> None:
    receiver = np.array([10.0, 10.0, 3.0, 10.0, 10.0, 10.0], np.float32)
    blocker = np.array([5.0, 9.999, 3.0, 12.0, np.inf, 0.0], np.float32)
    out = wp.zeros(len(receiver), dtype=float, device=device)
    inputs = [wp.array(a, dtype=float, device=device) for a in (receiver, blocker)]
    launch(run_ratio, len(receiver), [is_point, *inputs], [out], device=device)
    behind = np.maximum(receiver - blocker, 0.0)
    expected = behind / np.maximum(blocker, 1e-6 * receiver) if is_point else behind
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-5)
    assert np.isfinite(out.numpy()).all()


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_half_axes_have_the_second_moments_of_the_light(kind: str) -> None:
    rng = np.random.default_rng(5)
    right, up, forward = np.linalg.qr(rng.normal(size=(3, 3)))[0].T
    lamp = small.light(kind, centre=(0.0, 0.0, 0.0) if kind != "directional" else tuple(-10.0 * forward))
    if isinstance(lamp, DiscLight):
        lamp = replace(lamp, normal=np.array([0.4, 1.0, -0.3]))
    elif isinstance(lamp, RectangleLight):
        lamp = replace(lamp, edge_u=np.array([1.0, 0.3, 0.0]), edge_v=np.array([0.5, 0.2, 2.0]))
    points = lamp.sample(halton(20000))[:, :3]
    if lamp.is_directional:
        # towards the light is -forward; tangents are measured at distance 1 along it
        points = points / (points @ lamp.centre[:3])[:, None]
        right, up = np.linalg.svd(lamp.centre[None, :3])[2][1:]
    seen = np.cov(points @ np.stack([right, up], axis=1), rowvar=False)
    axes = light_half_axes(lamp, right, up)
    per_axis = 0.25 if isinstance(lamp, (DiscLight, SphereLight, DirectionalLight)) else 1.0 / 3.0
    np.testing.assert_allclose(per_axis * axes @ axes.T, seen, atol=3e-3 * seen.max())


def test_a_point_has_no_half_axes() -> None:
    np.testing.assert_array_equal(light_half_axes(PointLight(position=np.ones(3)), *np.eye(3)[:2]), np.zeros((2, 2)))


@wp.kernel
def run_footprint(
    first: int,
    light_map: LightMap,
    footprint: LightFootprint,
    position_ws: wp.array(dtype=wp.vec3),
    axes_ws: wp.array2d(dtype=wp.vec3),
    axes_out: wp.array(dtype=wp.mat22),
    moved_out: wp.array(dtype=wp.mat22),
):
    i = first + wp.tid()
    here = locate(light_map, position_ws[i])
    layer = int(here[3])
    axes_out[i] = texels_per_ratio(light_map, footprint, layer, position_ws[i])
    u = locate(light_map, position_ws[i] + axes_ws[layer, 0])
    v = locate(light_map, position_ws[i] + axes_ws[layer, 1])
    moved_out[i] = wp.mat22(u[0] - here[0], v[0] - here[0], u[1] - here[1], v[1] - here[1])
    if u[3] != here[3] or v[3] != here[3]:  # moved on to another face of the cube
        moved_out[i] = wp.mat22(wp.nan, wp.nan, wp.nan, wp.nan)


@pytest.mark.parametrize("lamp", ["rectangle", "sun", "six faces"])
def test_the_footprint_is_the_light_laid_over_the_map(lamp: str, device: str) -> None:
    lights: dict[str, Light] = {
        "rectangle": RectangleLight(
            center=np.array([3.0, 9.0, -2.0]), edge_u=np.array([0.02, 0.005, 0.0]), edge_v=np.array([0.0, 0.01, 0.03])
        ),
        "sun": DirectionalLight(direction=np.array([0.5, -1.0, 0.2]), angle_deg=1.0),
        "six faces": SphereLight(center=INSIDE.position, radius=0.01),
    }
    frame = session(small.cluttered(lights[lamp]))
    pulled = frame.light_map(512)
    light_map, footprint = pulled.map, pull_footprint(frame, pulled)
    assert pull_footprint(frame, frame.light_map(512)) is footprint
    depth = depths_on_host(light_map)
    np.testing.assert_array_equal(footprint.nearest_depth.numpy(), depth.reshape(light_map.layers, -1).min(axis=1))
    assert light_map.layers == (6 if lamp == "six faces" else 1)
    assert footprint.is_point == (0.0 if lamp == "sun" else 1.0)
    onto_map = np.stack([light_map.right_ws.numpy(), light_map.up_ws.numpy()], axis=1).astype(float)
    half = np.stack([light_half_axes(frame.light, *axes) for axes in onto_map])
    axes_ws = np.einsum("lrk,lra->lak", onto_map, half)  # the half-axes within the plane of the map
    points = np.random.default_rng(0).uniform((-4.0, 0.0, -4.0), (4.0, 0.4, 4.0), (50, 3)).astype(np.float32)
    out, moved = (wp.zeros(50, dtype=wp.mat22, device=device) for _ in range(2))
    inputs = [
        light_map,
        footprint,
        wp.array(points, dtype=wp.vec3, device=device),
        wp.array(axes_ws.astype(np.float32), dtype=wp.vec3, device=device),
    ]
    launch(run_footprint, 50, inputs, [out, moved], device=device)
    same_face = np.isfinite(moved.numpy()).all(axis=(1, 2))
    assert same_face.sum() > 40
    expected = moved.numpy()[same_face]
    np.testing.assert_allclose(out.numpy()[same_face], expected, atol=0.01 * np.abs(expected).max())


def test_vsm_is_lighter_where_casters_overlap() -> None:
    low = small.mesh("low", small.plane(3.0, y=1.0), receives=False)
    high = small.mesh("high", small.plane(3.0, y=6.0, centre=(1.4, 0.0)), receives=False)
    scene = small.scene([small.mesh("ground", small.plane(12.0)), low, high], small.light("rectangle"))
    truth = render(scene, "reference_multisample", samples=64).visibility
    leaking = render(scene, "vsm", width="pcss").visibility - truth
    cut = render(scene, "vsm", width="pcss", bleeding=0.4).visibility - truth
    umbra = truth == 0.0
    assert np.mean(leaking[umbra]) > 0.005 and np.nanmean(leaking) > 0.0
    assert np.mean(cut[umbra]) < 0.2 * np.mean(leaking[umbra])
