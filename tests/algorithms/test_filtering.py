"""pcf, pcss and vsm: their device functions against NumPy twins, their images against closed forms and each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from pydantic import ValidationError

from algorithms.plugins import find
from wkernels.errors import InputError
from wkernels.filtering import (
    TAP_SETS,
    LightFootprint,
    mean_blocker_depth,
    penumbra_filter,
    penumbra_ratio,
    pull_footprint,
    tap_set,
    texels_per_ratio,
)
from wkernels.frame import FrameResult, Session
from wkernels.geometry import Geometry
from wkernels.launch import launch
from wkernels.light_extent import light_half_axes
from wkernels.light_map import Bias, LightMap, Receiver, locate, locate_receiver
from wkernels.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    RectangleLight,
    SphereLight,
)
from wkernels.moments import Chebyshev, depth_range, find_moments, lit_share, sample_bilinear
from wkernels.sampling import halton
from wkernels.scene import Camera, Mesh, Scene

INSIDE = PointLight(position=np.array([0.2, 3.2, 1.5]))  # among the casters of `cluttered`: six faces
AREA_KINDS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")
TECHNIQUES = (("pcf", {}), ("pcss", {}), ("vsm", {}), ("vsm", {"width": "pcss"}))


@pytest.fixture(autouse=True)
def _sessions_on_the_device(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OPTIONS, "device", device)


OPTIONS: dict[str, Any] = {}


def render(scene: Scene, name: str, *, size: tuple[int, int] = (64, 48), **params: Any) -> FrameResult:
    return session(scene, size=size).render(technique(name, **params))


def technique(name: str, **params: Any) -> Any:
    plugin = find(name)
    return plugin(plugin.Params(**params))


def session(scene: Scene, *, size: tuple[int, int] = (64, 48), **options: Any) -> Session:
    return Session(Geometry(scene, OPTIONS["device"]), width=size[0], height=size[1], **OPTIONS, **options)


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
    out.depth = wp.array(layers, dtype=float, device=device)
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
    light_map = frame.light_map(512)
    footprint = pull_footprint(frame, light_map)
    assert pull_footprint(frame, light_map) is footprint
    depth = light_map.depth.numpy()
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


# ---- whole images against closed forms ----------------------------------------------------------------------------------


def half_plane(lamp: Light, blocker_height: float = 5.0) -> Scene:
    """A caster over x > 0 and a ground that it shadows, the light about 10 above: CATALOGUE A1, A2."""
    ground = small.mesh("ground", small.plane(12.0))
    wide = np.array([(x, blocker_height, z) for x in (0.0, 40.0) for z in (-40.0, 40.0)])
    caster = Mesh("half plane", wide, np.array([[0, 1, 2], [2, 1, 3]], np.int32), receives=False)
    eye = np.array([0.0, min(4.5, 0.9 * blocker_height), 0.1])  # below the caster, which would hide the ground
    view = Camera(eye, np.zeros(3), np.array([0.0, 0.0, -1.0]), 45.0, 0.1, 100.0)
    return small.scene([ground, caster], lamp, view)


def share_below(lamp: Light, limit: np.ndarray) -> np.ndarray:
    """Share of the light with x below ``limit``, for lights centred on x = 0 (closed form of the projected shape)."""
    if isinstance(lamp, (DiscLight, SphereLight)):
        h = np.clip(limit / lamp.radius, -1.0, 1.0)
        return 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    if isinstance(lamp, LinearLight):
        return np.clip(0.5 + limit / abs(lamp.b[0] - lamp.a[0]), 0.0, 1.0)
    assert isinstance(lamp, RectangleLight)
    u, v = sorted(np.abs([lamp.edge_u[0], lamp.edge_v[0]]))
    if u == 0.0:
        return np.clip(0.5 + limit / v, 0.0, 1.0)

    def twice_integrated(t: np.ndarray) -> np.ndarray:
        return 0.5 * np.maximum(t, 0.0) ** 2

    corners = ((u + v) / 2, 1), ((v - u) / 2, -1), ((u - v) / 2, -1), (-(u + v) / 2, 1)
    return sum(sign * twice_integrated(limit + shift) for shift, sign in corners) / (u * v)


def rectangle(width: float, depth: float, angle_deg: float = 0.0) -> RectangleLight:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return RectangleLight(
        center=np.array([0.0, 10.0, 0.0]),
        edge_u=width * np.array([c, 0.0, s]),
        edge_v=depth * np.array([-s, 0.0, c]),
    )


CLOSED_FORMS = {
    "square": (rectangle(2.0, 2.0), "box"),
    "narrow": (rectangle(0.7, 2.5), "box"),
    "wide": (rectangle(2.5, 0.7), "box"),
    "turned": (rectangle(2.0, 1.2, 30.0), "box"),
    "disc": (small.light("disc", size=2.0), "poisson"),
    "sphere": (small.light("sphere", size=2.0), "poisson"),
    "linear": (LinearLight(a=np.array([-1.0, 10.0, -0.5]), b=np.array([1.0, 10.0, 0.5])), "box"),
}


@pytest.mark.parametrize("case", CLOSED_FORMS)
def test_pcss_with_many_taps_meets_the_closed_form_of_a_half_plane(case: str) -> None:
    lamp, kernel = CLOSED_FORMS[case]
    count = 400
    result = render(half_plane(lamp), "pcss", kernel=kernel, blocker_taps=count, filter_taps=count, resolution=512)
    x = result.world_position[..., 0].astype(float)
    expected = share_below(lamp, -x * (10.0 - 5.0) / 5.0)
    error = result.visibility - expected
    texel = 2 * 6.1 / 512
    # a box of k x k taps has k levels along the edge, and the edge itself is known to half a texel
    width = 2.0 if case != "narrow" else 0.7
    assert np.abs(error).max() < 1.5 * (1.0 / np.sqrt(count) + texel / width)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert 0.1 < np.mean((expected > 0.0) & (expected < 1.0)) < 0.9  # most of the penumbra is in the picture


def test_pcss_as_published_stays_near_the_ramp() -> None:
    result = render(half_plane(rectangle(2.0, 2.0)), "pcss")
    error = result.visibility - np.clip(0.5 - result.world_position[..., 0] / 2.0, 0.0, 1.0)
    assert np.sqrt(np.mean(error**2)) < 0.06 and abs(np.mean(error)) < 0.02
    assert len(np.unique(np.round(result.visibility * 16.0, 3))) <= 17  # the bands of 16 taps


@pytest.mark.parametrize("blocker_height", [1.0, 3.0, 7.0])
def test_the_sun_casts_penumbrae_as_wide_as_its_angle_says(blocker_height: float) -> None:
    sun = DirectionalLight(direction=np.array([0.0, -1.0, 0.0]), angle_deg=20.0)
    scene = half_plane(sun, blocker_height)
    result = render(scene, "pcss", blocker_taps=300, filter_taps=300, resolution=512)
    radius = np.tan(np.radians(10.0)) * blocker_height
    h = np.clip(-result.world_position[..., 0].astype(float) / radius, -1.0, 1.0)
    expected = 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    error = result.visibility - expected
    assert np.abs(error).max() < 0.06 + 0.024 / radius
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_a_sparse_search_loses_the_outer_penumbra() -> None:
    scene = half_plane(rectangle(2.0, 2.0))
    x = render(scene, "pcss").world_position[..., 0]
    sparse = render(scene, "pcss", blocker_taps=1).visibility
    dense = render(scene, "pcss", blocker_taps=64).visibility
    outer = (x < -0.15) & (x > -0.9)
    assert (sparse[outer] == 1.0).all() and dense[outer].mean() < 0.85


def test_wide_kernels_do_not_shadow_the_plane_that_they_lie_on() -> None:
    """A lamp close over the ground: towards the horizon one texel spans ever more depth than at the receiver."""
    chip = small.mesh("chip", small.box((0.0, 1.7, 0.0), (0.1, 0.05, 0.1)))
    lamp = SphereLight(center=np.array([0.0, 2.0, 0.0]), radius=0.15)
    scene = small.scene([small.mesh("ground", small.plane(12.0)), chip], lamp)
    truth = render(scene, "reference_multisample", samples=64, size=(128, 96)).visibility
    for params in ({}, {"width": "pcss"}):
        image = render(scene, "vsm" if params else "pcss", size=(128, 96), **params).visibility
        lit = truth == 1.0
        assert lit.sum() > 5000 and np.mean(image[lit] < 0.95) < 0.005


def test_turned_taps_are_noise_round_the_same_mean() -> None:
    scene = half_plane(rectangle(2.0, 2.0))
    plain, turned, again, other = (
        session(scene, seed=seed).render(technique("pcss", rotate=rotate)).visibility
        for rotate, seed in ((False, 1), (True, 1), (True, 1), (True, 2))
    )
    np.testing.assert_array_equal(turned, again)
    assert np.mean(turned != plain) > 0.1 and np.mean(turned != other) > 0.1
    assert np.mean(turned) == pytest.approx(np.mean(plain), abs=0.01)


@pytest.mark.parametrize("lamp", [rectangle(2.0, 2.0), rectangle(0.8, 2.5)], ids=["square", "narrow"])
def test_vsm_over_two_planes_gives_the_exact_ramp(lamp: RectangleLight) -> None:
    result = render(half_plane(lamp), "vsm", width="pcss", blocker_taps=100)
    expected = share_below(lamp, -result.world_position[..., 0].astype(float))
    np.testing.assert_allclose(result.visibility, expected, atol=0.02)


# ---- limits -------------------------------------------------------------------------------------------------------------


def lights_without_size() -> dict[str, Light]:
    out: dict[str, Light] = {kind: small.light(kind, size=1e-30) for kind in ("rectangle", "disc", "sphere", "linear")}
    return {**out, "point": INSIDE, "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2]))}


@pytest.mark.parametrize("kind", lights_without_size())
@pytest.mark.parametrize("bias", ["none", "slope", "normal"])
def test_without_width_the_filters_are_the_hard_shadow_map(kind: str, bias: str) -> None:
    scene = small.cluttered(lights_without_size()[kind])
    hard = render(scene, "shadow_map", bias=bias, resolution=128).visibility
    assert 0.01 < np.nanmean(hard) < 0.99
    for name, params in (("pcf", {"radius": 0.0, "bilinear": False}), ("pcss", {}), ("pcss", {"kernel": "box"})):
        soft = render(scene, name, bias=bias, resolution=128, **params).visibility
        np.testing.assert_array_equal(soft, hard, err_msg=f"{name} {params}")


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
def test_six_faces_agree_with_rays_off_the_edges(name: str, params: dict[str, Any]) -> None:
    scene = small.cluttered(INSIDE)
    rays = render(scene, "ray_cast_point_shadow", size=(128, 96)).visibility
    image = render(scene, name, size=(128, 96), **params).visibility
    assert np.nanmean(np.abs(image - rays)) < 0.02


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize(
    "lamp",
    [
        SphereLight(center=np.array([0.3, 2.0, -0.2]), radius=0.3),  # inside the box
        SphereLight(center=np.array([0.0, 1.0, 3.0]), radius=5.0),  # reaches receivers
        DirectionalLight(direction=np.array([1.0, -0.02, 0.0]), angle_deg=60.0),  # grazing
        RectangleLight(center=np.array([0.0, 4.0, 0.0]), edge_u=np.array([90.0, 0, 0]), edge_v=np.array([0, 0, 1e-3])),
    ],
    ids=["inside a caster", "huge", "grazing", "sliver"],
)
def test_degenerate_lights_stay_within_bounds(name: str, params: dict[str, Any], lamp: Light) -> None:
    image = render(small.box_on_ground(lamp), name, resolution=64, **params).visibility
    seen = image[~np.isnan(image)]
    assert len(seen) > 500 and seen.min() >= 0.0 and seen.max() <= 1.0


# ---- moments ------------------------------------------------------------------------------------------------------------


@wp.kernel
def run_lit_share(
    first: int,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=float),
    share_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    share_out[i] = lit_share(chebyshev, moments[i], depth[i])


def chebyshev_of(near: float, far: float, min_variance: float = 1e-9, bleeding: float = 0.0) -> Chebyshev:
    out = Chebyshev()
    out.near, out.per_length, out.min_variance, out.bleeding = near, 1.0 / (far - near), min_variance, bleeding
    return out


def lit_shares(samples: list[np.ndarray], depth: np.ndarray, chebyshev: Chebyshev, device: str) -> np.ndarray:
    """``lit_share`` of sets of depths, each seen from one receiver depth (scene units)."""
    scaled = [(z - chebyshev.near) * chebyshev.per_length - 0.5 for z in samples]
    moments = np.array([(z.mean(), (z * z).mean()) for z in scaled], np.float32)
    t = ((depth - chebyshev.near) * chebyshev.per_length - 0.5).astype(np.float32)
    out = wp.zeros(len(t), dtype=float, device=device)
    inputs = [wp.array(moments, dtype=wp.vec2, device=device), wp.array(t, dtype=float, device=device)]
    launch(run_lit_share, len(t), [chebyshev, *inputs], [out], device=device)
    return out.numpy()


def test_two_planes_give_the_exact_share(device: str) -> None:
    lit = np.arange(1, 20)
    samples = [np.repeat([2.0, 7.0], [20 - k, k]) for k in lit]
    np.testing.assert_allclose(
        lit_shares(samples, np.full(len(lit), 7.0), chebyshev_of(1.0, 9.0), device), lit / 20, rtol=1e-4
    )


def test_light_bleeds_as_the_closed_form_says(device: str) -> None:
    depth = np.array([6.01, 7.0, 10.0])
    bleed = lit_shares([np.array([2.0, 6.0])] * 3, depth, chebyshev_of(0.0, 12.0), device)
    np.testing.assert_allclose(bleed, 1.0 / (1.0 + (1.0 + 2.0 * (depth - 6.0) / 4.0) ** 2), rtol=1e-4)
    np.testing.assert_allclose(bleed, [0.498, 0.308, 0.100], atol=1e-3)
    cut = lit_shares([np.array([2.0, 6.0])] * 3, depth, chebyshev_of(0.0, 12.0, bleeding=0.3), device)
    np.testing.assert_allclose(cut, np.maximum(bleed - 0.3, 0.0) / 0.7, rtol=1e-4, atol=1e-6)


def test_the_bound_is_never_below_the_share_that_is_lit(device: str) -> None:
    rng = np.random.default_rng(3)
    samples = [rng.choice(rng.uniform(1.0, 9.0, 4), 25) for _ in range(200)]
    depth = rng.uniform(1.0, 9.0, 200)
    share = lit_shares(samples, depth, chebyshev_of(1.0, 9.0), device)
    truth = np.array([np.mean(z >= t) for z, t in zip(samples, depth, strict=True)])
    assert (share >= truth - 1e-4).all() and (share <= 1.0).all()
    assert np.mean(share > truth + 0.05) > 0.2  # and it is a bound, not the share


@pytest.mark.parametrize("slope", [False, True])
def test_moments_agree_with_numpy(slope: bool, device: str) -> None:
    rng = np.random.default_rng(8)
    near, far = 1e4, 1e4 + 10.0
    depth = rng.uniform(near, far, (2, 17, 17)).astype(np.float32)
    depth[:, 3:6, 4] = np.inf
    out = wp.zeros((17, 17), dtype=wp.vec2, device=device)
    layers = wp.array(depth, dtype=float, device=device)
    launch(find_moments, (17, 17), [layers, chebyshev_of(near, far), int(slope), 1], [out], device=device)
    z = np.minimum((depth[1].astype(float) - near) / (far - near), 1.0) - 0.5
    square = z * z
    if slope:
        padded = np.pad(z, 1, mode="edge")
        for a, b in ((padded[1:-1, :-2], padded[1:-1, 2:]), (padded[:-2, 1:-1], padded[2:, 1:-1])):
            square = square + 0.25 * np.minimum(np.abs(z - a), np.abs(b - z)) ** 2
    np.testing.assert_allclose(out.numpy()[..., 0], z, atol=1e-6)
    np.testing.assert_allclose(out.numpy()[..., 1], square, atol=1e-6)


def test_normalised_moments_keep_small_variances(device: str) -> None:
    """At depth 10^4, z^2 has an ulp of 8 in float32; of a variance of 1e-3 nothing would be left."""
    z = 1e4 + np.array([-1.0, 1.0]) * np.sqrt(1e-3)
    near, far = 1e4 - 1.0, 1e4 + 1.0
    share = lit_shares([z], np.array([1e4 + 0.1]), chebyshev_of(near, far, min_variance=1e-12), device)
    assert share[0] == pytest.approx(1e-3 / (1e-3 + 0.1**2), rel=2e-3)


@wp.kernel
def run_bilinear(
    first: int, image: wp.array3d(dtype=wp.vec2), at: wp.array(dtype=wp.vec2), value_out: wp.array(dtype=wp.vec2)
):
    i = first + wp.tid()
    value_out[i] = sample_bilinear(image, 1, at[i][0], at[i][1])


def test_bilinear_lookup_agrees_with_numpy(device: str) -> None:
    rng = np.random.default_rng(2)
    image = rng.random((2, 9, 9, 2)).astype(np.float32)
    at = rng.uniform(0.0, 9.0, (200, 2)).astype(np.float32)
    out = wp.zeros(200, dtype=wp.vec2, device=device)
    inputs = [wp.array(image, dtype=wp.vec2, device=device), wp.array(at, dtype=wp.vec2, device=device)]
    launch(run_bilinear, 200, inputs, [out], device=device)
    corner = np.floor(at - 0.5).astype(int)
    f = at - 0.5 - corner
    (x0, y0), (x1, y1) = np.clip(corner, 0, 8).T, np.clip(corner + 1, 0, 8).T
    upper = image[1, y0, x0] * (1 - f[:, :1]) + image[1, y0, x1] * f[:, :1]
    lower = image[1, y1, x0] * (1 - f[:, :1]) + image[1, y1, x1] * f[:, :1]
    np.testing.assert_allclose(out.numpy(), upper * (1 - f[:, 1:]) + lower * f[:, 1:], atol=1e-6)


def test_depth_range_spans_the_box_in_front_of_the_light() -> None:
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (2.0, 3.0) for z in (-1.0, 1.0)])
    down = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 10.0], [0, 0, 0, 1.0]])
    away = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 1.0, 0, -10.0], [0, 0, 0, 1.0]])
    assert depth_range(down[None], corners) == pytest.approx((7.0, 8.0))
    assert depth_range(np.stack([down, away]), corners) == pytest.approx((0.0, 8.0))
    near, far = depth_range(away[None], corners)
    assert near == 0.0 and far > near


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


# ---- products, skips, determinism ---------------------------------------------------------------------------------------


def moving_box(lamp: Light) -> Scene:
    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.8 * frame
        return out

    box = Mesh("box", *small.box((-1.0, 1.5, 0.0), (1.5, 1.0, 1.5)), object_to_ws=pose, moving=True)
    return small.scene([small.mesh("ground", small.plane(12.0)), box], lamp)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize("lamp", [small.light("disc"), INSIDE], ids=["disc", "six faces"])
def test_products_follow_a_moving_caster(name: str, params: dict[str, Any], lamp: Light) -> None:
    scene = moving_box(lamp)
    running, plugin = session(scene), technique(name, resolution=256, **params)
    images = []
    for frame in (0, 1, 1):
        running.begin(frame)
        images.append(running.render(plugin).visibility)
        running.advance()
    fresh = session(scene)
    fresh.begin(1)
    expected = fresh.render(plugin).visibility
    assert np.nanmax(np.abs(images[0] - expected)) > 0.5
    np.testing.assert_array_equal(images[1], expected)
    np.testing.assert_array_equal(images[2], expected)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
def test_skips_and_threads_change_no_bit(name: str, params: dict[str, Any]) -> None:
    scene = small.cluttered(small.light("sphere"))
    plugin = technique(name, resolution=256, **params)
    images = []
    for options in ({}, {"skips": False}, {"threads": 1}, {"threads": 2}):
        running = session(scene, **options)
        for frame in (0, 1):
            running.begin(frame)
            result = running.render(plugin)
            running.advance()
        images.append(result.visibility)
        built = {label for label, _ in result.passes}
        kept = {what for what, _, _ in result.left_out}
        assert ("light depth map" in built) == ("light depth map" not in kept) == (options == {"skips": False})
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_vsm_keeps_its_filtered_moments_and_skips_an_empty_blur() -> None:
    scene = small.box_on_ground(small.light("rectangle"))
    for params, products in (
        ({"taps": 5}, {"moments", "blur of moments"}),
        ({"width": "pcss"}, {"moments", "summed-area tables", "nearest blocker"}),
    ):
        running = session(scene)
        for frame in (0, 1):
            running.begin(frame)
            result = running.render(technique("vsm", resolution=64, **params))
            running.advance()
        assert products <= {what for what, _, _ in result.left_out}
        assert not products & {label for label, _ in result.passes}
    one = session(scene).render(technique("vsm", taps=1))
    assert ("blur of moments", "its kernel has one tap", 1) in one.left_out
    full = session(scene, skips=False).render(technique("vsm", taps=1))
    np.testing.assert_array_equal(one.visibility, full.visibility)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize("skips", [True, False])
def test_nothing_casts_and_all_is_lit(name: str, params: dict[str, Any], skips: bool) -> None:
    scene = small.scene([small.mesh("ground", small.plane(12.0), casts=False)], small.light("rectangle"))
    result = session(scene, skips=skips).render(technique(name, **params))
    seen = result.visibility[~np.isnan(result.visibility)]
    assert len(seen) > 500 and (seen == 1.0).all()
    assert any("light depth map" in what for what, _, _ in result.left_out) == skips
