"""Published figures beside ours: published.csv and its text for people.

An entry of ``techniques``, or a curve of ``kind: analysis``, may say what its source printed (``published: {fps: 1}``).
Times of other machines are not comparable, so walkthroughs also give the ratios to the baseline on either side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.results.tables import Row, aligned, cell, read_table, table_text, write_text

COLUMNS = ("label", "quantity", "published", "ours", "published_ratio", "ours_ratio")


def compare_published(
    published: Mapping[str, Mapping[str, float]], ours: Mapping[str, Mapping[str, float]], baseline: str | None = None
) -> list[dict[str, Any]]:
    """Rows of published.csv.

    Args:
        published: By label, by quantity.
        ours: Likewise; for a walkthrough the rows of summary.csv. A label without rows yields empty cells.
        baseline: The label that ratios are relative to; None for no ratios.
    """
    rows = []
    for label, quantities in published.items():
        for name, value in quantities.items():
            own = ours.get(label, {})
            row: dict[str, Any] = {"label": label, "quantity": name, "published": float(value), "ours": own.get(name)}
            base = published.get(baseline, {}).get(name) if baseline else None
            if base:
                row["published_ratio"] = value / base
            if baseline:
                row["ours_ratio"] = _ratio(own, ours.get(baseline, {}), name)
            rows.append(row)
    return rows


def _ratio(own: Mapping[str, float], base: Mapping[str, float], name: str) -> float | None:
    """Costs as summary.csv compares them, frame by frame; everything else by its medians."""
    if name == "fps":
        cost = own.get("frame_ms_ratio")
        return 1.0 / cost if cost else None
    if f"{name}_ratio" in own:
        return own[f"{name}_ratio"]
    value, other = own.get(name), base.get(name)
    return value / other if value is not None and other else None


def write_published(out: Path, rows: Sequence[Row]) -> None:
    """Writes published.csv; nothing where there is nothing to compare."""
    if rows:
        write_text(out / "published.csv", table_text(COLUMNS, rows))


def read_published(out: Path) -> list[dict[str, Any]]:
    """The rows of a folder's published.csv with numbers as floats, None where empty; none without the file."""
    rows: list[dict[str, Any]] = []
    for row in read_table(out / "published.csv"):
        numbers = {name: float(row[name]) if row[name] else None for name in COLUMNS[2:]}
        rows.append({"label": row["label"], "quantity": row["quantity"], **numbers})
    return rows


def published_of_config(config: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """By label, what the entries of a resolved experiment file publish."""
    entries = [next(iter(entry.values())) for entry in config.get("techniques", [])]
    return {entry["label"]: entry["published"] for entry in entries if "published" in entry}


def published_text(rows: Sequence[Row]) -> str:
    """The rows as aligned columns; empty without rows."""
    if not rows:
        return ""
    names = [name for name in COLUMNS if any(cell(row.get(name)) for row in rows)]
    return aligned([names, *([_short(row.get(name)) for name in names] for row in rows)])


def _short(value: Any) -> str:
    return format(value, ".4g") if isinstance(value, float) and value == value else cell(value)
