"""What the interactive parts of a page read: points, curves and images of a result folder, as JSON."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.metrics.registry import MAP_METRICS, METRICS
from experiments.report.fields import REFERENCE, FieldFrame, error_palette
from experiments.report.pictures import jpeg_url
from experiments.results.images import read_exr, read_png, visibility_view, write_jpeg
from experiments.results.store import Store
from experiments.results.tables import read_table

THUMB_WIDTH = 260  # pixels
MAX_SHADED_CHARACTERS = 6_000_000  # of pictures that only the viewer shows
TITLES: Mapping[str, tuple[str, str]] = {  # of columns that are no metric: title, unit
    "frame_ms": ("frame time", "ms"),
    "shadow_ms": ("shadow time", "ms"),
    "frame_ms_ratio": ("frame time, × baseline", ""),
    "ratio": ("frame time, × baseline", ""),
    "shadow_ms_ratio": ("shadow time, × baseline", ""),
    "fps": ("frames per second", ""),
    "m_x_max": ("largest m_x along the view", "texels in pixels"),
    "m_z_max": ("largest m_z along the view", "texels in pixels"),
    "disoccluded": ("disoccluded share of the receivers", ""),
}
TIMES = ("frame_ms", "shadow_ms", "frame_ms_ratio", "ratio")
NO_ERRORS = {"reference_standard_error", "standard_error", *MAP_METRICS}  # metrics that measure no error of the picture
CURVES = ("frame_ms", "shadow_ms", "rmse", "flip", "standard_error", "flicker", "flicker_edges", "m_x_max")


def column_title(name: str) -> dict[str, str]:
    """Name, title, unit and description of a column, for axes and tables."""
    if name in METRICS:
        metric = METRICS[name]
        return {"name": name, "title": metric.title, "unit": "", "description": metric.description}
    title, unit = TITLES.get(name, (name.replace("_", " "), ""))
    return {"name": name, "title": title, "unit": unit, "description": ""}


def chart_data(
    table: pd.DataFrame,
    *,
    details: Mapping[str, Mapping[str, str]] | None = None,
    thumbs: Mapping[str, str] | None = None,
    baseline: str = "",
    by: str = "label",
    front: Sequence[bool] | None = None,
    indistinct_below: float = float("nan"),
) -> dict[str, Any]:
    """Points of the error/time scatter: every label with the numbers of every column that has some.

    Args:
        table: A row per label: ``technique``, ``label``, and numbers, of which ``NAME_q1`` and ``NAME_q3`` are the
            quartiles of NAME.
        details: Parameters by label, as texts.
        thumbs: Pictures by label, as data URLs.
        baseline: Label that ratios refer to.
        by: ``label`` or ``technique``: what has a colour and mark of its own, and is shown and hidden together.
        front: Whether each row is on the Pareto front of time and RMSE, where that was judged by more than the medians.
        indistinct_below: RMSE below which nothing can be told from the reference.
    """
    numbers = [str(name) for name in table.columns if table[name].dtype.kind == "f" and table[name].notna().any()]
    names = [name for name in numbers if not name.endswith(("_q1", "_q3"))]
    points = []
    for i, row in enumerate(table.to_dict("records")):
        values = {}
        for name in names:
            own = [row.get(key, np.nan) for key in (name, f"{name}_q1", f"{name}_q3")]
            if np.isfinite(own[0]):
                values[name] = own if np.isfinite(own[1]) and np.isfinite(own[2]) else own[:1]
        label = str(row["label"])
        points.append({
            "label": label,
            "technique": str(row["technique"]),
            "group": str(row[by]),
            "values": values,
            "details": dict((details or {}).get(label, {})),
            "front": None if front is None else front[i],
            "thumb": (thumbs or {}).get(label),
        })  # fmt: skip
    return {
        "points": points,
        "groups": list(dict.fromkeys(point["group"] for point in points)),
        "columns": {name: _named(column_title(name), baseline) for name in names},
        "x": [name for name in TIMES if name in names],
        "y": [name for name in names if name in METRICS and name not in NO_ERRORS],
        "floor": {"rmse": indistinct_below},
    }


def _named(column: dict[str, str], baseline: str) -> dict[str, str]:
    return column | {"title": column["title"].replace("baseline", baseline or "baseline")}


def curve_data(frames: pd.DataFrame) -> dict[str, Any]:
    """Columns of frames.csv over the frame number, a curve per label; and the share that each frame uncovered."""
    numbers = sorted(int(frame) for frame in frames["frame"].unique())
    metrics = [name for name in frames.columns if name in METRICS and name not in NO_ERRORS and name not in CURVES]
    columns = [name for name in (*CURVES, *metrics) if name in frames and frames[name].notna().any()]
    curves: dict[str, dict[str, list[float]]] = {name: {} for name in columns}
    for label, own in frames.groupby("label", sort=False):
        rows = own.set_index("frame").reindex(numbers)
        for name in columns:
            if rows[name].notna().any():
                curves[name][str(label)] = rows[name].tolist()
    out: dict[str, Any] = {
        "frames": numbers,
        "curves": [{**column_title(name), "lines": curves[name]} for name in columns],
    }
    if "disoccluded" in frames and frames["disoccluded"].max() > 0.0:
        share = frames.groupby("frame")["disoccluded"].mean().reindex(numbers)
        out["disoccluded"] = share.tolist()
    return out


def viewer_data(
    store: Store, labels: Sequence[str], fields: Sequence[FieldFrame], shaded: Sequence[int]
) -> dict[str, Any] | None:
    """What the viewer shows: frames, labels, and shaded pictures of the frames that are not among ``shaded``.

    Args:
        store: The result folder.
        labels: Labels in order.
        fields: What ``field_frames`` gave.
        shaded: Frames whose shaded pictures the page shows anyway.
    """
    if not fields:
        return None
    frames, left = [], MAX_SHADED_CHARACTERS
    for made in fields:
        own = {} if made.frame in shaded or left <= 0 else _shaded(store, labels, made.frame)
        left -= sum(len(url) for url in own.values())
        frames.append({"frame": made.frame, "width": made.width, "height": made.height, "shaded": own})
    return {
        "frames": frames,
        "labels": [label for label in labels if any(label in made.fields for made in fields)],
        "reference": any(REFERENCE in made.fields for made in fields),
        "errorColours": error_palette(),
        "step": fields[0].step,
        "characters": sum(made.characters for made in fields),
    }


def _shaded(store: Store, labels: Sequence[str], frame: int) -> dict[str, str]:
    paths = {label: store.view(label, "shaded", frame) for label in labels}
    urls = {label: jpeg_url(path) for label, path in paths.items()}
    return {label: url for label, url in urls.items() if url}


def thumbs(store: Store, labels: Sequence[str]) -> dict[str, str]:
    """A small picture of each label that has images, of the middle one of its frames, as data URLs."""
    out = {}
    with tempfile.TemporaryDirectory(prefix="wkernels-report-") as folder:
        scratch = Path(folder) / "thumb.jpg"
        for label in labels:
            frames = store.image_frames(label)
            if not frames:
                continue
            frame = frames[len(frames) // 2]
            path = store.view(label, "shaded", frame)
            if path.is_file():
                rgb = read_png(path)
            else:
                rgb = visibility_view(read_exr(store.raw(label, "visibility", frame)))
            write_jpeg(scratch, shrink(rgb, THUMB_WIDTH))
            out[label] = "data:image/jpeg;base64," + base64.b64encode(scratch.read_bytes()).decode("ascii")
    return out


def shrink(rgb: np.ndarray, width: int) -> np.ndarray:
    """Means of square blocks, as many as bring a picture (H, W, 3) to at least ``width``; uint8."""
    step = max(1, rgb.shape[1] // width)
    height, wide = rgb.shape[0] // step * step, rgb.shape[1] // step * step
    if step == 1 or not height:
        return rgb
    blocks = rgb[:height, :wide].reshape(height // step, step, wide // step, step, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def with_summary(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """The table with those numbers of the folder's summary.csv, by label, that it lacks."""
    rows = read_table(folder / "summary.csv")
    if not rows:
        return table
    found = pd.DataFrame(rows).drop_duplicates("label").set_index("label")
    more = {
        str(name): pd.to_numeric(found[name].reindex(table["label"]), errors="coerce").to_numpy(float)
        for name in found.columns
        if name not in table and name not in ("technique", "frames", "reference_frames")
    }
    known = {name: values for name, values in more.items() if np.isfinite(values).any()}
    return table.assign(**known)


def parameters(config: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Parameters of each label as a resolved configuration gives them; texts by name."""
    from experiments.report.page import plain

    out: dict[str, dict[str, str]] = {}
    for entry in config.get("techniques", []):
        for name, values in entry.items() if isinstance(entry, Mapping) else ():
            own = dict(values) if isinstance(values, Mapping) else {}
            label = str(own.pop("label", name))
            own.pop("published", None)
            out[label] = {str(key): plain(value) for key, value in own.items()}
    return out
