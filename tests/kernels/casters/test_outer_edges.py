"""Silhouette edges in a light's plane, against the geometry in space; feet of points against many cones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes
import warp as wp
from drawing import view_of

from wkernels.casters.outer_edges import (
    LightPlane,
    OuterEdges,
    bin_edges,
    from_light_plane,
    light_plane,
    light_radius,
    nearest_outside,
    pixel_to_plane,
    plane_of_view,
    to_light_plane,
)
from wkernels.casters.silhouettes import Silhouettes
from wkernels.device.launch import launch
from wkernels.projections.light_views import fit_scene
from wkernels.raster.binning import Binner
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView, ProjectiveView, eye_view
from wkernels.workspace.workspace import Workspace

LIGHTS = {"point": np.array((1.0, 8.0, 2.0, 1.0)), "direction": np.array((0.36, 0.8, 0.48, 0.0))}
DOWN = np.array((0.0, -1.0, 0.0))


@wp.kernel
def there_and_back(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    plane: LightPlane,
    there_out: wp.array(dtype=wp.vec3),
    back_out: wp.array(dtype=wp.vec3),
):
    i = first + wp.tid()
    p = to_light_plane(plane, points_ws[i])
    depth = p[2]
    if plane.light_ws[3] > 0.0:
        depth = -1.0 / p[2]
    there_out[i] = p
    back_out[i] = from_light_plane(plane, p[0], p[1], depth)


@wp.kernel
def find_nearest(
    first: int,
    points: wp.array(dtype=wp.vec2),
    edges: OuterEdges,
    found_out: wp.array2d(dtype=wp.vec2),
):
    i = first + wp.tid()
    for edge in range(found_out.shape[1]):
        found_out[i, edge] = nearest_outside(edges.line[edge], edges.ramp[edge], points[i][0], points[i][1])


def shadow_on(light: np.ndarray, axis: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Where the light throws points onto the plane through 0 across an axis."""
    way = points * light[3] - light[:3]
    if light[3] == 0.0:
        way = np.broadcast_to(way, points.shape)
    return points - way * ((points @ axis) / (way @ axis))[:, None]


@pytest.mark.parametrize("kind", LIGHTS)
def test_what_is_on_one_ray_has_one_place(kind: str, device: str) -> None:
    """Coordinates are those of the shadow on a plane across the axis, whatever the angle of the light to it."""
    light = LIGHTS[kind]
    points = np.random.default_rng(1).uniform((-3, 0.2, -3), (3, 5, 3), (50, 3))
    height = light[1] if light[3] else 0.0
    plane = light_plane(light, DOWN, float(height))
    shadows = shadow_on(light, DOWN, points)
    there = [np.zeros((50, 3)), np.zeros((50, 3))]
    for k, places in enumerate((points, shadows)):
        given = wp.array(places.astype(np.float32), dtype=wp.vec3, device=device)
        out = [wp.zeros(50, dtype=wp.vec3, device=device) for _ in range(2)]
        launch(there_and_back, 50, [given, plane], out, device=device)
        there[k] = out[0].numpy()
        np.testing.assert_allclose(out[1].numpy(), places, atol=2e-5)
    np.testing.assert_allclose(there[0][:, :2], there[1][:, :2], atol=1e-5)
    depth = height - points[:, 1]
    np.testing.assert_allclose(there[0][:, 2], -1.0 / depth if light[3] else depth, rtol=1e-5)
    axes = np.array([plane.right_ws, plane.up_ws])
    foot = light[:3] - np.array((0.0, height, 0.0)) if light[3] else np.zeros(3)
    expected = (shadows - foot) @ axes.T / (height if light[3] else 1.0)
    np.testing.assert_allclose(there[1][:, :2], expected, atol=1e-5)
    assert np.cross(plane.right_ws, plane.up_ws) @ DOWN < -0.999


def silhouettes_of(ends: np.ndarray) -> Silhouettes:
    count = len(ends)
    zero = np.zeros(count, np.int32)
    return Silhouettes(np.zeros(0, np.int8), ends.astype(np.int32), zero + 1, zero, zero)


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("radius", [0.1, 1.0, 5.0])
def test_feet_are_where_the_nearest_cone_stands(kind: str, radius: float, device: str) -> None:
    """The least key at which a point is in a cone, by many points of the edge; and shares of the way across the patch."""
    rng = np.random.default_rng(7)
    light = LIGHTS[kind]
    plane = light_plane(light, DOWN, float(light[1] if light[3] else 0.0))
    corners = rng.uniform((-2, 1.0, -2), (2, 4.0, 2), (40, 3))
    corners[20:22] = corners[0]  # an edge without a length
    ends = np.arange(40).reshape(-1, 2)
    far = float(light[1] if light[3] else 0.0)
    work = Workspace(device, 2)
    points_ws = wp.array(corners.astype(np.float32), dtype=wp.vec3, device=device)
    view = view_of(True, 32, 32).to_device()
    depths = (0.01 if light[3] else -1e30, far)
    bins = bin_edges(work, Binner(device, 2), points_ws, silhouettes_of(ends), plane, depths, radius, view)
    share = np.linspace(0.0, 1.0, 4001)
    along = corners[ends[:, 0], None] + share[:, None] * (corners[ends[:, 1]] - corners[ends[:, 0]])[:, None]
    flat = shadow_on(light, DOWN, along.reshape(-1, 3)).reshape(along.shape)
    axes = np.array([plane.right_ws, plane.up_ws])
    foot = light[:3] - np.array((0.0, light[1], 0.0)) if light[3] else np.zeros(3)
    scale = light[1] if light[3] else 1.0
    track = (flat - foot) @ axes.T / scale  # (edges, steps, 2)
    depth = (light[1] if light[3] else 0.0) - along[..., 1]
    keys = -1.0 / depth if light[3] else depth
    key_far = -1.0 / far if light[3] else far
    owner, step = rng.integers(0, len(ends), 300), rng.integers(0, len(share), 300)
    wide = radius * (key_far - keys[owner, step])
    places = track[owner, step] + 1.5 * wide[:, None] * rng.uniform(-1.0, 1.0, (300, 2))
    found = wp.zeros((300, len(ends)), dtype=wp.vec2, device=device)
    given = wp.array(places.astype(np.float32), dtype=wp.vec2, device=device)
    launch(find_nearest, 300, [given, bins.edges], [found], device=device)
    checked = patches = 0
    for edge in range(len(ends)):
        distance = np.linalg.norm(places[:, None] - track[edge], axis=2)
        way = track[edge, -1] - track[edge, 0]
        side = (places[:, 0] - track[edge, 0, 0]) * way[1] - (places[:, 1] - track[edge, 0, 1]) * way[0]
        got = found.numpy()[:, edge].astype(float)
        if np.linalg.norm(way) > 1e-6:
            clear = np.abs(side) > 1e-5
            np.testing.assert_array_equal(np.isfinite(got[clear, 0]), side[clear] > 0.0)
        outside = np.isfinite(got[:, 0])
        first = (keys[edge] + distance / radius).min(axis=1)
        own = got[:, 1] + got[:, 0] / radius
        seen = outside & (first < key_far)  # what is beyond all cones does not matter
        if abs(keys[edge, -1] - keys[edge, 0]) * radius > 0.99 * np.linalg.norm(way):
            # one end's cone holds the others; beside the edge it is still the edge that counts
            assert (own[seen] > first[seen] - 2e-4 / min(radius, 1.0)).all()
            continue
        steps = 2e-4 / min(radius, 1.0)  # between points of the edge that were tried, in radii
        np.testing.assert_allclose(own[seen], first[seen], atol=steps)
        checked += int(seen.sum())
        # the patch between the cones' circles at the farthest key and the edge, which is ruled by straight lines
        begin, end = track[edge, 0], track[edge, -1]
        wide = radius * (key_far - keys[edge, [0, -1]])
        length = np.linalg.norm(end - begin)
        if length < 1e-3 or abs(wide[1] - wide[0]) > 0.99 * length:
            continue
        lean = (wide[0] - wide[1]) / length
        unit = (end - begin) / length
        normal = lean * unit + np.sqrt(1.0 - lean**2) * np.array((unit[1], -unit[0]))
        u, v = (grid.ravel()[:, None] for grid in np.meshgrid(np.linspace(0.05, 0.95, 9), np.linspace(0.1, 0.9, 9)))
        tangent = begin + wide[0] * normal + u * (end - begin + (wide[1] - wide[0]) * normal)
        patch = (1.0 - v) * (begin + u * (end - begin)) + v * tangent
        at = wp.zeros((len(patch), len(ends)), dtype=wp.vec2, device=device)
        given = wp.array(patch.astype(np.float32), dtype=wp.vec2, device=device)
        launch(find_nearest, len(patch), [given, bins.edges], [at], device=device)
        near = at.numpy()[:, edge].astype(float)
        np.testing.assert_allclose(near[:, 0] / (radius * (key_far - near[:, 1])), v[:, 0], atol=1e-3)
        patches += 1
    assert checked > 50 and patches > (5 if radius < 5.0 else 0)


def test_edges_end_at_the_depths_that_count(device: str) -> None:
    """Parts above the light and below the receiver are none; nor are those without numbers."""
    light = LIGHTS["point"]
    plane = light_plane(light, DOWN, 8.0)
    corners = np.array(
        [(0, -2, 0), (0, 12, 1), (0, -1, 0), (1, -3, 0), (np.nan, 1, 0), (1, 1, 1), (0, 2, 0), (1, 3, 0)], float
    )
    points = wp.array(corners.astype(np.float32), dtype=wp.vec3, device=device)
    ends = np.arange(8).reshape(-1, 2)
    view = eye_view(small_scenes.camera(), 64, 48, np.zeros(3)).to_device()
    bins = bin_edges(
        Workspace(device, 2), Binner(device, 2), points, silhouettes_of(ends), plane, (0.5, 8.0), 1.0, view
    )
    ramp = bins.edges.ramp.numpy().astype(float)
    key_end = ramp[:, 1] + ramp[:, 2] * ramp[:, 0]
    np.testing.assert_allclose([ramp[0, 1], key_end[0]], [-1.0 / 8.0, -1.0 / 0.5], rtol=1e-4)
    np.testing.assert_array_equal(ramp[1:3], 0.0)
    np.testing.assert_allclose([ramp[3, 1], key_end[3]], [-1.0 / 6.0, -1.0 / 5.0], rtol=1e-5)
    assert set(bins.lists.shape.numpy()) == {0, 3}


def views() -> dict[str, tuple[np.ndarray, HostView]]:
    """Light maps' views: of a point, of a direction, and warped."""
    box = Bounds()
    box.add(np.array([(-4.0, 0.0, -4.0), (4.0, 3.0, 4.0)]))
    eye = eye_view(small_scenes.camera(), 64, 48, np.zeros(3))
    out = {kind: (light, fit_scene(light, box, box, 96, eye)[0]) for kind, light in LIGHTS.items()}
    light, view = out["point"]
    warp = np.eye(4)
    warp[3, 1], warp[1, 3] = 0.2, 0.1  # w gets a share of y
    rows = view.ws_to_ss.copy()
    rows[[0, 1, 3]] = np.delete(np.delete(warp, 2, 0), 2, 1) @ rows[[0, 1, 3]]
    kept = {name: getattr(view, name) for name in HostView.__dataclass_fields__}
    return out | {"warped": (light, ProjectiveView(**kept, rows=rows))}


@pytest.mark.parametrize("name", ["point", "direction", "warped"])
def test_texels_know_their_place_in_the_plane(name: str, device: str) -> None:
    light, view = views()[name]
    points = np.random.default_rng(3).uniform((-3, 0, -3), (3, 3, 3), (60, 3))
    h = np.column_stack([points, np.ones(60)]) @ view.ws_to_ss.T
    pixels = np.stack([(0.5 + 0.5 * h[:, 0] / h[:, 3]) * view.width, (0.5 - 0.5 * h[:, 1] / h[:, 3]) * view.height], 1)
    plane = plane_of_view(light, view)
    place = np.column_stack([pixels, np.ones(60)]) @ pixel_to_plane(light, view, plane).T
    out = [wp.zeros(60, dtype=wp.vec3, device=device) for _ in range(2)]
    launch(there_and_back, 60, [wp.array(points, dtype=wp.vec3, device=device), plane], out, device=device)
    np.testing.assert_allclose(place[:, :2] / place[:, 2:], out[0].numpy()[:, :2], atol=2e-5)


def test_radius_of_a_light() -> None:
    assert light_radius(small_scenes.light("sphere", size=3.0)) == 1.5
    assert light_radius(small_scenes.light("rectangle", size=3.0)) == 1.5
    sun = replace(small_scenes.light("directional"), angle_deg=60.0)
    assert light_radius(sun) == pytest.approx(np.tan(np.radians(30.0)))
