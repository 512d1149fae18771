"""The stability heat map: techniques by cases, coloured by status, with the level at which a technique breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from experiments.kinds.stability.cases import CASES
from experiments.report.style import new_figure, save, styled

STATUSES = ("not concerned", "ok", "declared", "broken")
COLORS = ("#eceff4", "#7fc8a9", "#f2c14e", "#d1495b")


def draw_heat_map(
    found: Mapping[tuple[str, str], tuple[str, str]], techniques: Sequence[str], cases: Sequence[str], path: Path
) -> None:
    """Writes the map as PNG and SVG.

    Args:
        found: ``breaking_points``.
        techniques, cases: Rows and columns.
        path: Without suffix.
    """
    image = np.zeros((len(techniques), len(cases)), int)
    with styled():
        figure, axes = new_figure(2.6 + 0.62 * len(cases), 1.9 + 0.3 * len(techniques))
        for y, technique in enumerate(techniques):
            for x, case in enumerate(cases):
                status, level = found.get((technique, case), ("not concerned", ""))
                image[y, x] = STATUSES.index(status)
                axes.text(x, y, level, ha="center", va="center", fontsize=5.5, wrap=True)
        axes.imshow(image, cmap=ListedColormap(COLORS), vmin=0, vmax=len(STATUSES) - 1, aspect="auto")
        axes.set_xticks(range(len(cases)), cases, rotation=40, ha="right", fontsize=8)
        axes.set_yticks(range(len(techniques)), techniques, fontsize=8)
        axes.set_xticks(np.arange(len(cases) - 1) + 0.5, minor=True)
        axes.set_yticks(np.arange(len(techniques) - 1) + 0.5, minor=True)
        axes.grid(False)
        axes.grid(which="minor", color="white", linewidth=1.5, alpha=1.0)
        axes.tick_params(which="both", length=0)
        axes.legend(
            [Patch(color=color) for color in COLORS], STATUSES, loc="lower left", bbox_to_anchor=(0.0, 1.01), ncols=4
        )
        for spine in axes.spines.values():
            spine.set_visible(False)
        sources = sorted({CASES[case].source for case in cases}, key=lambda source: int(source[1:]))
        axes.set_title(f"{sources[0]} to {sources[-1]}; text: the level at which it breaks", fontsize=8, loc="right")
        save(figure, path, ["png", "svg"])
