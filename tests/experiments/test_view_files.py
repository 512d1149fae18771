"""The pictures of a run: files, report, what is left out, and that nothing that is measured depends on them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from view_subjects import BOX, HEAD, write_configs

from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.explain import explain
from experiments.kinds.walkthrough.run import run
from experiments.results.images import read_exr, read_png
from experiments.results.store import Store
from experiments.schema.view_kinds import KINDS, kind_of, picture_names
from experiments.views import render
from experiments.views.subject import Subject

CONFIGS = Path(__file__).parents[2] / "configs"
PICTURED = [CONFIGS / "experiments" / "views.yaml", *sorted((CONFIGS / "papers").glob("s2_fig_5_*.yaml"))]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WKERNELS_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_configs(tmp_path_factory.mktemp("config"))


@pytest.fixture(scope="module")
def whole(files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    text = (HEAD + BOX).replace("frames: 1", "  - ray_cast_point_shadow\nframes: 1")
    (files / "all.yaml").write_text(text)
    return run(load_experiment(files / "all.yaml"), tmp_path_factory.mktemp("out") / "all", threads=2)


def test_all_pictures_are_there_and_the_report_shows_them(whole: Path) -> None:
    store = Store(whole)
    names = {name for kind in KINDS if KINDS[kind].pulls is None for name in picture_names(kind, ["det"])}
    assert {name for name, frame in store.pictures("shadow_map")} == names and len(names) == 16
    assert not store.pictures("ray_cast_point_shadow")
    rows = [row for row in store.rows("left_out") if row["what"].startswith("views ")]
    mapless = [row["label"] for row in rows if "reads no light map" in row["reason"]]
    foreign = {row["label"] for row in rows if row["what"].startswith("views silhouettes")}
    assert mapless == ["ray_cast_point_shadow"] and foreign == {"shadow_map", "ray_cast_point_shadow"}
    page = (whole / "report.html").read_text()
    assert page.count("<figcaption>") >= 16 and "shadow_map, light views, frame 0" in page
    for name in names:
        assert read_png(store.picture("shadow_map", name, 0)).shape[1] >= 560


def test_views_change_nothing_that_is_measured_and_are_the_same_every_time(
    files: Path, whole: Path, tmp_path: Path
) -> None:
    kinds = "views.kinds=[sampling_frequency, intersection_bodies, perspective_error]"
    again = run(load_experiment(files / "all.yaml", [kinds]), tmp_path / "again", threads=1, report=False)
    for name, frame in Store(again).pictures("shadow_map"):
        pair = [Store(out).picture("shadow_map", name, frame).read_bytes() for out in (whole, again)]
        assert pair[0] == pair[1], name
    plain = load_experiment(files / "all.yaml", ["views="])
    assert plain.views is None
    without = run(plain, tmp_path / "without", threads=2, report=False)
    assert not (without / "images" / "shadow_map" / "views").exists()
    images = [read_exr(Store(out).raw("shadow_map", "visibility", 0)) for out in (whole, without)]
    np.testing.assert_array_equal(*images)
    rows = [
        [row for row in Store(out).rows("left_out") if not row["what"].startswith("views ")] for out in (whole, without)
    ]
    assert rows[0] == rows[1]


def test_a_picture_that_fails_is_recorded_and_costs_nothing_else(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(subject: Subject) -> Any:
        raise ValueError("deliberate")

    monkeypatch.setattr(render, "_DRAW", {**render._DRAW, "depth_map": broken})
    experiment = load_experiment(files / "box.yaml", ["views.kinds=[depth_map, minimap]"])
    store = Store(run(experiment, tmp_path / "out", report=False))
    assert [name for name, _ in store.pictures("shadow_map")] == ["minimap_third"]
    (row,) = (row for row in store.rows("left_out") if row["what"] == "view depth_map")
    assert "ValueError: deliberate" in row["reason"] and len(store.rows("frames")) == 1
    assert "deliberate" in next((store.out / "failures").glob("*depth_map*")).read_text()


def test_a_label_without_a_map_has_pictures_where_it_is_asked_for(files: Path, tmp_path: Path) -> None:
    changes = ["techniques=[ray_cast_point_shadow]", "views.labels=[ray_cast_point_shadow]"]
    store = Store(run(load_experiment(files / "box.yaml", changes), tmp_path / "out", report=False))
    mapless = {
        name
        for kind in KINDS
        if not KINDS[kind].needs_map and KINDS[kind].pulls is None
        for name in picture_names(kind, [])
    }
    assert {name for name, _ in store.pictures("ray_cast_point_shadow")} == mapless and len(mapless) == 4
    rows = [row for row in store.rows("left_out") if row["what"].startswith("views ")]
    (row,) = (row for row in rows if "no light map" in row["reason"])
    assert (
        int(row["count"]) == len(KINDS) - 6
    )  # silhouettes and wedges, which it does not pull, have a row of their own


def test_silhouettes_are_of_those_that_pull_them(files: Path, tmp_path: Path) -> None:
    changes = ["techniques=[shadow_map, shadow_volume_zfail, penumbra_maps]", "views.kinds=[silhouettes]"]
    store = Store(run(load_experiment(files / "box.yaml", changes), tmp_path / "out", report=False))
    names = {label: [name for name, _ in store.pictures(label)] for label in ("shadow_volume_zfail", "penumbra_maps")}
    assert names == {label: ["silhouettes_eye", "silhouettes_third"] for label in names}
    (row,) = (row for row in store.rows("left_out") if row["what"] == "views silhouettes")
    assert "shadow_map pulls none" in row["reason"] and not list(store.pictures("shadow_map"))


def test_wedges_are_of_those_that_have_them(files: Path, tmp_path: Path) -> None:
    changes = ["techniques=[shadow_volume_zfail, wedge_spherical]", "views.kinds=[wedges, v_buffer]"]
    store = Store(run(load_experiment(files / "box.yaml", changes), tmp_path / "out", report=False))
    names = {name for name, _ in store.pictures("wedge_spherical")}
    assert names == {"wedges_third", "v_buffer_eye"} and not list(store.pictures("shadow_volume_zfail"))


def test_kinds_are_named_once(files: Path) -> None:
    modes = ["det", "x", "y"]
    assert set(render._DRAW) == {name for kind in KINDS for name in picture_names(kind, modes)}
    assert all(kind_of(name) == kind for kind in KINDS for name in picture_names(kind, modes))
    assert kind_of("nonsense") is None
    text = explain(load_experiment(files / "box.yaml", ["views.kinds=[frusta]"]))
    assert "1 picture each" in text and "frusta_third" in text and "90 x 60" in text


@pytest.mark.parametrize("config", PICTURED, ids=[path.stem for path in PICTURED])
def test_the_configs_of_chapter_5_load(config: Path) -> None:
    # on the small scene: the large one is tested where scenes are
    scene = (CONFIGS / "scenes" / "test_plane.yaml").as_posix()
    experiment = load_experiment(config, [f"scene={scene}", "frames=1", "views.frames="])
    assert experiment.views is not None and experiment.views.frames == [0]
    assert "Views" in explain(experiment)
