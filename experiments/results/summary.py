"""summary.csv (one row per label) and metrics computed again, from the stored folder alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.metrics import registry as metrics
from experiments.results.images import read_exr
from experiments.results.published import compare_published, published_of_config, write_published
from experiments.results.store import FRAME_COLUMNS, LEFT_OUT_COLUMNS, PASS_COLUMNS, Store
from experiments.results.tables import Row, table_text, write_text

_LAST = (*metrics.MAP_METRICS, *metrics.SCORES)  # columns that came later
_ERRORS = tuple(name for name in metrics.METRICS if name not in _LAST)
SUMMARISED = ("frame_ms", "shadow_ms", "fps", *_ERRORS, "m_x_max", "m_z_max", *_LAST)


def _with_quartiles(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"{name}{suffix}" for name in names for suffix in ("", "_q1", "_q3"))


SUMMARY_COLUMNS = (
    "technique",
    "label",
    "frames",
    "reference_frames",
    *_with_quartiles(name for name in SUMMARISED if name not in _LAST),
    "frame_ms_ratio",
    "frame_ms_ratio_q1",
    "frame_ms_ratio_q3",
    "shadow_ms_ratio",
    "pareto",
    "distinguishable",
    "distinguishable_from_baseline",
    *_with_quartiles(_LAST),
)


def load_frames(store: Store) -> pd.DataFrame:
    """frames.csv with numbers as floats, NaN where empty; ``frame`` as int."""
    return _numeric(store.rows("frames"), FRAME_COLUMNS, exact=("frame",))


def load_passes(store: Store) -> pd.DataFrame:
    """passes.csv, typed like ``load_frames``."""
    return _numeric(store.rows("passes"), PASS_COLUMNS, exact=("frame",))


def load_left_out(store: Store) -> pd.DataFrame:
    """left_out.csv added up over frames: columns label, what, reason, count; in order of first occurrence."""
    table = _numeric(store.rows("left_out"), LEFT_OUT_COLUMNS, exact=("count",))
    return table.groupby(["label", "what", "reason"], sort=False, as_index=False)["count"].sum()


def _numeric(rows: Sequence[Row], columns: Sequence[str], exact: Sequence[str]) -> pd.DataFrame:
    table = pd.DataFrame(list(rows), columns=list(columns))
    for name in columns:
        if name in exact:
            table[name] = table[name].astype(int)
        elif name not in ("technique", "label", "pass", "what", "reason"):
            table[name] = pd.to_numeric(table[name])
    return table


def summarise(frames: pd.DataFrame, baseline: str) -> pd.DataFrame:
    """One row per label, in the order of first occurrence.

    Medians and quartiles are over frames. ``*_ratio`` compares with the baseline frame by frame and then takes the
    median, because a shared machine drifts: neighbours in time are comparable, averages are not. ``pareto`` marks
    labels that no other beats in both frame time and RMSE. ``distinguishable`` says whether the RMSE exceeds twice the
    reference's standard error; ``distinguishable_from_baseline`` the same of the difference to the baseline's RMSE.

    Args:
        frames: As ``load_frames`` gives it.
        baseline: Label that costs are relative to; ratios are NaN where it has no frames.
    """
    base = frames[frames["label"] == baseline].set_index("frame")
    rows: list[dict[str, Any]] = []
    for label in frames["label"].unique():
        own = frames[frames["label"] == label].set_index("frame")
        row: dict[str, Any] = {"technique": own["technique"].iloc[0], "label": label, "frames": len(own)}
        row["reference_frames"] = int(own["rmse"].notna().sum())
        for name in SUMMARISED:
            values = _without_flicker_beside_edges(own) if name == "flicker" else own[name]
            row[f"{name}_q1"], row[name], row[f"{name}_q3"] = _quartiles(values)
        ratio = (own["frame_ms"] / base["frame_ms"]).dropna()
        row["frame_ms_ratio_q1"], row["frame_ms_ratio"], row["frame_ms_ratio_q3"] = _quartiles(ratio)
        row["shadow_ms_ratio"] = _quartiles((own["shadow_ms"] / base["shadow_ms"]).replace(np.inf, np.nan))[1]
        rows.append(row)
    table = pd.DataFrame(rows, columns=list(SUMMARY_COLUMNS))
    table["pareto"] = pareto_front(table["frame_ms"].to_numpy(float), table["rmse"].to_numpy(float))
    error = table["reference_standard_error"]
    base_rmse = (
        float(table.loc[table["label"] == baseline, "rmse"].iloc[0]) if baseline in set(table["label"]) else np.nan
    )
    pairs = list(zip(table["rmse"], error, strict=True))
    table["distinguishable"] = pd.Series([metrics.distinguishable(a, b) for a, b in pairs], dtype=object)
    table["distinguishable_from_baseline"] = pd.Series(
        [metrics.distinguishable(a - base_rmse, b) for a, b in pairs], dtype=object
    )
    return table


def _without_flicker_beside_edges(own: pd.DataFrame) -> pd.Series:
    """A label's flicker per frame; none of it where nothing changes on any frame but, for all that is known, at edges.

    A zero would rank hard shadows, whose changes all lie beside their edges, before all others.
    """
    flicker, with_edges = own["flicker"], own["flicker_edges"].dropna()
    still = len(with_edges) > 0 and not (with_edges >= metrics.ROUNDING).any()
    return flicker if still or (flicker >= metrics.ROUNDING).any() else flicker.where(flicker.isna())


def _quartiles(values: pd.Series) -> tuple[float, float, float]:
    known = values.dropna().to_numpy(float)
    if not len(known):
        return (np.nan, np.nan, np.nan)
    q1, median, q3 = np.percentile(known, [25.0, 50.0, 75.0])
    return float(q1), float(median), float(q3)


def pareto_front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Whether each point is dominated by no other: none is at most as high in both and lower in one; bool (N,).

    Points with an unknown coordinate are never on the front and dominate nothing.
    """
    known = np.isfinite(cost) & np.isfinite(error)
    out = np.zeros(len(cost), dtype=bool)
    for i in np.flatnonzero(known):
        no_worse = known & (cost <= cost[i]) & (error <= error[i])
        out[i] = not np.any(no_worse & ((cost < cost[i]) | (error < error[i])))
    return out


def write_summary(out: str | Path) -> pd.DataFrame:
    """Writes summary.csv of a result folder, published.csv where its entries give figures, and returns the former.

    Raises:
        InputError: ``out`` is no result folder.
    """
    store = Store.existing(out)
    table = summarise(load_frames(store), store.environment()["run"]["baseline"])
    rows = [{str(key): _yes_no(value) for key, value in row.items()} for row in table.to_dict("records")]
    write_text(store.out / "summary.csv", table_text(SUMMARY_COLUMNS, rows))
    published = published_of_config(store.config())
    ours = {str(row["label"]): _numbers(row) for row in table.to_dict("records")}
    write_published(store.out, compare_published(published, ours, store.environment()["run"]["baseline"]))
    return table


def _numbers(row: Row) -> dict[str, float]:
    return {name: value for name, value in row.items() if isinstance(value, float) and np.isfinite(value)}


def _yes_no(value: Any) -> Any:
    return {True: "yes", False: "no"}[bool(value)] if isinstance(value, bool | np.bool_) else value


def recompute_metrics(out: str | Path) -> int:
    """Computes again, from the raw images, every metric in frames.csv that they suffice for, and records the versions.

    Metrics that were not asked for stay empty, and rows without images stay as they are.

    Returns:
        How many rows were computed again.

    Raises:
        InputError: ``out`` is no result folder, or one of its images cannot be read.
    """
    store = Store.existing(out)
    before = store.rows("frames")
    asked = frozenset(name for name in metrics.METRICS if any(row.get(name) for row in before))
    again = [row for row in before if store.raw(row["label"], "visibility", int(row["frame"])).is_file()]

    def change(row: dict[str, str]) -> Row:
        if row not in again:
            return row
        values = metrics.evaluate(asked, _stored_images(store, row["label"], int(row["frame"])))
        return {**row, **{name: value for name, value in values.items() if metrics.METRICS[name].from_images}}

    store.rewrite_frames(change)
    # A version is a claim about a whole column.
    kept = {name for name in metrics.METRICS if any(row.get(name) and row not in again for row in before)}
    versions = dict(store.environment()["metrics"])
    versions |= {m.name: m.version for m in metrics.METRICS.values() if m.from_images and m.name not in kept}
    store.update_environment(metrics=versions)
    return len(again)


def _stored_images(store: Store, label: str, frame: int) -> metrics.Measured:
    def optional(path: Path) -> np.ndarray | None:
        return read_exr(path) if path.is_file() else None

    return metrics.Measured(
        visibility=read_exr(store.raw(label, "visibility", frame)),
        standard_error=optional(store.raw(label, "standard_error", frame)),
        reference=optional(store.raw(None, "visibility", frame)),
        reference_standard_error=optional(store.raw(None, "standard_error", frame)),
    )
