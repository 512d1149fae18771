"""The result folder: tables that survive a kill at any moment, raw images, and the record of where they come from.

A frame's rows in the side tables and its images are written first and its row in frames.csv last, so that a row in
frames.csv means that everything of that label and frame is there. ``Store.recover`` drops whatever is not so covered.
"""

from __future__ import annotations

import json
import shutil
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self

from experiments.config.source import load_yaml
from experiments.metrics import MAP_METRICS, METRICS
from experiments.tables import Row, Table, read_table, table_text, write_text
from wkernels.errors import InputError

FRAME_COLUMNS = (
    "technique", "label", "frame", "frame_ms", "shadow_ms", "fps",
    "rmse", "mean_signed_error", "p99_error", "flip", "standard_error", "reference_standard_error",
    "m_x_max", "m_z_max", "flicker",
    "frame_ms_q1", "frame_ms_q3", "shadow_ms_q1", "shadow_ms_q3", "receiver_pixels", "disoccluded",
    *MAP_METRICS,
)  # fmt: skip
PASS_COLUMNS = ("technique", "label", "frame", "pass", "ms")
LEFT_OUT_COLUMNS = ("label", "what", "reason", "count", "frame")
FAILURE_COLUMNS = ("technique", "label", "frame", "error")
TABLES: Mapping[str, tuple[str, ...]] = {
    "frames": FRAME_COLUMNS,
    "passes": PASS_COLUMNS,
    "left_out": LEFT_OUT_COLUMNS,
    "failures": FAILURE_COLUMNS,
}
assert set(METRICS) <= set(FRAME_COLUMNS)
CONVERGENCE_COLUMNS = (
    "technique", "label", "step", "n", "rmse", "mean_signed_error", "standard_error", "coverage_2se",
    "over", "p99_error", "reference_standard_error", "penumbra_rmse", "penumbra_standard_error",
    "n_effective", "zero_standard_error", "receiver_pixels", "penumbra_pixels",
)  # fmt: skip

RawKind = Literal["visibility", "standard_error"]
ViewKind = Literal["shaded", "visibility", "error", "standard_error"]


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


class Store:
    """One result folder.

    Attributes:
        out: The folder.
        tables: Columns of its tables.
        main: The table with one row for each piece of work that is done.
        place: The column of that table that, with the label, names the piece.
    """

    tables: Mapping[str, tuple[str, ...]] = TABLES
    main = "frames"
    place = "frame"

    def __init__(self, out: Path) -> None:
        self.out = out
        self._tables: dict[str, Table] = {}

    # ---- Opening ----

    @classmethod
    def existing(cls, out: str | Path) -> Self:
        """An earlier run's folder, for reading.

        Raises:
            InputError: It is no result folder.
        """
        out = Path(out)
        if not out.is_dir():
            raise InputError("there is no such result folder.", file=out)
        missing = [
            name for name in ("config.yaml", "environment.json", f"{cls.main}.csv") if not (out / name).is_file()
        ]
        if missing:
            raise InputError(f"is not a result folder: it has no {', '.join(missing)}.", file=out)
        store = cls(out)
        if absent := {"identity", "run", "environment", "metrics"} - set(store.environment()):
            raise InputError(f"has no '{min(absent)}'; it is not from a run.", file=out / "environment.json")
        return store

    @classmethod
    def open(cls, out: str | Path, config: str, environment: Mapping[str, Any], *, resume: bool) -> Self:
        """A folder to write into: a new one, one to start afresh, or one to continue.

        Args:
            out: The folder.
            config: Resolved experiment file.
            environment: What goes to environment.json; its ``identity`` must not change between parts of one run.
            resume: Continue: keep complete rows. Without earlier rows this is a fresh start.

        Raises:
            InputError: The folder cannot be written, holds something else, or holds results of another run.
        """
        store = cls(Path(out))
        try:
            store._prepare(config, environment, resume)
        except OSError as error:
            raise InputError(f"cannot write results here ({error.strerror or error}).", file=out) from error
        return store

    def _prepare(self, config: str, environment: Mapping[str, Any], resume: bool) -> None:
        out = self.out
        if out.exists() and not out.is_dir():
            raise InputError("is a file; results need a folder.", file=out)
        if not self._is_ours():
            raise InputError("holds other files and no earlier run; give a new or empty folder with --out.", file=out)
        config_file = out / "config.yaml"
        started = any(self.rows(name) for name in ("frames", "convergence", "failures"))
        if started:
            self._check_same(config_file, config, environment, resume)
        if started and resume:
            self.recover()
            return
        self._clear()
        out.mkdir(parents=True, exist_ok=True)
        # In this order: what a kill in between leaves behind is still known to be ours.
        write_text(out / "environment.json", _json(environment))
        write_text(config_file, config)

    def _is_ours(self) -> bool:
        """Whether everything here may be replaced: nothing is here, or a run that this module began."""
        if not self.out.is_dir() or not any(self.out.iterdir()):
            return True
        if all(path.name.startswith(".part-") for path in self.out.iterdir()):
            return True
        try:
            return "identity" in self.environment()
        except InputError:
            return False

    def _check_same(self, config_file: Path, config: str, environment: Mapping[str, Any], resume: bool) -> None:
        if config_file.read_text(encoding="utf-8") != config:
            message = "cannot be resumed with another" if resume else "holds results of another"
            raise InputError(f"the folder {message} configuration; give a new folder with --out.", file=config_file)
        if not resume:
            return
        old, new = self.environment().get("identity", {}), environment.get("identity", {})
        changed = sorted(key for key in {*old, *new} if old.get(key) != new.get(key))
        if changed:
            shown = "; ".join(f"{key} was {old.get(key)}, is {new.get(key)}" for key in changed)
            message = f"the run cannot be resumed, because its rows would not be comparable: {shown}."
            raise InputError(message, file=self.out / "environment.json")

    def _clear(self) -> None:
        written = ("convergence", "estimates", "stability", "savings", "summary", "published", "prediction")
        names = [f"{name}.csv" for name in (*TABLES, *written)]
        names += ["report.html", "environment.json", "config.yaml"]
        for name in names:
            (self.out / name).unlink(missing_ok=True)
        for folder in ("images", "plots", "failures"):
            if (self.out / folder).is_dir():
                shutil.rmtree(self.out / folder)

    def recover(self) -> None:
        """Makes all tables consistent with the complete rows of the main one and of failures.csv."""
        done = self.done()
        for name, columns in self.tables.items():
            rows = self.rows(name)
            if name in ("passes", "left_out"):
                rows = [row for row in rows if (row["label"], int(row["frame"])) in done]
            write_text(self.out / f"{name}.csv", table_text(columns, rows))

    # ---- Rows ----

    def append(self, table: str, rows: Sequence[Row]) -> None:
        """Adds rows to a table of ``tables``; they are on the disk when this returns."""
        if table not in self._tables:
            self._tables[table] = Table(self.out / f"{table}.csv", self.tables[table])
        self._tables[table].append(rows)

    def record_failure(self, technique: str, label: str, place: int, error: Exception) -> None:
        """Adds a row to failures.csv and a file with the traceback; ``place`` is the frame or step."""
        short = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        folder = self.out / "failures"
        folder.mkdir(exist_ok=True)
        write_text(folder / f"{label}.txt", "".join(traceback.format_exception(error)))
        self.append("failures", [{"technique": technique, "label": label, "frame": place, "error": short}])

    def start_tables(self) -> None:
        """Creates every table, so that one without rows is there with its head."""
        for name in self.tables:
            self.append(name, [])

    def close(self) -> None:
        """Closes all tables."""
        for table in self._tables.values():
            table.close()
        self._tables.clear()

    def rows(self, table: str) -> list[dict[str, str]]:
        """The complete rows of a table, every cell as text; empty where the table is missing."""
        return read_table(self.out / f"{table}.csv")

    def done(self) -> set[tuple[str, int]]:
        """Label and frame (or step) of all complete ones."""
        return {(row["label"], int(row[self.place])) for row in self.rows(self.main)}

    def rewrite_frames(self, change: Callable[[dict[str, str]], Row]) -> None:
        """Replaces every row of frames.csv by ``change(row)``, in one step."""
        write_text(self.out / "frames.csv", table_text(FRAME_COLUMNS, [change(row) for row in self.rows("frames")]))

    # ---- Record ----

    def environment(self) -> dict[str, Any]:
        """environment.json.

        Raises:
            InputError: It is missing or damaged.
        """
        path = self.out / "environment.json"
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read ({error}).", file=path) from error
        if not isinstance(data, dict):
            raise InputError("must hold a JSON object.", file=path)
        return data

    def config(self) -> dict[str, Any]:
        """config.yaml, the resolved experiment.

        Raises:
            InputError: It is missing or damaged.
        """
        data = load_yaml(self.out / "config.yaml").data
        if not isinstance(data, dict):
            raise InputError("must hold a mapping.", file=self.out / "config.yaml")
        return data

    def update_environment(self, **changes: Any) -> None:
        """Sets top-level keys of environment.json."""
        write_text(self.out / "environment.json", _json({**self.environment(), **changes}))

    # ---- Images ----

    def raw(self, label: str | None, kind: RawKind, frame: int) -> Path:
        """Path of a raw float image (EXR) of a label, or of the reference (None)."""
        return self.out / "images" / image_folder(label) / f"{kind}_{frame:04d}.exr"

    def view(self, label: str | None, kind: ViewKind, frame: int) -> Path:
        """Path of a picture for people (PNG) of a label, or of the reference (None)."""
        return self.out / "images" / image_folder(label) / f"{kind}_{frame:04d}.png"

    def picture(self, label: str, name: str, frame: int) -> Path:
        """Path of one of the pictures that the key ``views`` asks for (PNG)."""
        return self.out / "images" / image_folder(label) / "views" / f"{name}_{frame:04d}.png"

    def pictures(self, label: str) -> list[tuple[str, int]]:
        """Name and frame of all such pictures of a label, by name, frames ascending."""
        found = (self.out / "images" / image_folder(label) / "views").glob("*_[0-9]*.png")
        parts = (path.stem.rpartition("_") for path in found if not path.name.startswith("."))
        return sorted((name, int(frame)) for name, _, frame in parts)

    def image_frames(self, label: str | None) -> list[int]:
        """Frames of which there is a raw visibility image, ascending."""
        found = (self.out / "images" / image_folder(label)).glob("visibility_*.exr")
        return sorted(int(path.stem.rpartition("_")[2]) for path in found)


class ConvergenceStore(Store):
    """The folder of a run of ``kind: convergence``: images are of steps, a still camera's reference is of step 1."""

    tables: Mapping[str, tuple[str, ...]] = MappingProxyType(
        {"convergence": CONVERGENCE_COLUMNS, "failures": FAILURE_COLUMNS}
    )
    main = "convergence"
    place = "step"


def image_folder(label: str | None) -> str:
    """Folder of a label's images under images/; None is the reference."""
    if label is None:
        return "reference"
    # Labels are valid file names (the schema sees to it) but may be the name that is taken already.
    return f"{label} (label)" if label.casefold() == "reference" else label


def labels_in_order(rows: Collection[Row]) -> list[str]:
    """The labels of a table in the order of their first rows."""
    return list(dict.fromkeys(str(row["label"]) for row in rows))
