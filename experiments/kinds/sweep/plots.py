"""plots/pareto_SCENE.png: error against time of one scene, and of all relative to the baseline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.kinds.sweep.config import ALL
from experiments.report import style
from experiments.report.plots import error_vs_time


def write_plots(out: Path, rows: Sequence[dict[str, Any]], noise: dict[str, float], baseline: str) -> None:
    """One plot per scene that has rows.

    Args:
        out: The sweep's folder.
        rows: Of pareto.csv.
        noise: The reference's standard error, by scene.
        baseline: What the plot over all scenes is relative to.
    """
    look = style.Look(list(dict.fromkeys(str(row["label"]) for row in rows)))
    for scene in dict.fromkeys(str(row["scene"]) for row in rows):
        figure = error_vs_time(_table(rows, scene, noise.get(scene, np.nan)), look, **_titles(scene, baseline))
        style.save(figure, out / "plots" / f"pareto_{scene}", ("png", "svg"))


def _table(rows: Sequence[dict[str, Any]], scene: str, noise: float) -> pd.DataFrame:
    """Rows of one scene as ``summarise`` would give them."""
    time = "ratio" if scene == ALL else "frame_ms"
    table = pd.DataFrame([row for row in rows if row["scene"] == scene])
    for name in ("", "_q1", "_q3"):
        for column, source in ((f"frame_ms{name}", f"{time}{name}"), (f"rmse{name}", f"rmse{name}")):
            table[column] = pd.to_numeric(table[source]) if source in table else np.nan
    table["pareto"] = table["on_front"] == "yes"
    table["reference_standard_error"] = noise
    return table


def _titles(scene: str, baseline: str) -> dict[str, str]:
    if scene != ALL:
        return {}
    return {
        "title": f"RMSE, × that of {baseline}",
        "time": f"frame time, × that of {baseline}",
        "spread": "geometric mean and quartiles over scenes",
    }
