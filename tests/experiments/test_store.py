"""The result folder: what a kill can leave behind, what may be overwritten, and images that keep every bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.results.images import (
    error_view,
    read_exr,
    read_png,
    shaded_view,
    visibility_view,
    write_exr,
    write_png,
)
from experiments.results.store import FRAME_COLUMNS, TABLES, Store, image_folder
from experiments.results.tables import Table, cell, read_table
from wkernels.errors import InputError

CONFIG = "kind: walkthrough\n"


def environment(**changes: Any) -> dict[str, Any]:
    return {"identity": {"scene": "abc", "threads": 2, **changes}, "run": {}, "environment": {}, "metrics": {}}


def started(out: Path, frames: int = 2) -> Store:
    store = Store.open(out, CONFIG, environment(), resume=False)
    store.start_tables()
    for frame in range(frames):
        for label in ("a", "b"):
            key = {"technique": "t", "label": label, "frame": frame}
            store.append("passes", [{**key, "pass": "g-buffer", "ms": 1.5}, {**key, "pass": "compare", "ms": 2.0}])
            left_out = {"label": label, "frame": frame, "what": "x", "reason": "one, two", "count": 3}
            store.append("left_out", [left_out])
            store.append("frames", [{**key, "frame_ms": 3.5, "rmse": None}])
    return store


def test_cells() -> None:
    assert cell(None) == cell(float("nan")) == ""
    assert cell(0.0) == "0" and cell(0) == "0" and cell(1 / 3) == "0.333333333"
    assert cell("two\n  lines") == "two lines"


def test_rows_are_in_the_file_when_append_returns(tmp_path: Path) -> None:
    table = Table(tmp_path / "t.csv", ("a", "b"))
    table.append([{"a": 1, "b": "x, y"}])
    assert (tmp_path / "t.csv").read_text() == 'a,b\n1,"x, y"\n'
    with pytest.raises(KeyError, match="no such column"):
        table.append([{"a": 1, "c": 2}])
    table.close()
    again = Table(tmp_path / "t.csv", ("a", "b"))
    again.append([{"a": 2}])
    again.close()
    assert read_table(tmp_path / "t.csv") == [{"a": "1", "b": "x, y"}, {"a": "2", "b": ""}]


def test_every_possible_torn_end_is_dropped(tmp_path: Path) -> None:
    whole = b'a,b\n1,"x, y"\n2,z\n'
    rows = [{"a": "1", "b": "x, y"}, {"a": "2", "b": "z"}]
    for length in range(len(whole) + 1):
        (tmp_path / "t.csv").write_bytes(whole[:length])
        complete = max(0, whole[:length].count(b"\n") - 1)
        assert read_table(tmp_path / "t.csv") == rows[:complete]


def test_missing_values_are_empty_never_zero(tmp_path: Path) -> None:
    store = started(tmp_path / "out")
    store.close()
    assert {row["rmse"] for row in store.rows("frames")} == {""}
    assert (tmp_path / "out" / "frames.csv").read_text().splitlines()[0] == ",".join(FRAME_COLUMNS)


def test_recovery_keeps_whole_frames_only(tmp_path: Path) -> None:
    out = tmp_path / "out"
    store = started(out)
    whole = {name: (out / f"{name}.csv").read_bytes() for name in TABLES}
    # a kill while frame 2 of label a was stored, in the middle of its row
    key = {"technique": "t", "label": "a", "frame": 2}
    store.append("passes", [{**key, "pass": "g-buffer", "ms": 1.5}])
    store.append("left_out", [{"label": "a", "frame": 2, "what": "x", "reason": "y", "count": 1}])
    store.close()
    for name in ("frames", "passes"):
        with open(out / f"{name}.csv", "a") as file:
            file.write("t,a,2,3.")
    resumed = Store.open(out, CONFIG, environment(), resume=True)
    assert {name: (out / f"{name}.csv").read_bytes() for name in TABLES} == whole
    assert resumed.done() == {("a", 0), ("b", 0), ("a", 1), ("b", 1)}


def test_another_configuration_is_refused(tmp_path: Path) -> None:
    started(tmp_path).close()
    for resume in (True, False):
        with pytest.raises(InputError, match="another configuration") as caught:
            Store.open(tmp_path, "kind: other\n", environment(), resume=resume)
        assert caught.value.file == str(tmp_path / "config.yaml")
    assert len(Store(tmp_path).rows("frames")) == 4


def test_resuming_with_other_code_or_threads_is_refused(tmp_path: Path) -> None:
    started(tmp_path).close()
    with pytest.raises(InputError, match="threads was 2, is 1"):
        Store.open(tmp_path, CONFIG, environment(threads=1), resume=True)
    with pytest.raises(InputError, match="plugin pcf was None, is 12"):
        Store.open(tmp_path, CONFIG, environment(**{"plugin pcf": 12}), resume=True)


def test_the_same_run_without_resume_starts_afresh(tmp_path: Path) -> None:
    store = started(tmp_path)
    write_exr(store.raw("a", "visibility", 0), np.zeros((2, 2)))
    store.close()
    again = Store.open(tmp_path, CONFIG, environment(threads=1), resume=False)
    assert again.rows("frames") == [] and again.image_frames("a") == []
    assert again.environment()["identity"]["threads"] == 1


def test_a_run_that_stored_nothing_yet_may_be_replaced(tmp_path: Path) -> None:
    Store.open(tmp_path, CONFIG, environment(), resume=False)
    Store.open(tmp_path, "kind: other\n", environment(), resume=False)
    assert (tmp_path / "config.yaml").read_text() == "kind: other\n"


def test_other_peoples_files_are_never_touched(tmp_path: Path) -> None:
    mine = {"config.yaml": "mine\n", "images/holiday.png": "x", "environment.json": json.dumps({"PATH": "/bin"})}
    for name, text in mine.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for resume in (True, False):
        with pytest.raises(InputError, match="holds other files"):
            Store.open(tmp_path, CONFIG, environment(), resume=resume)
    assert {name: (tmp_path / name).read_text() for name in mine} == mine


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        Store.open(tmp_path / "file", CONFIG, environment(), resume=False)
    with pytest.raises(InputError, match="cannot write results here"):
        Store.open(tmp_path / "file" / "below", CONFIG, environment(), resume=False)


def test_reading_something_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such result folder"):
        Store.existing(tmp_path / "none")
    with pytest.raises(InputError, match=r"it has no config\.yaml, environment\.json, frames\.csv"):
        Store.existing(tmp_path)
    started(tmp_path).close()
    (tmp_path / "environment.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        Store.existing(tmp_path)


def test_a_label_called_reference_keeps_its_own_folder(tmp_path: Path) -> None:
    folders = {image_folder(label) for label in (None, "Reference", "reference_multisample", "a")}
    assert len(folders) == 4
    store = Store(tmp_path)
    assert store.raw(None, "visibility", 3).parent != store.raw("reference", "visibility", 3).parent


def test_raw_images_keep_every_bit(tmp_path: Path) -> None:
    image = np.random.default_rng(1).random((7, 11)).astype(np.float32)
    image[2, 3], image[0, 0] = np.nan, 1e-30
    write_exr(tmp_path / "deep" / "v.exr", image, "a note")
    np.testing.assert_array_equal(read_exr(tmp_path / "deep" / "v.exr"), image)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["v.exr"]
    rgb = np.arange(7 * 11 * 3, dtype=np.uint8).reshape(7, 11, 3)
    write_png(tmp_path / "v.png", rgb)
    np.testing.assert_array_equal(read_png(tmp_path / "v.png"), rgb)


def test_unreadable_images_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "v.exr").write_bytes(b"no image")
    for name in ("v.exr", "none.exr"):
        with pytest.raises(InputError, match=f"{name}: cannot read the image"):
            read_exr(tmp_path / name)


@pytest.mark.parametrize(("name", "at", "byte"), [("v.png", 33, 33), ("v.exr", 9, 0), ("v.exr", 15, 200)])
def test_damaged_images_are_refused_in_one_line(tmp_path: Path, name: str, at: int, byte: int) -> None:
    """The library's own words have several lines, and gather those of earlier files."""
    path = tmp_path / name
    if name.endswith("png"):
        write_png(path, np.random.default_rng(1).integers(0, 255, (16, 16, 3), np.uint8))
    else:
        write_exr(path, np.ones((16, 16), np.float32), "a note")
    sound = path.read_bytes()
    path.write_bytes(sound[:at] + bytes([byte]) + sound[at + 1 :])
    for _ in range(2):
        with pytest.raises(InputError, match="cannot read the image") as caught:
            read_png(path) if name.endswith("png") else read_exr(path)
        assert "\n" not in str(caught.value)


def test_views_for_people() -> None:
    visibility = np.array([[0.0, 0.5, 1.0, np.nan]], np.float32)
    grey = visibility_view(visibility)
    assert grey[0, :3, 0].tolist() == [0, 128, 255] and len(set(grey[0, 3].tolist())) > 1
    assert shaded_view(np.array([[[0.0, 0.214, 2.0]]])).tolist() == [[[0, 127, 255]]]
    reference = np.array([[0.5, 0.5, 0.5, 0.5]], np.float32)
    colors = error_view(visibility, reference).astype(int)
    assert colors[0, 1].sum() < 120  # no error is dark
    assert colors[0, 0, 2] > colors[0, 0, 0] and colors[0, 2, 0] > colors[0, 2, 2]  # too dark blue, too bright red
    assert colors[0, 3].tolist() == grey[0, 3].tolist()
