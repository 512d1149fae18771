"""``write_report``: summary.csv, plots and report.html of a walkthrough's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from experiments.kinds.stability.report import stability_values
from experiments.metrics.registry import METRICS, outdated
from experiments.report import plots, style
from experiments.report.data import chart_data, curve_data, parameters, thumbs, viewer_data
from experiments.report.fields import field_frames
from experiments.report.page import number, record, write_page, writing_report
from experiments.report.pictures import error_scale_css, picture_frames, view_groups
from experiments.report.prediction import scatter
from experiments.results import summary
from experiments.results.images import ERROR_SCALE
from experiments.results.prediction import Correlation, write_prediction
from experiments.results.published import read_published
from experiments.results.store import Store
from wkernels.errors import InputError

_PAPER = ("png", "svg", "pdf")
_SCREEN = ("png", "svg")


def write_report(out: str | Path) -> Path:
    """Writes summary.csv, plots/ and report.html from what a result folder holds; renders nothing.

    An interrupted run gives a report of what is there.

    Returns:
        Path of report.html, one file that needs no other.

    Raises:
        InputError: ``out`` is no result folder, has no frames yet, or cannot be written.
    """
    store = Store.existing(out)
    frames = summary.load_frames(store)
    if frames.empty:
        raise InputError("has no rows yet; there is nothing to report.", file=store.out / "frames.csv")
    with writing_report(store.out):
        table = summary.write_summary(store.out)
        passes = summary.load_passes(store)
        prediction = write_prediction(store.out, frames)
        figures = _draw(frames, passes, table, prediction)
        for name, (figure, suffixes) in figures.items():
            style.save(figure, store.out / "plots" / name, suffixes)
        svgs = {name: Markup(plots.inline_svg(figure)) for name, (figure, _) in figures.items()}
    return _write_page(store, frames, passes, table, prediction, svgs)


def _draw(
    frames: pd.DataFrame, passes: pd.DataFrame, table: pd.DataFrame, prediction: list[Correlation]
) -> dict[str, tuple[Figure, tuple[str, ...]]]:
    labels = list(table["label"])
    look = style.Look(labels)
    out: dict[str, tuple[Figure, tuple[str, ...]]] = {
        "error_vs_time": (plots.error_vs_time(table, look), _PAPER),
        "fps": (plots.per_frame(frames, look, "fps", "frames per second", log=True), _SCREEN),
        "error_per_frame": (
            plots.per_frame(frames, look, "rmse", "RMSE of visibility", log=True, sparse=True),
            _SCREEN,
        ),
        "frame_ms": (plots.frame_times(frames, look), _SCREEN),
    }
    if frames["frame"].nunique() > 1:
        title = "milliseconds per frame"
        out["frame_ms_per_frame"] = (plots.per_frame(frames, look, "frame_ms", title, log=True), _SCREEN)
    if not passes.empty:
        out["passes"] = (plots.pass_times(passes, labels), _SCREEN)
    if frames["m_x_max"].notna().any() and frames["frame"].nunique() > 1:
        title = "largest aliasing error m_x along the view"
        out["aliasing_per_frame"] = (plots.per_frame(frames, look, "m_x_max", title, log=True), _SCREEN)
    if prediction:
        out["prediction"] = (scatter(frames, prediction, look), _PAPER)
    return out


def _write_page(
    store: Store,
    frames: pd.DataFrame,
    passes: pd.DataFrame,
    table: pd.DataFrame,
    prediction: list[Correlation],
    svgs: dict[str, Markup],
) -> Path:
    told = record(store)
    run, metrics = told["run"], store.environment()["metrics"]
    labels = list(table["label"])
    with_images = sorted({frame for label in labels for frame in store.image_frames(label)})
    with_errors = set(frames.loc[frames["rmse"].notna(), "frame"].astype(int))
    all_pictures = [frame for frame in with_images if frame in with_errors] or with_images
    gradient, ticks = error_scale_css()
    # The reference's own error is one fact about the run, not a column that repeats it.
    shown_metrics = [
        m for m in METRICS.values() if m.name != "reference_standard_error" and table[m.name].notna().any()
    ]
    pictures = picture_frames(store, labels, all_pictures)
    fields = field_frames(store, labels, all_pictures)
    reference_error = float(table["reference_standard_error"].median())
    return write_page(
        store.out,
        Path(__file__).with_name("page.html"),
        **told,
        metric_versions=metrics,
        outdated=outdated(metrics),
        expected=len(run["labels"]) * len(run["frames"]),
        stored=len(frames),
        headline=headline(table, run["baseline"]),
        summary=table.to_dict("records"),
        metrics=shown_metrics,
        published=read_published(store.out),
        flicker_floor=_flicker_floor(table, run["labels"]),
        prediction=_prediction_rows(prediction),
        reference_error=reference_error,
        papers={entry["label"]: ", ".join(entry["paper"]) for entry in run["labels"]},
        svgs=svgs,
        chart=chart_data(
            table,
            details=parameters(store.config()),
            thumbs=thumbs(store, labels),
            baseline=run["baseline"],
            indistinct_below=2.0 * reference_error,
        ),
        curves=curve_data(frames) if frames["frame"].nunique() > 1 else None,
        fields=fields,
        viewer=viewer_data(store, labels, fields, [frame.frame for frame in pictures]),
        stability=stability_values(store.out),
        pictures=pictures,
        sheet_characters=sum(frame.characters for frame in pictures),
        picture_frames=all_pictures,
        views=view_groups(store, labels),
        error_scale=ERROR_SCALE,
        error_gradient=Markup(gradient),  # made of numbers only
        error_ticks=ticks,
        passes=_pass_shares(passes, labels),
        left_out=summary.load_left_out(store).to_dict("records"),
        failures=store.rows("failures"),
    )


def _flicker_floor(table: pd.DataFrame, labels: list[dict[str, Any]]) -> tuple[str, float] | None:
    """Label and flicker of a technique that casts rays at every frame's own receivers, and so has no flicker itself."""
    rays = {entry["label"] for entry in labels if entry["family"] == "reference"}
    own = table[table["label"].isin(rays) & table["flicker"].notna()]
    return None if own.empty else (str(own["label"].iloc[0]), float(own["flicker"].iloc[0]))


def _prediction_rows(prediction: list[Correlation]) -> tuple[list[str], list[tuple[str, list[Any]]]]:
    """Predictors and, per label, (points, correlation) of each, None where it has none."""
    predictors = list(dict.fromkeys(row.predictor for row in prediction))
    by = {(row.label, row.predictor): (row.n, row.spearman) for row in prediction}
    labels = dict.fromkeys(row.label for row in prediction)
    return predictors, [(label, [by.get((label, name)) for name in predictors]) for label in labels]


def headline(table: pd.DataFrame, baseline: str) -> list[str]:
    """What a reader should take away, in sentences, from a summary as ``summarise`` gives it."""
    out = []
    fastest = table.loc[table["frame_ms"].idxmin()]
    out.append(f"Fastest: {fastest['label']}, {number(fastest['frame_ms'])} ms per frame.")
    measured = table[table["rmse"].notna()]
    if measured.empty:
        return [*out, "No reference frame was made, so errors are unknown."]
    best = measured.loc[measured["rmse"].idxmin()]
    ratio = "" if best["label"] == baseline else f", {number(best['frame_ms_ratio'])} times the cost of {baseline}"
    error = f"RMSE {number(best['rmse'])}"
    out.append(f"Most accurate: {best['label']}, {error} at {number(best['frame_ms'])} ms{ratio}.")
    front = measured[measured["pareto"]].sort_values("frame_ms")["label"]
    out.append(f"Worth their time, from cheap to accurate (Pareto front): {', '.join(front)}.")
    same = [str(row["label"]) for row in measured.to_dict("records") if row["distinguishable"] is False]
    if same:
        out.append(f"Not distinguishable from the reference at its number of samples: {', '.join(same)}.")
    return out


def _pass_shares(passes: pd.DataFrame, labels: list[str]) -> list[tuple[str, list[tuple[str, float, float]]]]:
    """Per label: (pass, mean ms per frame, share of the frame in percent), in order of first use."""
    out = []
    for label in labels:
        own = passes[passes["label"] == label]
        frames = max(1, own["frame"].nunique())
        sums = own.groupby("pass", sort=False)["ms"].sum() / frames
        total = float(sums.sum()) or 1.0
        out.append((label, [(str(name), float(ms), 100.0 * float(ms) / total) for name, ms in sums.items()]))
    return out
