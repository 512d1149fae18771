"""``published``: figures of the sources beside ours, in analysis and walkthrough files."""

from __future__ import annotations

import csv
from pathlib import Path

import pandas as pd
import pytest
from fake_engine import FakeEngine, make_experiment, make_run

from experiments.kinds.analysis.config import load_analysis
from experiments.kinds.analysis.run import run_analysis
from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.run import run
from experiments.results.published import compare_published, published_text, read_published
from wkernels.errors import InputError

PAPERS = Path(__file__).parents[2] / "configs" / "papers"
WALK = """\
kind: walkthrough
image: {width: 64, height: 48}
scene: {meshes: [{primitive: box, size: [1, 1, 1]}], lights: [{kind: point, position: [0, 9, 0]}],
        camera: {eye: [4, 4, 4], target: [0, 0, 0], fov_deg: 50, near: 0.1, far: 50}}
techniques:
- shadow_map: {label: a, published: {fps: 100}}
- shadow_map: {label: b, PUBLISHED}
"""


@pytest.mark.parametrize("name", ["s2_fig_2_8", "s2_fig_3_19"])
def test_printed_curves_are_ours(name: str, tmp_path: Path) -> None:
    """Every published number is met to the digits that are printed."""
    run_analysis(load_analysis(PAPERS / f"{name}.yaml"), tmp_path / "o")
    rows = read_published(tmp_path / "o")
    assert len(rows) > 10
    for row in rows:
        assert row["ours"] == pytest.approx(row["published"], rel=4e-3), row
    assert "published_ratio" not in published_text(rows)


def test_ratios_to_the_baseline_are_on_both_sides(tmp_path: Path) -> None:
    runs = (make_run("a", published={"fps": 100.0}), make_run("b", ms=8.0, published={"fps": 40.0}))
    experiment = make_experiment(runs=runs)
    out = run(experiment, tmp_path / "o", engine=FakeEngine(experiment))
    rows = {row["label"]: row for row in read_published(out)}
    frames = pd.read_csv(out / "frames.csv").pivot(index="frame", columns="label", values="frame_ms")
    assert rows["b"]["published_ratio"] == pytest.approx(0.4)
    assert rows["b"]["ours_ratio"] == pytest.approx(1.0 / (frames["b"] / frames["a"]).median(), rel=1e-6)
    assert rows["a"]["ours"] == pytest.approx(float(pd.read_csv(out / "summary.csv").set_index("label")["fps"]["a"]))
    assert "Published beside ours" in (out / "report.html").read_text(encoding="utf-8")
    text = published_text(list(rows.values()))
    assert text.splitlines()[0].split() == ["label", "quantity", "published", "ours", "published_ratio", "ours_ratio"]


def test_what_was_not_measured_stays_empty() -> None:
    (row,) = compare_published({"a": {"rmse": 0.5}}, {"a": {}}, "a")
    assert row["ours"] is None and row["ours_ratio"] is None and row["published_ratio"] == 1.0
    assert published_text([]) == ""


def test_a_folder_without_published_figures_has_no_table(tmp_path: Path) -> None:
    experiment = make_experiment()
    out = run(experiment, tmp_path / "o", engine=FakeEngine(experiment))
    assert not (out / "published.csv").exists()
    assert "Published beside ours" not in (out / "report.html").read_text(encoding="utf-8")


def test_the_resolved_file_says_it_again(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(WALK.replace("PUBLISHED", "published: {fps: 50, rmse: 0.1}"))
    experiment = load_experiment(path)
    path.write_text(experiment.to_yaml())
    assert [dict(r.published) for r in load_experiment(path).runs] == [{"fps": 100.0}, {"fps": 50.0, "rmse": 0.1}]


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("published: {fpz: 50}", r"w\.yaml:7.*there is no quantity 'fpz'.*'fps'"),
        ("published: {fps: fast}", r"w\.yaml:7.*must be a finite number"),
        ("published: {fps: .inf}", r"w\.yaml:7.*must be a finite number"),
        ("published: 5", r"w\.yaml:7.*must map quantities to numbers"),
        ("published: {fps: 5}, sweep: {resolution: [64, 128]}", r"w\.yaml:7.*whole sweep"),
    ],
)
def test_wrong_figures_are_refused(written: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(WALK.replace("PUBLISHED", written))
    with pytest.raises(InputError, match=message):
        load_experiment(path)


def test_curves_refuse_unknown_quantities(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    text = "kind: analysis\ncamera: {fov_deg: 60, near: 1, far: 40}\ncurves:\n- {label: a, published: {m_y_near: 1}}\n"
    path.write_text(text)
    with pytest.raises(InputError, match=r"a\.yaml:4.*there is no quantity 'm_y_near'"):
        load_analysis(path)
    path.write_text(text.replace("m_y_near", "m_x_near"))
    run_analysis(load_analysis(path), tmp_path / "o")
    with open(tmp_path / "o" / "published.csv", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert float(row["ours"]) == pytest.approx(40.0)
