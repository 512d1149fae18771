"""The result folder: tables that survive a kill at any moment, raw images, and the record of where they come from.

A frame's rows in the side tables and its images are written first and its row in frames.csv last, so that a row in
frames.csv means that everything of that label and frame is there. ``Store.recover`` drops whatever is not so covered.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from experiments.metrics import METRICS
from wkernels.errors import InputError

FRAME_COLUMNS = (
    "technique", "label", "frame", "frame_ms", "shadow_ms", "fps",
    "rmse", "mean_signed_error", "p99_error", "flip", "standard_error", "reference_standard_error",
    "m_x_max", "m_z_max", "flicker",
    "frame_ms_q1", "frame_ms_q3", "shadow_ms_q1", "shadow_ms_q3", "receiver_pixels",
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

RawKind = Literal["visibility", "standard_error"]
ViewKind = Literal["shaded", "visibility", "error"]
Row = Mapping[str, Any]


def cell(value: Any) -> str:
    """One CSV cell: empty for None and NaN, floats with nine digits, text on one line."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, float):
        return format(value, ".9g")
    return re.sub(r"\s*[\r\n]+\s*", " ", str(value))


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def _line(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def write_text(path: Path, text: str) -> None:
    """Replaces a file in one step, so that a kill leaves the old or the new one."""
    part = path.with_name(f".part-{path.name}")
    with open(part, "w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, path)


def table_text(columns: Sequence[str], rows: Sequence[Row]) -> str:
    """A whole CSV table as text; keys a row does not have are empty cells."""
    return "".join([_line(columns), *(_line([cell(row.get(name)) for name in columns]) for row in rows)])


class Table:
    """An append-only CSV file; a row is on the disk when ``append`` returns."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        new = not path.exists() or path.stat().st_size == 0
        self._file = open(path, "a", encoding="utf-8", newline="")  # noqa: SIM115 (closed in close)
        if new:
            self._put(_line(self.columns))

    def append(self, rows: Sequence[Row]) -> None:
        """Adds rows; a key that is not a column is a defect."""
        for row in rows:
            unknown = set(row) - set(self.columns)
            if unknown:
                raise KeyError(f"no such column: {', '.join(sorted(unknown))}")
        if rows:
            self._put("".join(_line([cell(row.get(name)) for name in self.columns]) for row in rows))

    def _put(self, text: str) -> None:
        self._file.write(text)
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Closes the file; closing twice is fine."""
        self._file.close()


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV table that are complete: a line without its line end, as a kill leaves it, is not."""
    if not path.is_file():
        return []
    text = path.read_bytes().decode("utf-8", errors="replace")
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1], newline="")))
    if not lines:
        return []
    return [dict(zip(lines[0], line, strict=True)) for line in lines[1:] if len(line) == len(lines[0])]


class Store:
    """One result folder.

    Attributes:
        out: The folder.
    """

    def __init__(self, out: Path) -> None:
        self.out = out
        self._tables: dict[str, Table] = {}

    # ---- Opening ----

    @classmethod
    def existing(cls, out: str | Path) -> Store:
        """An earlier run's folder, for reading.

        Raises:
            InputError: It is no result folder.
        """
        out = Path(out)
        if not out.is_dir():
            raise InputError("there is no such result folder.", file=out)
        missing = [name for name in ("config.yaml", "environment.json", "frames.csv") if not (out / name).is_file()]
        if missing:
            raise InputError(f"is not a result folder: it has no {', '.join(missing)}.", file=out)
        store = cls(out)
        if absent := {"identity", "run", "environment", "metrics"} - set(store.environment()):
            raise InputError(f"has no '{min(absent)}'; it is not from a run.", file=out / "environment.json")
        return store

    @classmethod
    def open(cls, out: str | Path, config: str, environment: Mapping[str, Any], *, resume: bool) -> Store:
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
        started = bool(self.rows("frames") or self.rows("failures"))
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
        names = [f"{name}.csv" for name in (*TABLES, "summary")] + ["report.html", "environment.json", "config.yaml"]
        for name in names:
            (self.out / name).unlink(missing_ok=True)
        for folder in ("images", "plots"):
            if (self.out / folder).is_dir():
                shutil.rmtree(self.out / folder)

    def recover(self) -> None:
        """Makes all tables consistent with the complete rows of frames.csv and failures.csv."""
        done = self.done()
        for name, columns in TABLES.items():
            rows = self.rows(name)
            if name in ("passes", "left_out"):
                rows = [row for row in rows if (row["label"], int(row["frame"])) in done]
            write_text(self.out / f"{name}.csv", table_text(columns, rows))

    # ---- Rows ----

    def append(self, table: str, rows: Sequence[Row]) -> None:
        """Adds rows to a table of ``TABLES``; they are on the disk when this returns."""
        if table not in self._tables:
            self._tables[table] = Table(self.out / f"{table}.csv", TABLES[table])
        self._tables[table].append(rows)

    def start_tables(self) -> None:
        """Creates every table, so that one without rows is there with its head."""
        for name in TABLES:
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
        """Label and frame of all complete frames."""
        return {(row["label"], int(row["frame"])) for row in self.rows("frames")}

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

    def image_frames(self, label: str | None) -> list[int]:
        """Frames of which there is a raw visibility image, ascending."""
        found = (self.out / "images" / image_folder(label)).glob("visibility_*.exr")
        return sorted(int(path.stem.rpartition("_")[2]) for path in found)


def image_folder(label: str | None) -> str:
    """Folder of a label's images under images/; None is the reference."""
    if label is None:
        return "reference"
    # Labels are valid file names (the schema sees to it) but may be the name that is taken already.
    return f"{label} (label)" if label.casefold() == "reference" else label


def labels_in_order(rows: Collection[Row]) -> list[str]:
    """The labels of a table in the order of their first rows."""
    return list(dict.fromkeys(str(row["label"]) for row in rows))
