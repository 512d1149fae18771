"""README.md's picture: ``python -m experiments.commands.picture OUT/demo docs/images/demo.jpg`` makes it from a run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.results.images import ERROR_SCALE, read_png
from experiments.results.store import Store, labels_in_order
from wkernels.errors import InputError


def draw_picture(folder: Path, picture: Path) -> None:
    """One column per label of the last frame that has a reference: the shaded image above its error map.

    Raises:
        InputError: ``folder`` holds no results, or no frame with a reference.
    """
    from matplotlib.figure import Figure

    store = Store.existing(folder)
    rows = store.rows("frames")
    medians = {row["label"]: float(row["frame_ms"]) for row in store.rows("summary")}
    compared = [row for row in rows if row["rmse"]]
    if not compared:
        raise InputError("no frame of this run has a reference to compare with.", file=folder)
    frame = max(int(row["frame"]) for row in compared)
    rmse = {row["label"]: float(row["rmse"]) for row in compared if int(row["frame"]) == frame}
    labels = [label for label in labels_in_order(rows) if label in rmse]
    columns = min(4, len(labels))
    bands = -(-len(labels) // columns)
    figure = Figure(figsize=(3.2 * columns, bands * 4.05 + 0.3), layout="constrained")
    axes = figure.subplots(2 * bands, columns, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for i, label in enumerate(labels):
        upper, lower = (axes[2 * (i // columns) + k][i % columns] for k in (0, 1))
        upper.imshow(read_png(store.view(label, "shaded", frame)))
        upper.set_title(f"{label}\nrmse {rmse[label]:.3f}, {medians[label]:.0f} ms", fontsize=10)
        lower.imshow(read_png(store.view(label, "error", frame)))
    figure.supxlabel(f"frame {frame}; error maps: {ERROR_SCALE}", fontsize=9)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=100, pil_kwargs={"quality": 88} if picture.suffix == ".jpg" else None)


def main(arguments: list[str] | None = None) -> int:
    """Draws the picture of a result folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="result folder of a run with a reference")
    parser.add_argument("picture", type=Path, help="file to write, .jpg or .png")
    parsed = parser.parse_args(arguments)
    draw_picture(parsed.folder, parsed.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
