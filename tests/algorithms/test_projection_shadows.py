"""projection_shadows: the matrix against its closed form, what is cut and dropped, its exactness and its artefacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from filtering_sessions import OPTIONS, render, session, technique

from wkernels.casters.flattening import CUT, Flattener, flatten_vertices
from wkernels.casters.receiver_planes import plane_of, receiver_planes, turned_to_light
from wkernels.device.launch import launch
from wkernels.projections.clipping import clip_polygon
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, Light, PointLight
from wkernels.scene.model import Camera, Mesh, Scene
from wkernels.scene.views import eye_view


def flatten_twin(points: np.ndarray, plane: np.ndarray, light: np.ndarray) -> np.ndarray:
    """M = (P.l) I - l P^T on homogeneous points, in float64."""
    matrix = (plane @ light) * np.eye(4) - np.outer(light, plane)
    flat = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix.T
    return flat[:, :3] / flat[:, 3:]


def share_of_flips(image: np.ndarray, rays: np.ndarray) -> float:
    """Of the receivers; outlines are drawn to 1/256 of a pixel."""
    return float(np.mean((image != rays)[np.isfinite(rays)]))


@pytest.mark.parametrize("light", [(1.0, 9.0, -2.0, 1.0), (0.3, 0.9, -0.2, 0.0)])
def test_flattened_vertices_are_those_of_the_matrix(light: tuple[float, ...]) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform((-4.0, 0.0, -4.0), (4.0, 5.0, 4.0), size=(200, 3))
    plane = np.array([0.1, 0.98, -0.05, 0.7])
    plane /= np.linalg.norm(plane[:3])
    sample = np.array(light)
    given = wp.array(points.astype(np.float32), dtype=wp.vec3, device=OPTIONS["device"])
    out = wp.zeros(len(points), dtype=wp.vec3, device=OPTIONS["device"])
    launch(flatten_vertices, len(points), [given, wp.vec4(*plane), wp.vec4(*sample)], [out], device=OPTIONS["device"])
    expected = flatten_twin(points, plane, sample)
    np.testing.assert_allclose(out.numpy(), expected, rtol=2e-5, atol=2e-5)  # float32 and a division by 1 - h / h_l
    assert np.abs(out.numpy() @ plane[:3] + plane[3]).max() < 2e-5


def test_on_the_ground_the_matrix_is_the_published_formula() -> None:
    """y = 0: x' = (l_y x - l_x y) / (l_y - y), and points on the plane stay."""
    light = np.array([1.0, 9.0, -2.0, 1.0])
    points = np.array([[0.5, 2.0, 0.3], [-1.0, 0.0, 4.0]])
    flat = flatten_twin(points, np.array([0.0, 1.0, 0.0, 0.0]), light)
    for axis in (0, 2):
        expected = (9.0 * points[:, axis] - light[axis] * points[:, 1]) / (9.0 - points[:, 1])
        np.testing.assert_allclose(flat[:, axis], expected, rtol=1e-12)
    np.testing.assert_allclose(flat[1], points[1], atol=1e-12)


@pytest.mark.parametrize("elevation", [20.0, 40.0, 75.0])
def test_a_box_casts_a_shadow_as_long_as_its_height_says(elevation: float) -> None:
    """A8: h / tan e."""
    e = np.radians(elevation)
    sun = DirectionalLight(direction=np.array([np.cos(e), -np.sin(e), 0.0]))
    ground = small.mesh("ground", small.plane(30.0), casts=False)
    box = small.mesh("box", small.box((-0.5, 1.0, 0.0), (1.0, 2.0, 2.0)), receives=False)
    view = Camera(np.array([3.0, 14.0, 0.01]), np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]), 40.0, 0.1, 100.0)
    result = render(small.scene([ground, box], sun, view), "projection_shadows", size=(320, 240))
    middle = np.abs(result.world_position[..., 2]) < 0.5
    x = result.world_position[..., 0][middle & (result.world_position[..., 1] < 1e-3)]
    dark = result.visibility[middle & (result.world_position[..., 1] < 1e-3)] == 0.0
    end = min(2.0 / np.tan(e), 8.0)
    pixel = 14.0 * 2.0 * np.tan(np.radians(20.0)) / 240
    assert x[dark].max() == pytest.approx(end, abs=1.1 * pixel)
    assert dark[(x > 0.1) & (x < end - pixel)].all() and not dark[x > end + pixel].any()


def on_box(**ground: Any) -> list[Mesh]:
    return [
        small.mesh("ground", small.plane(12.0), **ground),
        small.mesh("box", small.box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6))),
    ]


LIGHTS: dict[str, Light] = {
    "point": PointLight(position=np.array([1.0, 9.0, -2.0])),
    "between": PointLight(position=np.array([0.2, 2.2, 2.0])),  # below the box's top, which is cut off
    "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2])),
    "grazing": DirectionalLight(direction=np.array([1.0, -1e-3, 0.2])),
    "from below": PointLight(position=np.array([0.5, -6.0, 0.4])),
}


@pytest.mark.parametrize("casts", [True, False])
@pytest.mark.parametrize("name", LIGHTS)
def test_on_the_plane_it_is_the_ray_cast(name: str, casts: bool) -> None:
    """Lights inside, below and along the scene; the ground may cast, and then hides what is behind it."""
    scene = small.scene(on_box(casts=casts), LIGHTS[name])
    size = (160, 120)
    image = render(scene, "projection_shadows", size=size)
    rays = render(scene, "ray_cast_point_shadow", size=size).visibility
    ground = np.abs(image.world_position[..., 1]) < 1e-4
    differs = image.visibility[ground] != rays[ground]
    # outlines are drawn to 1/256 of a pixel
    assert ground.sum() > 10000 and differs.mean() < 1e-3, f"{differs.sum()} pixels"


def test_what_is_beyond_the_light_casts_no_anti_shadow() -> None:
    roof = small.mesh("roof", small.box((0.0, 8.0, 0.0), (3.0, 0.5, 3.0)), receives=False)
    half = small.mesh("mast", small.box((0.0, 5.0, -1.5), (0.5, 9.0, 0.5)), receives=False)  # ends above the light
    lamp = PointLight(position=np.array([0.0, 5.0, 0.0]))
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    assert (render(small.scene([ground, roof], lamp), "projection_shadows").visibility != 0.0).all()
    scene = small.scene([ground, half], lamp)
    image = render(scene, "projection_shadows", size=(160, 120)).visibility
    rays = render(scene, "ray_cast_point_shadow", size=(160, 120)).visibility
    assert 0.005 < np.nanmean(rays == 0.0) and share_of_flips(image, rays) < 1e-3


def test_bodies_get_no_shadow_from_themselves_or_each_other() -> None:
    """Expected artefact, lighter: only back-lit faces of what is not flat are dark."""
    lower = small.mesh("lower", small.sphere((0.0, 1.5, 0.0), 1.2, 300))
    upper = small.mesh("upper", small.box((0.0, 5.0, 0.0), (1.5, 0.5, 1.5)), receives=False)
    lamp = PointLight(position=np.array([0.0, 10.0, 0.0]))
    scene = small.scene([small.mesh("ground", small.plane(12.0), casts=False), lower, upper], lamp)
    image = render(scene, "projection_shadows", size=(160, 120))
    rays = render(scene, "ray_cast_point_shadow", size=(160, 120)).visibility
    body = image.world_position[..., 1] > 0.05
    assert np.mean(rays[body] == 0.0) > 0.3
    difference = image.visibility[body] - rays[body]
    assert (difference >= 0.0).all() and difference.mean() > 0.05


def test_many_samples_are_the_reference_with_the_same_ones() -> None:
    scene = small.box_on_ground(small.light("disc"))
    image = render(scene, "projection_shadows", light_samples=32, size=(128, 96))
    rays = render(scene, "reference_multisample", samples=32, size=(128, 96))
    differs = np.abs(image.visibility - rays.visibility)
    assert np.nanmax(differs) <= 3.0 / 32.0 and np.nanmean(differs > 1e-6) < 0.02
    assert image.standard_error is not None
    same = differs <= 1e-6
    np.testing.assert_allclose(image.standard_error[same], rays.standard_error[same], atol=1e-6)


def test_a_moving_plane_takes_its_shadow_along() -> None:
    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[1, 3] = -0.5 * frame
        return out

    ground = Mesh("ground", *small.plane(12.0), casts=False, object_to_ws=pose, moving=True)
    scene = small.scene([ground, *small.box_on_ground(LIGHTS["point"]).meshes[1:]], LIGHTS["point"])
    running = session(scene)
    for frame in (0, 2):
        running.begin(frame)
        image = running.render(technique("projection_shadows")).visibility
        rays = running.render(technique("ray_cast_point_shadow")).visibility
        assert 0.02 < np.nanmean(rays == 0.0) and share_of_flips(image, rays) < 2e-3
        running.advance()


@pytest.mark.parametrize("fine", [False, True])
@pytest.mark.parametrize("ties", [False, True])
def test_cut_triangles_are_what_a_clipper_leaves(ties: bool, fine: bool) -> None:
    """Area and extent of each fan are those of the polygon that is clipped and flattened in float64."""
    rng = np.random.default_rng(7)
    corners = rng.uniform((-1.0, -1.0, -1.0), (1.0, 3.5, 1.0), size=(300, 3, 3)).astype(np.float32)
    if ties:
        corners[:, 1, 1] = corners[:, 0, 1]
    plane, light, high = np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.2, 2.5, 2.0, 1.0]), 2.2
    inside = (corners[:, :, 1].max(axis=1) > 0.05) & (corners[:, :, 1].min(axis=1) < high - 0.05)
    corners = corners[inside]
    count, device = len(corners), OPTIONS["device"]
    points = wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device=device)
    order = wp.array(np.arange(3 * count, dtype=np.int32), dtype=int, device=device)
    flat, indices = wp.zeros(5 * count, dtype=wp.vec3, device=device), wp.zeros(9 * count, dtype=int, device=device)
    vector, scalar = (wp.vec4d, wp.float64) if fine else (wp.vec4, wp.float32)
    inputs = [points, order, order[:count], vector(*plane), vector(*light), high, 0, 0]
    launch(CUT[scalar], count, inputs, [flat, indices], device=device)
    triangles = flat.numpy().astype(float)[indices.numpy()].reshape(count, 3, 3, 3)[..., [0, 2]]
    slab = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, -1.0, 0.0, high]])
    for fan, corner in zip(triangles, corners, strict=True):
        expected = flatten_twin(clip_polygon(corner, slab), plane, light)[:, [0, 2]]
        spokes = expected[1:] - expected[0]
        area = 0.5 * abs(np.sum(cross(spokes[:-1], spokes[1:])))
        drawn = 0.5 * np.abs(cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0])).sum()
        assert drawn == pytest.approx(area, rel=1e-3, abs=1e-4)
        reach = np.abs(expected).max()
        np.testing.assert_allclose(fan.reshape(-1, 2).min(axis=0), expected.min(axis=0), atol=1e-4 * reach)
        np.testing.assert_allclose(fan.reshape(-1, 2).max(axis=0), expected.max(axis=0), atol=1e-4 * reach)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# ---- planes -------------------------------------------------------------------------------------------------------------


def test_flat_meshes_on_one_plane_share_it() -> None:
    meshes = [
        small.mesh("a", small.plane(4.0)),
        small.mesh("b", small.plane(4.0, centre=(5.0, 0.0))),
        small.mesh("higher", small.plane(4.0, y=1.0)),
        small.mesh("bumpy", small.terrain(4.0, 4, 0.3)),
        small.mesh("blind", small.plane(4.0, y=2.0), receives=False),
    ]
    geometry = Geometry(small.scene(meshes, LIGHTS["point"]), OPTIONS["device"])
    names = [sorted(geometry.meshes[i].name for i in plane.meshes) for plane in receiver_planes(geometry, 0, {})]
    assert sorted(names) == [["a", "b"], ["higher"]]


def test_many_planes_are_merged_as_one_by_one() -> None:
    """Roofs of a town: each joins the first plane that it shares, whichever way its triangles turn."""
    rng = np.random.default_rng(4)
    meshes = []
    for i in range(120):
        vertices, faces = small.plane(rng.uniform(0.5, 2.0))
        height = rng.integers(0, 12) * 0.25 + rng.choice([0.0, 1e-9])
        vertices = vertices + np.array([rng.uniform(-20, 20), height, rng.uniform(-20, 20)])
        meshes.append(small.mesh(f"roof {i}", (vertices, faces[:, ::-1] if i % 2 else faces)))
    geometry = Geometry(small.scene(meshes, LIGHTS["point"]), OPTIONS["device"])
    extent = float(np.abs([geometry.bounds(receivers=True).low, geometry.bounds(receivers=True).high]).max())
    expected: list[tuple[np.ndarray, list[int]]] = []
    for i, mesh in enumerate(geometry.meshes):
        plane = plane_of(mesh.vertices - geometry.origin_ws)
        assert plane is not None
        for known, members in expected:
            weights = np.array([extent, extent, extent, 1.0])
            if min(np.abs(known - plane) @ weights, np.abs(known + plane) @ weights) <= 1e-6 * extent:
                members.append(i)
                break
        else:
            expected.append((plane, [i]))
    got = receiver_planes(geometry, 0, {})
    assert [plane.meshes for plane in got] == [members for _, members in expected]
    assert 12 <= len(got) < 120


@pytest.mark.parametrize(
    "vertices",
    [
        np.zeros((0, 3)),
        np.zeros((5, 3)),
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 1, 0]]),
    ],
    ids=["none", "a point", "a line", "a tetrahedron", "not a number"],
)
def test_what_spans_no_single_plane_has_none(vertices: np.ndarray) -> None:
    assert plane_of(vertices) is None


def test_a_light_in_the_plane_gives_rank_1_and_no_shadow() -> None:
    plane = np.array([0.0, 1.0, 0.0, 0.0])
    assert turned_to_light(plane, np.array([3.0, 0.0, 1.0, 1.0]), 6.0) is None
    assert turned_to_light(plane, np.array([1.0, 0.0, 0.0, 0.0]), 6.0) is None
    turned = turned_to_light(plane, np.array([0.0, -2.0, 0.0, 1.0]), 6.0)
    assert turned is not None and turned[1] == -1.0
    scene = small.scene(on_box(casts=False), PointLight(position=np.array([5.0, 0.0, 0.0])))
    image = render(scene, "projection_shadows")
    assert (image.visibility[np.abs(image.world_position[..., 1]) < 1e-4] == 1.0).all()


def test_without_a_flat_receiver_all_is_left_out() -> None:
    scene = small.cluttered(LIGHTS["point"])
    result = render(scene, "projection_shadows")
    assert ("flattened casters", "no receiver is flat", 1) in result.left_out
    assert "flattened casters" not in dict(result.passes)


def test_planes_out_of_sight_are_not_drawn() -> None:
    behind = small.mesh("behind", small.plane(4.0, y=1.0, centre=(0.0, 40.0)))
    scene = small.scene([*on_box(casts=False), behind], LIGHTS["point"])
    images = [session(scene, skips=skips).render(technique("projection_shadows")) for skips in (True, False)]
    assert ("flattened casters", "no pixel shows the plane", 1) in images[0].left_out
    np.testing.assert_array_equal(images[0].visibility, images[1].visibility)


def broken_scene() -> Scene:
    """Triangles without area, and some twice."""
    vertices, faces = small.box((0.0, 2.0, 0.0), (2.0, 1.0, 1.6))
    faces = np.concatenate([faces, faces[:4], [[0, 0, 1], [5, 5, 5]]]).astype(np.int32)
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    return small.scene([ground, Mesh("box", vertices, faces, receives=False)], LIGHTS["point"])


def test_broken_triangles_change_nothing() -> None:
    whole = small.mesh("box", small.box((0.0, 2.0, 0.0), (2.0, 1.0, 1.6)), receives=False)
    sound = small.scene([broken_scene().meshes[0], whole], LIGHTS["point"])
    np.testing.assert_array_equal(
        render(broken_scene(), "projection_shadows").visibility, render(sound, "projection_shadows").visibility
    )


def test_only_triangles_that_stick_out_are_cut() -> None:
    lamp = LIGHTS["between"]
    running = session(small.scene(on_box(casts=False), lamp))
    gbuffer = running.gbuffer()
    plane = receiver_planes(running.geometry, 0, {})[0].plane
    shadow = wp.zeros(gbuffer.depth.shape, dtype=float, device=OPTIONS["device"])
    flattener = Flattener(OPTIONS["device"], None)
    for height, expected in ((9.0, 0), (2.2, 8)):  # the sides; the top is dropped and the bottom is whole
        light = np.array([0.2, height, 2.0, 1.0]) - np.append(running.geometry.origin_ws, 0.0)
        turned = turned_to_light(plane, light, 6.0)
        assert turned is not None
        cut = flattener.draw(running.geometry, turned, light, 6.0, 20.0, gbuffer.view, shadow)
        assert cut == expected


def test_a_flattener_draws_one_triangle_anew_each_time() -> None:
    """Its list of triangles is written into the same memory: below the light, then above it, where nothing is thrown."""
    triangle = np.array([(-1.0, 2.0, -1.0), (1.0, 2.0, -1.0), (0.0, 2.0, 1.0)]), np.array([(0, 1, 2)], np.int32)
    geometry = Geometry(small.scene([small.mesh("leaf", triangle)], small.light("point")), OPTIONS["device"])
    view = eye_view(small.camera((0.0, 6.0, 8.0)), 40, 30, geometry.origin_ws).to_device()
    plane, depth = np.array([0.0, 1.0, 0.0, geometry.origin_ws[1]]), wp.empty((30, 40), device=OPTIONS["device"])
    flattener = Flattener(OPTIONS["device"], 2)
    shadows = []
    for height in (9.0, 1.0, 9.0):
        light = np.array([0.0, height - geometry.origin_ws[1], 0.0, 1.0])
        flattener.draw(geometry, plane, light, 10.0, 20.0, view, depth)
        shadows.append(int(np.isfinite(depth.numpy()).sum()))
    assert shadows[0] == shadows[2] > 0 and shadows[1] == 0
