"""Every wrong scene file ends in one InputError with file, line and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.scenes import load_scene
from wkernels.errors import InputError

GOOD = """\
meshes:
  - {primitive: box, size: [1, 1, 1]}
lights:
  - {kind: rectangle, center: [0, 10, 0], edge_u: [2, 0, 0], edge_v: [0, 0, 2]}
camera: {eye: [0, 2, 5], target: [0, 0, 0]}
path: {frames: 3, keyframes: [{frame: 0, eye: [0, 2, 5], target: [0, 0, 0]}, {frame: 2, eye: [1, 2, 5], target: [0, 0, 0]}]}
"""
BOX = "{primitive: box, size: [1, 1, 1]}"
RECTANGLE = "{kind: rectangle, center: [0, 10, 0], edge_u: [2, 0, 0], edge_v: [0, 0, 2]}"
EYE = "eye: [0, 2, 5], target: [0, 0, 0]}\npath"
KEYS = "keyframes: [{frame: 0, eye: [0, 2, 5], target: [0, 0, 0]}, {frame: 2, eye: [1, 2, 5], target: [0, 0, 0]}]"

WRONG = [
    # what is replaced, by what, line of the mistake, words of the message
    ("meshes:", "mesh:", 1, ["mesh", "Did you mean 'meshes'"]),
    ("meshes:", "imprt: a.glb\nmeshes:", 1, ["imprt", "Did you mean 'import'"]),
    (BOX, "{primitive: box, size: [1, 1, 1], cast: false}", 2, ["meshes.0.cast", "Did you mean 'casts'"]),
    (BOX, "{primitve: box, size: [1, 1, 1]}", 2, ["meshes.0.primitve", "Did you mean 'primitive'"]),
    (BOX, "{primitive: bos, size: [1, 1, 1]}", 2, ["'bos'", "Did you mean 'box'"]),
    (BOX, "{primitive: box, size: [1, -1, 1]}", 2, ["meshes.0.size.1", "at least 1e-12", "-1"]),
    (BOX, "{primitive: box, size: [1, .nan, 1]}", 2, ["meshes.0.size.1", "finite"]),
    (BOX, "{primitive: box, size: [1, .inf, 1]}", 2, ["meshes.0.size.1", "finite"]),
    (BOX, "{primitive: box, size: wide}", 2, ["meshes.0.size", "list", "'wide'"]),
    (BOX, "{primitive: box, size: [1, 1]}", 2, ["meshes.0.size", "too few"]),
    (BOX, "{primitive: box}", 2, ["meshes.0.size", "required"]),
    (BOX, "{primitive: sphere, radius: true}", 2, ["meshes.0.radius", "number", "true"]),
    (BOX, "{primitive: grid, size: [1, 1], cells: 2.5}", 2, ["meshes.0.cells", "whole number"]),
    (BOX, "{primitive: box, size: [1, 1, 1], file: a.obj}", 2, ["only one of", "primitive", "file"]),
    (BOX, "{size: [1, 1, 1]}", 2, ["primitive, file, generate"]),
    (BOX, "box", 2, ["meshes.0", "mapping"]),
    (BOX, "{primitive: box, size: [1, 1, 1], transform: {scale: 0}}", 2, ["transform.scale", "at least 1e-12"]),
    (BOX, "{primitive: box, size: [1, 1, 1], transform: {rotate: [0, 1, 0]}}", 2, ["Did you mean 'rotate_deg'"]),
    (BOX, "{primitive: box, size: [1, 1, 1], diffuse: [1, 2, 0]}", 2, ["meshes.0.diffuse.1", "at most 1"]),
    (BOX, "{primitive: box, size: [1, 1, 1], motion: {keyframes: []}}", 2, ["motion.keyframes", "at least 1"]),
    (
        BOX,
        "{primitive: box, size: [1, 1, 1], motion: {keyframes: [{frame: 4}, {frame: 4}]}}",
        2,
        ["motion.keyframes.1.frame", "rising order"],
    ),
    (BOX, f"{BOX[:-1]}, name: a}}\n  - {BOX[:-1]}, name: a}}", 3, ["meshes.1.name", "'a'"]),
    (BOX, "{file: nowhere.obj}", 2, ["no such file", "nowhere.obj"]),
    (BOX, "{file: bunny.sbj}", 2, ["no such file", "bunny.sbj"]),
    (BOX, "{file: no/where/nowhere.obj}", 2, ["no such file", "no folder"]),
    (BOX, "{file: 'warp:buny.usd'}", 2, ["no such file", "Did you mean 'bunny.usd'"]),
    (BOX, "{file: notes.txt}", 2, ["no known mesh format", ".obj"]),
    (BOX, "{file: empty.obj}", 2, ["meshes.0.file", "empty.obj", "no triangles"]),
    (BOX, "{file: nan.obj}", 2, ["meshes.0.file", "nan.obj", "no finite vertices"]),
    (BOX, "{file: broken.glb}", 2, ["meshes.0.file", "broken.glb", "cannot be read"]),
    (BOX, "{file: broken.usd}", 2, ["meshes.0.file", "broken.usd", "cannot be read"]),
    (BOX, "{generate: pari}", 2, ["meshes.0.generate", "Did you mean 'paris'"]),
    (BOX, "{generate: paris, triangels: 255000}", 2, ["meshes.0.triangels", "Did you mean 'triangles'"]),
    (BOX, "{generate: paris, triangles: 3}", 2, ["meshes.0.triangles", "at least"]),
    (BOX, "{generate: overlap, seed: one}", 2, ["meshes.0.seed", "whole number"]),
    (RECTANGLE, "{kind: rectangel, center: [0, 1, 0]}", 4, ["lights.0.kind", "Did you mean 'rectangle'"]),
    (RECTANGLE, "{knid: rectangle, center: [0, 1, 0]}", 4, ["lights.0.knid", "Did you mean 'kind'"]),
    (RECTANGLE, "{center: [0, 1, 0]}", 4, ["lights.0", "needs the key kind"]),
    (RECTANGLE, "{kind: rectangle, centre: [0, 1, 0]}", 4, ["lights.0.centre", "Did you mean 'center'"]),
    (RECTANGLE, RECTANGLE.replace("[0, 0, 2]", "[4, 0, 0]"), 4, ["lights.0.edge_v", "parallel"]),
    (RECTANGLE, RECTANGLE.replace("}", ", texture: no.png}"), 4, ["lights.0.texture", "no such file"]),
    (RECTANGLE, RECTANGLE.replace("}", ", texture: notes.txt}"), 4, ["lights.0.texture", "cannot be read as an image"]),
    (RECTANGLE, RECTANGLE.replace("}", ", radiance: [1, -1, 1]}"), 4, ["lights.0.radiance.1", "at least 0"]),
    (RECTANGLE, "{kind: sphere, center: [0, 1, 0], radius: -1}", 4, ["lights.0.radius", "at least 0", "-1"]),
    (RECTANGLE, "{kind: directional, direction: [0, 0, 0]}", 4, ["lights.0.direction", "zero vector"]),
    (RECTANGLE, "{kind: directional, direction: [0, 1, 0], angle_deg: 180}", 4, ["angle_deg", "less than 180"]),
    (RECTANGLE, "{kind: disc, center: [0, 1, 0], normal: [0, 0, 0], radius: 1}", 4, ["lights.0.normal", "zero vector"]),
    (RECTANGLE, "{kind: polygon, vertices: [[0, 1, 0], [1, 1, 0]]}", 4, ["lights.0.vertices", "at least 3"]),
    (RECTANGLE, "{kind: polygon, vertices: [[0, 1, 0], [1, 1, 0], [2, 1, 0]]}", 4, ["lights.0.vertices", "no area"]),
    (
        RECTANGLE,
        "{kind: polygon, vertices: [[0, 1, 0], [1, 1, 0], [1, 1.2, 1], [0, 1, 1]]}",
        4,
        ["lights.0.vertices", "planar"],
    ),
    (
        RECTANGLE,
        "{kind: polygon, vertices: [[0, 1, 0], [2, 1, 0], [0.5, 1, 0.5], [0, 1, 2]]}",
        4,
        ["lights.0.vertices", "convex"],
    ),
    (
        RECTANGLE,  # a pentagram turns the same way at every corner
        "{kind: polygon, vertices: [[0, 1, 1], [0.588, 1, -0.809], [-0.951, 1, 0.309], [0.951, 1, 0.309], [-0.588, 1, -0.809]]}",
        4,
        ["lights.0.vertices", "convex"],
    ),
    (
        RECTANGLE,
        RECTANGLE.replace("}", ", motion: {keyframe: []}}"),
        4,
        ["lights.0.motion", "Did you mean 'keyframes'"],
    ),
    (
        RECTANGLE,
        RECTANGLE.replace("}", ", motion: {keyframes: [{frame: 4}, {frame: 2}]}}"),
        4,
        ["lights.0.motion.keyframes.1.frame", "rising order"],
    ),
    (
        RECTANGLE,
        "{kind: directional, direction: [0, -1, 0], motion: {keyframes: [{frame: 0, translate: [1, 0, 0]}]}}",
        4,
        ["lights.0.motion.keyframes.0.translate", "rotate_deg"],
    ),
    (
        RECTANGLE,
        "{kind: sphere, center: [0, 1, 0], radius: 1, motion: {keyframes: [{frame: 0, scale: [1, 2, 1]}]}}",
        4,
        ["lights.0.motion.keyframes.0.scale", "round"],
    ),
    ("lights:\n  - " + RECTANGLE, "lights: []", 3, ["lights", "at least 1"]),
    ("camera: {eye", "camera: {fov_deg: 190, eye", 5, ["camera.fov_deg", "less than 180"]),
    ("camera: {eye", "camera: {near: 5, far: 5, eye", 5, ["camera.far", "greater than near"]),
    ("camera: {eye", "camera: {up: [0, 0, 0], eye", 5, ["camera.up", "zero vector"]),
    (GOOD.split("\n")[4] + "\n" + GOOD.split("\n")[5], "camera: {fov_deg: 60}", 5, ["camera", "eye is required"]),
    (
        GOOD.split("\n")[4] + "\n" + GOOD.split("\n")[5],
        "camera: {eye: [0, 1, 0], target: [0, 1, 0]}",
        5,
        ["on the target"],
    ),
    ("frames: 3", "frames: 0", 6, ["path.frames", "at least 1"]),
    (KEYS, "keyframes: []", 6, ["path.keyframes", "at least 1"]),
    ("frame: 2", "frame: 0", 6, ["path.keyframes.1.frame", "rising order"]),
    ("eye: [1, 2, 5]", "eye: [1, 2, five]", 6, ["path.keyframes.1.eye.2", "number", "'five'"]),
    ("eye: [1, 2, 5]", "eye: [0, 0, 0]", 6, ["path", "on the target at frame 2"]),
    (KEYS, "orbit: {center: [0, 0, 0], radius: 0}", 6, ["path.orbit.radius", "at least 1e-12"]),
    (KEYS, KEYS + ", orbit: {center: [0, 0, 0], radius: 1}", 6, ["exactly one of"]),
    (", " + KEYS, "", 6, ["exactly one of", "there is none"]),
    ("frames: 3, " + KEYS, "orbit: {center: [0, 0, 0], radius: 1}", 6, ["path.frames", "required"]),
    (KEYS, "file: nowhere.csv", 6, ["path.file", "no such file"]),
    (KEYS, "file: notes.txt", 6, ["path.file", ".csv or .json"]),
]


@pytest.fixture()
def folder(tmp_path: Path) -> Path:
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv nan 0 1\nv nan 1 0\nf 1 2 3\n")
    (tmp_path / "broken.glb").write_bytes(b"glTF nonsense")
    (tmp_path / "broken.usd").write_bytes(b"nonsense")
    return tmp_path


def test_the_scene_that_the_wrong_ones_are_made_from_is_right(folder: Path):
    file = folder / "scene.yaml"
    file.write_text(GOOD)
    assert load_scene(file).frames == 3


@pytest.mark.parametrize(("old", "new", "line", "words"), WRONG, ids=[f"{i}-{w[3][0]}" for i, w in enumerate(WRONG)])
def test_wrong_scene(folder: Path, old: str, new: str, line: int, words: list[str]):
    assert GOOD.count(old) >= 1
    file = folder / "scene.yaml"
    file.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_scene(file)
    message = str(caught.value)
    assert message.startswith(f"{file}:{line}: "), message
    for word in words:
        assert word in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "text", "line", "word"),
    [
        ("a.csv", "0,0,1,5,0,0,0\n1,0,1,five,0,0,0\n", 2, "eye_z: must be a number"),
        ("b.csv", "0,0,1,5,0,0\n", 1, "7 columns"),
        ("c.csv", "0,0,1,5,0,0,0\n0,0,1,5,0,0,0\n", 2, "rising order"),
        ("d.csv", "0,0,1,5,0,0,nan\n", 1, "finite"),
        ("e.csv", "0.5,0,1,5,0,0,0\n", 1, "whole number"),
        ("j.csv", "0,0,1,5,0,0,1e300\n", 1, "too large"),
        ("f.csv", "\n", None, "no keyframes"),
        ("g.json", '[{"frame": 0, "eye": [0,1,5],\n "traget": [0,0,0]}]', 2, "Did you mean 'target'"),
        (
            "h.json",
            '[{"frame": 3, "eye": [0,1,5], "target": [0,0,0]},\n{"frame": 1, "eye": [0,1,5], "target": [0,0,0]}]',
            2,
            "rising",
        ),
        ("i.json", "{}", 1, "list"),
    ],
)
def test_wrong_path_file(folder: Path, name: str, text: str, line: int | None, word: str):
    (folder / name).write_text(text)
    file = folder / "scene.yaml"
    file.write_text(GOOD.replace(KEYS, f"file: {name}"))
    with pytest.raises(InputError) as caught:
        load_scene(file)
    place = f"{folder / name}:{line}: " if line else f"{folder / name}: "
    assert str(caught.value).startswith(place), str(caught.value)
    assert word in str(caught.value)


def test_missing_scene_file(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path / "nowhere.yaml")


def test_wrong_dict_has_no_file_but_the_key():
    with pytest.raises(InputError) as caught:
        load_scene({"meshes": [{"primitive": "box", "size": [1, 1, float("nan")]}], "lights": [{}], "camera": {}})
    assert caught.value.file is None
    assert caught.value.key == "meshes.0.size.2"
