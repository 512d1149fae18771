"""The pages in headless Chromium, as a reader uses them: nothing is loaded, everything answers, numbers are exact."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_engine import HEIGHT, WIDTH, FakeEngine, make_experiment
from matplotlib.image import imread

from experiments.kinds.stability.report import write_stability_report
from experiments.kinds.sweep.report import write_sweep_report
from experiments.kinds.walkthrough.run import run
from experiments.results.images import read_exr
from experiments.results.store import Store

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: it is in the extra 'dev'")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium; apt-get install chromium brings one")
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
    "--disable-sync", "--disable-quic", "--disable-component-update",
]  # fmt: skip
LABELS = ("cheap", "memory", "slow [exact]")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    experiment = make_experiment(metrics=["rmse", "flip", "flicker"])
    return run(experiment, tmp_path_factory.mktemp("browser") / "out", engine=FakeEngine(experiment))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


class Visit:
    """An open page, and what it asked for and complained about."""

    def __init__(self, browser: Any, path: Path, width: int = 1200, scheme: str = "light") -> None:
        self.page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        self.asked: list[str] = []
        self.said: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.goto(path.as_uri())

    def viewer(self) -> Any:
        """The viewer's stage, once its first picture is drawn."""
        self.page.wait_for_selector(".stage[data-zoom]")
        self.page.evaluate("document.getElementById('look').scrollIntoView()")
        return self.page.locator(".stage")

    def redrawn(self) -> None:
        """Waits until what was asked for is painted: drawing happens in the next animation frame."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def picture(self) -> np.ndarray:
        """The viewer's canvas as it is seen, (H, W, 3) in [0, 1]."""
        self.redrawn()
        return np.asarray(imread(io.BytesIO(self.page.locator(".stage").screenshot())))[..., :3]

    def point_at(self, x: int, y: int) -> dict[str, float | None]:
        """What the viewer reads off with the pointer on a pixel's centre."""
        stage = self.viewer()
        box, seen = stage.bounding_box(), stage.evaluate("e => ({...e.dataset})")
        zoom = float(seen["zoom"])
        self.page.mouse.move(
            box["x"] + box["width"] / 2 + (x + 0.5 - float(seen["x"])) * zoom,
            box["y"] + box["height"] / 2 + (y + 0.5 - float(seen["y"])) * zoom,
        )
        self.redrawn()
        assert self.page.text_content("[data-readout=pixel]") == f"{x}, {y}"
        found = self.page.eval_on_selector_all(
            "[data-readout]", "all => Object.fromEntries(all.map(e => [e.dataset.readout, e.dataset.value]))"
        )
        return {name: float(text) if text else None for name, text in found.items()}


@pytest.fixture
def visit(browser: Any, folder: Path) -> Iterator[Visit]:
    made = Visit(browser, folder / "report.html")
    yield made
    made.page.close()
    assert made.said == []


def overflow(page: Any) -> int:
    return int(page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth"))


# ---- The whole page ----


def test_a_page_loads_nothing_and_complains_about_nothing(visit: Visit, folder: Path) -> None:
    visit.viewer()
    visit.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    visit.redrawn()
    assert {url for url in visit.asked if not url.startswith("data:")} == {(folder / "report.html").as_uri()}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1200])
def test_no_width_overflows_and_both_colour_schemes_can_be_read(
    browser: Any, folder: Path, width: int, scheme: str
) -> None:
    visit = Visit(browser, folder / "report.html", width, scheme)
    visit.viewer()
    assert overflow(visit.page) == 0
    ink, paper = (
        visit.page.evaluate(f"getComputedStyle(document.body).{name}.match(/\\d+/g).map(Number)")
        for name in ("color", "backgroundColor")
    )
    assert (np.mean(paper[:3]) < 128) == (scheme == "dark") and abs(np.mean(ink[:3]) - np.mean(paper[:3])) > 150
    assert visit.said == []
    visit.page.close()


# ---- Scatter ----


def test_hovering_a_point_shows_label_numbers_and_picture(visit: Visit, folder: Path) -> None:
    page = visit.page
    rows = {row["label"]: row for row in csv.DictReader((folder / "summary.csv").open())}
    page.locator('.point[data-label="memory"] .marker').hover()
    text = page.inner_text("#tooltip")
    assert text.startswith("memory") and "own_error True" in text and f"{float(rows['memory']['frame_ms']):.2f}" in text
    assert page.eval_on_selector("#tooltip img", "image => image.complete && image.naturalWidth") == WIDTH
    page.mouse.move(5, 5)
    assert page.is_hidden("#tooltip")


def test_points_answer_to_keys_and_are_pinned(visit: Visit) -> None:
    page = visit.page
    page.locator(".point").first.focus()
    page.keyboard.press("ArrowRight")
    label = page.evaluate("document.activeElement.dataset.label")
    assert label == "memory" and page.inner_text("#tooltip").startswith(label)
    page.keyboard.press("Enter")
    assert page.locator(".pin").get_attribute("data-label") == label
    assert page.get_attribute(f'.point[data-label="{label}"]', "aria-pressed") == "true"
    page.click(".pin .close")
    assert page.locator(".pin").count() == 0


def test_the_front_is_that_of_what_is_shown(visit: Visit) -> None:
    page = visit.page

    def labels(selector: str) -> list[str]:
        return sorted(page.eval_on_selector_all(selector, "all => all.map(e => e.dataset.label)"))

    assert labels(".point") == list(LABELS) and "slow [exact]" in labels(".point.on-front")
    page.select_option("[data-axis=y]", "flip")
    page.select_option("[data-axis=x]", "frame_ms_ratio")
    for label in ("cheap", "slow [exact]"):
        entry = page.locator(f'[data-chart] .entry[data-group="{label}"]')
        entry.click()  # gone from the curves too
    assert (
        labels(".point") == ["memory"] == labels(".point.on-front") and entry.get_attribute("aria-pressed") == "false"
    )
    assert labels('.curve[data-column="frame_ms"] .line') == ["memory"]
    page.locator('[data-chart] .legend .plain:text("all")').click()
    assert labels(".point") == list(LABELS)


def test_an_error_of_zero_has_a_place_of_its_own(visit: Visit) -> None:
    page = visit.page
    places = {label: page.locator(f'.point[data-label="{label}"] .marker').bounding_box()["y"] for label in LABELS}
    assert places["slow [exact]"] > max(places["cheap"], places["memory"]) + 20.0
    ticks = page.eval_on_selector_all("[data-chart] .tick", "all => all.map(e => e.textContent)")
    assert "0" in ticks


# ---- Viewer ----


def test_a_pixel_reads_what_the_stored_image_holds(visit: Visit, folder: Path) -> None:
    visit.viewer()
    store, page = Store(folder), visit.page
    for index, frame in enumerate(store.image_frames("memory")):
        page.locator("#viewer select").first.select_option(index=index)
        page.click('.thumb[data-label="memory"]')
        page.wait_for_selector(f'.stage[data-frame="{frame}"][data-label="memory"]')
        own, truth = (read_exr(store.raw(label, "visibility", frame)) for label in ("memory", None))
        error = read_exr(store.raw("memory", "standard_error", frame))
        for x, y in ((0, HEIGHT - 1), (7, 9), (WIDTH - 1, 12)):
            found = visit.point_at(x, y)
            half = 0.5 / 65534 + 1e-7  # of a step of the 16 bits that the page holds; 1/255 is what is asked for
            assert found["technique"] == pytest.approx(min(own[y, x], 1.0), abs=half)
            assert found["reference"] == pytest.approx(truth[y, x], abs=half)
            assert found["difference"] == pytest.approx(own[y, x] - truth[y, x], abs=2 * half)
            assert found["standard error"] == pytest.approx(error[y, x], abs=half)
        assert visit.point_at(3, 0)["technique"] is None  # sees no receiver


def test_flipping_through_techniques_keeps_the_spot(visit: Visit) -> None:
    stage, page = visit.viewer(), visit.page

    def spot() -> list[str]:
        return list(stage.evaluate("e => [e.dataset.zoom, e.dataset.x, e.dataset.y]"))

    stage.focus()
    whole = spot()
    for key in ("+", "+", "+", "Shift+ArrowRight", "Shift+ArrowUp"):
        page.keyboard.press(key)
    visit.redrawn()
    near = spot()
    assert float(near[0]) > 3.0 * float(whole[0]) and near[1:] != whole[1:]
    page.click('.thumb[data-label="cheap"]')
    stage.focus()
    pictures = [visit.picture()]
    for label in ("memory", "slow [exact]", "reference"):
        page.keyboard.press("ArrowRight")
        pictures.append(visit.picture())
        assert stage.get_attribute("data-label") == label and spot() == near
    assert np.abs(pictures[0] - pictures[2]).mean() > 0.05
    for key in ("ArrowUp", "ArrowDown"):
        page.keyboard.press(key)
    visit.redrawn()
    assert spot() == near
    page.keyboard.press("0")
    visit.redrawn()
    assert spot()[0] == whole[0]


def test_every_technique_tells_its_value_at_the_pixel_under_the_pointer(visit: Visit, folder: Path) -> None:
    visit.viewer()
    facts = visit.page.inner_text('.thumb[data-label="memory"] small')
    assert facts.endswith(" ms")
    visit.point_at(4, 11)
    frame = int(visit.page.get_attribute(".stage", "data-frame"))
    value = float(read_exr(Store(folder).raw("memory", "visibility", frame))[11, 4])
    assert visit.page.inner_text('.thumb[data-label="memory"] small').startswith(f"{value:.4f}"[:5])


def test_wheel_zooms_about_the_pointer_and_only_with_the_focus(visit: Visit) -> None:
    stage, page = visit.viewer(), visit.page
    before = visit.point_at(5, 8), stage.get_attribute("data-zoom")
    page.mouse.wheel(0, 1)
    visit.redrawn()
    assert stage.get_attribute("data-zoom") == before[1]
    stage.focus()
    visit.point_at(5, 8)
    for _ in range(3):
        page.mouse.wheel(0, -120)
    page.wait_for_function(f"document.querySelector('.stage').dataset.zoom > {1.5 * float(before[1])}")
    assert page.text_content("[data-readout=pixel]") == "5, 8"


def test_the_border_between_before_and_after_moves_by_key_and_pointer(visit: Visit) -> None:
    stage, page = visit.viewer(), visit.page
    page.click('.thumb[data-label="cheap"]')
    page.click("[data-mode=visibility]")
    page.click("[data-action=wipe]")
    page.mouse.move(2, 2)
    handle = page.locator(".wipe-handle")
    handle.focus()
    page.keyboard.press("Home")
    reference = visit.picture()
    page.keyboard.press("End")
    technique = visit.picture()
    assert handle.get_attribute("aria-valuenow") == "100"
    page.keyboard.press("PageDown")
    visit.redrawn()
    box = stage.bounding_box()
    grip = handle.bounding_box()
    page.mouse.move(grip["x"] + grip["width"] / 2, grip["y"] + grip["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    page.mouse.up()
    page.mouse.move(2, 2)
    both = visit.picture()
    assert 24 <= int(handle.get_attribute("aria-valuenow")) <= 26
    lines, columns = both.shape[:2]
    middle = slice(lines // 4, lines // 2)  # names and the handle's knob lie elsewhere
    left, right = slice(int(0.05 * columns), int(0.2 * columns)), slice(int(0.3 * columns), int(0.9 * columns))
    np.testing.assert_allclose(both[middle, left], technique[middle, left], atol=0.01)
    np.testing.assert_allclose(both[middle, right], reference[middle, right], atol=0.01)
    assert np.abs(technique[middle, left] - reference[middle, left]).mean() > 0.05


def test_the_error_map_has_the_colours_of_its_scale(visit: Visit, folder: Path) -> None:
    from experiments.results.images import error_colors

    visit.viewer()
    visit.page.click('.thumb[data-label="cheap"]')
    visit.page.click("[data-mode=error]")
    visit.page.mouse.move(2, 2)
    seen = visit.picture()
    store = Store(folder)
    frame = int(visit.page.get_attribute(".stage", "data-frame"))
    error = read_exr(store.raw("cheap", "visibility", frame)) - read_exr(store.raw(None, "visibility", frame))
    x, y = WIDTH // 2, HEIGHT // 2
    # near a corner of the pixel, for its value is written in the middle
    found = seen[int((y + 0.15) * seen.shape[0] / HEIGHT), int((x + 0.15) * seen.shape[1] / WIDTH)]
    np.testing.assert_allclose(255.0 * found, error_colors(error[y, x]), atol=3.0)  # 513 steps of the scale
    assert "visibility minus reference" in visit.page.inner_text(".colour-bar")
    visit.page.click("[data-mode=standard_error]")
    visit.redrawn()
    assert "cheap has no standard error" in visit.page.inner_text(".stage .missing")


# ---- Curves and tables ----


def test_curves_read_single_frames_in_all_plots(visit: Visit) -> None:
    page = visit.page
    area = page.locator('.curve[data-column="frame_ms"] .plot-area')
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    page.mouse.move(box["x"] + 0.99 * box["width"], box["y"] + 60)
    text = page.inner_text("#tooltip")
    assert text.startswith("frame 4") and all(label in text for label in LABELS)
    crosses = page.eval_on_selector_all(".cross", "all => all.map(e => e.getAttribute('visibility'))")
    assert len(crosses) >= 3 and set(crosses) == {"visible"}


def test_tables_sort_by_number_and_back(visit: Visit) -> None:
    page = visit.page

    def labels() -> list[str]:
        cells = page.locator("#summary-table tbody td:first-child")
        return list(cells.evaluate_all("all => all.map(e => e.dataset.value)"))

    head = page.locator("#summary-table th", has_text="RMSE").first
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending" and labels() == ["slow [exact]", "memory", "cheap"]
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "descending" and labels() == ["cheap", "memory", "slow [exact]"]
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") is None and labels() == list(LABELS)


def test_pictures_open_large_and_close_again(visit: Visit) -> None:
    page = visit.page
    page.locator("#pictures summary").first.click()
    page.locator("#pictures img").first.click()
    assert page.get_attribute("dialog.big img", "alt") == "reference, visibility, frame 0"
    page.keyboard.press("Escape")
    assert not page.is_visible("dialog.big")


# ---- Other pages ----


def test_without_scripts_the_plots_and_pictures_are_there(browser: Any, folder: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((folder / "report.html").as_uri())
    assert page.is_visible("#plot noscript svg") and page.locator("#frames noscript svg").count() >= 3
    page.click("#pictures summary >> nth=0")
    assert page.is_visible('img[alt="memory, visibility, frame 0"]')
    context.close()


def test_the_stability_map_tells_every_level(browser: Any, folder: Path, tmp_path: Path) -> None:
    rows = [
        "technique,case,level,status,detail", "a,depth_range,10,ok,", "a,depth_range,1e+08,broken,NaN in 3 pixels",
        "a,world_offset,1000000,declared,as published", "b,depth_range,10,ok,", "b,depth_range,1e+08,ok,",
    ]  # fmt: skip
    (tmp_path / "stability.csv").write_text("\n".join(rows) + "\n")
    for name in ("environment.json", "config.yaml"):
        shutil.copy(folder / name, tmp_path)
    visit = Visit(browser, write_stability_report(tmp_path), 400)
    page = visit.page
    cell = page.locator('td[data-technique="a"][data-case="depth_range"]')
    assert cell.inner_text() == "1e8" and "broken" in cell.get_attribute("class")
    cell.hover()
    assert "NaN in 3 pixels" in page.inner_text("#tooltip") and "far / near" in page.inner_text("#tooltip")
    cell.focus()
    page.keyboard.press("ArrowDown")
    assert page.inner_text("#tooltip").startswith("b")
    page.click("#stability-bad")
    assert page.is_hidden('td[data-technique="b"] >> nth=0') and cell.is_visible()
    assert "No technique fails" not in page.inner_text("#broken") and overflow(page) == 0 and visit.said == []
    page.close()


def test_a_sweep_has_a_chart_per_scene_and_links_to_its_report(browser: Any, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "hall")
    head = (
        "scene,technique,label,frame_ms,frame_ms_q1,frame_ms_q3,ratio,ratio_q1,ratio_q3,rmse,rmse_q1,rmse_q3,"
        "error_to_reference,on_front,dominated_by"
    )
    rows = [
        "hall,flat,cheap,3,2.9,3.2,1,1,1,0.2,0.19,0.21,distinguishable,yes,",
        "hall,remembering,memory,5,4.9,5.5,1.7,1.6,1.8,0.3,0.29,0.31,distinguishable,no,cheap",
        "yard,flat,cheap,4,3.9,4.2,1,1,1,0.1,0.09,0.12,distinguishable,yes,",
        "all,flat,cheap,,,,1,1,1,1,1,1,distinguishable,yes,",
    ]
    (tmp_path / "pareto.csv").write_text("\n".join([head, *rows]) + "\n")
    (tmp_path / "equal_time.csv").write_text(
        "scene,budget_label,budget_ms,place,label,frame_ms,rmse\nhall,cheap,3,1,cheap,3,0.2\n"
    )
    (tmp_path / "recommendation.csv").write_text("scene,label,reason\nhall,cheap,Nothing errs less.\nyard,,Unknown.\n")
    visit = Visit(browser, write_sweep_report(tmp_path))
    page = visit.page
    titles = page.locator("h2").all_inner_texts()
    axes = page.locator("#scene-1 [data-axis=y] option").all_inner_texts()
    assert "FLIP" in axes and page.locator("#scene-2 [data-axis=y] option").all_inner_texts() == ["RMSE"]
    assert titles[:3] == ["Recommendation", "hall", "yard"] and "Over scenes" in titles
    assert page.locator("#scene-1 .point").count() == 2 and page.locator("#scene-2 .point").count() == 1
    page.locator('#scene-1 .point[data-label="cheap"] .marker').hover()
    assert page.eval_on_selector("#tooltip img", "image => image.naturalWidth") == WIDTH
    assert page.locator("main a[href$='report.html']").evaluate_all("all => all.map(e => e.getAttribute('href'))") == [
        "hall/report.html"
    ]
    assert page.locator("#scene-1 .entry").all_inner_texts() == ["flat", "remembering"]  # by technique
    page.locator('#scene-1 .entry[data-group="flat"]').click()
    assert page.locator("#scene-1 .point").count() == 1 and page.locator("#scene-2 .point").count() == 0
    assert "hall: cheap. Nothing errs less." in page.inner_text("#advice")
    assert overflow(page) == 0 and visit.said == []
    page.close()


def test_data_cannot_end_its_script_element() -> None:
    from experiments.report.page import json_script

    text = json_script({"a": "</script><b>&", "n": float("nan"), "u": "\u2028"})
    assert "<" not in text and json.loads(text) == {"a": "</script><b>&", "n": None, "u": "\u2028"}
