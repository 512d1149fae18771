"""Plateaus, penumbra maps and smoothies against their closed forms, and their errors with their sign."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_scenes
from sessions import open_session, render, render_frames, technique, true_visibility

from algorithms.plugins import find
from experiments import render_visibility
from experiments.scenes import analytic, load_scene
from experiments.schema.needs import unmet_need
from wkernels.frame.session import FrameResult
from wkernels.scene.lights import Light
from wkernels.scene.model import Scene

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
NAMES = ("plateaus", "penumbra_maps", "smoothies")
MAPS = ("penumbra_maps", "smoothies")
SIZE = (200, 150)
TEXEL = 0.02
"""Of a penumbra 1 wide: what half a texel of 4096 on the ground, and the slope of the ramp there, make a difference."""


def ramp_of(name: str, share: np.ndarray, z_v: float, z_p: float, nearness: float) -> np.ndarray:
    """What a technique makes of a share of the way across the outer penumbra.

    Args:
        name: The technique.
        share: 0 at the hard shadow, 1 at the penumbra's border.
        z_v, z_p: Depths of silhouette and receiver.
        nearness: Mean of one over the silhouette's distance from the light.
    """
    share = np.clip(share, 0.0, 1.0)
    if name == "penumbra_maps":
        z_f = 1.0 / (1.0 / z_v - share * (1.0 / z_v - 1.0 / z_p))  # where the receiver's ray meets the cone
        return np.clip((z_f - z_v) / (z_p - z_v), 0.0, 1.0)
    return np.clip(share * (1.0 / z_v / nearness if name == "smoothies" else 1.0), 0.0, 1.0)


def rendered(scene: str, name: str, **params: Any) -> tuple[np.ndarray, np.ndarray]:
    """Visibility and place of each receiver pixel."""
    if name in MAPS:
        params["resolution"] = 4096
    result = render_visibility(SCENES / f"{scene}.yaml", name, params, width=160, height=120)
    seen = np.isfinite(result.visibility)
    return result.visibility[seen].astype(float), result.world_position[seen].astype(float)


@pytest.mark.parametrize("name", NAMES)
def test_round_a_disc(name: str) -> None:
    """A3: umbra as large as the hard shadow, whatever the light; outer border exact."""
    lit, position = rendered("a3_coaxial_discs", name)
    radius = np.hypot(position[:, 0], position[:, 2])
    umbra, hard, outer = analytic.a3_radii()
    expected = ramp_of(name, (radius - hard) / (outer - hard), 5.0, 10.0, 1.0 / np.hypot(5.0, 1.5))
    assert ((lit > 0.05) & (lit < 0.95)).sum() > 500
    np.testing.assert_allclose(lit, expected, atol=TEXEL if name in MAPS else 5e-4)  # the disc is a polygon
    # the sign: nothing of the light that comes round the rim inside of the hard shadow
    truth = analytic.a3_coaxial_discs(position)
    inside = (radius > umbra + 0.1) & (radius < hard - 0.1)
    assert (lit[inside] == 0.0).all() and truth[inside].mean() > 0.15
    assert (lit - truth)[radius < outer].mean() < -0.05


@pytest.mark.parametrize("name", ["plateaus", "penumbra_maps"])
def test_beside_a_half_plane(name: str) -> None:
    """A2: the outer half of the penumbra, 1 wide at height 0."""
    lit, position = rendered("a2_half_plane_disc", name)
    assert ((lit > 0.05) & (lit < 0.95)).sum() > 500
    expected = ramp_of(name, position[:, 0] / 1.0, 5.0, 10.0, 0.2)
    np.testing.assert_allclose(lit, expected, atol=TEXEL if name in MAPS else 1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_the_umbra_knows_nothing_of_the_light(name: str, device: str) -> None:
    """Too dark, and the more the larger the light is, until it has no umbra at all."""
    errors = []
    for size in (0.5, 2.0, 10.0):
        scene = small_scenes.box_on_ground(small_scenes.light("sphere", size=size))
        seen = render(scene, device, name, {"size": SIZE}).visibility
        truth = true_visibility(scene, device, size=SIZE)
        hard = true_visibility(scene, device, size=SIZE, centre=True) == 0.0
        assert np.mean(seen[hard] == 0.0) > 0.98
        errors.append(float(np.nanmean(seen - truth)))
    assert truth[hard].min() > 0.0  # no umbra is left
    assert 0.0 > errors[0] > errors[1] > errors[2], errors


def stacked(light: Light) -> Scene:
    """A low plate whose shadow ends within the penumbra of a high one."""
    return small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(14.0), casts=False),
            small_scenes.mesh("high", small_scenes.box((-4.0, 6.0, 0.0), (7.0, 0.1, 9.0)), receives=False),
            small_scenes.mesh("low", small_scenes.box((-4.31, 1.5, 0.0), (7.0, 0.1, 3.0)), receives=False),
        ],
        light,
        small_scenes.camera((3.0, 4.0, 5.0), (0.5, 0.0, 0.0)),
    )


def test_of_smoothies_that_overlap_the_nearest_to_the_light_wins(device: str) -> None:
    """Where the low plate's shadow ends it is lit by what the high one's penumbra leaves, not dark as it should be."""
    scene = stacked(small_scenes.light("sphere", size=1.2))
    images = {name: render(scene, device, name, {"size": (400, 300)}).visibility for name in NAMES}
    darkest = images["plateaus"]
    lost = (images["smoothies"] > darkest + 0.3) & (darkest < 0.2)
    assert lost.sum() > 30
    assert ((images["penumbra_maps"] > darkest + 0.3) & (darkest < 0.2)).sum() < 0.2 * lost.sum()


@pytest.mark.parametrize("name", NAMES)
def test_penumbrae_narrow_towards_contact(name: str, device: str) -> None:
    """A wall that stands on the ground: its shadow's edge widens with the height that throws it."""
    wall = small_scenes.mesh("wall", small_scenes.box((0.0, 1.5, 0.0), (0.2, 3.0, 4.0)), receives=False)
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0), casts=False)
    light = small_scenes.light("sphere", (-9.0, 8.0, 0.0), size=1.5)
    scene = small_scenes.scene([ground, wall], light, small_scenes.camera((2.0, 9.0, 0.01), (2.0, 0.0, 0.0)))
    result = render(scene, device, name, {"size": (320, 240)}, **({"resolution": 2048} if name in MAPS else {}))
    position = result.world_position
    soft = (result.visibility > 0.02) & (result.visibility < 0.98)
    width = [soft[(np.abs(position[..., 0] - x) < 0.1) & (position[..., 2] > 0.0)].sum() for x in (0.4, 1.5, 3.0)]
    assert width[0] < width[1] < width[2], width


def test_plateaus_lie_on_planes_alone(device: str) -> None:
    """What is not flat has the hard shadow."""
    lamp = small_scenes.light("sphere", (1.5, 9.0, 2.0), size=2.0)
    bumpy = small_scenes.mesh("ground", small_scenes.terrain(12.0, 12, 0.3), casts=False)
    box = small_scenes.box_on_ground(lamp).meshes[1]
    scene = small_scenes.scene([bumpy, box], lamp)
    soft, hard = (
        render(scene, device, name, {"size": SIZE}).visibility for name in ("plateaus", "shadow_volume_zfail")
    )
    np.testing.assert_array_equal(soft, hard)
    assert unmet_need(find("plateaus"), scene, lamp) is not None


@pytest.mark.parametrize(
    "projection",
    [
        {"fit": "focused", "warp": "none"},
        {"fit": "focused", "warp": "lispsm_nopt"},
        {"fit": "focused", "splits": 3, "scheme": "practical", "storage": "atlas4"},
    ],
    ids=["focused", "warped", "splits"],
)
@pytest.mark.parametrize("kind", ["sphere", "directional"])
@pytest.mark.parametrize("name", MAPS)
def test_maps_of_any_projection(name: str, kind: str, projection: dict[str, Any], device: str) -> None:
    """Distances are those of the light's plane, not of the texels."""
    if kind == "directional" and name == "smoothies":
        return
    scene = small_scenes.box_on_ground(small_scenes.light(kind, (1.5, 9.0, 2.0), 2.0))
    plain, mapped = (
        render(scene, device, name, {"size": SIZE, **options}, resolution=2048).visibility
        for options in ({}, {"projection": projection})
    )
    difference = np.abs(plain - mapped)
    assert np.nanmean(difference > 0.05) < 0.004 and np.nanmax(plain) == 1.0 and (plain == 0.0).any()


@pytest.mark.parametrize("name", MAPS)
def test_a_light_amid_its_casters_has_six_maps(name: str, device: str) -> None:
    """Penumbrae go on across the faces of the cube."""
    light = small_scenes.light("sphere", (0.2, 1.9, 1.6), 0.4)
    scene = small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False),
            small_scenes.mesh("box", small_scenes.box((0.3, 0.6, -0.4), (2.0, 0.6, 1.2)), receives=False),
        ],
        light,
    )
    soft = render(scene, device, name, {"size": SIZE}).visibility
    wide = render(scene, device, "plateaus", {"size": SIZE}).visibility
    assert ((soft > 0.05) & (soft < 0.95)).sum() > 100
    assert np.sqrt(np.nanmean((soft - wide) ** 2)) < 0.12


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_found_twice_for_a_light_and_casters_that_stand(name: str, device: str) -> None:
    scene = small_scenes.box_on_ground(small_scenes.light("sphere"), small_scenes.circling(3.0))
    session = open_session(scene, device, size=(64, 48))
    first, second = (
        {pass_name for pass_name, _ in result.passes} for result in render_frames(session, technique(name), 2)
    )
    kept = {"silhouettes", "caster edges", "caster components"}
    kept |= {"volumes", "receiver planes"} if name == "plateaus" else {"surfaces seen from the light"}
    kept |= {"penumbra_maps": {"penumbra map"}, "smoothies": {"smoothie buffer"}}.get(name, set())
    assert kept <= first and not kept & second


def test_what_moves_moves_its_penumbra(device: str) -> None:
    """Of a receiver too, which is no caster: the map of surfaces knows it."""
    light = small_scenes.light("sphere", (1.5, 9.0, 2.0), 3.0)
    still = small_scenes.box_on_ground(light)

    def lift(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[1, 3] = 0.9 * (frame > 0)
        return out

    ground = replace(still.meshes[0], object_to_ws=lift, moving=True)
    scene = replace(still, meshes=(ground, still.meshes[1]))
    for name in NAMES:
        session = open_session(scene, device, size=SIZE)
        moved = render_frames(session, technique(name), 2)[1]
        fresh = open_session(scene, device, size=SIZE)
        (alone,) = render_frames(fresh, technique(name), 1, 1)
        np.testing.assert_array_equal(moved.visibility, alone.visibility)


def test_smoothies_have_no_place_under_the_sun() -> None:
    sun = small_scenes.light("directional")
    message = unmet_need(find("smoothies"), small_scenes.box_on_ground(sun), sun)
    assert message is not None and "directional" in message
    assert all(unmet_need(find(name), small_scenes.box_on_ground(sun), sun) is None for name in NAMES[:2])


def test_width_of_smoothies(device: str) -> None:
    """Twice the width, half the slope; none is the hard shadow."""
    scene = small_scenes.box_on_ground(small_scenes.light("sphere", size=2.0))

    def seen(width: float) -> FrameResult:
        return render(scene, device, "smoothies", {"size": SIZE}, width=width)

    narrow, wide = seen(1.0).visibility, seen(2.0).visibility
    soft = (wide > 0.1) & (wide < 0.45)
    assert soft.sum() > 50
    np.testing.assert_allclose(narrow[soft], 2.0 * wide[soft], atol=0.02)
    np.testing.assert_array_equal(seen(0.0).visibility, render(scene, device, "shadow_map", {"size": SIZE}).visibility)


def test_scene_files_of_analytic_scenes_suit_them() -> None:
    for name in NAMES:
        for scene in ("a2_half_plane_disc", "a3_coaxial_discs"):
            loaded = load_scene(SCENES / f"{scene}.yaml")
            assert unmet_need(find(name), loaded, loaded.lights[0]) is None
