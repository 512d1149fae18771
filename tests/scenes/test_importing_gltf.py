"""glTF scenes: what is imported renders as the same scene written by hand, and what cannot be is refused or told."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import GltfFile

from experiments import reference_visibility
from experiments.scenes import load_scene, primitives
from wkernels.errors import InputError
from wkernels.scene.geometry import Geometry
from wkernels.temporal.mesh_motion import mesh_motion

FPS = 10
TURN = [0.0, np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))]  # 40 degrees about y
DOWN = [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # -z becomes -y


def plane_and_box() -> tuple[GltfFile, int, int]:
    file = GltfFile()
    ground = file.mesh(*primitives.plane((12.0, 12.0)))
    box = file.mesh(*primitives.box((1.0, 1.0, 1.0)))
    return file, ground, box


def rich_file(path: Path) -> Path:
    """Two cameras, three lights, an animated node with an animated light below it, and instances in a hierarchy."""
    file, ground, box = plane_and_box()
    file.node(mesh=ground, name="ground")
    child = file.node(root=False, mesh=box, translation=[1.5, 0, 0], scale=[0.5, 2.0, 0.5], name="child")
    file.node(children=[child], mesh=box, translation=[-2, 1, 0], rotation=TURN, name="parent")
    lamp = file.node(root=False, translation=[0, 3, 0], extensions=file.light(type="point", intensity=5.0))
    mover = file.node(children=[lamp], mesh=box, name="mover")
    file.node(rotation=DOWN, extensions=file.light(type="directional", color=[1, 0.5, 0.25]))
    file.node(translation=[0, 5, 1], rotation=DOWN, extensions=file.light(type="spot", spot={}))
    file.json["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": np.radians(50.0), "znear": 0.5, "zfar": 60.0}},
        {"type": "orthographic", "orthographic": {"xmag": 6.0, "ymag": 4.0, "znear": 0.0, "zfar": 60.0}},
    ]
    tilt = np.radians(-35.0)
    look = [np.sin(tilt / 2), 0, 0, np.cos(tilt / 2)]
    file.node(camera=0, translation=[0, 7, 10], rotation=look, name="eye")
    file.node(camera=1, translation=[0, 9, 0], rotation=DOWN, name="plan")
    file.animate((mover, "translation", [0.0, 1.0], [[0, 1, 2], [3, 1, 2]]))
    return file.write(path)


BY_HAND: dict[str, Any] = {
    "meshes": [
        {"primitive": "plane", "size": [12, 12]},
        {
            "primitive": "box",
            "size": [1, 1, 1],
            "transform": {"translate": [-2, 1, 0], "rotate_deg": [0, 40, 0]},
        },
        {
            "primitive": "box",
            "size": [0.5, 2, 0.5],
            "transform": {
                "translate": [-2 + 1.5 * np.cos(np.radians(40)), 1, -1.5 * np.sin(np.radians(40))],
                "rotate_deg": [0, 40, 0],
            },
        },
        {
            "primitive": "box",
            "size": [1, 1, 1],
            "motion": {"keyframes": [{"frame": 0, "translate": [0, 1, 2]}, {"frame": FPS, "translate": [3, 1, 2]}]},
        },
    ],
    "lights": [
        {
            "kind": "point",
            "position": [0, 3, 0],
            "radiance": [5, 5, 5],
            "motion": {"keyframes": [{"frame": 0, "translate": [0, 1, 2]}, {"frame": FPS, "translate": [3, 1, 2]}]},
        },
        {"kind": "directional", "direction": [0, -1, 0], "radiance": [1, 0.5, 0.25]},
        {"kind": "point", "position": [0, 5, 1]},
    ],
    "camera": {
        "eye": [0, 7, 10],
        "target": [0, 7 - np.sin(np.radians(35)), 10 - np.cos(np.radians(35))],
        "fov_deg": 50,
        "near": 0.5,
        "far": 60,
    },
}


def same_visibility(a: Any, b: Any, *, frame: int = 0, light: int = 0, samples: int = 1) -> float:
    """Checks that two scenes look the same but for pixels on edges, which may flip by rounding; returns the lit share."""
    size = {"frame": frame, "width": 64, "height": 40, "light": light, "samples": samples}
    (one, _), (other, _) = reference_visibility(a, **size), reference_visibility(b, **size)
    assert np.array_equal(np.isnan(one), np.isnan(other))
    seen = ~np.isnan(one)
    assert seen.sum() > 500
    assert np.mean(np.abs(one - other)[seen] > 1e-6) <= 0.002  # matrices are multiplied in another order
    return float(np.nanmean(one))


@pytest.fixture
def rich(tmp_path: Path) -> dict[str, Any]:
    return {"import": str(rich_file(tmp_path / "rich.gltf")), "fps": FPS}


@pytest.mark.filterwarnings("ignore:.*spot light")
@pytest.mark.parametrize("light", [0, 1, 2])
@pytest.mark.parametrize("frame", [0, 7])
def test_renders_as_the_scene_written_by_hand(rich: dict[str, Any], light: int, frame: int) -> None:
    assert same_visibility(rich, BY_HAND, frame=frame, light=light) < 0.98


@pytest.mark.filterwarnings("ignore:.*spot light")
def test_what_came_in(rich: dict[str, Any]) -> None:
    scene, twin = load_scene(rich), load_scene(BY_HAND)
    assert [mesh.name for mesh in scene.meshes] == ["ground", "parent", "child", "mover"]
    assert [mesh.moving for mesh in scene.meshes] == [False, False, False, True]
    assert scene.frames == FPS + 1
    assert scene.meshes[1].vertices is scene.meshes[3].vertices  # one shape, several instances
    for frame in (0, 3, 10, 99):
        for own, other in zip(scene.meshes, twin.meshes, strict=True):
            np.testing.assert_allclose(
                np.ptp(own.vertices @ own.object_to_ws(frame)[:3, :3].T, axis=0),
                np.ptp(other.vertices @ other.object_to_ws(frame)[:3, :3].T, axis=0),
                atol=1e-6,
            )
        for index in range(3):
            own, other = scene.light(index, frame), twin.light(index, frame)
            assert (own.kind, own.radiance) == (other.kind, other.radiance)
            np.testing.assert_allclose(own.centre, other.centre, atol=1e-12)
    assert "4 meshes of 2 shapes, 1 of them moving" in scene.notes[0]
    assert "eye (perspective), plan (orthographic)" in scene.notes[0]
    assert any("spot" in note for note in scene.notes)


@pytest.mark.filterwarnings("ignore:.*spot light")
def test_keys_beside_it_override(rich: dict[str, Any]) -> None:
    scene = load_scene({**rich, "light_size": 0.5, "light_angle_deg": 2, "camera": {"fov_deg": 20, "far": 30}})
    assert [light.kind for light in scene.lights] == ["sphere", "directional", "sphere"]
    assert [light.size for light in scene.lights] == pytest.approx([0.5, np.radians(2.0), 0.5])
    camera = scene.camera(0)
    assert (camera.fov_deg, camera.near, camera.far) == (20, 0.5, 30)
    np.testing.assert_allclose(camera.eye, [0, 7, 10])
    other = load_scene(
        {
            **rich,
            "camera": {"eye": [0, 5, 5], "target": [0, 0, 0]},
            "lights": ["from_file", {"kind": "point", "position": [0, 9, 0]}],
            "meshes": [{"primitive": "disc", "radius": 1}],
            "animation": "none",
        }
    )
    assert other.frames == 1 and not any(mesh.moving for mesh in other.meshes)
    assert len(other.lights) == 4 and other.meshes[-1].name == "disc"
    assert other.camera(0).fov_deg == pytest.approx(50) and other.camera(0).eye.tolist() == [0, 5, 5]
    plan = load_scene({**rich, "camera": "plan"}).camera(0)
    assert plan.height == 8.0
    np.testing.assert_allclose(plan.target - plan.eye, [0, -1, 0], atol=1e-7)


@pytest.mark.filterwarnings("ignore:.*spot light")
def test_hash_sees_what_moves(rich: dict[str, Any]) -> None:
    hashes = [load_scene({**rich, **more}).content_hash for more in ({}, {}, {"fps": 11}, {"animation": "none"})]
    assert hashes[0] == hashes[1] and len(set(hashes)) == 3


def test_skin_and_morph_targets_deform(tmp_path: Path) -> None:
    """A strip whose upper end hangs on a joint that moves sideways, above a plane that a morph target lifts."""
    file, ground, _ = plane_and_box()
    strip = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, 2.5, 0], [-0.5, 2.5, 0]])
    joints = np.array([[0, 1, 0, 0]] * 4)
    weights = np.array([[1, 0, 0, 0]] * 2 + [[0, 1, 0, 0]] * 2, float)
    skinned = file.mesh(
        strip,
        [[0, 1, 2], [0, 2, 3]],
        attributes={"JOINTS_0": file.accessor(joints), "WEIGHTS_0": file.accessor(weights)},
    )
    lifted = file.mesh(
        strip + np.array([3, 0, 0]),
        [[0, 1, 2], [0, 2, 3]],
        targets=[{"POSITION": file.accessor(np.tile([0.0, 1.0, 0.0], (4, 1)))}],
    )
    low = file.node(name="low")
    high = file.node(name="high", translation=[0, 0, 0])
    file.json["skins"] = [{"joints": [low, high]}]
    file.node(mesh=ground)
    file.node(mesh=skinned, skin=0, translation=[50, 0, 0], name="skinned")  # the node's own pose has no part
    morphing = file.node(mesh=lifted, name="lifted")
    file.animate((high, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]]), (morphing, "weights", [0, 1], [0.0, 1.0]))
    keys = {
        "import": str(file.write(tmp_path / "skin.gltf")),
        "camera": {"eye": [0, 5, 9], "target": [0, 1, 0]},
        "lights": [{"kind": "point", "position": [0, 6, -3]}],
    }
    scene = load_scene({**keys, "fps": 4})
    shape = {mesh.name: mesh for mesh in scene.meshes}
    assert [shape[name].moving for name in ("skinned", "lifted")] == [True, True]
    np.testing.assert_allclose(shape["skinned"].vertices_at(2), strip + np.outer([0, 0, 1, 1], [0.5, 0, 0]))
    np.testing.assert_allclose(shape["skinned"].object_to_ws(2), np.eye(4))
    np.testing.assert_allclose(shape["lifted"].vertices_at(4), strip + np.array([3, 1, 0]))
    at_end = {
        "meshes": [
            {"primitive": "plane", "size": [12, 12]},
            {"file": str(_obj(tmp_path / "a.obj", shape["skinned"].vertices_at(4)))},
            {"file": str(_obj(tmp_path / "b.obj", strip + np.array([3, 1, 0])))},
        ],
        "camera": {"eye": [0, 5, 9], "target": [0, 1, 0], "far": scene.camera(0).far, "near": scene.camera(0).near},
        "lights": [{"kind": "point", "position": [0, 6, -3]}],
    }
    assert same_visibility(scene, at_end, frame=4) < 0.98
    motion, _ = mesh_motion(Geometry(scene), 3, 2)
    assert [bool(np.abs(one[:3, 3]).max() > 1e12) for one in motion] == [False, True, True]  # no matrix follows them
    assert np.array_equal(mesh_motion(Geometry(scene), 9, 8)[0], np.tile(np.eye(4), (3, 1, 1)))  # they rest

    geometry = Geometry(load_scene({**keys, "fps": 24}))
    geometry.set_frame(12)
    assert not geometry.resting  # their poses stay the same, their shapes do not
    geometry.set_frame(60)
    assert {geometry.meshes[i].name for i in geometry.resting} == {"skinned", "lifted"}


def _obj(path: Path, vertices: np.ndarray) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    path.write_text("\n".join([*lines, "f 1 2 3", "f 1 3 4", ""]))
    return path


@pytest.mark.parametrize(
    ("kind", "values", "middle"),
    [
        ("LINEAR", [[0, 0, 0], [4, 0, 0]], 2.0),
        ("STEP", [[0, 0, 0], [4, 0, 0]], 0.0),
        # tangents in units per second: a Hermite curve from 0 with slope 0 to 4 with slope 8 over a second
        ("CUBICSPLINE", [[9, 0, 0], [0, 0, 0], [0, 0, 0], [8, 0, 0], [4, 0, 0], [9, 0, 0]], 2.0 - 8.0 / 8.0),
    ],
)
def test_interpolations(tmp_path: Path, kind: str, values: list, middle: float) -> None:
    file, _, box = plane_and_box()
    node = file.node(mesh=box)
    file.animate((node, "translation", [0, 1], values), kind=kind)
    scene = load_scene(with_view(file.write(tmp_path / "a.gltf"), fps=2))
    assert scene.frames == 3
    assert [scene.meshes[0].object_to_ws(i)[0, 3] for i in range(3)] == pytest.approx([0, middle, 4])


def with_view(path: Path, **more: Any) -> dict[str, Any]:
    return {
        "import": str(path),
        "camera": {"eye": [0, 5, 9], "target": [0, 0, 0]},
        "lights": [{"kind": "point", "position": [0, 4, 6]}],
        **more,
    }


def test_instances_and_mirrors(tmp_path: Path) -> None:
    file, _, box = plane_and_box()
    attributes = {
        "TRANSLATION": file.accessor([[0.0, 0, 0], [3, 0, 0]]),
        "SCALE": file.accessor([[1.0, 1, 1], [2, 2, 2]]),
    }
    file.node(
        mesh=box, name="two", translation=[0, 1, 0], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    )
    file.node(mesh=box, name="mirror", scale=[-1, 1, 1])
    file.json |= {"extensionsUsed": ["EXT_mesh_gpu_instancing"], "extensionsRequired": ["EXT_mesh_gpu_instancing"]}
    scene = load_scene(with_view(file.write(tmp_path / "i.gltf")))
    assert [mesh.name for mesh in scene.meshes] == ["two", "two_2", "mirror"]
    np.testing.assert_allclose(
        scene.meshes[1].object_to_ws(0), [[2, 0, 0, 3], [0, 2, 0, 1], [0, 0, 2, 0], [0, 0, 0, 1]]
    )
    np.testing.assert_array_equal(scene.meshes[2].faces, scene.meshes[0].faces[:, ::-1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"extensionsRequired": ["EXT_nobody_knows"]}, "requires EXT_nobody_knows"),
        ({"animations": [{"channels": [{"sampler": 3, "target": {}}]}]}, "uses sampler 3"),
        ({"nodes": [{"mesh": 0, "translation": ["x", 0, 0]}]}, "translation of node 0"),
        ({"nodes": [{"camera": 7}]}, "number 7 of its cameras"),
        ({"nodes": [{"extensions": {"KHR_lights_punctual": {"light": 2}}}]}, "uses light 2"),
        ({"nodes": [{"children": [0]}]}, "child of several nodes, or of itself"),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    file, ground, _ = plane_and_box()
    file.node(mesh=ground)
    file.json |= change
    with pytest.raises(InputError, match=message):
        load_scene(with_view(file.write(tmp_path / "broken.gltf")))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"camera": "from_file"}, "camera: is required: the file has no camera"),
        ({"camera": "eye"}, "the file has no camera 'eye'"),
        ({"lights": "from_file"}, "there is no light"),
        ({"lights": "from_flie"}, "from_file"),
        ({"animation": "walk"}, "no animation 'walk'"),
        ({"import": "none.gltf"}, "no such file"),
        ({"import": "scene.yaml"}, "of no format"),
        ({"light_size": 0}, "light_size"),
        ({"light_siez": 1}, "light_size"),
        ({"camera": {"eye": [0, 1, 2]}}, "target is required"),
    ],
)
def test_wrong_keys_are_refused(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    file, ground, _ = plane_and_box()
    file.node(mesh=ground)
    keys = {**with_view(file.write(tmp_path / "ground.gltf")), **more}
    (tmp_path / "scene.yaml").write_text(json.dumps(keys))
    with pytest.raises(InputError, match=message) as caught:
        load_scene(tmp_path / "scene.yaml")
    assert "scene.yaml" in str(caught.value)


def test_nothing_is_dropped_in_silence(tmp_path: Path) -> None:
    file, ground, box = plane_and_box()
    file.json["materials"] = [{"alphaMode": "BLEND"}]
    file.json["meshes"][box]["primitives"][0]["material"] = 0
    file.json["extensionsUsed"] = ["EXT_nobody_knows"]
    file.node(mesh=ground)
    node = file.node(mesh=box)
    file.animate((node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]]), name="walk")
    file.animate((node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]]), name="run")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load_scene(with_view(file.write(tmp_path / "told.gltf")))
    told = [str(one.message) for one in caught]
    for word in ("BLEND", "EXT_nobody_knows", "'run'"):
        assert any(word in message for message in told) and any(word in note for note in scene.notes)
