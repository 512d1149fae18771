"""Report of a folder of ``kind: convergence``: summary.csv, log-log plot, pictures side by side, report.html."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from experiments.kinds.convergence.plots import coverage_plot, log_log_plot, picture_sheet
from experiments.kinds.convergence.store import CONVERGENCE_COLUMNS, ConvergenceStore
from experiments.report import style
from experiments.report.page import number, record, write_page, writing_report
from experiments.report.pictures import error_scale_css
from experiments.report.plots import inline_svg
from experiments.results.images import ERROR_SCALE, error_view, read_exr, standard_error_view, visibility_view
from experiments.results.tables import table_text, write_text
from wkernels.errors import InputError

FIT_FROM = 4
"""First step of fitted slopes: with three samples the estimates of the standard error are still far off."""

SUMMARY_COLUMNS = (
    "technique", "label", "over", "last_step", "rmse", "rmse_slope", "standard_error", "standard_error_slope",
    "error_ratio", "coverage_2se", "coverage_2se_least", "coverage_2se_median", "zero_standard_error",
    "reference_standard_error",
)  # fmt: skip


def load_convergence_rows(store: ConvergenceStore) -> pd.DataFrame:
    """convergence.csv with numbers as floats, NaN where empty; ``step`` as int."""
    table = pd.DataFrame(store.rows(store.main), columns=list(CONVERGENCE_COLUMNS))
    for name in CONVERGENCE_COLUMNS:
        if name == "step":
            table[name] = table[name].astype(int)
        elif name not in ("technique", "label", "over"):
            table[name] = pd.to_numeric(table[name])
    return table


def fitted_slope(steps: np.ndarray, values: np.ndarray, floor: float = 0.0) -> float:
    """Exponent p of values ~ steps^p: least squares in the logarithms; NaN with fewer than three points.

    Points weigh 1 / step, so that frames 128 to 256 count as much as 4 to 8.

    Args:
        steps: (N,), at least 1; those before ``FIT_FROM`` are left out, unless fewer than three are left.
        values: (N,); not positive ones, and those not above ``floor``, are left out.
        floor: Below it a value says nothing.
    """
    known = np.isfinite(values) & (values > max(floor, 0.0))
    late = known & (steps >= FIT_FROM)
    used = late if late.sum() >= 3 else known
    if used.sum() < 3:
        return float("nan")
    x, y, weight = np.log(steps[used].astype(float)), np.log(values[used]), 1.0 / steps[used]
    x -= np.average(x, weights=weight)
    spread = float(np.sum(weight * x * x))
    return float(np.sum(weight * x * y) / spread) if spread > 0.0 else float("nan")


def summarise_convergence(table: pd.DataFrame, still: bool) -> pd.DataFrame:
    """One row per label: its last step, slopes (of a still camera) and coverage.

    Args:
        table: As ``load_convergence_rows`` gives it.
        still: Whether the camera stood, so that errors can be expected to fall.
    """
    rows = []
    for label in dict.fromkeys(table["label"]):
        own = table[table["label"] == label].sort_values("step")
        last = own.iloc[-1]
        row = {name: last[name] for name in SUMMARY_COLUMNS if name in own}
        row["last_step"] = int(last["step"])
        row["error_ratio"] = last["penumbra_rmse"] / last["penumbra_standard_error"]
        steps, floor = own["step"].to_numpy(), 2.0 * float(own["reference_standard_error"].max())
        fits = still and len(own) > 1
        row["rmse_slope"] = fitted_slope(steps, own["rmse"].to_numpy(), floor) if fits else np.nan
        row["standard_error_slope"] = fitted_slope(steps, own["standard_error"].to_numpy()) if fits else np.nan
        covered = own.loc[own["step"] >= min(FIT_FROM, row["last_step"]), "coverage_2se"]
        row["coverage_2se_least"], row["coverage_2se_median"] = covered.min(), covered.median()
        rows.append(row)
    return pd.DataFrame(rows, columns=list(SUMMARY_COLUMNS))


def write_convergence_report(out: str | Path) -> Path:
    """Writes summary.csv, plots/ and report.html from what a folder holds; renders nothing.

    Raises:
        InputError: ``out`` is no such folder, has no rows yet, or cannot be written.
    """
    store = ConvergenceStore.existing(out)
    table = load_convergence_rows(store)
    if table.empty:
        raise InputError("has no rows yet; there is nothing to report.", file=store.out / "convergence.csv")
    run = store.environment()["run"]
    still = run["camera"] == "still"
    summary = summarise_convergence(table, still)
    labels = list(summary["label"])
    look = style.Look(labels)
    figures = {"convergence": log_log_plot(table, summary, look, still=still)}
    if table["coverage_2se"].notna().any():
        figures["coverage"] = coverage_plot(table, look, still=still)
    sheets = _sheets(store, labels, run)
    with writing_report(store.out):
        rows = [{str(key): value for key, value in row.items()} for row in summary.to_dict("records")]
        write_text(store.out / "summary.csv", table_text(SUMMARY_COLUMNS, rows))
        for name, figure in figures.items():
            style.save(figure, store.out / "plots" / name, ("png", "svg"))
        for name, (_, sheet) in sheets.items():
            style.save(sheet, store.out / "plots" / name, ("png",))
        svgs = {name: Markup(inline_svg(figure)) for name, figure in figures.items()}
        urls = [(title, _data_url(store.out / "plots" / f"{name}.png")) for name, (title, _) in sheets.items()]
    return _write_page(store, table, summary, svgs, urls)


def _sheets(store: ConvergenceStore, labels: list[str], run: dict[str, Any]) -> dict[str, tuple[str, Figure]]:
    """Pictures side by side: a row per label, a column per step; last the reference, along a path as a row."""
    steps, crop, still = run["steps"], run["crop"], run["camera"] == "still"

    def image(label: str | None, kind: Any, step: int) -> np.ndarray | None:
        path = store.raw(label, kind, step)
        if not path.is_file():
            return None
        whole = read_exr(path)
        if crop is None:
            return whole
        return whole[crop["y"] : crop["y"] + crop["height"], crop["x"] : crop["x"] + crop["width"]]

    def reference(step: int) -> np.ndarray | None:
        return image(None, "visibility", 1 if still else step)

    seen: dict[str, list[np.ndarray | None]] = {}
    errors: dict[str, list[np.ndarray | None]] = {}
    own: dict[str, list[np.ndarray | None]] = {}
    for label in labels:
        shown = [image(label, "visibility", step) for step in steps]
        if not any(v is not None for v in shown):  # rendered once, for all steps
            shown[0] = image(label, "visibility", 1)
        truth = [reference(step) for step in steps]
        seen[label] = [None if v is None else visibility_view(v) for v in shown]
        errors[label] = [
            None if v is None or r is None else error_view(v, r) for v, r in zip(shown, truth, strict=True)
        ]
        stated = [image(label, "standard_error", step) for step in steps]
        own[label] = [None if s is None else standard_error_view(s) for s in stated]
    heads = [f"step {step}" for step in steps]
    if not still:
        seen["reference"] = [None if (v := reference(step)) is None else visibility_view(v) for step in steps]
        out = {"steps_visibility": ("Visibility", picture_sheet(seen, heads))}
    else:
        truth_view = None if (v := reference(1)) is None else visibility_view(v)
        beside = {label: [*images, truth_view] for label, images in seen.items()}
        out = {"steps_visibility": ("Visibility", picture_sheet(beside, [*heads, "reference"]))}
    out["steps_error"] = ("Error", picture_sheet(errors, heads))
    own = {label: images for label, images in own.items() if any(i is not None for i in images)}
    if own:
        out["steps_standard_error"] = ("The technique's own standard error", picture_sheet(own, heads))
    return out


def _data_url(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def _write_page(
    store: ConvergenceStore,
    table: pd.DataFrame,
    summary: pd.DataFrame,
    svgs: dict[str, Markup],
    sheets: list[tuple[str, str]],
) -> Path:
    told = record(store)
    gradient, ticks = error_scale_css()
    return write_page(
        store.out,
        Path(__file__).with_name("page.html"),
        **told,
        metric_versions=store.environment()["metrics"],
        stored=len(table),
        headline=headline(summary),
        summary=summary.to_dict("records"),
        papers={entry["label"]: ", ".join(entry["paper"]) for entry in told["run"]["labels"]},
        svgs=svgs,
        sheets=sheets,
        fit_from=FIT_FROM,
        error_scale=ERROR_SCALE,
        error_gradient=Markup(gradient),  # made of numbers only
        error_ticks=ticks,
        failures=store.rows("failures"),
    )


def headline(summary: pd.DataFrame) -> list[str]:
    """What a reader should take away, in sentences, from a summary as ``summarise_convergence`` gives it."""
    known = summary[summary["rmse"].notna()]
    if known.empty:
        return ["No pixel receives shadows; there are no errors."]
    best = known.loc[known["rmse"].idxmin()]
    out = [f"Least error in the end: {best['label']}, RMSE {number(best['rmse'])} at step {best['last_step']}."]
    steep = known[known["rmse_slope"].notna()]
    if len(steep):
        fastest = steep.loc[steep["rmse_slope"].idxmin()]
        out.append(f"Steepest: {fastest['label']}, error as the power {fastest['rmse_slope']:.2f} of the step.")
    for row in known[known["error_ratio"].notna()].to_dict("records"):
        side = "too large" if row["error_ratio"] < 1.0 else "too small"
        factor = 1.0 / row["error_ratio"] if row["error_ratio"] < 1.0 else row["error_ratio"]
        out.append(
            f"{row['label']}: {100.0 * row['coverage_2se']:.1f} % of penumbra pixels lie within two of its own "
            f"standard errors in the end, which are {number(factor)} times {side}."
        )
    return out
