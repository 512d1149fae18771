"""Predicted beside measured errors: rank correlations, prediction.csv, the plot and the report's table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine, make_experiment
from scipy import stats

from experiments.kinds.walkthrough.run import run
from experiments.metrics.registry import MAP_METRICS
from experiments.report.prediction import scatter
from experiments.report.style import Look
from experiments.results.prediction import (
    ALL,
    PREDICTORS,
    WITHIN_FRAMES,
    Correlation,
    correlations,
    spearman,
    write_prediction,
)


def table(**columns: list[float]) -> pd.DataFrame:
    """Frames 0 to 3 of the labels a, b and c."""
    out = pd.DataFrame({"label": np.repeat(["a", "b", "c"], 4), "frame": np.tile(np.arange(4), 3)})
    for name in (*PREDICTORS, "rmse"):
        out[name] = columns.get(name, np.nan)
    return out


def found(rows: list[Correlation]) -> dict[tuple[str, str], tuple[int, float]]:
    return {(row.label, row.predictor): (row.n, row.spearman) for row in rows}


def test_rank_correlation_is_that_of_scipy() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        a, b = rng.integers(0, 6, 15).astype(float), rng.integers(0, 6, 15).astype(float)  # with ties
        assert spearman(a, b) == pytest.approx(stats.spearmanr(a, b).statistic, abs=1e-12)
    assert np.isnan(spearman(np.ones(5), np.arange(5.0))) and np.isnan(spearman(np.arange(2.0), np.arange(2.0)))


def test_within_labels_over_all_and_between_the_labels_of_a_frame() -> None:
    """Every label's error falls with m while that between labels grows: what one number would hide."""
    m = [4, 3, 2, 1, 40, 30, 20, 10, 400, 300, 200, 100]
    rmse = [1, 2, 3, 4, 11, 12, 13, 14, 21, 22, 23, 24]
    got = found(correlations(table(m_x_max=m, rmse=rmse)))
    assert {predictor for _, predictor in got} == {"m_x_max"}
    assert got[("a", "m_x_max")] == got[("c", "m_x_max")] == (4, pytest.approx(-1.0))
    assert got[(WITHIN_FRAMES, "m_x_max")] == (4, pytest.approx(1.0))
    assert got[(ALL, "m_x_max")] == (12, pytest.approx(stats.spearmanr(m, rmse).statistic))


def test_rows_without_prediction_or_reference_do_not_count() -> None:
    nan = float("nan")
    m = [1, 2, 3, 4, nan, nan, nan, nan, 1, 2, 3, nan]
    rmse = [1, nan, 3, 4, 1, 2, 3, 4, 4, 3, 2, 1]
    got = found(correlations(table(m_z_max=m, rmse=rmse)))
    assert got[("a", "m_z_max")] == (3, pytest.approx(1.0)) and got[("c", "m_z_max")] == (3, pytest.approx(-1.0))
    assert ("b", "m_z_max") not in got and (WITHIN_FRAMES, "m_z_max") not in got
    assert correlations(table(m_z_max=m)) == []


def test_a_result_folder_gets_table_and_plot(tmp_path: Path) -> None:
    experiment = make_experiment(frames=range(6), every=1, metrics=["rmse", *MAP_METRICS])
    out = run(experiment, tmp_path / "out", engine=FakeEngine(experiment))
    with open(out / "prediction.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["label", "predictor", "n", "spearman"]
    assert {row["predictor"] for row in rows} == {"m_z_max", "m_pixel_median", "m_pixel_p99", "undersampled"}
    assert {row["n"] for row in rows if row["label"] == "cheap"} == {"6"}
    constant = next(row for row in rows if row["label"] == "slow [exact]" and row["predictor"] == "m_z_max")
    assert constant["spearman"] == ""  # not defined, and so empty
    assert (out / "plots" / "prediction.png").is_file()
    page = (out / "report.html").read_text()
    assert "Predicted and measured error" in page
    assert "m_pixel_p99" in page


def test_no_file_where_there_is_nothing_to_compare(tmp_path: Path) -> None:
    (tmp_path / "prediction.csv").write_text("old")
    assert write_prediction(tmp_path, table(rmse=[1.0] * 12)) == []
    assert not (tmp_path / "prediction.csv").exists()


def test_the_plot_has_a_panel_per_predictor_and_a_legend() -> None:
    rng = np.random.default_rng(4)
    frames = table(**{name: list(rng.uniform(0.1, 0.9, 12)) for name in (*PREDICTORS, "rmse")})
    figure = scatter(frames, correlations(frames), Look(["a", "b", "c"]))
    panels = [axes for axes in figure.axes if axes.get_xlabel()]
    assert len(panels) == len(PREDICTORS)
    assert all(len(axes.collections) == 3 and "n = 12" in axes.get_title() for axes in panels)
    legends = [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    assert len(legends) == 1 and [text.get_text()[0] for text in legends[0].get_texts()] == ["a", "b", "c"]
