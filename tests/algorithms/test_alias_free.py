"""Alias-free shadows against rays: the same pixels, whatever the light, the grid or the scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small

from algorithms.hard.alias_free import AliasFree
from algorithms.reference.ray_cast_point_shadow import RayCastPointShadow
from algorithms.technique import Technique
from wkernels.device.lanes import uses_lanes
from wkernels.frame.session import Session
from wkernels.irregular import hidden
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, Light, PointLight
from wkernels.scene.model import Camera, Mesh, Scene

SIZE = (160, 120)
SAME = 1e-3  # share of pixels that lie within float32's rounding of an edge

LIGHTS: dict[str, Light] = {
    "point outside": small.light("point"),
    "point low and outside": small.light("point", (7.0, 3.0, 5.0)),
    "point inside": PointLight(position=np.array([0.2, 3.2, 1.5])),
    "point near the ground": PointLight(position=np.array([-2.3, 0.9, 2.1])),
    "directional": small.light("directional"),
    "directional, low": DirectionalLight(direction=np.array([1.0, -0.15, 0.3])),
    "rectangle": small.light("rectangle", (2.0, 8.0, 1.0)),
    "sphere": small.light("sphere", (-3.0, 9.0, 0.0)),
}


def visibility(
    technique: type[Technique], scene: Scene, device: str, size: tuple[int, int] = SIZE, **params: Any
) -> np.ndarray:
    session = Session(Geometry(scene, device), width=size[0], height=size[1], device=device)
    return session.render(technique(technique.Params(**params))).visibility


def share_that_differs(a: np.ndarray, b: np.ndarray) -> float:
    np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
    return float(np.mean(np.nan_to_num(a) != np.nan_to_num(b)))


def assert_like_rays(scene: Scene, device: str, *, shadows: bool = True, **params: Any) -> np.ndarray:
    """Differs from the ray cast on at most SAME of all pixels; with ``shadows`` both lit and dark ones are seen."""
    expected = visibility(RayCastPointShadow, scene, device)
    if shadows:
        assert 0.02 < np.nanmean(expected) < 0.98, "nothing to tell apart"
    actual = visibility(AliasFree, scene, device, **params)
    differs = share_that_differs(actual, expected)
    assert differs <= SAME, f"{differs:.3%} of the pixels differ"
    return actual


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("build", [small.box_on_ground, small.cluttered])
def test_shadows_are_those_of_rays(build: Callable[[Light], Scene], light: str, device: str) -> None:
    # the low lights throw the floating box's shadow off the ground
    assert_like_rays(build(LIGHTS[light]), device, shadows=build is small.cluttered)


@pytest.mark.parametrize("resolution", [1, 2, 7, 64, 1000])
@pytest.mark.parametrize("light", ["directional", "point inside"])
def test_cells_change_the_cost_only(light: str, resolution: int, device: str) -> None:
    assert_like_rays(small.cluttered(LIGHTS[light]), device, resolution=resolution)


def test_shadows_are_those_of_planes_in_double(device: str) -> None:
    """Brute force in float64, not Warp's rays: where the answer is not within rounding of an edge, it is the answer."""
    lamp = small.light("point", (1.0, 6.0, -2.0))
    ground, box = small.plane(12.0), small.box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6))
    sphere = small.sphere((1.5, 3.0, 1.5), 0.8)
    shapes = [ground, box, sphere]
    scene = small.scene([small.mesh(str(i), shape, receives=i == 0) for i, shape in enumerate(shapes)], lamp)
    geometry = Geometry(scene, device)
    session = Session(geometry, width=SIZE[0], height=SIZE[1], device=device)
    actual = session.render(AliasFree()).visibility
    receives = np.isfinite(actual)
    corners = small.corners_of([box, sphere]) - geometry.origin_ws
    origin = session.gbuffer().position_ws.numpy()[receives].astype(float)
    towards = lamp.centre[:3] - geometry.origin_ws - origin
    t, least = small.ray_hits(origin, towards, corners)
    hidden = ((t > 0.0) & (t < 1.0)).any(axis=1)
    near_edge = (np.abs(least) < 1e-4).any(axis=1)
    assert 0.05 < hidden.mean() < 0.95 and near_edge.mean() < 0.05
    np.testing.assert_array_equal(actual[receives][~near_edge] == 0.0, hidden[~near_edge])


@pytest.mark.parametrize("light", ["directional", "point outside", "point inside"])
def test_degenerate_and_broken_triangles_hide_nothing(light: str, device: str) -> None:
    scene = small.cluttered(LIGHTS[light])
    good = np.array([[-2.0, 1.0, -2.0], [2.0, 1.0, 2.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 0, 0], [0, 1, 1], [0, 1, 2], [0, 1, 3], [3, 3, 3], [0, 4, 1], [5, 0, 4], [5, 1, 2]])
    more = Mesh("broken", np.concatenate([good, good]), faces.astype(np.int32), receives=False)
    images = []
    for broken in (False, True):
        geometry = Geometry(replace(scene, meshes=(*scene.meshes, more) if broken else scene.meshes), device)
        if broken:
            points = geometry.points_ws.numpy().copy()
            first = geometry.caster_indices.numpy()[-3 * len(faces)]
            points[first + 3 : first + 6] = ([np.nan] * 3, [np.inf] * 3, (-np.inf, 0.0, 3e38))
            geometry.points_ws.assign(points)
        session = Session(geometry, width=SIZE[0], height=SIZE[1], device=device)
        images.append(session.render(AliasFree()).visibility)
    assert share_that_differs(*images) <= SAME  # a line is as wide as float32's rounding


def test_a_mesh_without_a_crack_lets_no_light_through(device: str) -> None:
    """A fine, uneven sheet of triangles hides every pixel of the ground below it, edges and corners included."""
    sheet = small.terrain(14.0, 60, 0.3)
    sheet[0][:, 1] += 3.0
    ground = small.mesh("ground", small.plane(3.0), casts=False)
    view = small.camera((0.0, 1.5, 3.0))
    for light in ("directional", "point outside"):
        scene = small.scene([ground, small.mesh("sheet", sheet, receives=False)], LIGHTS[light], view)
        assert np.nanmax(visibility(AliasFree, scene, device, (320, 240))) == 0.0, light


@pytest.mark.parametrize("angle_deg", [0.0, 0.001, 0.1, 1.0, 30.0, 179.0, 179.999, 180.0])
def test_light_along_the_view(angle_deg: float, device: str) -> None:
    """Duelling frusta: the light looks the eye in the face, or comes from right behind it."""
    view = small.camera((0.0, 2.0, 8.0), (0.0, 1.5, 0.0))
    forward = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
    side = np.cross(forward, view.up)
    angle = np.radians(angle_deg)
    lamp = DirectionalLight(direction=np.cos(angle) * forward + np.sin(angle) * np.cross(side, forward))
    assert_like_rays(small.cluttered(lamp, view), device, shadows=False)


def test_light_inside_the_view(device: str) -> None:
    view = small.camera((0.0, 3.0, 8.0))
    assert_like_rays(small.cluttered(PointLight(position=np.array([0.4, 1.8, 4.5])), view), device)


@pytest.mark.parametrize("near", [1e-4, 1e-1])
def test_far_reaching_views(near: float, device: str) -> None:
    """From close to a box over a wide ground: f / n = 1e6, most samples in very few cells."""
    meshes = [
        small.mesh("ground", small.plane(200.0)),
        small.mesh("box", small.box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6))),
        small.mesh("pebble", small.box((0.01, 0.012, 0.02), (0.01, 0.02, 0.01))),
    ]
    view = Camera(
        np.array([0.05, 0.03, 0.08]), np.array([0.0, 0.01, 0.0]), np.array([0.0, 1.0, 0.0]), 60.0, near, 1e6 * near
    )
    lamp = DirectionalLight(direction=np.array([0.5, -1.0, 0.2]))
    assert_like_rays(small.scene(meshes, lamp, view), device)


def test_world_offset_of_a_million(device: str) -> None:
    scene = small.cluttered(LIGHTS["point outside"])
    offset = np.array([1e6, -1e6, 1e6])
    pose = np.eye(4)
    pose[:3, 3] = offset
    view = scene.camera(0)
    moved = Scene(
        "moved",
        tuple(replace(mesh, object_to_ws=lambda frame: pose) for mesh in scene.meshes),
        (PointLight(position=scene.lights[0].centre[:3] + offset),),
        lambda frame: replace(view, eye=view.eye + offset, target=view.target + offset),
    )
    actual = assert_like_rays(moved, device)
    # positions at 1e6 are rounded to 1e-10 in double, the vertices themselves to float32 only after rebasing
    assert share_that_differs(actual, visibility(AliasFree, scene, device)) <= 5e-3


def test_nothing_casts(device: str) -> None:
    scene = small.cluttered(LIGHTS["point inside"])
    scene = replace(scene, meshes=tuple(replace(mesh, casts=False) for mesh in scene.meshes))
    for skips in (True, False):
        session = Session(Geometry(scene, device), width=40, height=30, device=device, skips=skips)
        assert np.nanmin(session.render(AliasFree()).visibility) == 1.0


def test_light_at_a_vertex_and_in_a_triangle(device: str) -> None:
    """What touches the light has no place in its view; nothing fails, and everything else keeps its shadow."""
    for position in ([0.0, 3.0, 0.0], [0.2, 3.0, 0.1]):
        sail = (np.array([[0.0, 3.0, 0.0], [1.0, 3.0, 0.0], [0.0, 3.0, 1.0]]), np.array([[0, 1, 2]], dtype=np.int32))
        lamp = PointLight(position=np.array(position))
        scene = small.box_on_ground(lamp)
        scene = replace(scene, meshes=(*scene.meshes, small.mesh("sail", sail, receives=False)))
        finite = visibility(AliasFree, scene, device, (64, 48))
        assert set(np.unique(finite[np.isfinite(finite)])) <= {0.0, 1.0}


@pytest.mark.parametrize("resolution", [1, 5, 96, 256])
@pytest.mark.parametrize("light", LIGHTS)
def test_lanes_are_the_plain_kernels(light: str, resolution: int, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")
    images = []
    for lanes in (False, True):
        monkeypatch.setattr(hidden, "uses_lanes", lambda device, lanes=lanes: lanes)
        images.append(visibility(AliasFree, small.cluttered(LIGHTS[light]), device, resolution=resolution))
    # the compiler may fuse other multiplications with additions
    assert share_that_differs(*images) <= 1e-4
