"""Files of ``kind: sweep``: scenes and their names, ``all``, what a scene does not serve, baseline, budgets, mistakes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_config_experiment import PLUGINS, SCENE

from experiments.kinds.sweep.config import Sweep, load_sweep
from experiments.kinds.sweep.explain import explain_sweep
from experiments.kinds.walkthrough.config import load_experiment
from wkernels.errors import InputError

POINT = SCENE.replace("- {kind: rectangle, center: [0, 4, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1]}\n", "")
HEAD = "kind: sweep\nscenes: [area.yaml, point.yaml]\nimage: {width: 32, height: 24}\n"
Load = Callable[..., Sweep]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Load:
    monkeypatch.chdir(tmp_path)
    Path("area.yaml").write_text(SCENE)
    Path("point.yaml").write_text(POINT)

    def load_text(text: str, *overrides: str) -> Sweep:
        Path("s.yaml").write_text(text)
        return load_sweep("s.yaml", overrides, PLUGINS)

    return load_text


def labels(sweep: Sweep) -> dict[str, list[str]]:
    return {scene.name: [run.label for run in scene.experiment.runs] for scene in sweep.scenes}


def test_each_scene_gets_what_it_serves_and_says_why_not_the_rest(load: Load) -> None:
    sweep = load(HEAD + "techniques: all\nframes: 2\nrepeats: 3\n")
    assert labels(sweep) == {"area": ["sharp", "soft"], "point": ["sharp"]}
    area, point = sweep.scenes
    assert {run.label: why for run, why in area.unserved}.keys() == {"closed"}
    assert "light with an area" in {run.label: why for run, why in point.unserved}["soft"]
    assert [run.label for run in sweep.runs] == ["sharp", "soft"]  # nothing serves `closed`, the plane being open
    assert sweep.baseline == "sharp" and all(s.experiment.baseline == "sharp" for s in sweep.scenes)
    assert area.experiment.frames == (0, 1) and area.experiment.repeats == 3


def test_all_leaves_out_what_is_listed(load: Load) -> None:
    sweep = load(HEAD + "techniques:\n- all\n- sharp: {sweep: {resolution: [8, 16], bias: [0, 1]}}\n")
    assert [run.label for run in sweep.runs] == [
        "soft",
        *(f"sharp[resolution={r} bias={b}]" for r in (8, 16) for b in (0, 1)),
    ]


def test_one_scene_alone_and_scenes_written_here(load: Load) -> None:
    assert labels(
        load(HEAD.replace("scenes: [area.yaml, point.yaml]", "scene: area.yaml") + "techniques: [soft]\n")
    ) == {"area": ["soft"]}
    inline = "".join("    " + line + "\n" for line in SCENE.splitlines())
    text = HEAD.replace("[area.yaml, point.yaml]", f"\n  - area.yaml\n  -\n    name: mine\n{inline}")
    sweep = load(text + "techniques: [soft]\n")
    assert list(labels(sweep)) == ["area", "mine"]
    with pytest.raises(InputError, match=r"s\.yaml:8: scenes\.1\.meshes\.1\.size"):
        load(text.replace("size: [1, 1, 1]", "size: [1, -1, 1]") + "techniques: [soft]\n")


def test_the_resolved_form_loads_to_the_same(load: Load, tmp_path: Path) -> None:
    text = HEAD + "techniques: [all, {soft: {label: s2, taps: 2}}]\nbudgets: [s2, 2.5]\nreference: {samples: 4}\n"
    inline = load(text, "scenes.1.camera.fov_deg=33")
    assert inline.scenes[1].name == "point" and inline.scenes[1].experiment.load_scene().camera(0).fov_deg == 33
    Path("again.yaml").write_text(inline.to_yaml())
    again = load_sweep("again.yaml", [], PLUGINS)
    assert again.to_yaml() == inline.to_yaml() and again.budgets == ("s2", 2.5)
    for one, other in zip(inline.scenes, again.scenes, strict=True):
        assert one.experiment.to_yaml() == other.experiment.to_yaml()
    Path("walk.yaml").write_text(inline.scenes[0].experiment.to_yaml())
    assert load_experiment("walk.yaml", [], PLUGINS).baseline == inline.baseline


def test_the_default_baseline_is_pcss_where_it_runs(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    class Pcss(PLUGINS["soft"]):  # type: ignore[misc, name-defined]
        name = "pcss"

    monkeypatch.setitem(PLUGINS, "pcss", Pcss)
    one = HEAD.replace(", point.yaml", "")
    assert load(one + "techniques: all\n").baseline == "pcss"
    assert load(one + "techniques: [sharp, {pcss: {label: p}}]\n").baseline == "p"
    assert load(HEAD + "techniques: all\n").baseline == "sharp"  # pcss does not run on a point light
    assert load(one + "techniques: all\nbaseline: soft\n").baseline == "soft"


def test_views_are_asked_of_the_labels_that_are_there(load: Load) -> None:
    sweep = load(HEAD + "techniques: [sharp, soft]\nviews: {labels: [soft], kinds: [frusta]}\n")
    assert [scene.experiment.views is not None for scene in sweep.scenes] == [True, False]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (HEAD + "techniques: [shrap]\n", "s.yaml:4: techniques.0: there is no technique 'shrap'. Did you mean 'sharp'?"),
        (HEAD + "techniques: every\n", "s.yaml:4: techniques: must be 'all' or a list of techniques, not 'every'."),
        (HEAD + "techniques: []\n", "s.yaml:4: techniques: must list at least one technique, or be 'all'."),
        (HEAD + "techniques: [sharp, closed]\n", "s.yaml:4: techniques.1: no scene serves it: 'closed' works with"),
        (HEAD + "techniques: [all, all]\n", "s.yaml:4: techniques.1: 'all' is listed twice."),
        (HEAD + "techniques: all\nbaseline: sharpe\n", "s.yaml:5: baseline: no technique has the label 'sharpe'. Did you"),
        (HEAD + "techniques: all\nbaseline: soft\n", "s.yaml:5: baseline: the baseline must run in every scene; not in 'point'"),
        (HEAD + "techniques: [soft]\nscene: area.yaml\n", "s.yaml:5: scene: give either 'scene' or 'scenes', not both."),
        (HEAD + "techniques: all\nbudgets: [sharp, soft, sharp]\n", "s.yaml:5: budgets.2: sharp is listed twice."),
        (HEAD + "techniques: all\nbudgets: [shurp]\n", "s.yaml:5: budgets.0: no technique has the label 'shurp'."),
        (HEAD + "techniques: all\nbudgets: [-3]\n", "s.yaml:5: budgets.0"),
        (HEAD + "techniques: all\nbaselines: sharp\n", "s.yaml:5: baselines: is not a known key. Did you mean 'baseline'?"),
        (HEAD + "techniques: all\nframes: 0\n", "s.yaml:5: frames: must be at least 1"),
        (HEAD.replace("[area.yaml, point.yaml]", "[]") + "techniques: all\n", "s.yaml:2: scenes: needs at least one scene."),
        (HEAD.replace("scenes: [area.yaml, point.yaml]\n", "") + "techniques: all\n", "s.yaml:1: needs at least one scene."),
        (HEAD.replace("point.yaml", "absent.yaml") + "techniques: all\n", "s.yaml:2: scenes.1: no scene file"),
        (HEAD.replace("point.yaml", "./area.yaml") + "techniques: all\n", "s.yaml:2: scenes.1: there is a scene 'area' already"),
        (HEAD.replace("point.yaml", "3") + "techniques: all\n", "s.yaml:2: scenes.1: must be"),
        (HEAD + "techniques: all\nlight: 2\n", "s.yaml:5: light: the scene has 2 light(s)"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_file_line_and_key(load: Load, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        load(text)
    assert str(caught.value).startswith(expected), str(caught.value)


def test_names_that_the_results_use_are_refused(load: Load) -> None:
    Path("all.yaml").write_text(SCENE)
    with pytest.raises(InputError, match=r"s\.yaml:2: scenes\.1: a scene cannot be called 'all'"):
        load(HEAD.replace("point.yaml", "all.yaml") + "techniques: all\n")


def test_explain_says_what_runs_where(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    from algorithms.plugins import load_all

    plugins = load_all()
    Path("s.yaml").write_text(HEAD + "techniques: [shadow_map, pcss]\nbudgets: [pcss, 4]\nframes: 2\nrepeats: 2\n")
    text = explain_sweep(load_sweep("s.yaml", [], plugins), plugins)
    assert "2 labels on 2 scenes: 12 timed renderings" in text
    assert "compared at equal time and equal error with: shadow_map, pcss, 4 ms" in text
    head, _, point = text.partition("==== point")
    assert "==== area" in head and "Not run here" not in head
    assert "Not run here\n  pcss: 'pcss' needs a light with an area" in point
