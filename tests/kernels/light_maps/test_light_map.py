"""Light depth maps: where points fall, what is stored, how planes are predicted, what a comparison says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes
import warp as wp
from compare import assert_twin
from light_map_probe import LIGHTS, cluttered_session, compare, host_locate, locate_all, make_bias, planes_all, upload

from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import BIAS_SLOPE, depths_on_host
from wkernels.scene.geometry import Geometry


@pytest.mark.parametrize("kind", LIGHTS)
def test_points_are_found_where_the_views_put_them(kind: str, device: str) -> None:
    session, views = cluttered_session(kind, device)
    light_map = session.light_map(48).map
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
        ahead, behind = (
            host_locate(views, points + step * moved, 48)[0],
            host_locate(views, points - step * moved, 48)[0],
        )
        slope = np.abs(ahead - behind)[np.arange(4000), best, index] / (2.0 * step)
        assert_twin(density.numpy()[held, index], slope[held], rtol=2e-4)


@pytest.mark.parametrize("kind", LIGHTS)
def test_texels_hold_the_depth_of_what_the_light_sees(kind: str, device: str) -> None:
    session, views = cluttered_session(kind, device)
    light_map = session.light_map(48).map
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
        got = depths_on_host(light_map)[layer]
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
    light_map = session.light_map(resolution).map
    rng = np.random.default_rng(1)
    box = session.geometry.bounds(receivers=True)
    points = rng.uniform(box.low, box.high, (4 * count, 3)).astype(np.float32).astype(float)
    held = host_locate(views, points, resolution)[2].max(axis=1) > 1e-4
    points = points[held][:count]
    assert len(points) == count
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
            base, along = (
                (view.eye_ws, view.forward_ws + across) if view.perspective else (view.eye_ws + across, view.forward_ws)
            )
            expected = normal[i] @ (points[i] - base) / (normal[i] @ along)
            if scale_row[i] @ offset > 0.2 and expected > 0.0:  # else the offset runs along or past the plane's horizon
                assert predicted[i] == pytest.approx(expected, rel=3e-4, abs=3e-5)
                checked += 1
    assert checked > 800


def test_a_plane_seen_edge_on_predicts_its_own_depth(device: str) -> None:
    session, _ = cluttered_session("directional", device)
    light_map = session.light_map(48).map
    direction = session.light.centre[:3]
    normal = np.cross(direction, [1.0, 0.0, 0.0])
    rows = [wp.zeros(1, dtype=wp.vec3, device=device) for _ in range(2)]
    inputs = [light_map, upload(np.zeros((1, 3)), device), upload((normal / np.linalg.norm(normal))[None], device)]
    launch(planes_all, 1, inputs, rows, device=device)
    depth_row, scale_row = (row.numpy()[0] for row in rows)
    assert (depth_row[:2] == 0.0).all() and depth_row[2] > 0.0
    np.testing.assert_array_equal(scale_row, (0.0, 0.0, 1.0))


# ---- comparisons ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", LIGHTS)
def test_bilinear_is_the_weighted_mean_of_four_comparisons(kind: str, device: str) -> None:
    session, _ = cluttered_session(kind, device)
    light_map = session.light_map(48).map
    rng = np.random.default_rng(2)
    box = session.geometry.bounds(receivers=True)
    points = rng.uniform(box.low, box.high, (3000, 3))
    normals = np.tile([0.0, 1.0, 0.0], (3000, 1))
    offsets = rng.uniform(-6.0, 6.0, (3000, 2))
    got = compare(light_map, make_bias(BIAS_SLOPE), points, normals, device, offsets)
    held = got["receiver"][:, 3] >= 0
    assert held.mean() > 0.5
    lit = (got["predicted"] <= np.abs(got["stored"])).astype(float)
    position = got["receiver"][:, :2].astype(float) + offsets.astype(np.float32) - 0.5
    fx, fy = (position - np.floor(position)).T
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    expected = (lit * weights).sum(axis=1)
    assert_twin(got["bilinear"][held], expected[held], atol=2e-5)
    assert ((expected[held] > 0.05) & (expected[held] < 0.95)).any()
    assert np.isposinf(got["stored"][held]).any(), "some taps must leave the map, where everything is lit"
    column, row = np.floor(got["receiver"][:, :2]).astype(int).T
    texel = depths_on_host(light_map)[got["receiver"][:, 3].astype(int)[held], row[held], column[held]]
    np.testing.assert_array_equal(got["nearest"][held], got["receiver"][held, 2] <= texel)


@pytest.mark.parametrize("kind", LIGHTS)
def test_comparisons_agree_with_shadow_rays(kind: str, device: str) -> None:
    """Points well inside a surface's lit or dark part."""
    session, _ = cluttered_session(kind, device)
    light_map = session.light_map(1024).map
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
    light_map = session.light_map(16).map
    points = np.array([(500.0, 0.0, 0.0), (2.0, 50.0, -1.0), (0.0, 0.0, 0.0)]) - session.geometry.origin_ws
    got = compare(light_map, make_bias(BIAS_SLOPE), points, np.tile([0.0, 1.0, 0.0], (3, 1)), device)
    np.testing.assert_array_equal(got["receiver"][:, 3], [-1, -1, 0])


def test_moving_casters_are_tagged_by_sign_only(device: str) -> None:
    scene = small_scenes.box_on_ground(LIGHTS["perspective"])
    ground, box = scene.meshes
    ground, box = replace(ground, casts=True), replace(box, moving=True)
    session = Session(Geometry(replace(scene, meshes=(ground, box)), device), width=8, height=8, device=device)
    plain = depths_on_host(session.light_map(64).map)
    tagged = depths_on_host(session.light_map(64, tag_moving_casters=True).map)
    np.testing.assert_array_equal(np.abs(tagged), plain)
    still = session.geometry.meshes.index(ground)
    assert still == 0
    without = Session(
        Geometry(replace(scene, meshes=(ground, replace(box, casts=False))), device), width=8, height=8, device=device
    )
    ground_only = without.light_map(
        64, session.light.centre + np.append(session.geometry.origin_ws - without.geometry.origin_ws, 0)
    ).map
    assert 0.01 < (tagged < 0.0).mean() < 0.9
    nearer = plain < depths_on_host(ground_only) - 0.05
    assert ((tagged < 0.0) == nearer).mean() > 0.97
    assert not (np.isposinf(plain) & (tagged < 0.0)).any()
