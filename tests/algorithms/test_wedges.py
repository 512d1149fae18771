"""Penumbra wedges against closed forms and rays, their options, their known errors with their signs, and stiff cases."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import small_scenes
import warp as wp
from compare import edge_band
from sessions import open_session, render, render_frames, technique, true_visibility

from wkernels.casters.wedges.coverage import beyond_in_square
from wkernels.casters.wedges.stored import BUFFERS, Channels, add_code, stored_code, stored_sum
from wkernels.casters.wedges.textures import LightTexture, light_beyond, light_texture
from wkernels.device.launch import launch
from wkernels.scene.lights import DiscLight, Light, RectangleLight, SphereLight
from wkernels.scene.model import Camera, Mesh, Scene
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace

SIZE = (160, 120)
HEIGHT = 8.0  # of lights over the ground
NAMES = {"rectangle": "wedge_rectangular", "sphere": "wedge_spherical", "disc": "wedge_spherical"}


def rectangle(width: float = 1.6, depth: float = 1.2, texture: np.ndarray | None = None) -> RectangleLight:
    u, v = np.array([width, 0.0, 0.0]), np.array([0.0, 0.0, depth])
    return RectangleLight(center=np.array([0.3, HEIGHT, -0.2]), edge_u=u, edge_v=v, texture=texture)


def disc() -> DiscLight:
    return DiscLight(center=np.array([0.3, HEIGHT, -0.2]), normal=np.array([0.0, -1.0, 0.0]), radius=0.8)


def ground() -> Mesh:
    return small_scenes.mesh("ground", small_scenes.plane(9.0), casts=False)


def sheet(centre: tuple[float, float], size: float, height: float) -> Mesh:
    return small_scenes.mesh(f"sheet {centre} {height}", small_scenes.plane(size, height, centre), receives=False)


def positions(scene: Scene, device: str, size: tuple[int, int] = SIZE) -> np.ndarray:
    """What the eye sees, (H, W, 3)."""
    session = open_session(scene, device, size=size)
    session.begin(0)
    return np.asarray(session.gbuffer().position_ws.numpy(), np.float64) + session.geometry.origin_ws


def interval_shares(
    p: np.ndarray, light: RectangleLight, axis: int, low: float, high: float, height: float
) -> np.ndarray:
    """Share of the light's extent along an axis that lies behind an interval at a height, seen from p on the ground."""
    half = 0.5 * (light.edge_u[0] if axis == 0 else light.edge_v[2])
    scale = HEIGHT / height
    a = p[..., axis] + scale * (low - p[..., axis]) - light.center[axis]
    b = p[..., axis] + scale * (high - p[..., axis]) - light.center[axis]
    return (np.clip(b, -half, half) - np.clip(a, -half, half)) / (2.0 * half)


@pytest.mark.parametrize("name", ["wedge_rectangular", "wedge_textured"])
@pytest.mark.parametrize("side", [0.4, 2.0])
def test_a_rectangle_behind_a_rectangle_is_exact_in_every_pixel(name: str, side: float, device: str) -> None:
    """Inside and out of the hard shadow, next to its edges too: 1 less the product of covered extents, to 1e-4."""
    light = rectangle()
    scene = small_scenes.scene([ground(), sheet((0.2, 0.1), side, 3.0)], light)
    p, visible = positions(scene, device, (320, 240)), render(scene, device, name, {"size": (320, 240)}).visibility
    x, z = (interval_shares(p, light, k, c - side / 2, c + side / 2, 3.0) for k, c in ((0, 0.2), (2, 0.1)))
    seen = np.isfinite(visible) & (np.abs(p[..., 1]) < 1e-3)
    assert ((visible > 0.01) & (visible < 0.99))[seen].sum() > 300
    assert np.abs(visible - (1.0 - x * z))[seen].max() < 1e-4


def test_a_half_plane_before_a_disc_is_exact_in_every_pixel(device: str) -> None:
    """The share of a circle's segment, to 1e-4."""
    light = disc()
    vertices, faces = small_scenes.plane(40.0, 3.0, (-19.8, 0.0))
    scene = small_scenes.scene([ground(), small_scenes.mesh("half", (vertices, faces), receives=False)], light)
    p, visible = (
        positions(scene, device, (320, 240)),
        render(scene, device, "wedge_spherical", {"size": (320, 240)}).visibility,
    )
    h = np.clip((p[..., 0] + HEIGHT / 3.0 * (0.2 - p[..., 0]) - light.center[0]) / light.radius, -1.0, 1.0)
    lit = (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    seen = np.isfinite(visible) & (np.abs(p[..., 1]) < 1e-3) & (np.abs(p[..., 2]) < 4.0)
    assert ((visible > 0.01) & (visible < 0.99))[seen].sum() > 300
    assert np.abs(visible - lit)[seen].max() < 1e-4


@pytest.mark.parametrize("kind", NAMES)
def test_casters_that_shade_themselves_are_near_the_reference(kind: str, device: str) -> None:
    """A box over the ground, and clutter: what is left is overlap, single silhouettes, and the reference's noise."""
    for scene, rmse in ((small_scenes.box_on_ground, 0.003), (small_scenes.cluttered, 0.02)):
        made = scene(small_scenes.light(kind))
        expected = true_visibility(made, device, size=SIZE, samples=1024)
        error = render(made, device, NAMES[kind], {"size": SIZE}).visibility - expected
        assert np.sqrt(np.nanmean(error**2)) < rmse


def two_patches(apart: bool) -> Scene:
    """A patch over 16 % of a square light and one over 4 %, as seen from the middle of the ground, apart or overlapped."""
    light = RectangleLight(
        center=np.array([0.0, HEIGHT, 0.0]), edge_u=np.array([2.0, 0.0, 0.0]), edge_v=np.array([0.0, 0.0, 2.0])
    )
    x = 0.15 if apart else -0.1
    eye = Camera(np.array([0.0, 1.0, 1.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), 2.0, 0.1, 100.0)
    return small_scenes.scene([ground(), sheet((-0.2, -0.1), 0.4, 4.0), sheet((x, -0.05), 0.1, 2.0)], light, eye)


@pytest.mark.parametrize(
    ("name", "params", "expected"),
    [
        ("wedge_rectangular", {"overlap": "sum"}, (0.20, 0.20)),
        ("wedge_rectangular", {"overlap": "probabilistic"}, (0.18, 0.18)),
        ("wedge_blending_fbp06", {}, (0.20, 0.16)),
    ],
)
def test_two_patches(name: str, params: dict[str, Any], expected: tuple[float, float], device: str) -> None:
    """Sums have 20 % wherever the patches are, equation 1 has 18 %, and cells what is true, to their size."""
    tolerance = 0.035 if name == "wedge_blending_fbp06" else 1e-3
    for apart, covered in zip((True, False), expected, strict=True):
        visible = render(two_patches(apart), device, name, {"size": (8, 6)}, **params).visibility
        assert abs(1.0 - visible[3, 4] - covered) < tolerance, apart


def stacked() -> Scene:
    """Two plates, one above the other: their penumbrae lie on each other."""
    plates = [
        small_scenes.mesh(f"plate {y}", small_scenes.box((0.0, y, 0.0), (1.6, 0.02, 1.6)), receives=False)
        for y in (2.0, 3.0)
    ]
    return small_scenes.scene([ground(), *plates], small_scenes.light("rectangle", (0.0, HEIGHT, 0.0), 2.0))


def test_overlap_is_too_dark_and_who_heals_it(device: str) -> None:
    expected = true_visibility(stacked(), device, size=SIZE, samples=1024)

    def error(name: str, **params: Any) -> np.ndarray:
        return np.asarray(render(stacked(), device, name, {"size": SIZE}, **params).visibility - expected)

    summed, halved = error("wedge_rectangular"), error("wedge_rectangular", overlap="probabilistic")
    cells = error("wedge_blending_fbp06")
    assert np.nanmean(summed) < -0.001 and np.nanmin(summed) < -0.2 and np.nanmax(summed) < 0.05
    assert np.nanmean(summed) < np.nanmean(halved) < -1e-4
    assert abs(np.nanmean(cells)) < 0.2 * abs(np.nanmean(summed)) and np.nanmax(np.abs(cells)) < 0.15


def test_a_silhouette_from_the_centre_misses_what_the_rest_of_the_light_sees(device: str) -> None:
    """A tall box under a wide light: its top hides all that the centre sees, its foot more of the rest. Too light."""
    tall = small_scenes.mesh("tall", small_scenes.box((0.0, 2.0, 0.0), (0.6, 4.0, 0.6)), receives=False)
    scene = small_scenes.scene([ground(), tall], small_scenes.light("rectangle", (0.0, HEIGHT, 0.0), 4.0))
    expected = true_visibility(scene, device, size=SIZE, samples=1024)
    error = [
        render(scene, device, "wedge_rectangular", {"size": SIZE}, light_split=n).visibility - expected
        for n in (1, 2, 4)
    ]
    assert np.nanmean(error[0]) > 0.002 and np.nanmax(error[0]) > 0.1
    rmse = [np.sqrt(np.nanmean(e**2)) for e in error]
    assert rmse[0] > 5.0 * rmse[1] and rmse[1] >= 0.99 * rmse[2]


@pytest.mark.parametrize("make", [stacked, lambda: small_scenes.cluttered(small_scenes.light("rectangle"))])
def test_errors_fall_with_every_split(make: Any, device: str) -> None:
    scene = make()
    expected = true_visibility(scene, device, size=SIZE, samples=1024)
    rmse = []
    for split in (1, 2, 3, 4):
        visible = render(scene, device, "wedge_rectangular", {"size": SIZE}, light_split=split).visibility
        rmse.append(np.sqrt(np.nanmean((visible - expected) ** 2)))
    assert all(b < a for a, b in pairwise(rmse)), rmse


@pytest.mark.parametrize("kind", NAMES)
def test_what_changes_the_cost_changes_no_bit(kind: str, device: str) -> None:
    scene = small_scenes.cluttered(small_scenes.light(kind))
    plain = render(scene, device, NAMES[kind], {"size": SIZE, "threads": 1})
    others = [({}, {"threads": 2}), ({"culling": False}, {}), ({}, {"skips": False})]
    if kind == "rectangle":
        others.append(({"wedge": "sphere_bounded"}, {}))
    for params, options in others:
        image = render(scene, device, NAMES[kind], {"size": SIZE, **options}, **params).visibility
        np.testing.assert_array_equal(image, plain.visibility)


@pytest.mark.parametrize("kind", ["rectangle", "sphere"])
def test_published_tables_and_buffers_are_close(kind: str, device: str) -> None:
    """Tables to a sector's step, buffers to what their bits are worth times the edges that add up."""
    scene = small_scenes.box_on_ground(small_scenes.light(kind))
    plain = render(scene, device, NAMES[kind], {"size": SIZE}).visibility
    bounds = {"table": 2.5 / 256.0, "split12": 8.0 / 4095.0, "lut10": 8.0 / 1023.0, "bits6of8": 8.0 / 63.0}
    for name, bound in bounds.items():
        params = {"coverage": name} if name == "table" else {"buffer": name}
        apart = np.abs(render(scene, device, NAMES[kind], {"size": SIZE}, **params).visibility - plain)
        assert 0.0 < np.nanmax(apart) < bound, name


@wp.kernel
def add_often(first: int, buffer: int, share: float, often: int, sum_out: wp.array(dtype=float)):
    channels = Channels(0)
    for _ in range(often):
        channels = add_code(buffer, channels, stored_code(buffer, share))
    sum_out[first + wp.tid()] = stored_sum(buffer, channels)


def test_twelve_bits_hold_36_sums_and_wrap_at_37(device: str) -> None:
    def summed(buffer: str, share: float, often: int) -> float:
        out = wp.empty(1, dtype=float, device=device)
        launch(add_often, 1, [BUFFERS[buffer], share, often], [out], device=device)
        return float(out.numpy()[0])

    for often in (1, 2, 35, 36):
        assert summed("split12", 1.0, often) == pytest.approx(often, rel=1e-6)
        assert summed("split12", 0.31, often) == pytest.approx(often * round(0.31 * 4095) / 4095, rel=1e-6)
    assert summed("split12", 1.0, 37) == pytest.approx(37 - 256 * 585 / 4095, rel=1e-6)
    assert summed("lut10", 0.3004, 1) == pytest.approx(0.3004, abs=0.6 / 1023)
    assert summed("lut10", 0.3004, 1) != summed("split12", 0.3004, 1)
    assert summed("bits6of8", 1.0, 4) == pytest.approx(4.0) and summed("bits6of8", 1.0, 5) == pytest.approx(
        5 - 256 / 63
    )


@wp.kernel
def find_light_beyond(
    first: int,
    texture: LightTexture,
    ends: wp.array(dtype=wp.vec4),
    textured_out: wp.array(dtype=float),
    plain_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    e = ends[i]
    textured_out[i] = light_beyond(texture, e)
    plain_out[i] = beyond_in_square(e[0], e[1], e[2], e[3])


def test_light_beyond_an_edge_is_the_texture_s_integral(device: str) -> None:
    """Of a constant texture the area; of any other a sum over points of the region."""
    rng = np.random.default_rng(4)
    ends = rng.uniform(-1.0, 1.0, (300, 4))

    def both(texels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        outs = [wp.empty(len(ends), dtype=float, device=device) for _ in range(2)]
        texture = light_texture(Workspace(device), texels, False)
        launch(
            find_light_beyond, len(ends), [texture, wp.array(ends, dtype=wp.vec4, device=device)], outs, device=device
        )
        return outs[0].numpy(), outs[1].numpy()

    for size in ((1, 1), (5, 3)):
        textured, plain = both(np.full(size, 0.7))
        np.testing.assert_allclose(textured, plain, atol=2e-6)
    texels = rng.uniform(0.0, 1.0, (4, 6)) ** 2
    textured, _ = both(texels)
    count = 400
    at = (np.arange(count) + 0.5) * 2.0 / count - 1.0
    x, y = np.meshgrid(at, at)
    light = texels[(np.arange(count) * 4 // count)[:, None], np.arange(count) * 6 // count]
    for k in range(60):
        x0, y0, x1, y1 = ends[k]
        turn = np.sign(x0 * y1 - y0 * x1)
        inside = (turn * (x0 * y - y0 * x) >= 0) & (turn * (x * y1 - y * x1) > 0)
        inside &= turn * ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) < 0
        assert abs(textured[k] - turn * (light * inside).sum() / light.sum()) < 4e-3


def test_a_texture_is_seen(device: str) -> None:
    """A light that is bright at one end moves the penumbra: near the reference, far from the plain light."""
    texels = np.full((4, 8), 0.05)
    texels[:, 6:] = 1.0
    scene, plain = (
        small_scenes.scene([ground(), sheet((0.0, 0.0), 2.0, 3.0)], rectangle(2.0, 2.0, t)) for t in (texels, None)
    )
    expected = true_visibility(scene, device, size=SIZE, samples=1024)
    exact = render(scene, device, "wedge_textured", {"size": SIZE}).visibility
    stored = render(scene, device, "wedge_textured", {"size": SIZE}, coverage="table").visibility
    other = render(plain, device, "wedge_textured", {"size": SIZE}).visibility
    rmse = {
        name: np.sqrt(np.nanmean((v - expected) ** 2))
        for name, v in (("exact", exact), ("table", stored), ("other", other))
    }
    assert rmse["exact"] < 0.003 and rmse["table"] < 0.02 and rmse["other"] > 0.03, rmse


STIFF: dict[str, tuple[float, float, float]] = {
    "edge through the centre": (1.3, HEIGHT, -0.2),
    "light in a caster": (0.3, 2.0, -0.2),
    "edges behind the light": (0.3, 0.8, 0.4),
    "light on the ground": (2.0, 0.0, 0.0),
    "far away": (300.0, 800.0, 0.0),
}


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("where", STIFF)
def test_wherever_the_light_is_visibility_is_a_share(where: str, kind: str, device: str) -> None:
    scene = small_scenes.box_on_ground(small_scenes.light(kind, STIFF[where], 0.5))
    visible = render(scene, device, NAMES[kind], {"size": SIZE}).visibility
    expected = true_visibility(scene, device, size=SIZE, samples=256)
    seen = np.isfinite(expected)
    assert np.isfinite(visible[seen]).all() and (visible[seen] >= 0.0).all() and (visible[seen] <= 1.0).all()
    if where not in ("light on the ground", "light in a caster"):  # there the light itself is cut
        assert np.sqrt(np.mean((visible - expected)[seen] ** 2)) < 0.02


def test_broken_triangles_change_nothing(device: str) -> None:
    """Triangles without an area, and corners that are no numbers."""
    plain = small_scenes.box_on_ground(small_scenes.light("rectangle"))
    box = plain.meshes[1]
    vertices = np.concatenate([box.vertices, [(np.nan, 0.0, 0.0), (0.3, 2.0, -0.2)]])
    faces = np.concatenate([box.faces, [[0, 0, 1], [1, 2, 8], [9, 9, 9]]]).astype(np.int32)
    broken = replace(plain, meshes=(plain.meshes[0], replace(box, vertices=vertices, faces=faces)))
    images = [render(scene, device, "wedge_rectangular", {"size": SIZE}).visibility for scene in (plain, broken)]
    np.testing.assert_allclose(images[0], images[1], atol=1e-6)


@pytest.mark.parametrize("kind", NAMES)
def test_offsets_of_a_million_cost_nothing(kind: str, device: str) -> None:
    scene = small_scenes.box_on_ground(small_scenes.light(kind))
    offset = np.array([1e6, -1e6, 1e6])
    meshes = tuple(replace(mesh, vertices=mesh.vertices + offset) for mesh in scene.meshes)
    eye = scene.camera(0)
    moved = replace(eye, eye=eye.eye + offset, target=eye.target + offset)
    far = replace(scene, meshes=meshes, lights=(scene.lights[0].moved(offset),), camera=lambda frame: moved)
    images = [render(made, device, NAMES[kind], {"size": SIZE}).visibility for made in (scene, far)]
    seen = np.isfinite(images[0])
    assert (np.abs(images[0] - images[1])[seen] > 2e-3).mean() < 0.002


@pytest.mark.parametrize("kind", NAMES)
def test_a_light_that_shrinks_becomes_the_volumes(kind: str, device: str) -> None:
    scene = small_scenes.box_on_ground(small_scenes.light(kind, size=1e-4))
    hard = render(scene, device, "shadow_volume_zfail", {"size": SIZE}).visibility
    soft = render(scene, device, NAMES[kind], {"size": SIZE}).visibility
    seen = np.isfinite(hard) & ~edge_band(hard)
    np.testing.assert_allclose(soft[seen], hard[seen], atol=1e-6)


def test_silhouettes_are_found_once_for_light_and_casters(device: str) -> None:
    scene = replace(small_scenes.cluttered(small_scenes.light("sphere")), camera=small_scenes.circling(3.0))
    results = render_frames(open_session(scene, device, size=(64, 48)), technique("wedge_spherical"), 3)
    found = [[name for name, _ in result.passes] for result in results]
    assert Product.SILHOUETTES.value in found[0] and Product.WEDGES.value in found[0]
    for names in found[1:]:
        assert Product.SILHOUETTES.value not in names and Product.WEDGES.value not in names and "penumbrae" in names


def lamps() -> list[Light]:
    return [small_scenes.light("rectangle"), SphereLight(center=np.array([0.0, HEIGHT, 0.0]), radius=0.7)]


@pytest.mark.parametrize("light", lamps(), ids=["rectangle", "sphere"])
def test_no_pixel_next_to_a_hard_edge_is_wrong_by_the_whole_light(light: Light, device: str) -> None:
    """Where the drawn count is of the other side of an edge, receivers are counted again: no speckles in 300 000 pixels."""
    ball = small_scenes.mesh("ball", small_scenes.sphere((0.2, 2.0, 0.1), 1.0, 400), receives=False)
    scene = small_scenes.scene([ground(), ball], light)
    visible = render(scene, device, NAMES[light.kind], {"size": (640, 480)}).visibility
    inner = visible[1:-1, 1:-1]
    around = np.stack([visible[:-2, 1:-1], visible[2:, 1:-1], visible[1:-1, :-2], visible[1:-1, 2:]])
    flat = np.isfinite(around).all(axis=0) & (np.ptp(around, axis=0) < 0.2)
    assert flat.sum() > 100000
    assert np.abs(inner - around.mean(axis=0))[flat].max() < 0.1
