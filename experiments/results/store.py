"""The result folder: tables that survive a kill at any moment, raw images, and the record of where they come from.

A frame's rows in the side tables and its images are written first and its row in frames.csv last, so that a row in
frames.csv means that everything of that label and frame is there. ``Store.recover`` drops whatever is not so covered.

What cannot be written ends no run. Rows wait in memory for the next that can be written; those that wait at the end go
to a spare folder. An image that cannot be written is a row of failures.csv, and its frame is rendered again with
``resume``; so is what a folder that was deleted had held.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from experiments.config.source import load_yaml
from experiments.metrics.registry import MAP_METRICS, METRICS, SCORES
from experiments.results.images import check_path
from experiments.results.result_tables import FAILURE_COLUMNS, RECORD, ResultTables, cannot_write
from experiments.results.tables import Row, table_text, write_text
from wkernels.errors import InputError

FRAME_COLUMNS = (
    "technique", "label", "frame", "frame_ms", "shadow_ms", "fps",
    "rmse", "mean_signed_error", "p99_error", "flip", "standard_error", "reference_standard_error",
    "m_x_max", "m_z_max", "flicker",
    "frame_ms_q1", "frame_ms_q3", "shadow_ms_q1", "shadow_ms_q3", "receiver_pixels", "disoccluded",
    *MAP_METRICS, *SCORES, "flicker_edges",
)  # fmt: skip
REPEAT_COLUMNS = ("technique", "label", "frame", "repeat", "frame_ms", "shadow_ms")
PASS_COLUMNS = ("technique", "label", "frame", "pass", "ms")
LEFT_OUT_COLUMNS = ("label", "what", "reason", "count", "frame")
TABLES: Mapping[str, tuple[str, ...]] = {
    "frames": FRAME_COLUMNS,
    "repeats": REPEAT_COLUMNS,
    "passes": PASS_COLUMNS,
    "left_out": LEFT_OUT_COLUMNS,
    "failures": FAILURE_COLUMNS,
}
assert set(METRICS) <= set(FRAME_COLUMNS)

RawKind = Literal["visibility", "standard_error"]
ViewKind = Literal["shaded", "visibility", "error", "standard_error"]


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


class Store(ResultTables):
    """One result folder."""

    tables: Mapping[str, tuple[str, ...]] = TABLES
    main = "frames"
    place = "frame"

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
        missing = [name for name in (*sorted(RECORD), f"{cls.main}.csv") if not (out / name).is_file()]
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
            InputError: The folder cannot be written, is not named in UTF-8, holds something else or results of another
                run, or another run is writing there.
        """
        store = cls(Path(out))
        check_path(store.out)
        try:
            store._prepare(config, environment, resume)
        except OSError as error:
            raise cannot_write(store.out, error) from error
        return store

    def _prepare(self, config: str, environment: Mapping[str, Any], resume: bool) -> None:
        out = self.out
        if out.exists() and not out.is_dir():
            raise InputError("is a file; results need a folder.", file=out)
        if not self._is_ours():
            raise InputError("holds other files and no earlier run; give a new or empty folder with --out.", file=out)
        self._lock.refuse_if_taken(out)
        config_file = out / "config.yaml"
        started = self.started()
        if started:
            self._check_same(config_file, config, environment, resume)
        if started and resume:
            self.recover()
            self._note_resumed(environment)
            return
        self._clear()
        out.mkdir(parents=True, exist_ok=True)
        # In this order: what a kill in between leaves behind is still known to be ours.
        write_text(out / "environment.json", _json(environment))
        write_text(config_file, config)

    def started(self) -> bool:
        """Whether there is anything that a resumed run would keep."""
        return any(self.rows(name) for name in ("frames", "convergence", "stability", "failures"))

    def _note_resumed(self, environment: Mapping[str, Any]) -> None:
        """Adds the machine and commit of this part of the run, where they are not those of the part before."""
        now = {k: v for k, v in environment.get("environment", {}).items() if k != "date"}
        told = self.environment()
        parts = [told.get("environment", {}), *told.get("resumed", [])]
        if {k: v for k, v in parts[-1].items() if k != "date"} != now:
            self.update_environment(resumed=[*parts[1:], environment["environment"]])

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
        """Deletes what an earlier run wrote but environment.json, so that after a kill the rest is known to be ours."""
        written = ("convergence", "estimates", "stability", "savings", "summary", "published", "prediction")
        for name in ["failures", *TABLES, *written]:  # rows first: they say that images are there
            (self.out / f"{name}.csv").unlink(missing_ok=True)
        for folder in ("images", "plots", "failures"):
            if (self.out / folder).is_dir():
                shutil.rmtree(self.out / folder)
        for name in ("report.html", "config.yaml"):
            (self.out / name).unlink(missing_ok=True)

    def recover(self) -> None:
        """Makes all tables consistent with the complete rows of the main one and of failures.csv.

        Rows go whose images could not be written, or whose reference could not be made, so that they are made again.
        """
        failures = self.rows("failures")
        again = [row for row in failures if row.get("what", "technique") not in ("", "technique")]
        self._write_rows(self.main, [row for row in self.rows(self.main) if self._is_whole(row, again)])
        done = self.done()
        for name in self.tables:
            rows = self.rows(name)
            if name == "failures":
                rows = [row for row in failures if row not in again]
            elif name != self.main and self.place in self.tables[name]:  # a row without a frame is about the whole run
                rows = [row for row in rows if not row[self.place] or (row["label"], int(row[self.place])) in done]
            if name != self.main:
                self._write_rows(name, rows)
        for part in self.out.rglob(".part-*"):
            part.unlink(missing_ok=True)

    def _write_rows(self, table: str, rows: Sequence[Row]) -> None:
        write_text(self.out / f"{table}.csv", table_text(self.tables[table], rows))

    def _is_whole(self, row: Mapping[str, str], failures: Collection[Mapping[str, str]]) -> bool:
        """Whether nothing is missing of the piece of work that a row of the main table is about."""
        if not row[self.place].isdigit():
            return False
        for failure in failures:
            here = failure["frame"] == row[self.place]
            if failure["what"] == "file" and here and failure["label"] == row["label"]:
                return False
            if failure["what"] in ("file", "reference") and here and not failure["label"]:
                return False
            if failure["what"] == "folder" and not all(path.is_file() for path in self._images_of(row)):
                return False
        return True

    def _images_of(self, row: Mapping[str, str]) -> list[Path]:
        """Raw images that there are where nothing was lost."""
        frame, frames = int(row["frame"]), self.environment()["run"].get("frames", [])
        reference = [self.raw(None, "visibility", frame)] if row["rmse"] else []
        return [self.raw(row["label"], "visibility", frame), *reference] if reference or frame in frames[-1:] else []

    # ---- Record ----

    def rewrite_frames(self, change: Callable[[dict[str, str]], Row]) -> None:
        """Replaces every row of frames.csv by ``change(row)``, in one step."""
        write_text(self.out / "frames.csv", table_text(FRAME_COLUMNS, [change(row) for row in self.rows("frames")]))

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


def image_folder(label: str | None) -> str:
    """Folder of a label's images under images/; None is the reference."""
    if label is None:
        return "reference"
    # Labels are valid file names (the schema sees to it) but may be the name that is taken already.
    return f"{label} (label)" if label.casefold() == "reference" else label


def labels_in_order(rows: Collection[Row]) -> list[str]:
    """The labels of a table in the order of their first rows."""
    return list(dict.fromkeys(str(row["label"]) for row in rows))
