"""Small scenes of any scale: far objects, long grounds, lights beside walls, units, movers at rest, turns. Right values."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from experiments.api import reference_visibility, render_visibility
from experiments.commands.render import render_image
from experiments.scenes import load_scene
from wkernels.errors import InputError
from wkernels.scene.geometry import Geometry

CASES = Path(__file__).parent / "cases"
SIZE: dict[str, Any] = {"width": 320, "height": 180}
SUN = {"kind": "directional", "direction": [0.5, -1, 0.2], "angle_deg": 6.0}


def keys(name: str) -> dict[str, Any]:
    out: dict[str, Any] = yaml.safe_load((CASES / name).read_text())
    return out


def with_box(scene: dict[str, Any], place: list[float]) -> dict[str, Any]:
    """A scene with one more box of size 1."""
    box = {"primitive": "box", "size": [1, 1, 1], "transform": {"translate": place}}
    return {**scene, "meshes": [*scene["meshes"], box]}


def truth(scene: Any, **options: Any) -> np.ndarray:
    return reference_visibility(scene, cache=False, **{**SIZE, **options})[0]


def shown(scene: Any, technique: str, **options: Any) -> np.ndarray:
    return render_visibility(scene, technique, **{**SIZE, **options}).visibility


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean((a - b) ** 2)))


def changed(a: np.ndarray, b: np.ndarray) -> float:
    """Share of pixels that are not the same; those without a receiver are."""
    return float(np.mean((a != b) & ~(np.isnan(a) & np.isnan(b))))


# ---- far objects ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9, 1e12])
def test_a_far_box_changes_no_bit_of_the_reference(distance: float) -> None:
    near = keys("near.yaml")
    for scene in (near, {**near, "lights": [SUN]}):
        plain = truth(scene, samples=16)
        assert np.nanmin(plain) == 0.0
        for place in ([distance, 0.0, 0.0], [0.0, 0.0, -distance]):
            np.testing.assert_array_equal(truth(with_box(scene, place), samples=16), plain)


def test_the_case_has_its_value() -> None:
    assert np.nanmean(truth(CASES / "far.yaml")) == pytest.approx(0.9486, abs=5e-5)


@pytest.mark.parametrize("technique", ["shadow_map", "pcss", "vsm", "tc_soft_paper", "tc_adaptive", "alias_free"])
def test_a_far_box_changes_no_bit_of_a_technique(technique: str) -> None:
    near = {**keys("near.yaml"), "lights": [SUN]}
    options: dict[str, Any] = {"frames": 3, "width": 160, "height": 90}
    plain = shown(near, technique, **options)
    for distance in (1e3, 1e9):
        np.testing.assert_array_equal(shown(with_box(near, [distance, 0.0, 0.0]), technique, **options), plain)


def test_a_caster_far_towards_the_sun_costs_no_other_shadow() -> None:
    near = keys("near.yaml")
    up = -1e6 * np.array(near["lights"][0]["direction"])
    result = render_visibility(with_box(near, [*up]), "shadow_map", **SIZE)
    np.testing.assert_array_equal(result.visibility, shown(near, "shadow_map"))
    assert any(what == "casters in light maps" for what, *_ in result.left_out)


@pytest.mark.parametrize("size", [1e3, 1e5, 1e6])
def test_a_ground_seen_from_its_corner_is_as_one_of_its_own_size(size: float) -> None:
    near = keys("near.yaml")
    camera = {**near["camera"], "near": 0.1, "far": 100.0}
    small = {**near, "meshes": [{"primitive": "plane", "size": [200, 200]}, *near["meshes"][1:]], "camera": camera}
    middle = 0.5 * size - 100.0
    ground = {"primitive": "plane", "size": [size, size], "transform": {"translate": [middle, 0, -middle]}}
    far = {**small, "meshes": [ground, *near["meshes"][1:]]}
    assert changed(truth(far), truth(small)) < 2e-3  # pixels at edges
    for technique in ("shadow_map", "vsm"):
        picture = shown(far, technique, projection={"fit": "focused", "splits": 4})
        assert rmse(picture, truth(far)) < 0.04


# ---- depth ranges, lights beside walls --------------------------------------------------------------------------------


def test_moments_are_relative_to_their_own_layer() -> None:
    scene, splits = CASES / "vsm.yaml", {"fit": "focused", "splits": 4}
    right = truth(scene)
    assert rmse(shown(scene, "vsm", projection=splits), right) < 0.013
    assert rmse(shown(scene, "pcf", projection=splits), right) < 0.013


@pytest.mark.parametrize("distance", [1e-2, 1e-4, 1e-5])
def test_a_light_beside_a_wall_keeps_the_walls_shadow(distance: float) -> None:
    scene = keys("wall.yaml")
    scene["lights"][0]["position"][2] = -distance
    right = truth(scene)
    assert np.nanmean(right) == pytest.approx(0.0612, abs=3e-4)
    assert changed(shown(scene, "projection_shadows"), right) < 2e-3


# ---- motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("technique", ["tc_soft_paper", "tc_soft_thesis", "tc_adaptive"])
def test_a_mover_that_rests_converges(technique: str) -> None:
    frames: dict[str, Any] = {"frame": 100, "frames": 101, "width": 160, "height": 90}
    right = truth(CASES / "still.yaml", samples=1024, width=160, height=90)
    still, rests = (rmse(shown(CASES / f"{name}.yaml", technique, **frames), right) for name in ("still", "lift"))
    assert rests < max(1.3 * still, 0.006) and rests < 0.02


@pytest.mark.parametrize("technique", ["tc_soft_paper", "tc_soft_thesis", "tc_adaptive", "tc_hard"])
def test_nothing_is_left_of_the_shadow_of_what_leaves_its_rest(technique: str) -> None:
    """The mover rests for 20 frames and goes in one step: where its shadow was nothing may be remembered."""
    scene = keys("lift.yaml")
    scene["meshes"][2]["motion"]["keyframes"] = [{"frame": 0}, {"frame": 20}, {"frame": 21, "translate": [-40, 0, 0]}]
    frames: dict[str, Any] = {"frame": 21, "frames": 22, "width": 160, "height": 90}
    gone = {**scene, "meshes": scene["meshes"][:2]}
    left = shown(scene, technique, **frames)
    shadow = truth(keys("still.yaml"), samples=64, width=160, height=90) < 0.1
    lit = shadow & (truth(gone, samples=64, width=160, height=90) == 1.0)
    assert lit.sum() > 100
    assert np.nanmean(left[lit]) > 0.97  # edges of the body's own penumbra may be filtered


def test_keyframes_turn_by_the_angles_that_they_name() -> None:
    mesh = load_scene(CASES / "spin.yaml").meshes[1]
    assert mesh.moving

    def angle(frame: int) -> float:
        pose = mesh.object_to_ws(frame)
        return float(np.degrees(np.arctan2(pose[0, 2], pose[0, 0])) % 360.0)

    assert [angle(frame) for frame in (0, 15, 45, 60, 75)] == pytest.approx([0.0, 60.0, 180.0, 240.0, 300.0])


@pytest.mark.parametrize("turn", [270.0, -270.0, 180.0, -180.0, 720.0])
def test_turns_of_half_a_circle_and_more(turn: float) -> None:
    scene = keys("spin.yaml")
    scene["meshes"][1]["motion"]["keyframes"][1]["rotate_deg"] = [0, turn, 0]
    pose = load_scene(scene).meshes[1].object_to_ws(30)
    third = np.radians(turn / 3.0)
    np.testing.assert_allclose(pose[:3, :3][0], [np.cos(third), 0.0, np.sin(third)], atol=1e-12)


def test_a_light_turns_a_whole_turn_too() -> None:
    scene = keys("near.yaml")
    frames = [{"frame": 0}, {"frame": 40, "rotate_deg": [0, 360, 0]}]
    scene["lights"][0]["motion"] = {"keyframes": frames}
    loaded = load_scene(scene)
    way = loaded.lights[0].centre[:3]
    np.testing.assert_allclose(loaded.light(0, 20).centre[:3], way * (-1.0, 1.0, -1.0), atol=1e-12)


def test_tc_hard_refuses_a_light_that_moves() -> None:
    scene = keys("near.yaml")
    scene["lights"][0]["motion"] = {"keyframes": [{"frame": 0}, {"frame": 40, "rotate_deg": [0, 90, 0]}]}
    with pytest.raises(InputError, match="'tc_hard' is made for lights that stand still"):
        shown(scene, "tc_hard")


# ---- depth planes -----------------------------------------------------------------------------------------------------


def scaled(factor: float) -> dict[str, Any]:
    """near.yaml in other units."""
    scene = keys("near.yaml")
    for mesh in scene["meshes"]:
        mesh["size"] = [factor * length for length in mesh["size"]]
        if "transform" in mesh:
            mesh["transform"]["translate"] = [factor * length for length in mesh["transform"]["translate"]]
    for key in ("eye", "target"):
        scene["camera"][key] = [factor * length for length in scene["camera"][key]]
    return scene


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_depth_planes_follow_the_unit(factor: float) -> None:
    right = truth(keys("near.yaml"))
    assert changed(right, truth(scaled(factor))) < 1e-3
    picture = shown(scaled(factor), "shadow_map", projection={"fit": "focused", "warp": "lispsm_nopt"})
    assert rmse(picture, right) < 0.05


def test_depth_planes_stay_where_a_scene_fits() -> None:
    for place in (None, [1e3, 0, 0], [1e12, 0, 0]):
        scene = keys("near.yaml") if place is None else with_box(keys("near.yaml"), place)
        camera = load_scene(scene).camera(0)
        assert (camera.near, camera.far) == (0.1, 1000.0)


def test_depth_planes_that_are_given_stay_and_the_other_follows() -> None:
    scene = keys("near.yaml")
    scene["camera"]["near"] = 2000.0
    camera = load_scene(scene).camera(0)
    assert camera.near == 2000.0 < camera.far
    del scene["camera"]["near"]
    scene["camera"]["far"] = 0.01
    camera = load_scene(scene).camera(0)
    assert camera.near < camera.far == 0.01


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"near": 0.1, "far": 1000.0}, r"camera\.far \(1000\) hides all receivers, which lie 1\d{3} and more"),
        ({"near": 90000.0, "far": 1e6}, r"camera\.near \(90000\) hides all receivers"),
        ({"target": [800, 9000, 2500]}, r"outside the field of view"),
    ],
)
def test_an_empty_picture_says_which_key_hides_everything(
    changes: dict[str, Any], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = keys("mm.yaml")
    assert np.isfinite(truth(scene)).any()
    scene["camera"] |= changes
    file = tmp_path / "mm.yaml"
    file.write_text(yaml.safe_dump(scene))
    options = {"frame": 0, "frames": 1, "light": 0, "device": "cpu", "threads": None, "seed": 1}
    lists: dict[str, Any] = {"param_texts": [], "plugin_files": []}
    render_image(file, "shadow_map", tmp_path / "out.exr", **lists, **options, width=64, height=36)
    out = capsys.readouterr().out
    assert "no receiver is seen: " in out and re.search(says, out)


# ---- the origin ---------------------------------------------------------------------------------------------------------


def test_the_origin_of_a_scene_around_the_eye_is_its_middle() -> None:
    near = keys("near.yaml")
    middle = Geometry(load_scene(near)).origin_ws
    np.testing.assert_array_equal(middle, [0.0, 1.0, 0.0])
    for place in ([1e3, 0, 0], [1e12, 1e12, 0]):
        np.testing.assert_array_equal(Geometry(load_scene(with_box(near, place))).origin_ws, middle)


def test_the_origin_leaves_the_middle_where_float32_would_lose_what_is_near() -> None:
    near = keys("near.yaml")
    for size, moved in ((1e3, False), (1e5, True)):
        ground = {"primitive": "plane", "size": [size, size], "transform": {"translate": [0.5 * size, 0, 0.5 * size]}}
        geometry = Geometry(load_scene({**near, "meshes": [ground, *near["meshes"][1:]]}))
        eye = np.array(near["camera"]["eye"])
        assert (np.linalg.norm(geometry.origin_ws - eye) < 10.0) == moved
