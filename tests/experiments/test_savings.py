"""``kind: savings``: what is measured, what is written, how it resumes; and what ``explain`` foresees."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_scenes

from algorithms.plugins import load_all
from experiments.commands.run import explain_experiment
from experiments.kinds.savings import run as measured
from experiments.kinds.savings.config import Savings, load_savings
from experiments.kinds.savings.report import write_savings_report
from experiments.kinds.savings.run import COLUMNS, EVERYTHING, run_savings, savings_text
from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.explain import explain
from experiments.kinds.walkthrough.foreseen import own_omissions, skip_lines
from experiments.rendering.engine import WarpEngine
from experiments.results.failures import TechniquesFailed
from experiments.results.tables import read_table
from experiments.schema.experiment import Experiment
from experiments.schema.needs import unmet_need
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Scene
from wkernels.workspace.products import UNCHANGED, Unasked

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
PLUGINS = load_all()
FILE = """
kind: savings
scenes: [{scenes}/moving_blocker.yaml, bare.yaml]
image: {{width: 32, height: 18}}
techniques: [pcf_blocker_skip: {{resolution: 64}}, multi_shadow_map: {{resolution: 64, samples: 2}}]
frames: 2
still: 1
repeats: 1
"""


def load(folder: Path, text: str = FILE, overrides: tuple[str, ...] = ()) -> Savings:
    empty = (SCENES / "a6_empty.yaml").read_text(encoding="utf-8")
    (folder / "bare.yaml").write_text(
        empty.replace("primitive: plane", "primitive: plane, casts: false"), encoding="utf-8"
    )
    path = folder / "saves.yaml"
    path.write_text(text.format(scenes=SCENES.as_posix()), encoding="utf-8")
    return load_savings(path, overrides, PLUGINS)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("savings")
    return run_savings(load(folder), folder / "out", PLUGINS, threads=1)


def test_every_skip_has_a_row_and_changes_no_image(table: Path) -> None:
    rows = read_table(table)
    assert tuple(rows[0]) == COLUMNS
    assert all(float(row["image_difference"]) == 0.0 for row in rows)
    found = {(row["scene"], row["label"], row["what"]) for row in rows}
    labels = ("pcf_blocker_skip", "multi_shadow_map")
    assert {(s, label, EVERYTHING) for s in ("moving_blocker", "bare") for label in labels} <= found
    assert ("moving_blocker", "pcf_blocker_skip", "filter of pixels") in found
    assert ("bare", "multi_shadow_map", "light depth map and comparisons") in found
    assert not any(row["reason"] == Unasked.LIGHT_MAP.pair[1] for row in rows), "what a method never does saves nothing"
    for row in rows:
        assert float(row["ms_with"]) > 0.0 and float(row["ms_without"]) > 0.0 and int(row["count"]) > 0
        if row["frames"] == "1":  # medians of one number
            with_ms, without_ms = float(row["ms_with"]), float(row["ms_without"])
            np.testing.assert_allclose(float(row["saving_ms"]), without_ms - with_ms, atol=1e-6)
            np.testing.assert_allclose(float(row["ratio"]), without_ms / with_ms, rtol=1e-6)


def test_a_still_view_keeps_its_g_buffer(table: Path) -> None:
    rows = [row for row in read_table(table) if row["scene"] == "bare" and row["what"] == "g-buffer"]
    assert rows and all(row["reason"] == UNCHANGED for row in rows)


def test_text_and_report_show_every_row(table: Path) -> None:
    rows = read_table(table)
    assert len(savings_text(rows).splitlines()) == len(rows)
    html = write_savings_report(table.parent).read_text(encoding="utf-8")
    totals = sum(row["what"] == EVERYTHING for row in rows)
    assert html.count("<tr") == len(rows) + 2 and totals == 4  # and the heads of two tables
    assert all(escape(row["reason"]) in html for row in rows)


def test_resuming_keeps_complete_labels_alone(table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    savings = load(table.parents[1])
    out = tmp_path / "out"
    out.mkdir()
    for name in ("config.yaml", "environment.json"):
        (out / name).write_bytes((table.parent / name).read_bytes())
    lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
    (out / "savings.csv").write_text("".join(lines[:-1]), encoding="utf-8")  # the last label's total is missing
    asked = []

    def measure(engine: WarpEngine, run: Any, *_: Any) -> list:
        asked.append((engine.scene.name, run.label))
        return []

    monkeypatch.setattr(measured, "measure", measure)
    run_savings(savings, out, PLUGINS, threads=1, resume=True)
    assert asked == [("bare", "multi_shadow_map")]
    assert len(read_table(out / "savings.csv")) < len(lines) - 1
    run_savings(savings, out, PLUGINS, threads=1)
    assert len(asked) == 1 + 4


def test_a_technique_that_raises_leaves_the_others_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(engine: WarpEngine, run: Any, *_: Any) -> list:
        if run.label == "pcf_blocker_skip":
            raise RuntimeError("boom")
        return [dict.fromkeys(COLUMNS, 1) | {"scene": engine.scene.name, "label": run.label}]

    monkeypatch.setattr(measured, "measure", measure)
    with pytest.raises(TechniquesFailed, match="boom"):
        run_savings(load(tmp_path), tmp_path / "out", PLUGINS, threads=1)
    assert [row["label"] for row in read_table(tmp_path / "out" / "savings.csv")] == ["multi_shadow_map"] * 2
    assert {row["label"] for row in read_table(tmp_path / "out" / "failures.csv")} == {"pcf_blocker_skip"}


def test_an_image_that_a_skip_changes_is_told() -> None:
    one, two = np.array([[1.0, np.nan]], np.float32), np.array([[0.75, np.nan]], np.float32)
    assert measured._difference(one, two) == 0.25
    assert measured._difference(one, np.zeros((1, 2), np.float32)) == np.inf
    assert measured._difference(one * np.nan, two * np.nan) == 0.0


def test_files(tmp_path: Path) -> None:
    savings = load(tmp_path)
    again = tmp_path / "again.yaml"
    again.write_text(savings.to_yaml(), encoding="utf-8")
    assert load_savings(again, [], PLUGINS).to_yaml() == savings.to_yaml()
    assert savings.walk(savings.experiments[0]) == (0, 1, 1)
    everything = load(tmp_path, FILE.replace("techniques:", "# techniques:"))
    scene = everything.experiments[0].loaded_scene
    able_here = [name for name, plugin in PLUGINS.items() if unmet_need(plugin, scene, scene.lights[0]) is None]
    assert [run.name for run in everything.experiments[0].runs] == able_here and len(able_here) > 0.8 * len(PLUGINS)
    able = load_point(tmp_path, "[shadow_map, pcss]")
    assert [run.label for run in able.experiments[0].runs] == ["shadow_map"]
    assert "area" in able.unmet["point", "pcss"]


def load_point(folder: Path, techniques: str) -> Savings:
    """With a scene whose light has no area."""
    text = (SCENES / "a6_empty.yaml").read_text(encoding="utf-8")
    head, _, tail = text.partition("  - {kind: rectangle")
    tail = tail.partition("\n")[2]
    (folder / "point.yaml").write_text(f"{head}  - {{kind: point, position: [0, 10, 0]}}\n{tail}", encoding="utf-8")
    head, _, tail = FILE.partition("techniques:")
    tail = tail.partition("\n")[2]
    return load(
        folder,
        f"{head}techniques: {techniques}\n{tail}".replace("bare", "point").replace(
            "{scenes}/moving_blocker.yaml, ", ""
        ),
    )


def test_a_scene_without_techniques_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none of the techniques"):
        load_point(tmp_path, "[pcss]")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("bare", "no_such"), "no scene file"),
        (("multi_shadow_map", "no_such"), "no technique 'no_such'"),
        (("repeats: 1", "repeats: 0"), "repeats"),
        (("bare.yaml", "other/moving_blocker.yaml"), r":3: scenes\.1: has the name 'moving_blocker', as scenes\.0 has"),
    ],
)
def test_wrong_files_are_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        load(tmp_path, FILE.replace(*change))


def test_without_skips_there_is_nothing_to_measure(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="with and without"):
        run_savings(load(tmp_path), tmp_path / "out", PLUGINS, skips=False)


# ---- explain ---------------------------------------------------------------------------------------------------------


def test_explain_names_scenes_and_what_cannot_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load(tmp_path)
    explain_experiment(tmp_path / "saves.yaml", overrides=[], plugin_files=[])
    text = capsys.readouterr().out
    assert "moving_blocker: pcf_blocker_skip, multi_shadow_map" in text and "no mesh casts" in text


def experiment(folder: Path, scene: str, techniques: str, frames: int = 3) -> Experiment:
    path = folder / "walk.yaml"
    lines = [
        "kind: walkthrough",
        f"scene: {SCENES.as_posix()}/{scene}.yaml",
        "image: {width: 32, height: 18}",
        f"techniques: [{techniques}]",
        f"frames: {frames}",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return load_experiment(path, [], PLUGINS)


def test_explain_knows_that_temporal_techniques_draw_a_map_a_frame(tmp_path: Path) -> None:
    text = explain(experiment(tmp_path, "a4_rectangle", "pcss, tc_soft_paper"), PLUGINS)
    assert "building depth maps and ray structures anew on later frames" in text
    assert "(but not the maps of tc_soft_paper)" in text
    assert "nothing of the depth maps of tc_soft_paper: every frame draws one" in text
    alone = explain(experiment(tmp_path, "a4_rectangle", "tc_soft_paper"), PLUGINS)
    assert "building depth maps" not in alone and "every frame draws one" in alone
    moving = explain(experiment(tmp_path, "moving_blocker", "pcss"), PLUGINS)
    assert "on frames in which no caster has moved" in moving


def test_explain_leaves_out_what_scene_or_parameters_rule_out(tmp_path: Path) -> None:
    text = explain(experiment(tmp_path, "overlap", "pcss, tc_hard, vsm, vsm: {label: one, taps: 1}"), PLUGINS)
    assert "no area" not in text and "tags of moving casters" not in text
    assert "\n  one: blur of moments" in text
    for scene in ("a4_rectangle", "moving_blocker"):  # where nothing moves, and where what moves rests for a while
        text = explain(experiment(tmp_path, scene, "tc_hard, pcss"), PLUGINS)
        assert "tags of moving casters: no caster moves" in text


def test_explain_sees_that_no_caster_lies_in_the_lights_view(tmp_path: Path) -> None:
    plain = experiment(tmp_path, "a4_rectangle", "shadow_map")
    assert not any("no caster lies" in line for line in skip_lines(plain, plain.load_scene(), PLUGINS))
    beside = scene_with_a_box_behind_the_light()
    assert any("drawing of the light depth map" in line for line in skip_lines(plain, beside, PLUGINS))


def scene_with_a_box_behind_the_light() -> Scene:
    return small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False),
            small_scenes.mesh("box", small_scenes.box((0.0, 30.0, 0.0), (2.0, 1.0, 2.0)), receives=False),
        ],
        small_scenes.light("rectangle"),
    )


@pytest.mark.parametrize("name", PLUGINS)
def test_what_techniques_leave_out_they_declare(name: str) -> None:
    technique: Any = PLUGINS[name]
    kind = "directional" if "directional" in technique.needs.lights else "rectangle"
    for scene in (small_scenes.box_on_ground(small_scenes.light(kind)), scene_with_a_box_behind_the_light()):
        session = Session(Geometry(scene, "cpu"), width=32, height=24)
        fields = technique.Params.model_fields
        small = {key: value for key, value in {"resolution": 64, "samples": 4}.items() if key in fields}
        made = technique(technique.Params(**small))
        told = set()
        for index in (0, 1):
            session.begin(index)
            told |= {(what, why) for what, why, _ in session.render(made).left_out}
            session.advance()
        by_frames = {
            pair for pair in told if pair[1] in (Unasked.LIGHT_MAP.pair[1], UNCHANGED) or "light depth map" in pair[0]
        }
        foreseen = set(own_omissions(scene, 0, technique, made.params.model_dump()))
        assert told - by_frames <= foreseen, "every session may, or the technique declares it"
