"""Experiment files: what is refused and how, sweeps, labels, overrides, and the resolved form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from algorithms.technique import Needs, Params, setting
from experiments.kinds.walkthrough.config import load_experiment
from experiments.metrics.registry import MAP_METRICS
from experiments.scenes import load_scene
from experiments.schema.experiment import Experiment
from experiments.schema.models import Reference
from experiments.schema.needs import is_closed, is_planar, unmet_need
from wkernels.errors import InputError
from wkernels.scene.model import Mesh

SCENE = """\
meshes:
- {primitive: plane, size: [4, 4]}
- {primitive: box, size: [1, 1, 1], transform: {translate: [0, 1, 0]}}
lights:
- {kind: rectangle, center: [0, 4, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1]}
- {kind: point, position: [0, 4, 0]}
- {kind: directional, direction: [0, -1, 0], angle_deg: 0}
camera: {eye: [3, 3, 3], target: [0, 0, 0], fov_deg: 50, near: 0.1, far: 50}
path: {frames: 6, keyframes: [{frame: 0, eye: [3, 3, 3], target: [0, 0, 0]}, {frame: 5, eye: [3, 3, 2], target: [0, 0, 0]}]}
"""

HEAD = """\
kind: walkthrough
scene: scene.yaml
image: {width: 32, height: 24}
techniques:
"""


class Sharp:
    name = "sharp"
    needs = Needs()

    class Params(Params):
        resolution: int = setting(1024, "texels per side", unit="texels", ge=1, le=8192)
        bias: float = setting(1.0, "bias", unit="texels", ge=0.0)


class Soft:
    name = "soft"
    needs = Needs(area=True)

    class Params(Params):
        taps: int = setting(16, "taps", unit="1", ge=1)
        search: int = setting(8, "taps", unit="1", ge=1)


class Closed:
    name = "closed"
    needs = Needs(lights=frozenset({"point"}), closed_meshes=True)
    Params = Params


PLUGINS: dict[str, type] = {cls.name: cls for cls in (Sharp, Soft, Closed)}
Load = Callable[..., Experiment]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Load:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.yaml").write_text(SCENE)

    def load_text(text: str, *overrides: str) -> Experiment:
        Path("e.yaml").write_text(text)
        return load_experiment("e.yaml", overrides, PLUGINS)

    return load_text


def labels(experiment: Experiment) -> list[str]:
    return [run.label for run in experiment.runs]


def test_defaults_are_filled_in(load: Load) -> None:
    experiment = load(HEAD + "- sharp\n- soft: {taps: 4}\n")
    assert labels(experiment) == ["sharp", "soft"]
    assert experiment.runs[0].params == {"resolution": 1024, "bias": 1.0}
    assert experiment.runs[1].params == {"taps": 4, "search": 8}
    assert experiment.baseline == "sharp"
    assert experiment.frames == (0, 1, 2, 3, 4, 5)  # the scene's path
    assert (experiment.repeats, experiment.seed, experiment.light, experiment.reference) == (1, 1, 0, None)
    assert experiment.metrics == ()
    assert experiment.load_scene().frames == 6


def test_reference_brings_its_metrics(load: Load) -> None:
    experiment = load(HEAD + "- sharp\nreference: {samples: 16}\n")
    assert experiment.reference is not None and experiment.reference.every == 1
    assert experiment.metrics == ("rmse", "mean_signed_error", "p99_error", "flip")


def test_a_group_of_metrics_stands_for_its_members(load: Load) -> None:
    experiment = load(HEAD + "- sharp\nreference: {light: centre}\nmetrics: [rmse, sampling]\n")
    assert experiment.metrics == ("rmse", *MAP_METRICS)
    assert experiment.reference == Reference(samples=1, every=1, light="centre")


@pytest.mark.parametrize(
    ("text", "frames"), [("3", (0, 1, 2)), ("{start: 2, stop: 7, step: 2}", (2, 4, 6)), ("{stop: 1}", (0,))]
)
def test_frames(load: Load, text: str, frames: tuple[int, ...]) -> None:
    assert load(HEAD + f"- sharp\nframes: {text}\n").frames == frames


def test_sweeps_multiply_in_file_order(load: Load) -> None:
    experiment = load(
        HEAD
        + "- soft: {label: s, search: 2, sweep: {taps: [1, 4]}}\n- sharp: {sweep: {resolution: [8, 16], bias: [0, 0.5]}}\n"
    )
    assert labels(experiment) == [
        "s[taps=1]",
        "s[taps=4]",
        "sharp[resolution=8 bias=0]",
        "sharp[resolution=8 bias=0.5]",
        "sharp[resolution=16 bias=0]",
        "sharp[resolution=16 bias=0.5]",
    ]
    assert [run.params for run in experiment.runs[:2]] == [{"taps": 1, "search": 2}, {"taps": 4, "search": 2}]
    assert experiment.runs[3].params == {"resolution": 8, "bias": 0.5}


def test_projection_of_a_run_changes_single_keys(load: Load) -> None:
    experiment = load(HEAD + "- sharp\n- sharp: {label: b, projection: {lambda: 0.9}}\nprojection: {scheme: log}\n")
    first, second = (run.projection for run in experiment.runs)
    assert first is not None and second is not None
    assert (first["scheme"], first["lambda"]) == ("log", 0.5)
    assert (second["scheme"], second["lambda"]) == ("log", 0.9)


def test_the_resolved_file_gives_the_same_experiment(load: Load) -> None:
    first = load(
        HEAD
        + "- sharp: {sweep: {bias: [0, 2]}}\n- soft\nreference: {samples: 4, every: 2}\nframes: {start: 1, stop: 6, step: 2}\n"
        "baseline: soft\nprojection: {lambda: 0.25}\n",
        "seed=7",
    )
    second = load(first.to_yaml())
    assert second.to_yaml() == first.to_yaml()
    assert labels(second) == labels(first)
    assert [run.params for run in second.runs] == [run.params for run in first.runs]
    assert (second.baseline, second.frames, second.seed) == ("soft", (1, 3, 5), 7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("- shrap\n", "e.yaml:5: techniques.0: there is no technique 'shrap'. Did you mean 'sharp'?"),
        ("- sharp\n- soft: {tap: 3}\n", "e.yaml:6: techniques.1.soft.tap: the technique 'soft' has no parameter 'tap'. Did you mean 'taps'?"),
        ("- soft:\n    taps: 0\n", "e.yaml:6: techniques.0.soft.taps: must be at least 1, not 0."),
        ("- soft:\n    taps: '4'\n", "e.yaml:6: techniques.0.soft.taps: must be a whole number, not '4'."),
        ("- soft: 4\n", "e.yaml:5: techniques.0.soft: must be a mapping of parameters to values, not 4."),
        ("- {soft: {}, sharp: {}}\n", "e.yaml:5: techniques.0: must be one technique"),
        ("- soft:\n    sweep:\n      taps:\n      - 4\n      - 0\n", "e.yaml:9: techniques.0.soft.sweep.taps.1: must be at least 1, not 0."),
        ("- soft: {sweep: {taps: []}}\n", "e.yaml:5: techniques.0.soft.sweep.taps: must be a list of at least one value"),
        ("- soft: {sweep: {taps: 4}}\n", "e.yaml:5: techniques.0.soft.sweep.taps: must be a list of at least one value"),
        ("- soft: {sweep: {tips: [4]}}\n", "e.yaml:5: techniques.0.soft.sweep.tips: the technique 'soft' has no parameter"),
        ("- soft: {taps: 1, sweep: {taps: [4]}}\n", "e.yaml:5: techniques.0.soft.sweep.taps: 'taps' is swept and given"),
        ("- sharp\n- soft\n- sharp\n", "e.yaml:7: techniques.2: the label 'sharp' is taken already on line 5"),
        ("- soft: {label: a/b}\n", "e.yaml:5: techniques.0.soft.label: must be at most 100 printable characters"),
        ("- soft: {label: 3}\n", "e.yaml:5: techniques.0.soft.label: must be a name, not 3."),
        (" []\n", "e.yaml:4: techniques: must have at least 1 item, not 0."),
        ("- sharp\nrepeats: 0\n", "e.yaml:6: repeats: must be at least 1, not 0."),
        ("- sharp\nframes: 0\n", "e.yaml:6: frames: must be at least 1"),
        ("- sharp\nframes: {start: 4, stop: 4}\n", "e.yaml:6: frames: holds no frame"),
        ("- sharp\nframes: {start: 4}\n", "e.yaml:6: frames.stop: is required."),
        ("- sharp\nframes: {strat: 4, stop: 5}\n", "e.yaml:6: frames.strat: is not a known key. Did you mean 'start'?"),
        ("- sharp\nfames: 3\n", "e.yaml:6: fames: is not a known key. Did you mean 'frames'?"),
        ("- sharp\nframes: {start: 4, stop: 6}\nlead_in: 5\n", "e.yaml:7: lead_in: there are 4 frames before frame 4, not 5."),
        ("- sharp\nlight: 3\n", "e.yaml:6: light: the scene has 3 light(s); there is no light 3."),
        ("- sharp\nbaseline: shrap\n", "e.yaml:6: baseline: no technique has the label 'shrap'. Did you mean 'sharp'?"),
        ("- sharp\nmetrics: [rmse]\n", "e.yaml:6: metrics.0: the metric 'rmse' needs the key 'reference'"),
        ("- sharp\nmetrics: [flip, rsme]\nreference: {samples: 4}\n", "e.yaml:6: metrics.1: there is no metric 'rsme'. Did you mean 'rmse'?"),
        ("- sharp\nmetrics: [samplin]\n", "e.yaml:6: metrics.0: there is no metric 'samplin'. Did you mean 'sampling'?"),
        ("- sharp\nmetrics: [map_waste, sampling]\n", "e.yaml:6: metrics.1: the metric 'map_waste' is listed twice."),
        ("- sharp\nreference: {samples: 4, light: centre}\n", "e.yaml:6: reference: asks for 4 samples of the light's centre, which is one."),
        ("- sharp\nreference: {light: center}\n", "e.yaml:6: reference.light: 'center' is not a valid name. Did you mean 'centre'?"),
        ("- sharp\nreference: {samples: 0}\n", "e.yaml:6: reference.samples: must be at least 1, not 0."),
        ("- sharp\nprojection: {splits: 17}\n", "e.yaml:6: projection.splits: must be at most 16, not 17."),
        ("- sharp\nprojection: {warp: lispm_nopt}\n", "e.yaml:6: projection.warp: 'lispm_nopt' is not a valid name. Did you mean 'lispsm_nopt'?"),
        ("- sharp\nprojection: {warp: psm}\n", "e.yaml:6: projection.warp: 'psm' needs a fit that follows the eye (focused)"),
        ("- sharp: {projection: {splits: 4}}\n", "e.yaml:5: techniques.0.sharp.projection.splits: 4 needs a fit that follows the eye"),
        ("- soft\nlight: 1\n", "e.yaml:5: techniques.0: 'soft' needs a light with an area; this point light has none"),
        ("- soft\nlight: 2\n", "e.yaml:5: techniques.0: 'soft' needs a light with an area; this directional light has none (give it an angle_deg"),
        ("- closed\n", "e.yaml:5: techniques.0: 'closed' works with lights of kind point; this one is a rectangle light."),
        ("- closed\nlight: 1\n", "e.yaml:5: techniques.0: 'closed' needs closed casters; the mesh 'plane' is open"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_file_line_and_key(load: Load, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load(HEAD + text)
    assert str(caught.value).startswith(expected)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "walkthrough",
            "bench",
            "e.yaml:1: kind: kind 'bench' is not available yet; available: analysis, convergence, savings, stability, sweep, walkthrough.",
        ),
        (
            "walkthrough",
            "walktrough",
            "e.yaml:1: kind: 'walktrough' is not a kind of experiment. Did you mean 'walkthrough'?",
        ),
        ("kind: walkthrough\n", "", "e.yaml:1: kind: is required."),
        ("width: 32", "width: -32", "e.yaml:3: image.width: must be at least 1, not -32."),
        ("width: 32", "width: .nan", "e.yaml:3: image.width: must be a whole number, not nan."),
        ("width: 32", "width: 32, widht: 3", "e.yaml:3: image.widht: is not a known key. Did you mean 'width'?"),
        ("scene.yaml", "absent.yaml", "e.yaml:2: scene: no scene file"),
        ("scene.yaml", "3", "e.yaml:2: scene: must be a word or a mapping of keys to values, not 3."),
    ],
)
def test_mistakes_in_the_head(load: Load, old: str, new: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load(HEAD.replace(old, new) + "- sharp\n")
    assert str(caught.value).startswith(expected)


def test_a_mistake_in_the_scene_is_reported_in_its_own_file(load: Load, tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE.replace("size: [1, 1, 1]", "size: [1, -1, 1]"))
    with pytest.raises(InputError) as caught:
        load(HEAD + "- sharp\n")
    assert caught.value.file is not None and caught.value.file.endswith("scene.yaml")
    assert caught.value.line == 3


def test_overrides(load: Load) -> None:
    text = HEAD + "- sharp\n- soft: {taps: 2}\n"
    experiment = load(
        text, "image.width=64", "techniques.0.sharp.resolution=99", "techniques.1.soft.taps=3", "reference.samples=5",
        "metrics=[rmse]", "frames=2", "repeats=4",
    )  # fmt: skip
    assert experiment.image.width == 64 and experiment.image.height == 24
    assert experiment.runs[0].params["resolution"] == 99 and experiment.runs[1].params["taps"] == 3
    assert experiment.reference is not None and experiment.reference.samples == 5
    assert (experiment.metrics, experiment.frames, experiment.repeats) == (("rmse",), (0, 1), 4)
    assert labels(load(text, "techniques=[soft, sharp]")) == ["soft", "sharp"]


def test_overrides_reach_into_the_scene_file(load: Load) -> None:
    experiment = load(HEAD + "- sharp\n", "scene.camera.fov_deg=20", "scene.path.frames=2")
    scene = experiment.load_scene()
    assert scene.camera(0).fov_deg == 20.0
    assert experiment.frames == (0, 1)
    assert load(experiment.to_yaml()).load_scene().content_hash == scene.content_hash


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("image.width", "--set image.width: must have the form key.path=value."),
        ("=3", "--set =3: must have the form key.path=value."),
        ("image..width=3", "--set image..width=3: must have the form key.path=value."),
        ("image.width=[", "--set image.width=[:1: is not valid YAML"),
        ("image.width=-4", "--set image.width=-4: image.width: must be at least 1, not -4."),
        ("image.widht=4", "--set image.widht=4: image.widht: is not a known key. Did you mean 'width'?"),
        ("kind.x=1", "--set kind.x=1: 'kind' is 'walkthrough' and has no 'x' in it."),
        ("techniques.x=1", "--set techniques.x=1: 'techniques' is a list; 'x' must be the index of an item, 0 to 0."),
        ("techniques.1=soft", "--set techniques.1=soft: 'techniques' has 1 item; there is no item 1 (the first is 0)."),
        ("techniques.0.sharp.bias=-1", "--set techniques.0.sharp.bias=-1: techniques.0.sharp.bias: must be at least 0"),
        (
            "techniques.0.soft.taps=1",
            "--set techniques.0.soft.taps=1: 'techniques.0' is 'sharp' and has no 'soft' in it.",
        ),
        ("scene.camera.fov=1", "scene.camera.fov: is not a known key"),
    ],
)
def test_wrong_overrides(load: Load, override: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load(HEAD + "- sharp\n", override)
    assert expected in str(caught.value)


def test_an_inline_scene_finds_its_files_beside_the_experiment(load: Load, tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    inline = (
        "scene: {meshes: [{file: m/t.obj}], "
        + "lights: [{kind: point, position: [0, 4, 0]}], "
        + ("camera: {eye: [3, 3, 3], target: [0, 0, 0], fov_deg: 50, near: 0.1, far: 50}}")
    )
    experiment = load(HEAD.replace("scene: scene.yaml", inline) + "- sharp\n")
    assert len(experiment.load_scene().meshes) == 1
    (tmp_path / "elsewhere").mkdir()
    moved = tmp_path / "elsewhere" / "again.yaml"
    moved.write_text(experiment.to_yaml())
    again = load_experiment(moved, (), PLUGINS)
    assert again.load_scene().content_hash == experiment.load_scene().content_hash


def test_needs_of_meshes(load: Load, tmp_path: Path) -> None:
    scene = load_scene(tmp_path / "scene.yaml")
    plane, box = scene.meshes
    assert is_closed(box) and not is_closed(plane)
    assert is_planar(plane) and not is_planar(box)
    flipped = Mesh("flipped", box.vertices, np.concatenate([box.faces[:1, ::-1], box.faces[1:]]))
    assert not is_closed(flipped)
    assert unmet_need(Sharp, scene, scene.lights[1]) is None
    assert unmet_need(Soft, scene, scene.lights[0]) is None
