"""The key ``views`` of an experiment file: defaults, mistakes with file, line and key, and the way there and back."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.kinds.walkthrough.config import load_experiment
from experiments.schema.experiment import Experiment
from experiments.schema.view_kinds import KINDS
from wkernels.errors import InputError

HEAD = """\
kind: walkthrough
scene:
  meshes: [{primitive: plane, size: [8, 8]}]
  lights: [{kind: directional, direction: [0, -1, 0]}]
  camera: {eye: [0, 3, 5], target: [0, 0, 0], fov_deg: 45, near: 0.1, far: 50}
image: {width: 48, height: 32}
techniques: [shadow_map, pcf]
frames: {start: 2, stop: 12, step: 2}
"""


def load(tmp_path: Path, text: str, *overrides: str) -> Experiment:
    path = tmp_path / "e.yaml"
    path.write_text(HEAD + text)
    return load_experiment(path, overrides)


def test_defaults_are_filled_in(tmp_path: Path) -> None:
    assert load(tmp_path, "").views is None
    views = load(tmp_path, "views: {}\n").views
    assert views is not None and views.image is not None
    assert (views.frames, views.labels, views.modes, views.texels) == ([2], None, ["det"], None)
    assert views.kinds == list(KINDS)
    assert (views.image.width, views.image.height) == (48, 32)
    assert views.third_person.eye is None and views.third_person.fov_deg == 50.0


@pytest.mark.parametrize(
    ("text", "frames"),
    [("[6, 2]", [2, 6]), ("{start: 0, stop: 7, step: 3}", [6]), ("{stop: 100}", [2, 4, 6, 8, 10])],
)
def test_frames_are_those_that_are_rendered(tmp_path: Path, text: str, frames: list[int]) -> None:
    views = load(tmp_path, f"views: {{frames: {text}}}\n").views
    assert views is not None and views.frames == frames


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "{kinds: frusta}",
        "{frames: [4, 8], kinds: [depth_map, frusta], labels: [pcf], modes: [x, det], texels: 8}",
        "{third_person: {azimuth_deg: 30, distance: 2.0}, image: {width: 320, height: 200}}",
        "{kinds: all, third_person: {eye: [1, 2, 3], target: [0, 0, 0], up: [0, 0, 1], fov_deg: 30}}",
    ],
)
def test_the_resolved_file_gives_the_same_views(tmp_path: Path, text: str) -> None:
    first = load(tmp_path, f"views: {text}\n")
    (tmp_path / "again.yaml").write_text(first.to_yaml())
    again = load_experiment(tmp_path / "again.yaml")
    assert again.views == first.views and again.to_yaml() == first.to_yaml()


def test_overrides(tmp_path: Path) -> None:
    views = load(tmp_path, "", "views.kinds=[texel_borders]", "views.third_person.azimuth_deg=10").views
    assert views is not None and views.kinds == ["texel_borders"] and views.third_person.azimuth_deg == 10.0
    assert load(tmp_path, "views: {}\n", "views=").views is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{kind: all}", "views.kind: is not a known key. Did you mean 'kinds'?"),
        (
            "{kinds: [depth_map, texel_border]}",
            "views.kinds.1: there is no view 'texel_border'. Did you mean 'texel_borders'",
        ),
        ("{kinds: [all, frusta]}", "views.kinds.0: there is no view 'all'"),
        ("{kinds: []}", "views.kinds: must have at least 1 item"),
        ("{kinds: frustum}", "views.kinds: there is no view 'frustum'. Did you mean 'frusta'"),
        ("{kinds: 3}", "views.kinds: must be a word or a list, not 3"),
        ("{kinds: [frusta, frusta]}", "views.kinds.1: frusta is listed twice"),
        (
            "{frames: [2, 3]}",
            "views.frames.1: frame 3 is not rendered; the frames of this experiment are 2, 4, ..., 10",
        ),
        ("{frames: {stop: 2}}", "views.frames: none of these frames is rendered"),
        ("{labels: [pfc]}", "views.labels.0: no technique has the label 'pfc'. Did you mean 'pcf'?"),
        ("{modes: [z]}", "views.modes.0: 'z' is not a valid name"),
        ("{texels: 0}", "views.texels: must be at least 1"),
        ("{third_person: {eye: [0, 1]}}", "views.third_person.eye: has too few items"),
        ("{third_person: {eye: [0, 1, 2], distance: 2}}", "views.third_person: has an eye already; distance"),
        ("{third_person: {eye: [0, 1, 2], target: [0, 1, 2]}}", "must not be the same point"),
        ("{third_person: {up: [0, 0, 0]}}", "must not be the zero vector"),
        ("{third_person: {fov_deg: 180}}", "views.third_person.fov_deg: must be less than 180"),
        ("{third_person: {elevation: 3}}", "views.third_person.elevation: is not a known key. Did you mean 'elev"),
        ("{image: {width: 0, height: 3}}", "views.image.width: must be at least 1"),
    ],
)
def test_a_mistake_is_named_with_file_line_and_key(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as error:
        load(tmp_path, f"views: {text}\n")
    message = str(error.value)
    assert expected in message and "e.yaml:9" in message, message
