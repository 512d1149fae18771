"""Scene files to scenes: primitives, transforms, motion, lights, cameras, names and the content hash."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import trimesh

from experiments.scenes import load_scene
from experiments.scenes.lights import LightWarning
from wkernels.errors import InputError
from wkernels.scene.lights import LIGHT_KINDS

LIGHT = {"kind": "rectangle", "center": [0, 10, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2]}
CAMERA = {"eye": [0, 2, 5], "target": [0, 0, 0]}


def scene(*meshes: dict, **other):
    return load_scene({"meshes": list(meshes), "lights": [LIGHT], "camera": CAMERA, **other})


def solid(mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize(
    ("mesh", "half", "volume", "count"),
    [
        ({"primitive": "box", "size": [2, 1, 3]}, [1, 0.5, 1.5], 6.0, 12),
        ({"primitive": "sphere", "radius": 2, "subdivisions": 4}, [2, 2, 2], 32 / 3 * np.pi, 20 * 4**4),
        ({"primitive": "cylinder", "radius": 1.5, "height": 4}, [1.5, 2, 1.5], 9 * np.pi, None),
    ],
)
def test_solids_are_closed_centred_and_face_outwards(mesh, half, volume, count):
    loaded = scene(mesh).meshes[0]
    shape = solid(loaded)
    assert shape.is_watertight and shape.is_winding_consistent
    assert shape.volume == pytest.approx(volume, rel=0.01)
    np.testing.assert_allclose(shape.bounds, [-np.array(half), np.array(half)], atol=1e-3)
    assert loaded.vertices.dtype == np.float64 and loaded.faces.dtype == np.int32
    if count:
        assert len(loaded.faces) == count


@pytest.mark.parametrize(
    ("mesh", "area", "count"),
    [
        ({"primitive": "plane", "size": [4, 3]}, 12.0, 2),
        ({"primitive": "grid", "size": [4, 3], "cells": 7}, 12.0, 98),
        ({"primitive": "disc", "radius": 2}, 4 * np.pi, None),
    ],
)
def test_flat_primitives_lie_in_xz_and_face_up(mesh, area, count):
    loaded = scene(mesh).meshes[0]
    shape = solid(loaded)
    np.testing.assert_array_equal(loaded.vertices[:, 1], 0.0)
    np.testing.assert_allclose(shape.face_normals, np.tile([0.0, 1.0, 0.0], (len(loaded.faces), 1)), atol=1e-12)
    assert shape.area == pytest.approx(area, rel=2e-4)
    if count:
        assert len(loaded.faces) == count
        np.testing.assert_allclose(shape.bounds, [[-2, 0, -1.5], [2, 0, 1.5]])


def test_transform_scales_then_rotates_about_x_y_z_then_translates():
    angles = np.radians([20.0, 30.0, 40.0])
    cos, sin = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cos[0], -sin[0]], [0, sin[0], cos[0]]])
    about_y = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    about_z = np.array([[cos[2], -sin[2], 0], [sin[2], cos[2], 0], [0, 0, 1]])
    transform = {"translate": [1, 2, 3], "rotate_deg": [20, 30, 40], "scale": [2, 3, 4]}
    mesh = scene({"primitive": "box", "size": [1, 1, 1], "transform": transform}).meshes[0]
    expected = np.eye(4)
    expected[:3, :3] = about_z @ about_y @ about_x @ np.diag([2.0, 3.0, 4.0])
    expected[:3, 3] = [1, 2, 3]
    np.testing.assert_allclose(mesh.object_to_ws(7), expected, atol=1e-14)
    assert not mesh.moving


def test_motion_is_outside_of_the_transform_exact_at_keys_linear_between_and_held():
    keys = [
        {"frame": 10, "translate": [0, 0, 0]},
        {"frame": 20, "translate": [10, 0, 0], "rotate_deg": [0, 90, 0], "scale": 3},
    ]
    mesh = scene(
        {
            "primitive": "box",
            "size": [1, 1, 1],
            "transform": {"translate": [1, 0, 0]},
            "motion": {"keyframes": keys},
        }
    ).meshes[0]
    assert mesh.moving
    origin = np.array([0.0, 0, 0, 1])
    np.testing.assert_array_equal(mesh.object_to_ws(-5), mesh.object_to_ws(10))
    np.testing.assert_array_equal(mesh.object_to_ws(99), mesh.object_to_ws(20))
    np.testing.assert_allclose((mesh.object_to_ws(10) @ origin)[:3], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose((mesh.object_to_ws(20) @ origin)[:3], [10, 0, -3], atol=1e-12)
    half = np.sqrt(0.5) * 2.0
    np.testing.assert_allclose((mesh.object_to_ws(15) @ origin)[:3], [5 + half, 0, -half], atol=1e-12)


def test_motion_without_change_is_not_moving():
    keys = [{"frame": 0, "translate": [1, 0, 0]}, {"frame": 9, "translate": [1, 0, 0]}]
    assert not scene({"primitive": "box", "size": [1, 1, 1], "motion": {"keyframes": keys}}).meshes[0].moving


def test_a_light_moves_as_a_mesh_does():
    keys = [{"frame": 0}, {"frame": 10, "translate": [4, 0, 2], "rotate_deg": [0, 90, 0]}]
    light = {**LIGHT, "motion": {"keyframes": keys}}
    loaded = load_scene({"meshes": [], "lights": [light], "camera": CAMERA})
    still = load_scene({"meshes": [], "lights": [LIGHT], "camera": CAMERA}).lights[0]
    mesh = scene({"primitive": "box", "size": [1, 1, 1], "motion": {"keyframes": keys}}).meshes[0]
    for frame in (-3, 0, 4, 10, 99):
        matrix, moved = mesh.object_to_ws(frame), loaded.light(0, frame)
        np.testing.assert_allclose(moved.centre, matrix @ still.centre, atol=1e-12)
        np.testing.assert_allclose(moved.hull, still.hull @ matrix.T, atol=1e-12)
    constant = {"keyframes": [{"frame": 0, "translate": [1, 0, 0]}, {"frame": 9, "translate": [1, 0, 0]}]}
    placed = load_scene({"meshes": [], "lights": [{**LIGHT, "motion": constant}], "camera": CAMERA}).lights[0]
    assert placed.motion is None
    np.testing.assert_allclose(placed.centre[:3], still.centre[:3] + np.array([1.0, 0.0, 0.0]))


def test_all_light_kinds_load():
    lights = [
        {"kind": "point", "position": [0, 5, 0]},
        {"kind": "directional", "direction": [1, -2, 0], "angle_deg": 0.53},
        LIGHT,
        {"kind": "disc", "center": [0, 5, 0], "normal": [0, -2, 0], "radius": 0},
        {"kind": "sphere", "center": [0, 5, 0], "radius": 1, "radiance": [3, 2, 1]},
        {"kind": "linear", "a": [0, 5, 0], "b": [1, 5, 0]},
        {"kind": "polygon", "vertices": [[0, 5, 0], [1, 5, 0], [2, 5, 0], [2, 5, 1], [0, 5, 1]]},
    ]
    loaded = load_scene({"meshes": [], "lights": lights, "camera": CAMERA}).lights
    assert [light.kind for light in loaded] == [light["kind"] for light in lights]
    assert {light.kind for light in loaded} == set(LIGHT_KINDS)
    assert loaded[4].radiance == (3.0, 2.0, 1.0)
    assert loaded[3].has_area is False
    assert len(loaded[6].vertices) == 4  # the one in the middle of an edge says nothing
    u = np.random.default_rng(0).uniform(size=(16, 3))
    for light in loaded:
        assert np.all(np.isfinite(light.sample(u)))


def test_zero_edges_make_a_rectangle_without_area():
    light = {**LIGHT, "edge_u": [0, 0, 0], "edge_v": [0, 0, 0]}
    with pytest.warns(LightWarning, match="the light is a point"):
        assert not load_scene({"meshes": [], "lights": [light], "camera": CAMERA}).lights[0].has_area


def test_texture_becomes_linear_luminance_with_row_0_on_top(tmp_path: Path):
    pixels = np.zeros((2, 3, 3), np.float32)
    pixels[0, :, 1] = [0.25, 0.5, 1.0]
    image = oiio.ImageBuf(oiio.ImageSpec(3, 2, 3, oiio.FLOAT))
    image.set_pixels(oiio.ROI(), pixels)
    assert image.write(str(tmp_path / "light.exr"))
    light = {**LIGHT, "texture": "light.exr"}
    loaded = load_scene({"meshes": [], "lights": [light], "camera": CAMERA}, base=tmp_path).lights[0]
    np.testing.assert_allclose(loaded.texture, 0.7152 * pixels[..., 1], atol=1e-6)
    grey = oiio.ImageBuf(oiio.ImageSpec(1, 1, 3, oiio.UINT8))
    grey.set_pixels(oiio.ROI(), np.full((1, 1, 3), 188 / 255, np.float32))
    assert grey.write(str(tmp_path / "light.png"))
    light["texture"] = "light.png"
    loaded = load_scene({"meshes": [], "lights": [light], "camera": CAMERA}, base=tmp_path).lights[0]
    assert loaded.texture[0, 0] == pytest.approx(0.5028, abs=1e-3)  # sRGB 188 is half the light


def test_camera_keyframes_are_exact_and_smooth_and_held():
    keys = [
        {"frame": 0, "eye": [0, 1, 5], "target": [0, 0, 0]},
        {"frame": 10, "eye": [1, 1, 5], "target": [0, 0, 0]},
        {"frame": 40, "eye": [4, 3, 5], "target": [0, 1, 0]},
    ]
    loaded = scene(path={"frames": 50, "keyframes": keys})
    assert loaded.frames == 50
    for key in keys:
        np.testing.assert_allclose(loaded.camera(key["frame"]).eye, key["eye"], atol=1e-12)
        np.testing.assert_allclose(loaded.camera(key["frame"]).target, key["target"], atol=1e-12)
    np.testing.assert_array_equal(loaded.camera(-3).eye, loaded.camera(0).eye)
    np.testing.assert_array_equal(loaded.camera(49).eye, loaded.camera(40).eye)
    steps = np.diff([loaded.camera(f).eye for f in range(41)], axis=0)
    assert np.abs(np.diff(steps, axis=0)).max() < 0.02  # no kink at the middle key


def test_orbit_starts_in_front_and_a_full_turn_repeats():
    orbit = {"center": [1, 2, 3], "radius": 4, "height": 1.5}
    loaded = scene(path={"frames": 8, "orbit": orbit})
    np.testing.assert_allclose(loaded.camera(0).eye, [1, 3.5, 7])
    np.testing.assert_allclose(loaded.camera(2).eye, [5, 3.5, 3], atol=1e-12)
    np.testing.assert_allclose(loaded.camera(5).target, [1, 2, 3])
    eyes = np.array([loaded.camera(f).eye for f in range(8)])
    step = np.linalg.norm(np.diff(np.concatenate([eyes, eyes[:1]]), axis=0), axis=1)
    np.testing.assert_allclose(step, step[0])


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_path_files(tmp_path: Path, suffix: str):
    text = {
        "csv": "frame,eye_x,eye_y,eye_z,target_x,target_y,target_z\n0,0,1,5,0,0,0\n\n20, 2,1,5, 0,0.5,0\n",
        "json": '[{"frame": 0, "eye": [0,1,5], "target": [0,0,0]},\n {"frame": 20, "eye": [2,1,5], "target": [0,0.5,0]}]',
    }[suffix]
    (tmp_path / f"path.{suffix}").write_text(text)
    data = {"meshes": [], "lights": [LIGHT], "path": {"file": f"path.{suffix}"}}
    loaded = load_scene(data, base=tmp_path)
    assert loaded.frames == 21
    np.testing.assert_allclose(loaded.camera(10).eye, [1, 1, 5])
    np.testing.assert_allclose(loaded.camera(20).target, [0, 0.5, 0])


def test_names_are_unique_and_options_reach_every_part():
    box = {"primitive": "box", "size": [1, 1, 1]}
    loaded = scene(box, box, {**box, "name": "mine", "casts": False, "diffuse": [0.1, 0.2, 0.3]})
    assert [m.name for m in loaded.meshes] == ["box", "box_2", "mine"]
    assert [m.casts for m in loaded.meshes] == [True, True, False]
    assert loaded.meshes[2].diffuse == (0.1, 0.2, 0.3)
    parts = scene({"generate": "test_plane", "name": "far", "receives": False, "transform": {"translate": [0, 5, 0]}})
    assert parts.name == "test_plane"
    assert [m.name for m in parts.meshes] == ["far/plane", "far/posts"]
    assert not any(m.receives for m in parts.meshes)
    assert all(m.object_to_ws(0)[1, 3] == 5.0 for m in parts.meshes)


def test_dict_and_file_are_the_same_scene(tmp_path: Path):
    text = "meshes: [{primitive: box, size: [1, 2, 3]}]\nlights: [{kind: point, position: [0, 5, 0]}]\n"
    text += "camera: {eye: [0, 2, 5], target: [0, 0, 0]}\n"
    file = tmp_path / "small.yaml"
    file.write_text(text)
    from_file = load_scene(file)
    light = {"kind": "point", "position": (0.0, 5.0, 0.0)}
    box = {"primitive": "box", "size": np.array([1, 2, 3])}
    from_dict = load_scene({"meshes": [box], "lights": [light], "camera": CAMERA})
    assert from_file.name == "small"
    assert from_file.content_hash == from_dict.content_hash
    assert len(from_file.content_hash) == 64


def test_content_hash_follows_pixels_and_nothing_else():
    box = {"primitive": "box", "size": [1, 1, 1]}
    base = scene(box).content_hash
    assert scene({**box, "name": "other"}).content_hash == base
    assert scene({**box, "transform": {"translate": [-0.0, 0, 0]}}).content_hash == base
    motion = {"keyframes": [{"frame": 0}, {"frame": 5, "translate": [0, 1, 0]}]}
    changed = [
        scene({**box, "size": [1, 1, 1.0000001]}),
        scene({**box, "transform": {"translate": [0, 1e-9, 0]}}),
        scene({**box, "motion": motion}),
        scene({**box, "casts": False}),
        scene(box, box),
        scene(box, lights=[{**LIGHT, "edge_u": [2.1, 0, 0]}]),
        scene(box, lights=[{**LIGHT, "radiance": [1, 1, 2]}]),
        scene(box, lights=[{**LIGHT, "motion": motion}]),
        scene(box, lights=[{**LIGHT, "motion": {"keyframes": [*motion["keyframes"], {"frame": 9}]}}]),
        scene(box, camera={**CAMERA, "fov_deg": 61}),
        scene(box, camera={**CAMERA, "eye": [0, 2, 5.5]}),
        scene(box, path={"frames": 2, "orbit": {"center": [0, 0, 0], "radius": 5}}),
    ]
    hashes = [base, *(item.content_hash for item in changed)]
    assert len(set(hashes)) == len(hashes)


def test_names_are_counted_on_and_none_is_taken_twice():
    meshes = [{"primitive": "box", "size": [1, 1, 1], "name": "box_3"}]
    meshes += [{"primitive": "box", "size": [1, 1, 1]} for _ in range(4)]
    scene = load_scene({"meshes": meshes, "lights": [LIGHT], "camera": CAMERA})
    assert [mesh.name for mesh in scene.meshes] == ["box_3", "box", "box_2", "box_4", "box_5"]
    meshes.append({"primitive": "box", "size": [1, 1, 1], "name": "box_4"})
    with pytest.raises(InputError, match=r"meshes\.5\.name: another mesh has the name 'box_4' already"):
        load_scene({"meshes": meshes, "lights": [LIGHT], "camera": CAMERA})


def test_20_000_meshes_load_in_seconds(tmp_path: Path):
    """It took 66 s when every mesh went through the names of all; now 4 on an idle core, and this leaves room."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    rows = "".join(
        f"  - {{{'file: a.obj' if i % 2 else 'primitive: box, size: [1, 1, 1]'}, transform: {{translate: [{i}, 0, 0]}}}}\n"
        for i in range(20_000)
    )
    file = tmp_path / "many.yaml"
    file.write_text(
        f"meshes:\n{rows}lights: [{{kind: point, position: [0, 1, 0]}}]\ncamera: {{eye: [0, 0, 5], target: [0, 0, 0]}}\n"
    )
    begin = time.process_time()
    scene = load_scene(file)
    seconds = time.process_time() - begin
    assert len({mesh.name for mesh in scene.meshes}) == 20_000
    assert scene.meshes[1].vertices is scene.meshes[19_999].vertices  # read once
    assert seconds < 30
