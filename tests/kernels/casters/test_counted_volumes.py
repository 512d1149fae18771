"""Volumes counted in a picture, against rays to the light in float64: whoever is inside, whatever is cut, whatever is left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes
from caster_meshes import fan, torus

from wkernels.casters import pulls
from wkernels.casters.components import Components
from wkernels.casters.pulls import pull_components, pull_silhouettes
from wkernels.casters.silhouettes import facing_of
from wkernels.casters.volume_counts import Uncounted, count_volumes, may_be_seen, may_hold_near_plane, near_hull
from wkernels.raster import Rasteriser
from wkernels.raster.gbuffer import GBuffer, allocate_gbuffer, fill_gbuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Camera, Scene
from wkernels.scene.views import HostView, eye_view
from wkernels.workspace.workspace import Workspace

SIZE = (75, 53)
LIGHTS = {"point": (1.0, 7.0, 2.0, 1.0), "direction": (0.2, 0.9, 0.35, 0.0)}
EYES = {
    "lit": small_scenes.camera(),
    "in the shadow": small_scenes.camera((-0.1, 0.7, -0.1), (-3.0, 0.0, 2.0), near=0.02),
    "in the box": small_scenes.camera((0.0, 1.5, 0.0), (-2.0, 0.0, 1.0), near=0.02),
    "near plane cuts box and volume": small_scenes.camera((0.5, 2.2, 2.0), (0.0, 0.6, 0.0), near=1.5, fov_deg=80.0),
}


def pictured(scene: Scene, device: str, rasteriser: Rasteriser) -> tuple[Geometry, GBuffer, HostView]:
    geometry = Geometry(scene, device, 2)
    view = eye_view(scene.camera(0), *SIZE, geometry.origin_ws)
    gbuffer = allocate_gbuffer(*SIZE, device)
    fill_gbuffer(gbuffer, geometry, view, rasteriser)
    return geometry, gbuffer, view


def bodies(camera: Camera) -> Scene:
    """A box, a ring, an open leaf and a fan over a ground that casts too: all kinds of casters, all of which receive."""
    leaf = small_scenes.plane(1.5, y=2.6, centre=(1.6, -0.8), cells=2)
    shapes = {
        "ground": small_scenes.plane(9.0, cells=3),
        "box": small_scenes.box((0.0, 1.5, 0.0), (1.5, 1.0, 1.2)),
        "ring": (torus()[0] * 0.5 + np.array([-1.4, 1.0, 1.2]), torus()[1]),
        "leaf": leaf,
        "fan": (fan(5)[0] * 0.8 + np.array([1.8, 0.4, 1.4]), fan(5)[1]),
    }
    return small_scenes.scene(
        [small_scenes.mesh(name, shape) for name, shape in shapes.items()], small_scenes.light("point"), camera
    )


def hidden_by_rays(geometry: Geometry, gbuffer: GBuffer, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether any caster lies between surface and light, and where that is not a matter of rounding, (H, W)."""
    positions = gbuffer.position_ws.numpy().reshape(-1, 3).astype(float)
    own = gbuffer.triangle.numpy().ravel()
    corners = geometry.points_ws.numpy().astype(float)[geometry.caster_indices.numpy().reshape(-1, 3)]
    ways = light[:3] - positions * light[3]
    distance, inside = small_scenes.ray_hits(positions, ways, corners)
    distance[np.arange(len(own)), np.maximum(own, 0)] = np.inf  # its own surface is not between
    end = 1.0 if light[3] > 0.0 else np.inf
    near_end = (np.abs(distance) < 1e-3) | ((np.abs(distance - 1.0) < 1e-3) & (end == 1.0))
    sure = ~((np.abs(inside) < 0.02) | (near_end & (inside > -0.02))).any(axis=1) & (own >= 0)
    hidden = ((distance > 0.0) & (distance < end)).any(axis=1)
    return hidden.reshape(SIZE[::-1]), sure.reshape(SIZE[::-1])


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("eye", EYES)
def test_counts_are_above_none_exactly_in_the_shadow(eye: str, light: str, device: str) -> None:
    """Of surfaces that are turned to the light as seen from the eye; z-pass alone only where the eye is lit."""
    rasteriser, light_ws = Rasteriser(device, 2), np.array(LIGHTS[light])
    geometry, gbuffer, view = pictured(bodies(EYES[eye]), device, rasteriser)
    light_ws[:3] -= geometry.origin_ws * light_ws[3]
    hidden, sure = hidden_by_rays(geometry, gbuffer, light_ws)
    to_light = light_ws[:3] - gbuffer.position_ws.numpy() * light_ws[3]
    sure &= np.einsum("hwi,hwi->hw", gbuffer.normal_ws.numpy(), to_light) > 1e-3
    assert sure.mean() > 0.25 and (hidden & sure).mean() > 0.01
    assert (~hidden & sure).any() or eye == "in the box"  # which shows nothing but its dark inside
    counts = {}
    for rule in ("zpass", "zfail", "per_caster"):
        for skips in (True, False):
            work = Workspace(device, 2, skips=skips)
            got = count_volumes(work, rasteriser, geometry, gbuffer, view, light_ws, rule).numpy()  # type: ignore[arg-type]
            counts[rule, skips] = got.copy()
            if rule != "zpass":
                wrong = sure & ((got > 0) != hidden)
                assert not wrong.any(), f"{rule}: {wrong.sum()} wrong, {(got[sure] < 0).sum()} negative"
    seen = gbuffer.triangle.numpy() >= 0
    for rule in ("zpass", "zfail", "per_caster"):
        np.testing.assert_array_equal(counts[rule, True][seen], counts[rule, False][seen])
    np.testing.assert_array_equal(counts["per_caster", True][seen], counts["zfail", True][seen])
    assert (counts["zpass", True][seen] == counts["zfail", True][seen]).all() == (eye == "lit")


def test_a_light_inside_a_caster_is_hidden_from_all_outside(device: str) -> None:
    rasteriser = Rasteriser(device, 2)
    geometry, gbuffer, view = pictured(bodies(EYES["lit"]), device, rasteriser)
    light_ws = np.append(np.array((0.1, 1.4, 0.05)) - geometry.origin_ws, 1.0)
    hidden, sure = hidden_by_rays(geometry, gbuffer, light_ws)
    got = count_volumes(Workspace(device, 2), rasteriser, geometry, gbuffer, view, light_ws).numpy()
    assert (hidden & sure).sum() > 1000
    assert (got[hidden & sure] > 0).all()


def test_volumes_beside_the_view_are_left_out_and_told(device: str) -> None:
    rasteriser = Rasteriser(device, 2)
    away = small_scenes.camera((0.0, 2.0, 6.0), (0.0, 0.5, 40.0))  # looks along the ground, away from all bodies
    geometry, gbuffer, view = pictured(bodies(away), device, rasteriser)
    light_ws = np.append(np.array((1.0, 7.0, 2.0)) - geometry.origin_ws, 1.0)
    work = Workspace(device, 2)
    got = count_volumes(work, rasteriser, geometry, gbuffer, view, light_ws)
    assert work.left_out[Uncounted.BESIDE.pair] >= 3
    assert (gbuffer.triangle.numpy() >= 0).sum() == 0 or not got.numpy()[gbuffer.triangle.numpy() >= 0].any()


def random_boxes(rng: np.random.Generator, count: int) -> Components:
    centre, half = rng.uniform(-6.0, 6.0, (count, 3)), rng.uniform(0.05, 1.5, (count, 3))
    return Components(centre - half, centre + half, np.ones(count, bool))


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize(
    "light", [(3.0, 2.0, -4.0, 1.0), (0.3, 5.0, 6.9, 1.0), (0.2, 0.9, 0.35, 0.0), (0.0, 0.0, 1.0, 0.0)]
)
def test_boxes_that_are_parted_are_so(light: tuple[float, ...], perspective: bool) -> None:
    """Against many points of each box: none of what lies behind one that is left out is at the near plane, or in view."""
    rng = np.random.default_rng(11)
    camera = small_scenes.camera((0.5, 1.0, 6.0), (0.0, 0.0, 0.0), near=1.0, fov_deg=70.0)
    if not perspective:
        camera = Camera(camera.eye, camera.target, camera.up, camera.fov_deg, camera.near, camera.far, height=4.0)
    view, light_ws = eye_view(camera, 40, 30, np.zeros(3)), np.array(light)
    boxes = random_boxes(rng, 500)
    near, seen = may_hold_near_plane(boxes, view, light_ws), may_be_seen(boxes, view, light_ws)
    share = rng.uniform(0.0, 1.0, (300, 3))
    points = boxes.low[:, None] + share * (boxes.high - boxes.low)[:, None]  # (C, 300, 3)
    rows = view.ws_to_ss
    way = points * light_ws[3] - light_ws[:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        # how far each point is carried until it is at the near plane
        step = (view.near - points @ rows[2, :3] - rows[2, 3]) / (way @ rows[2, :3])
        at = points + step[..., None] * way
        inside = [np.abs(at @ row[:3] + row[3]) <= at @ rows[3, :3] + rows[3, 3] for row in rows[:2]]
        truly_near = ((step >= 0.0) & inside[0] & inside[1]).any(axis=1)
    assert truly_near.any() and not (truly_near & ~near).any()
    assert (near & ~truly_near).sum() < 0.5 * (~truly_near).sum(), (
        "boxes far from the near plane are told to be clear of it"
    )
    truly_seen = np.zeros(len(near), bool)
    for step_on in (0.0, 0.3, 1.0, 4.0, 30.0):
        at = points + step_on * way
        w = at @ rows[3, :3] + rows[3, 3]
        inside = [np.abs(at @ row[:3] + row[3]) <= w for row in rows[:2]]
        truly_seen |= ((at @ rows[2, :3] + rows[2, 3] >= view.near) & inside[0] & inside[1]).any(axis=1)
    assert truly_seen.any() and not (truly_seen & ~seen).any()
    assert (~seen).any() or (light[2:] == (1.0, 0.0) and perspective)  # carried straight on, all come into view


def test_the_hull_of_the_near_plane_is_that_of_the_view() -> None:
    for height in (None, 3.0):
        camera = small_scenes.camera((0.5, 1.0, 6.0), near=0.7)
        camera = Camera(camera.eye, camera.target, camera.up, camera.fov_deg, camera.near, camera.far, height=height)
        view = eye_view(camera, 40, 30, np.zeros(3))
        hull = near_hull(view, np.array(LIGHTS["point"]))
        h = hull[:4] @ view.ws_to_ss.T
        np.testing.assert_allclose(h[:, 2], 0.7)
        np.testing.assert_allclose(h[:, :2] / h[:, 3:], [(-1, -1), (1, -1), (1, 1), (-1, 1)], atol=1e-12)


def test_silhouettes_are_found_once_for_light_and_casters(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not per frame: only a light or a caster that moves asks again which faces are lit."""
    asked: list[np.ndarray] = []

    def counted(*args: Any) -> np.ndarray:
        asked.append(facing_of(*args))
        return asked[-1]

    monkeypatch.setattr(pulls, "facing_of", counted)
    rasteriser = Rasteriser(device, 2)
    scene = small_scenes.moved(bodies(EYES["lit"]), 1, lambda frame: 0.1 * (frame > 2))
    geometry, gbuffer, view = pictured(scene, device, rasteriser)
    work, light_ws = Workspace(device, 2), np.array(LIGHTS["point"])
    for frame, found in ((0, 1), (1, 1), (2, 1), (3, 2), (4, 2)):
        geometry.set_frame(frame)
        view = eye_view(small_scenes.camera((0.1 * frame, 6.0, 8.0)), *SIZE, geometry.origin_ws)
        fill_gbuffer(gbuffer, geometry, view, rasteriser)
        count_volumes(work, rasteriser, geometry, gbuffer, view, light_ws)
        assert len(asked) == found
    count_volumes(work, rasteriser, geometry, gbuffer, view, light_ws + np.array((0.1, 0.0, 0.0, 0.0)))
    assert len(asked) == 3


def test_nothing_casts_nothing_is_counted(device: str) -> None:
    rasteriser = Rasteriser(device, 2)
    scene = small_scenes.scene(
        [small_scenes.mesh("ground", small_scenes.plane(9.0), casts=False)], small_scenes.light("point")
    )
    geometry, gbuffer, view = pictured(scene, device, rasteriser)
    work = Workspace(device, 2)
    for rule in ("zpass", "zfail", "per_caster"):
        assert (
            not count_volumes(work, rasteriser, geometry, gbuffer, view, np.array(LIGHTS["point"]), rule).numpy().any()
        )
    assert len(pull_components(work, geometry).low) == 0
    assert len(pull_silhouettes(work, geometry, np.array(LIGHTS["point"])).edge) == 0
