"""Light depth maps: where points fall, what is stored, how planes are predicted, and what each bias does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes
import warp as wp
from compare import assert_twin

from wkernels.frame import Session
from wkernels.geometry import Geometry
from wkernels.launch import launch
from wkernels.light_map import (
    BIAS_CONSTANT,
    BIAS_NONE,
    BIAS_NORMAL,
    BIAS_SLOPE,
    Bias,
    LightMap,
    compare_bilinear,
    compare_nearest,
    locate,
    locate_receiver,
    plane_of_receiver,
    receiver_depth_at,
    stored_depth,
    texels_per_length,
)
from wkernels.light_views import scene_views
from wkernels.lights import DirectionalLight, PointLight
from wkernels.scene import Mesh
from wkernels.views import HostView

LIGHTS = {
    "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2])),
    "perspective": PointLight(position=np.array([2.0, 9.0, -1.0])),
    "six faces": PointLight(position=np.array([0.2, 1.1, 0.3])),
}


@wp.kernel
def locate_all(
    first: int,
    light_map: LightMap,
    position_ws: wp.array(dtype=wp.vec3),
    found_out: wp.array(dtype=wp.vec4),
    density_out: wp.array(dtype=wp.vec2),
):
    i = first + wp.tid()
    found = locate(light_map, position_ws[i])
    found_out[i] = found
    if found[3] >= 0.0:
        density_out[i] = texels_per_length(light_map, int(found[3]), position_ws[i])


@wp.kernel
def planes_all(
    first: int,
    light_map: LightMap,
    position_ws: wp.array(dtype=wp.vec3),
    normal_ws: wp.array(dtype=wp.vec3),
    depth_row_out: wp.array(dtype=wp.vec3),
    scale_row_out: wp.array(dtype=wp.vec3),
):
    i = first + wp.tid()
    found = locate(light_map, position_ws[i])
    depth_row, scale_row = plane_of_receiver(light_map, int(found[3]), position_ws[i], normal_ws[i])
    depth_row_out[i] = depth_row
    scale_row_out[i] = scale_row


@wp.kernel
def compare_all(
    first: int,
    light_map: LightMap,
    bias: Bias,
    position_ws: wp.array(dtype=wp.vec3),
    normal_ws: wp.array(dtype=wp.vec3),
    offset: wp.array(dtype=wp.vec2),
    receiver_out: wp.array(dtype=wp.vec4),
    nearest_out: wp.array(dtype=float),
    bilinear_out: wp.array(dtype=float),
    stored_out: wp.array(dtype=wp.vec4),
    predicted_out: wp.array(dtype=wp.vec4),
):
    i = first + wp.tid()
    receiver = locate_receiver(light_map, bias, position_ws[i], normal_ws[i])
    receiver_out[i] = wp.vec4(receiver.x, receiver.y, receiver.depth, float(receiver.layer))
    if receiver.layer < 0:
        return
    nearest_out[i] = compare_nearest(light_map, receiver)
    bilinear_out[i] = compare_bilinear(light_map, receiver, offset[i][0], offset[i][1])
    x = receiver.x + offset[i][0] - 0.5
    y = receiver.y + offset[i][1] - 0.5
    stored = wp.vec4()
    predicted = wp.vec4()
    for k in range(4):
        column = int(wp.floor(x)) + k % 2
        row = int(wp.floor(y)) + k / 2
        stored[k] = stored_depth(light_map, receiver.layer, column, row)
        predicted[k] = receiver_depth_at(receiver, float(column) + 0.5 - receiver.x, float(row) + 0.5 - receiver.y)
    stored_out[i] = stored
    predicted_out[i] = predicted


def make_bias(kind: int, constant: float = 1.0, slope: float = 1.1) -> Bias:
    out = Bias()
    out.kind, out.constant, out.slope = kind, constant, slope
    return out


def make_session(meshes: list[Mesh], lamp: DirectionalLight | PointLight, device: str) -> Session:
    return Session(Geometry(small_scenes.scene(meshes, lamp), device), width=8, height=8, device=device)


def cluttered_session(kind: str, device: str) -> tuple[Session, list[HostView]]:
    scene = small_scenes.cluttered(LIGHTS[kind])  # type: ignore[arg-type]
    session = Session(Geometry(scene, device), width=8, height=8, device=device)
    box = session.geometry.bounds(receivers=True)
    return session, scene_views(session.light.centre, box, session.geometry.bounds(casters=True), 48)


def upload(values: np.ndarray, device: str) -> wp.array:
    dtype = wp.vec3 if values.shape[1] == 3 else wp.vec2
    return wp.array(values.astype(np.float32), dtype=dtype, device=device)


def host_locate(views: list[HostView], points: np.ndarray, resolution: int) -> tuple[np.ndarray, ...]:
    """Texel positions (N, layers, 2), depth and centrality (N, layers), from the definitions, float64."""
    xy, depth, inside = [], [], []
    for view in views:
        h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            ndc = h[:, :2] / h[:, 3:]
        xy.append((0.5 + 0.5 * ndc * np.array([1.0, -1.0])) * resolution)
        depth.append(h[:, 2])
        inside.append(np.where(h[:, 3] > 0.0, 1.0 - np.abs(ndc).max(axis=1), -np.inf))
    return np.stack(xy, axis=1), np.stack(depth, axis=1), np.stack(inside, axis=1)


@pytest.mark.parametrize("kind", LIGHTS)
def test_points_are_found_where_the_views_put_them(kind: str, device: str) -> None:
    session, views = cluttered_session(kind, device)
    light_map = session.light_map(48)
    assert light_map.layers == len(views) == (6 if kind == "six faces" else 1)
    box = session.geometry.bounds(receivers=True)
    points = np.random.default_rng(0).uniform(box.low - 1.0, box.high + 1.0, (4000, 3))
    found, density = wp.zeros(4000, dtype=wp.vec4, device=device), wp.zeros(4000, dtype=wp.vec2, device=device)
    launch(locate_all, 4000, [light_map, upload(points, device)], [found, density], device=device)
    got = found.numpy().astype(float)
    xy, depth, inside = host_locate(views, points, 48)
    best = inside.argmax(axis=1)
    clear = np.abs(inside).min(axis=1) > 1e-4  # on the rim of a layer either answer will do
    layer = np.where(inside.max(axis=1) >= 0.0, best, -1)
    second = np.sort(inside, axis=1)[:, -2] if len(views) > 1 else np.full(4000, -9.0)
    clear &= inside.max(axis=1) - second > 1e-4
    assert clear.mean() > 0.99 and len(np.unique(layer[layer >= 0])) == len(views)
    assert (layer == -1).any() or kind == "six faces"
    np.testing.assert_array_equal(got[clear, 3], layer[clear])
    held = clear & (layer >= 0)
    rows = np.flatnonzero(held)
    assert_twin(got[held, :2], xy[rows, best[held]], atol=2e-4)
    assert_twin(got[held, 2], depth[rows, best[held]], atol=1e-5)

    step = 1e-4
    for axis, index in (("right_ws", 0), ("up_ws", 1)):
        moved = np.stack([getattr(view, axis) for view in views])[best]
        ahead, behind = host_locate(views, points + step * moved, 48)[0], host_locate(views, points - step * moved, 48)[0]
        slope = np.abs(ahead - behind)[np.arange(4000), best, index] / (2.0 * step)
        assert_twin(density.numpy()[held, index], slope[held], rtol=2e-4)


@pytest.mark.parametrize("kind", LIGHTS)
def test_texels_hold_the_depth_of_what_the_light_sees(kind: str, device: str) -> None:
    session, views = cluttered_session(kind, device)
    light_map = session.light_map(48)
    geometry = session.geometry
    corners = geometry.points_ws.numpy().astype(float)[geometry.indices.numpy().reshape(-1, 3)]
    pixels = (np.arange(48) + 0.5) / 48
    for layer, view in enumerate(views):
        left, right, bottom, top = view.window
        x, y = np.meshgrid(left + (right - left) * pixels, top + (bottom - top) * pixels)
        across = x.ravel()[:, None] * view.right_ws + y.ravel()[:, None] * view.up_ws
        if view.perspective:
            origin, along = np.broadcast_to(view.eye_ws, across.shape), across + view.forward_ws
        else:
            origin, along = view.eye_ws + across, np.broadcast_to(view.forward_ws, across.shape)
        t, least = small_scenes.ray_hits(origin, along, corners)
        t = np.where(t > 0.0, t, np.inf)
        expected = t.min(axis=1).reshape(48, 48)
        near_an_edge = (np.abs(least) < 0.1).any(axis=1).reshape(48, 48)
        got = light_map.depth.numpy()[layer]
        both = np.isfinite(got) & np.isfinite(expected)
        assert (np.isfinite(got) != np.isfinite(expected)).mean() < 0.01
        assert both.mean() > 0.05
        close = np.abs(got[both] - expected[both]) <= 5e-3 * expected[both]  # a slope within 1/256 texel
        assert close.mean() > 0.98 and close[~near_an_edge[both]].mean() > 0.999


@pytest.mark.parametrize("kind", LIGHTS)
def test_planes_are_predicted_over_texel_offsets(kind: str, device: str) -> None:
    """Against where the ray of the offset texel position meets the plane, in float64."""
    session, views = cluttered_session(kind, device)
    resolution, count = 48, 400
    light_map = session.light_map(resolution)
    rng = np.random.default_rng(1)
    box = session.geometry.bounds(receivers=True)
    points = rng.uniform(box.low, box.high, (count, 3)).astype(np.float32).astype(float)
    xy, _, inside = host_locate(views, points, resolution)
    best = inside.argmax(axis=1)
    light = session.light.centre
    to_light = light[:3] - points * light[3]
    to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal.astype(np.float32).astype(float)
    facing = np.abs(np.einsum("ij,ij->i", normal, to_light))
    rows = [wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(2)]
    inputs = [light_map, upload(points, device), upload(normal, device)]
    launch(planes_all, count, inputs, rows, device=device)
    depth_row, scale_row = (row.numpy().astype(float) for row in rows)
    checked = 0
    for dx, dy in ((0.0, 0.0), (0.5, 0.0), (0.0, -0.5), (1.5, 2.0), (-3.0, 1.0)):
        offset = np.array([dx, dy, 1.0])
        predicted = (depth_row @ offset) / (scale_row @ offset)
        for i in np.flatnonzero(facing > 0.15):
            view = views[best[i]]
            left, right, bottom, top = view.window
            x, y = (xy[i, best[i]] + offset[:2]) / resolution
            across = (left + (right - left) * x) * view.right_ws + (top + (bottom - top) * y) * view.up_ws
            base, along = (view.eye_ws, view.forward_ws + across) if view.perspective else (view.eye_ws + across, view.forward_ws)
            expected = normal[i] @ (points[i] - base) / (normal[i] @ along)
            if scale_row[i] @ offset > 0.2 and expected > 0.0:  # else the offset runs along or past the plane's horizon
                assert predicted[i] == pytest.approx(expected, rel=3e-4, abs=3e-5)
                checked += 1
    assert checked > 800


def test_a_plane_seen_edge_on_predicts_its_own_depth(device: str) -> None:
    session, _ = cluttered_session("directional", device)
    light_map = session.light_map(48)
    direction = session.light.centre[:3]
    normal = np.cross(direction, [1.0, 0.0, 0.0])
    rows = [wp.zeros(1, dtype=wp.vec3, device=device) for _ in range(2)]
    inputs = [light_map, upload(np.zeros((1, 3)), device), upload((normal / np.linalg.norm(normal))[None], device)]
    launch(planes_all, 1, inputs, rows, device=device)
    depth_row, scale_row = (row.numpy()[0] for row in rows)
    assert (depth_row[:2] == 0.0).all() and depth_row[2] > 0.0
    np.testing.assert_array_equal(scale_row, (0.0, 0.0, 1.0))


# ---- comparisons --------------------------------------------------------------------------------------------------------


def compare(
    light_map: LightMap, bias: Bias, points: np.ndarray, normals: np.ndarray, device: str, offsets: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    count = len(points)
    offsets = np.zeros((count, 2)) if offsets is None else offsets
    out = {
        "receiver": wp.zeros(count, dtype=wp.vec4, device=device),
        "nearest": wp.full(count, -1.0, dtype=float, device=device),
        "bilinear": wp.full(count, -1.0, dtype=float, device=device),
        "stored": wp.zeros(count, dtype=wp.vec4, device=device),
        "predicted": wp.zeros(count, dtype=wp.vec4, device=device),
    }
    inputs = [light_map, bias, upload(points, device), upload(normals, device), upload(offsets, device)]
    launch(compare_all, count, inputs, list(out.values()), device=device)
    return {name: array.numpy().copy() for name, array in out.items()}


@pytest.mark.parametrize("kind", LIGHTS)
def test_bilinear_is_the_weighted_mean_of_four_comparisons(kind: str, device: str) -> None:
    session, _ = cluttered_session(kind, device)
    light_map = session.light_map(48)
    rng = np.random.default_rng(2)
    box = session.geometry.bounds(receivers=True)
    points = rng.uniform(box.low, box.high, (3000, 3))
    normals = np.tile([0.0, 1.0, 0.0], (3000, 1))
    offsets = rng.uniform(-6.0, 6.0, (3000, 2))
    got = compare(light_map, make_bias(BIAS_SLOPE), points, normals, device, offsets)
    held = got["receiver"][:, 3] >= 0
    assert held.mean() > 0.9
    lit = (got["predicted"] <= np.abs(got["stored"])).astype(float)
    position = got["receiver"][:, :2].astype(float) + offsets.astype(np.float32) - 0.5
    fx, fy = (position - np.floor(position)).T
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    expected = (lit * weights).sum(axis=1)
    assert_twin(got["bilinear"][held], expected[held], atol=2e-5)
    assert ((expected[held] > 0.05) & (expected[held] < 0.95)).any()
    assert np.isposinf(got["stored"][held]).any(), "some taps must leave the map, where everything is lit"
    column, row = np.floor(got["receiver"][:, :2]).astype(int).T
    texel = light_map.depth.numpy()[got["receiver"][:, 3].astype(int)[held], row[held], column[held]]
    np.testing.assert_array_equal(got["nearest"][held], got["receiver"][held, 2] <= texel)


@pytest.mark.parametrize("kind", LIGHTS)
def test_comparisons_agree_with_shadow_rays(kind: str, device: str) -> None:
    """Points well inside a surface's lit or dark part."""
    session, _ = cluttered_session(kind, device)
    light_map = session.light_map(1024)
    geometry = session.geometry
    corners = geometry.points_ws.numpy().astype(float)[geometry.indices.numpy().reshape(-1, 3)]
    rng = np.random.default_rng(3)
    which = rng.integers(0, len(corners), 2000)
    weights = rng.dirichlet((1.0, 1.0, 1.0), 2000)
    points = np.einsum("ij,ijk->ik", weights, corners[which])
    normals = geometry.triangle_normal_ws.numpy()[which].astype(float)
    light = session.light.centre
    to_light = light[:3] - points * light[3]
    reach = np.where(light[3] > 0.0, 1.0, 1e3)
    facing = np.einsum("ij,ij->i", normals, to_light) > 0.1 * np.linalg.norm(to_light, axis=1)
    t, _ = small_scenes.ray_hits(points + 1e-6 * normals, to_light, corners)
    lit = ~((t > 0.0) & (t < reach)).any(axis=1)
    got = compare(light_map, make_bias(BIAS_SLOPE), points, normals, device)
    held = facing & (got["receiver"][:, 3] >= 0)
    assert held.mean() > 0.2 and 0.1 < lit[held].mean() < 0.98
    assert (got["nearest"][held] == lit[held]).mean() > 0.985


def test_points_outside_every_layer_have_no_receiver(device: str) -> None:
    session, _ = cluttered_session("perspective", device)
    light_map = session.light_map(16)
    points = np.array([(500.0, 0.0, 0.0), (2.0, 50.0, -1.0), (0.0, 0.0, 0.0)]) - session.geometry.origin_ws
    got = compare(light_map, make_bias(BIAS_SLOPE), points, np.tile([0.0, 1.0, 0.0], (3, 1)), device)
    np.testing.assert_array_equal(got["receiver"][:, 3], [-1, -1, 0])


# ---- bias ---------------------------------------------------------------------------------------------------------------

TILTS = [(0.0, 0.0), (15.0, 40.0), (40.0, 0.0), (60.0, 77.0), (75.0, 200.0), (84.0, 110.0)]


def tilted_plane(tilt_deg: float, turn_deg: float) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """Catalogue scene A9: a square turned away from straight up, points on it, and its normal."""
    tilt, turn = np.radians([tilt_deg, turn_deg])
    normal = np.array([np.sin(tilt) * np.cos(turn), np.cos(tilt), np.sin(tilt) * np.sin(turn)])
    e_u = np.cross(normal, [0.3, 0.1, 1.0])
    e_u /= np.linalg.norm(e_u)
    e_v = np.cross(normal, e_u)
    vertices, faces = small_scenes.plane(8.0)
    vertices = vertices[:, :1] * e_u + vertices[:, 2:] * e_v
    st = np.random.default_rng(4).uniform(-3.9, 3.9, (6000, 2))
    return small_scenes.mesh("plane", (vertices, faces)), st[:, :1] * e_u + st[:, 1:] * e_v, normal


@pytest.mark.parametrize("light", ["directional", "perspective"])
@pytest.mark.parametrize("resolution", [16, 200, 1024])
@pytest.mark.parametrize(("tilt", "turn"), TILTS)
def test_slope_bias_leaves_no_acne_where_no_bias_does(
    tilt: float, turn: float, resolution: int, light: str, device: str
) -> None:
    plane, points, normal = tilted_plane(tilt, turn)
    lamp = DirectionalLight(direction=np.array([0.05, -1.0, 0.02]))
    session = make_session([plane], lamp if light == "directional" else PointLight(position=np.array([1.0, 30.0, -2.0])), device)
    light_map = session.light_map(resolution)
    normals = np.tile(normal, (len(points), 1))
    points = points - session.geometry.origin_ws

    def dark(bias: Bias) -> float:
        return float((compare(light_map, bias, points, normals, device)["nearest"] == 0.0).mean())

    assert dark(make_bias(BIAS_SLOPE, slope=1.1)) == 0.0
    assert dark(make_bias(BIAS_NONE)) > 0.05
    if tilt > 30.0:
        assert dark(make_bias(BIAS_SLOPE, slope=0.5)) > 0.02, "the least bias must be just about needed"


@pytest.mark.parametrize("kind", [BIAS_CONSTANT, BIAS_NORMAL])
def test_large_constant_and_normal_biases_clear_a_moderate_tilt(kind: int, device: str) -> None:
    plane, points, normal = tilted_plane(40.0, 25.0)
    session = make_session([plane], DirectionalLight(direction=np.array([0.0, -1.0, 0.0])), device)
    light_map = session.light_map(128)
    normals = np.tile(normal, (len(points), 1))
    points = points - session.geometry.origin_ws
    inside = np.abs(points).max(axis=1) < 2.5
    assert (compare(light_map, make_bias(kind, 4.0), points, normals, device)["nearest"][inside] == 1.0).all()
    assert (compare(light_map, make_bias(kind, 0.1), points, normals, device)["nearest"][inside] == 0.0).any()


@pytest.mark.parametrize("elevation_deg", [30.0, 45.0, 65.0])
@pytest.mark.parametrize("footprints", [40.0, 80.0])
def test_a_constant_bias_opens_a_gap_at_a_wall(elevation_deg: float, footprints: float, device: str) -> None:
    """Stingl 2011, section 2.2.1: b / tan(elevation) for a bias that lifts the receiver by b; along the light b sin of that."""
    elevation = np.radians(elevation_deg)
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)
    corners = np.array([(0.0, 0.0, -4.0), (0.0, 0.0, 4.0), (0.0, 3.0, 4.0), (0.0, 3.0, -4.0)])
    wall = small_scenes.mesh("wall", (corners, np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32)), receives=False)
    lamp = DirectionalLight(direction=np.array([np.cos(elevation), -np.sin(elevation), 0.0]))
    session = make_session([ground, wall], lamp, device)
    light_map = session.light_map(1024)
    x = np.linspace(0.002, 5.9, 6000)
    points = np.stack([x, np.zeros_like(x), np.full_like(x, 0.1)], axis=1) - session.geometry.origin_ws
    normals = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    found, density = wp.zeros(len(x), dtype=wp.vec4, device=device), wp.zeros(len(x), dtype=wp.vec2, device=device)
    launch(locate_all, len(x), [light_map, upload(points, device)], [found, density], device=device)
    footprint = 1.0 / float(density.numpy().min(axis=1)[0])
    dark = compare(light_map, make_bias(BIAS_CONSTANT, footprints), points, normals, device)["nearest"] == 0.0
    texel_on_ground = 2.0 * footprint / np.sin(elevation)
    depth_bias = footprints * footprint
    assert x[dark].min() == pytest.approx(depth_bias * np.cos(elevation), abs=texel_on_ground)
    assert x[dark].min() == pytest.approx((depth_bias * np.sin(elevation)) / np.tan(elevation), abs=texel_on_ground)
    assert x[dark].max() == pytest.approx(3.0 / np.tan(elevation), abs=texel_on_ground)
    no_gap = compare(light_map, make_bias(BIAS_SLOPE), points, normals, device)["nearest"] == 0.0
    assert x[no_gap].min() < texel_on_ground


def test_moving_casters_are_tagged_by_sign_only(device: str) -> None:
    scene = small_scenes.box_on_ground(LIGHTS["perspective"])
    ground, box = scene.meshes
    ground, box = replace(ground, casts=True), replace(box, moving=True)
    session = Session(Geometry(replace(scene, meshes=(ground, box)), device), width=8, height=8, device=device)
    plain = session.light_map(64).depth.numpy().copy()
    tagged = session.light_map(64, tag_moving_casters=True).depth.numpy()
    np.testing.assert_array_equal(np.abs(tagged), plain)
    still = session.geometry.meshes.index(ground)
    assert still == 0
    without = Session(Geometry(replace(scene, meshes=(ground, replace(box, casts=False))), device), width=8, height=8, device=device)
    ground_only = without.light_map(64, session.light.centre + np.append(session.geometry.origin_ws - without.geometry.origin_ws, 0))
    assert 0.01 < (tagged < 0.0).mean() < 0.9
    nearer = plain < ground_only.depth.numpy() - 0.05
    assert ((tagged < 0.0) == nearer).mean() > 0.97
    assert not (np.isposinf(plain) & (tagged < 0.0)).any()
