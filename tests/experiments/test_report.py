"""summary.csv, recomputed metrics, plots and the page, from stored folders alone."""

from __future__ import annotations

import csv
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine, make_experiment, make_run
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.kinds.walkthrough.explain import explain
from experiments.kinds.walkthrough.report import headline, number, write_report
from experiments.kinds.walkthrough.run import run
from experiments.metrics import registry as metrics
from experiments.report.fields import LEVELS, decode, encode, evenly, field_frames
from experiments.report.labels import place_labels
from experiments.report.pictures import picture_frames
from experiments.report.plots import error_vs_time, per_frame
from experiments.report.style import Look
from experiments.results import summary
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr, write_exr
from experiments.results.store import Store
from experiments.results.summary import recompute_metrics
from wkernels.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    experiment = make_experiment(metrics=["rmse", "flip", "flicker"])
    return run(experiment, tmp_path_factory.mktemp("results") / "out", engine=FakeEngine(experiment))


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def make_frames(rows: list[tuple[str, int, float, float | None, float | None]]) -> pd.DataFrame:
    """Rows of (label, frame, frame_ms, rmse, reference_standard_error)."""
    table = pd.DataFrame(rows, columns=["label", "frame", "frame_ms", "rmse", "reference_standard_error"])
    table["technique"] = "t"
    table["shadow_ms"] = table["frame_ms"] - 1.0
    for name in summary.SUMMARISED:
        if name not in table:
            table[name] = np.nan
    return table.astype({"rmse": float, "reference_standard_error": float})


# ---- Summary ----


def test_summary_against_a_direct_computation() -> None:
    frames = make_frames([
        ("a", 0, 2.0, 0.1, 0.01), ("b", 0, 6.0, 0.02, 0.01),
        ("a", 1, 4.0, None, None), ("b", 1, 8.0, None, None),
        ("a", 2, 10.0, 0.3, 0.01), ("b", 2, 40.0, 0.018, 0.01),
    ])  # fmt: skip
    table = summary.summarise(frames, "a").set_index("label")
    assert table.loc["a", ["frame_ms_q1", "frame_ms", "frame_ms_q3"]].tolist() == [3.0, 4.0, 7.0]
    assert table.loc["b", "rmse"] == pytest.approx(0.019)
    assert table.loc["b", "frame_ms_ratio"] == 3.0  # of 3, 2 and 4: frame by frame, then the median
    assert table.loc["a", "frame_ms_ratio"] == 1.0
    assert table.loc["b", "shadow_ms_ratio"] == pytest.approx(13.0 / 3.0)  # of 5, 7/3 and 39/9
    assert table["frames"].tolist() == [3, 3] and table["reference_frames"].tolist() == [2, 2]
    assert table["distinguishable"].tolist() == [True, False]
    assert table["distinguishable_from_baseline"].tolist() == [False, True]


def test_unknown_errors_stay_unknown() -> None:
    table = summary.summarise(make_frames([("a", 0, 2.0, None, None), ("b", 0, 3.0, None, None)]), "b").set_index(
        "label"
    )
    assert table["rmse"].isna().all() and not table["pareto"].any()
    assert table["distinguishable"].tolist() == [None, None]


def test_missing_baseline_leaves_ratios_empty() -> None:
    table = summary.summarise(make_frames([("a", 0, 2.0, 0.1, 0.01)]), "gone")
    assert table["frame_ms_ratio"].isna().all() and table["frame_ms"].tolist() == [2.0]


def test_pareto_front_against_brute_force() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        cost, error = rng.integers(0, 6, 12).astype(float), rng.integers(0, 6, 12).astype(float)
        error[rng.integers(12)] = np.nan
        points = list(zip(cost, error, strict=True))
        expected = [
            np.isfinite(e)
            and not any((c2 <= c and e2 <= e and (c2, e2) != (c, e)) for c2, e2 in points if np.isfinite(e2))
            for c, e in points
        ]
        assert summary.pareto_front(cost, error).tolist() == expected


def test_summary_file(folder: Path) -> None:
    with open(folder / "summary.csv", newline="") as file:
        rows = {row["label"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["cheap", "memory", "slow [exact]"]
    assert list(rows["cheap"]) == list(summary.SUMMARY_COLUMNS)
    assert rows["cheap"]["frame_ms_ratio"] == "1" and float(rows["slow [exact]"]["frame_ms_ratio"]) > 2.0
    assert rows["slow [exact]"]["rmse"] == "0" and rows["slow [exact]"]["distinguishable"] == "no"
    assert rows["cheap"]["distinguishable"] == "yes" and rows["cheap"]["standard_error"] == ""
    assert rows["cheap"]["pareto"] == "yes"


def test_left_out_is_added_up_over_frames(folder: Path) -> None:
    table = summary.load_left_out(Store(folder))
    assert table.to_dict("records") == [
        {"label": label, "what": "depth map", "reason": "its inputs have not changed", "count": 4}
        for label in ("cheap", "memory", "slow [exact]")
    ]


# ---- Metrics again ----


def test_recomputing_changes_nothing_that_was_right(copy: Path) -> None:
    before = (copy / "frames.csv").read_bytes()
    assert recompute_metrics(copy) == 9
    assert (copy / "frames.csv").read_bytes() == before


def test_recomputing_reads_the_images_and_only_them(copy: Path) -> None:
    store = Store(copy)
    before = {(row["label"], row["frame"]): row for row in store.rows("frames")}
    path = store.raw("cheap", "visibility", 2)
    write_exr(path, read_exr(path) + np.float32(0.25))
    store.update_environment(metrics={**store.environment()["metrics"], "rmse": 0, "flicker": 0})
    recompute_metrics(copy)
    after = {(row["label"], row["frame"]): row for row in store.rows("frames")}
    assert {key for key in after if after[key] != before[key]} == {("cheap", "2")}
    changed = {name for name, text in after["cheap", "2"].items() if text != before["cheap", "2"][name]}
    scores = {"rmse_penumbra", "penumbra_width_error"}  # the fake reference is penumbra everywhere
    assert changed == {"rmse", "mean_signed_error", "p99_error", "flip", *scores}
    assert store.environment()["metrics"]["rmse"] == 1
    assert (
        store.environment()["metrics"]["flicker"] == 0
    )  # cannot be computed from single images, so it is still the old one


def test_a_page_says_which_metrics_are_of_another_version(copy: Path) -> None:
    assert "is that of version" not in write_report(copy).read_text()
    store = Store(copy)
    old = {name: version for name, version in store.environment()["metrics"].items() if name not in metrics.SCORES}
    store.update_environment(metrics={**old, "flip": 0})
    text = write_report(copy).read_text()
    assert "FLIP is that of version 0; this program has version 1." in text and "Older than the scores" in text
    recompute_metrics(copy)
    assert "is that of version" not in (text := write_report(copy).read_text()) and "Older than" not in text


# ---- Page and plots ----


class Page(HTMLParser):
    """Collects what a page would load and what it says."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.images: dict[str, str] = {}
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {key: value or "" for key, value in attributes}
        self.loads += [found[key] for key in ("src", "srcset", "data", "poster") if key in found]
        self.loads += [found["href"]] if tag in ("link", "base", "image") else []
        self.links += [found["href"]] if tag == "a" else []
        self.ids |= {found["id"]} if "id" in found else set()
        if tag == "img":
            self.images[found["alt"]] = found["src"]
        if tag not in ("meta", "img", "link", "br", "path", "use"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("path", "use"):
            assert self.open.pop() == tag


def test_page_is_whole_and_needs_no_other_file(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert page.open == []
    assert all(source.startswith("data:image/jpeg;base64,") for source in page.loads) and len(page.loads) > 20
    assert "@import" not in text and not re.search(r"url\((?!#)", text)
    assert {link.removeprefix("#") for link in page.links} <= page.ids
    assert text.count("<svg") >= 5


def test_page_shows_pictures_of_reference_frames_and_all_tables(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    page = Page(text)
    for frame in (0, 2, 4):
        assert f"reference, visibility, frame {frame}" in page.images
        for label in ("cheap", "memory", "slow [exact]"):
            for kind in ("shaded", "visibility", "error"):
                assert f"{label}, {kind}, frame {frame}" in page.images
    assert "sqrt(|error|)" in text and "its inputs have not changed" in text and "kind: walkthrough" in text
    assert "Most accurate: slow [exact]" in text and "g-buffer" in text


def test_labels_cannot_inject_markup(tmp_path: Path) -> None:
    experiment = make_experiment([make_run("<b>&amp;"), make_run("b", error=0.2)], frames=[0], repeats=1)
    text = (run(experiment, tmp_path, engine=FakeEngine(experiment)) / "report.html").read_text()
    assert "<b>" not in text and "&lt;b&gt;&amp;amp;" in text


def test_report_needs_only_the_folder_and_repeats_itself(copy: Path) -> None:
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.suffix in (".html", ".svg", ".png", ".pdf")}
    names = {path.name for path in (copy / "plots").iterdir()}
    assert {
        "error_vs_time.png",
        "error_vs_time.pdf",
        "fps.png",
        "error_per_frame.png",
        "frame_ms.png",
        "frame_ms_per_frame.png",
        "passes.png",
    } <= names
    shutil.rmtree(copy / "plots")
    (copy / "summary.csv").unlink()
    assert write_report(copy) == copy / "report.html"
    assert {path: path.read_bytes() for path in before} == before


def test_disocclusion_is_drawn_under_the_curves_where_there_is_any() -> None:
    frames = make_frames([("a", 0, 2.0, 0.1, 0.01), ("a", 1, 4.0, 0.1, 0.01), ("a", 2, 3.0, 0.1, 0.01)])
    look = Look(["a"])
    assert len(per_frame(frames, look, "frame_ms", "ms", log=True).axes) == 1
    frames["disoccluded"] = [np.nan, 0.0, 0.0]
    assert len(per_frame(frames, look, "frame_ms", "ms", log=True).axes) == 1
    frames["disoccluded"] = [np.nan, 0.25, 0.0]
    above, below = per_frame(frames, look, "frame_ms", "ms", log=True).axes
    assert above.get_ylabel() == "ms" and "disoccluded" in below.get_ylabel()
    assert below.get_xlabel() == "frame" and below.get_ylim()[1] == pytest.approx(26.25)
    assert above.get_position().y0 > below.get_position().y1


def test_fields_keep_values_to_16_bits_and_places_without_receiver() -> None:
    rng = np.random.default_rng(3)
    image = rng.random((9, 7)).astype(np.float32)
    image[2, 3], image[4], image[0, :3] = np.nan, (0.0, 1.0, 0.5, 1.0, 0.0, 0.25, 0.75), (-0.5, 1.5, np.inf)
    expected = np.where(np.isfinite(image), np.clip(image, 0.0, 1.0), np.nan)
    np.testing.assert_allclose(decode(encode(image), 7), expected, atol=0.5 / LEVELS + 1e-7)
    assert decode(encode(image), 7)[4, 1] == 1.0


def test_a_page_never_grows_without_bound(folder: Path) -> None:
    store, labels = Store(folder), ["cheap", "memory", "slow [exact]"]
    assert evenly([8, 0, 16, 24], 3) == [0, 16, 24] and evenly([], 3) == [] and evenly([5, 1], 9) == [1, 5]
    whole = field_frames(store, labels, [0, 2, 4])
    assert [made.frame for made in whole] == [0, 2, 4] and {made.step for made in whole} == {1}
    one = whole[0].characters
    assert set(whole[0].fields) == {"", *labels} and set(whole[0].fields["memory"]) == {"visibility", "standard_error"}
    assert [made.frame for made in field_frames(store, labels, [0, 2, 4], int(2.5 * one))] == [0, 4]
    coarse = field_frames(store, labels, [0, 2, 4], one // 2)
    assert [(made.frame, made.step, made.width, made.height) for made in coarse] == [(0, 2, 12, 8)]
    truth = read_exr(store.raw(None, "visibility", 0))[::2, ::2]
    np.testing.assert_allclose(decode(coarse[0].fields[""]["visibility"], 12), truth, atol=1.0 / LEVELS)
    sheet = picture_frames(store, labels, [0, 2, 4])
    assert [frame.frame for frame in sheet] == [0, 2, 4]
    assert [frame.frame for frame in picture_frames(store, labels, [0, 2, 4], 2 * sheet[0].characters + 9)] == [0, 4]
    assert [frame.frame for frame in picture_frames(store, labels, [0, 2, 4], 1)] == [0]


def test_report_of_an_interrupted_run_says_so(copy: Path) -> None:
    lines = (copy / "frames.csv").read_text().splitlines(keepends=True)
    (copy / "frames.csv").write_text("".join(lines[:8]))
    shutil.rmtree(copy / "images")
    text = write_report(copy).read_text()
    assert "7 of 15 frames are stored" in text and "holds no pictures" in text


def test_report_without_any_reference(tmp_path: Path) -> None:
    experiment = make_experiment(every=None, metrics=[], frames=[0, 1], repeats=1)
    out = run(experiment, tmp_path, engine=FakeEngine(experiment))
    text = (out / "report.html").read_text()
    assert "errors are unknown" in text
    assert {row["rmse"] for row in Store(out).rows("frames")} == {""}
    assert "cheap, visibility, frame 1" in Page(text).images


def test_report_names_failures(tmp_path: Path) -> None:
    experiment = make_experiment([make_run("good"), make_run("bad", fails_on=1)], frames=[0, 1], repeats=1)
    with pytest.raises(TechniquesFailed):
        run(experiment, tmp_path, engine=FakeEngine(experiment))
    assert "bad failed" in (tmp_path / "report.html").read_text()


def test_nothing_but_failures_still_ends_in_order(tmp_path: Path) -> None:
    experiment = make_experiment([make_run("bad", fails_on=0)], frames=[0])
    with pytest.raises(TechniquesFailed, match="'bad' failed on frame 0"):
        run(experiment, tmp_path, engine=FakeEngine(experiment))
    assert (tmp_path / "summary.csv").read_text().count("\n") == 1
    with pytest.raises(InputError, match="nothing to report"):
        write_report(tmp_path)


def test_report_of_something_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a result folder"):
        write_report(tmp_path)


def test_crowded_labels_never_overlap() -> None:
    rng = np.random.default_rng(2)
    figure = Figure(figsize=(8, 5), dpi=100)
    renderer = FigureCanvasAgg(figure).get_renderer()
    axes = figure.add_subplot()
    points = [(1.0 + 0.02 * x, 1.0 + 0.02 * y) for x, y in rng.random((30, 2))]  # all within a few pixels
    axes.set_xlim(0, 3)
    axes.set_ylim(0, 3)
    notes = place_labels(
        axes, points, [f"technique_{i}[taps={4 ** (i % 4)}]" for i in range(30)], ["#000000"] * 30, 9.0
    )
    boxes = [note.get_window_extent(renderer) for note in notes]
    assert not [(i, j) for i in range(30) for j in range(i) if boxes[i].overlaps(boxes[j])]
    frame = axes.get_window_extent(renderer)
    assert sum(frame.x0 <= b.x0 and b.x1 <= frame.x1 and frame.y0 <= b.y0 and b.y1 <= frame.y1 for b in boxes) == 30


def test_headline() -> None:
    rows = [("fast", 0, 2.0, 0.2, 0.01), ("bad", 0, 4.0, 0.3, 0.01), ("best", 0, 8.0, 0.015, 0.01)]
    said = headline(summary.summarise(make_frames(rows), "fast"), "fast")
    assert said == [
        "Fastest: fast, 2.00 ms per frame.",
        "Most accurate: best, RMSE 0.0150 at 8.00 ms, 4.00 times the cost of fast.",
        "Worth their time, from cheap to accurate (Pareto front): fast, best.",
        "Not distinguishable from the reference at its number of samples: best.",
    ]


def test_numbers_for_people() -> None:
    texts = {0.0: "0", 0.012345: "0.0123", 1234.5: "1234", 12.345: "12.3", 1e-7: "1.00e-07", float("nan"): ""}
    assert {value: number(value) for value in texts} == texts


# ---- explain ----


def test_explain_names_what_runs_and_what_does_not() -> None:
    from fake_engine import PLUGINS

    text = explain(make_experiment(), PLUGINS)
    assert "cheap" in text and "error=-0.2, ms=3.0" in text and "baseline of all costs" in text
    assert "uses earlier frames" in text
    assert "45 timed renderings of 24 x 16: 3 labels x 5 frames x 3 repeats, and 4 untimed" in text
    assert f"reference on 3 frames: 0, 2, 4; 64 light samples, at most {3 * 24 * 16 * 64:,} rays" in text
    assert "no caster moves" in text and "flicker: not among" in text
    without = explain(make_experiment([make_run("a")], every=None), PLUGINS)
    assert "there is no reference" in without and "reference on" not in without


def test_explain_tells_what_projections_fall_back_to() -> None:
    from fake_engine import PLUGINS

    split = {"fit": "focused", "splits": 16, "scheme": "uniform"}
    runs = [
        replace(make_run("wide"), projection={**split, "adjust": False}),
        replace(make_run("fitted"), projection=split),
    ]
    text = explain(make_experiment(runs), PLUGINS)
    told = "light view of a split on 5 of 5 frames looked at: nothing of what the eye sees lies in it"
    assert f"wide: {told}" in text and f"fitted: {told}" not in text
    assert "building depth maps that do not follow the eye" in text  # the fake camera moves
    assert "building depth maps and ray structures" in explain(make_experiment([make_run("a")]), PLUGINS)


def test_a_mean_outside_its_quartiles_is_drawn() -> None:
    row = {
        "label": "a",
        "frame_ms": 3.0,
        "frame_ms_q1": 1.0,
        "frame_ms_q3": 2.0,
        "rmse": 0.1,
        "rmse_q1": 0.2,
        "rmse_q3": 0.3,
    }
    table = pd.DataFrame([{**row, "pareto": True, "reference_standard_error": 0.01}])
    assert isinstance(error_vs_time(table, Look(["a"])), Figure)
