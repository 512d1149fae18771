"""What is not refused, but is not what one would think either: lights without area, an eye along its vertical axis."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from experiments.scenes import load_scene
from experiments.scenes.cameras import CameraWarning
from experiments.scenes.lights import LightWarning
from wkernels.errors import InputError
from wkernels.scene.views import eye_view

SCENE = """\
meshes:
- {primitive: box, size: [1, 1, 1]}
lights:
- kind: rectangle
  center: [0, 10, 0]
  edge_u: [2, 0, 0]
  edge_v: [0, 0, 2]
camera:
  eye: [0, 2, 5]
  target: [0, 0, 0]
  up: [0, 1, 0]
"""
U, V = "edge_u: [2, 0, 0]", "edge_v: [0, 0, 2]"


def load(folder: Path, *changes: tuple[str, str]) -> list[warnings.WarningMessage]:
    """What loading the scene with changes warns of."""
    text = SCENE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "s.yaml").write_text(text)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        load_scene(folder / "s.yaml")
    return told


def test_nothing_is_told_of_an_ordinary_scene(tmp_path: Path) -> None:
    assert not load(tmp_path)
    assert not load(tmp_path, ("up: [0, 1, 0]", "up: [0, 3, 0.01]"))


@pytest.mark.parametrize(
    ("changes", "line", "words"),
    [
        ([(U, "edge_u: [0, 0, 0]")], 6, "lights.0.edge_u: edge_u zero: the light is a line."),
        ([(V, "edge_v: [0, -0.0, 0]")], 7, "lights.0.edge_v: edge_v zero: the light is a line."),
        ([(U, "edge_u: [0, 0, 0]"), (V, "edge_v: [0, 0, 0]")], 6, "edge_u and edge_v zero: the light is a point."),
    ],
)
def test_a_rectangle_without_area_is_told_with_its_line(
    tmp_path: Path, changes: list[tuple[str, str]], line: int, words: str
) -> None:
    (told,) = load(tmp_path, *changes)
    assert told.category is LightWarning
    assert str(told.message).startswith(f"{tmp_path / 's.yaml'}:{line}: ") and words in str(told.message)


@pytest.mark.parametrize("edge", ["[2, 0, 0]", "[-3, 0, 0]", "[1e-9, 0, 0]", "[2e6, 1e-3, 0]"])
def test_parallel_edges_are_refused_with_their_line(tmp_path: Path, edge: str) -> None:
    with pytest.raises(InputError, match="must not be parallel to edge_u") as raised:
        load(tmp_path, (V, f"edge_v: {edge}"))
    assert raised.value.line == 7


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ([("eye: [0, 2, 5]", "eye: [0, 5, 0]")], 11),
        ([("up: [0, 1, 0]", "up: [0, -2, -5]")], 11),
        ([("eye: [0, 2, 5]", "eye: [0, 5, 0]"), ("  up: [0, 1, 0]\n", "")], 8),
        ([("camera:", "path: {frames: 3, keyframes: [{frame: 0, eye: [0, 5, 5], target: [0, 0, 0]}, "
           "{frame: 2, eye: [0, 5, 0], target: [0, 0, 0]}]}\ncamera:"), ("  up: [0, 1, 0]\n", "")], 8),
    ],
)  # fmt: skip
def test_an_eye_that_looks_along_up_is_told_with_its_line(
    tmp_path: Path, changes: list[tuple[str, str]], line: int
) -> None:
    (told,) = load(tmp_path, *changes)
    assert told.category is CameraWarning
    text = str(told.message)
    assert text.startswith(f"{tmp_path / 's.yaml'}:{line}: ") and "looks along camera.up" in text
    assert (" at frame 2" in text) == ("path" in text)


def test_told_is_what_the_view_does() -> None:
    """Just within the limit the view takes another axis for up, just without its own."""
    base = {
        "meshes": [],
        "lights": [{"kind": "point", "position": [0, 1, 0]}],
    }
    for tilt, along in ((0.5e-6, True), (2e-6, False)):
        camera = {"eye": [0, 5, 0], "target": [0, 0, 0], "up": [0.0, 1.0, tilt]}
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            scene = load_scene({**base, "camera": camera})
        view = eye_view(scene.camera(0), 8, 8, np.zeros(3))
        assert bool(told) == along == (abs(view.up_ws[0]) > 0.5)


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ("transform: {translate: [9e11, 0, 0], scale: [4e11, 1, 1]}", "transform"),
        ("transform: {translate: [0, 0, -9e11], rotate_deg: [0, 90, 0], scale: [4e11, 1, 1]}", "transform"),
        ("motion: {keyframes: [{frame: 0}, {frame: 9, translate: [0, -9e11, 0], scale: [1, 4e11, 1]}]}", "motion"),
        ("transform: {scale: 1e6}, motion: {keyframes: [{frame: 3, scale: 2.2e6}]}", "motion"),
    ],
)
def test_a_mesh_that_a_transform_takes_too_far_is_refused_by_name(tmp_path: Path, keys: str, key: str) -> None:
    box = "- {primitive: box, size: [1, 1, 1]}"
    text = SCENE.replace(box, f"- {{primitive: box, size: [1, 1, 1], name: tower,\n   {keys}}}")
    (tmp_path / "s.yaml").write_text(text)
    words = r"takes the mesh 'tower' to a coordinate of 1.1e\+12; lengths beyond 1e\+12 cannot be drawn"
    with pytest.raises(InputError, match=words) as raised:
        load_scene(tmp_path / "s.yaml")
    assert raised.value.line == 3 and raised.value.key == f"meshes.0.{key}"


def test_a_part_of_a_generator_that_is_taken_too_far_is_named() -> None:
    scene = {
        "meshes": [{"generate": "overlap", "name": "far", "transform": {"scale": [1, 1, 1e12]}}],
        "lights": [{"kind": "point", "position": [0, 1, 0]}],
        "camera": {"eye": [0, 2, 5], "target": [0, 0, 0]},
    }
    with pytest.raises(InputError, match=r"meshes.0.transform: takes the mesh 'far/\w+"):
        load_scene(scene)


def test_a_mesh_at_the_limit_is_taken() -> None:
    scene = {
        "meshes": [{"primitive": "box", "size": [1, 1, 1], "transform": {"translate": [1e12, 0, 0]}}],
        "lights": [{"kind": "point", "position": [0, 1, 0]}],
        "camera": {"eye": [0, 2, 5], "target": [0, 0, 0]},
    }
    assert load_scene(scene).meshes[0].object_to_ws(0)[0, 3] == 1e12
