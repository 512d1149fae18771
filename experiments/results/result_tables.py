"""Tables of a result folder while they are written: what the disk does not take waits, and is never lost in silence."""

from __future__ import annotations

import contextlib
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from experiments.results.locks import FolderLock
from experiments.results.tables import Row, Table, cell, parse_table, read_table, table_text, write_text
from wkernels.errors import InputError

FAILURE_COLUMNS = ("technique", "label", "frame", "error", "what")
Failed = Literal["technique", "file", "folder", "reference", "report"]
"""What failed: a technique, which ``resume`` does not try again; or something that it does."""
Put = Callable[..., None]
LOST_ON_A_FOLDER = "the result folder was deleted or moved; its tables were written anew, images made before are gone"
RECORD = ("environment.json", "config.yaml")


def cannot_write(out: Path, error: OSError) -> InputError:
    """The message for a file of a result folder that cannot be written."""
    name = error.filename if isinstance(error.filename, str) else None
    why = error.strerror or error
    if name is None or Path(name) == out:
        return InputError(f"cannot write results here ({why}).", file=out)
    return InputError(f"cannot write results here ({why}: {Path(name).name.removeprefix('.part-')}).", file=out)


@contextlib.contextmanager
def refusing(out: Path) -> Iterator[None]:
    """Turns a failure to write into the one message, where there is nothing that could be lost."""
    try:
        yield
    except OSError as error:
        raise cannot_write(out, error) from error


class ResultTables:
    """The tables of one result folder.

    Attributes:
        out: The folder.
        tables: Columns of its tables.
        main: The table with one row for each piece of work that is done.
        place: The column of that table that, with the label, names the piece.
        spare: Where ``close`` put tables that could not be written; None where all could.
        unwritten: File names of those tables, and why.
    """

    tables: Mapping[str, tuple[str, ...]]
    main: str
    place: str

    def __init__(self, out: Path) -> None:
        self.out = out
        self.spare: Path | None = None
        self.unwritten: dict[str, str] = {}
        self._tables: dict[str, Table] = {}
        self._aside: dict[str, str] = {}
        self._record: list[str] = []  # texts of ``RECORD`` while rows are written
        self._lock = FolderLock()

    def append(self, table: str, rows: Sequence[Row]) -> None:
        """Adds rows to a table of ``tables``; they are on the disk when this returns, or wait for it (``Table``)."""
        if table not in self._tables:
            self._tables[table] = Table(self.out / f"{table}.csv", self.tables[table])
        self._restore_folder(rows)
        with contextlib.suppress(OSError):  # ``close`` tries again and says what is lost
            self._tables[table].append(rows)

    def append_once(self, table: str, rows: Sequence[Row]) -> None:
        """Adds those rows that are not there yet, which an earlier part of the run may have added."""
        names = self.tables[table]
        there = {tuple(row[name] for name in names) for row in self.rows(table)}
        self.append(table, [row for row in rows if tuple(cell(row.get(name)) for name in names) not in there])

    def _restore_folder(self, rows: Sequence[Row]) -> None:
        """Makes a folder that was deleted anew, for the tables to follow."""
        if not self._record or (self.out / "environment.json").is_file():
            return
        record, self._record = self._record, []
        with contextlib.suppress(OSError, InputError):
            self.out.mkdir(parents=True, exist_ok=True)
            for name, text in zip(RECORD, record, strict=True):
                write_text(self.out / name, text)
            place = next((row[self.place] for row in rows if self.place in row), "")
            self.record_failure("", "", place, FileNotFoundError(LOST_ON_A_FOLDER), "folder")
            self._lock.take(self.out)
        self._record = record

    def record_failure(
        self, technique: str, label: str, place: int | str, error: BaseException, what: Failed = "technique"
    ) -> None:
        """Adds a row to failures.csv and a file with the traceback; ``place`` is the frame or step."""
        short = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        folder = self.out / "failures"
        with contextlib.suppress(OSError):  # the row says what happened
            folder.mkdir(exist_ok=True)
            write_text(folder / f"{label or what}.txt", "".join(traceback.format_exception(error)))
        row = {"technique": technique, "label": label, "frame": place, "error": short, "what": what}
        self.append("failures", [row])

    @contextlib.contextmanager
    def files(self, technique: str, label: str, place: int) -> Iterator[Put]:
        """Yields ``put(write, path, ...)``; files that cannot be written are one failure, and nothing is raised."""
        lost: list[tuple[Path, Exception]] = []

        def put(write: Callable[..., None], path: Path, *arguments: Any) -> None:
            try:
                write(path, *arguments)
            except OSError as error:
                lost.append((path, error))

        yield put
        if lost:
            path, error = lost[0]
            more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
            why = getattr(error, "strerror", None) or str(error)
            failure = OSError(f"cannot write {path}: {why}{more}")
            self.record_failure(technique, label, place, failure, "file")

    def failed(self) -> set[str]:
        """Labels whose technique failed: they are not tried again."""
        return {row["label"] for row in self.rows("failures") if row.get("what", "technique") in ("", "technique")}

    def start_tables(self) -> None:
        """Creates every table, so that one without rows is there with its head; nobody else may write until ``close``.

        Raises:
            InputError: The folder cannot be written, or another run is writing there.
        """
        try:
            self._record = [(self.out / name).read_text(encoding="utf-8") for name in RECORD]
            self._lock.take(self.out)
            for name in self.tables:
                self._tables[name] = Table(self.out / f"{name}.csv", self.tables[name])
                self._tables[name].flush()
        except (OSError, InputError) as error:
            for table in self._tables.values():
                table.close()  # nothing is computed yet that could be lost
            self._tables.clear()
            self._lock.release()
            raise error if isinstance(error, InputError) else cannot_write(self.out, error) from error

    def close(self) -> None:
        """Closes all tables; rows that the disk does not take are put into a spare folder (``spare``)."""
        waiting = {}
        for name, table in self._tables.items():
            try:
                table.flush()
            except OSError as error:
                waiting[name] = table.text()
                self.unwritten[f"{name}.csv"] = error.strerror or str(error)
            table.close()
            table.unwritten = ""
        if waiting:
            self._put_aside(waiting)
        self._tables.clear()
        self._lock.release()
        self._record = []

    def unwritten_text(self) -> str:
        """Which tables ``close`` could not write, and where they are; empty where it could."""
        if not self.unwritten:
            return ""
        names = ", ".join(f"{name} ({why})" for name, why in self.unwritten.items())
        kept = f"they are in {self.spare}; copy them there" if self.spare else "nor anywhere else, and are lost"
        return f"Tables could not be written to {self.out}: {names}; {kept}."

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Starts the tables and closes them at the end, however it comes; an exception says what could not be written.

        Raises:
            InputError: As ``start_tables``.
        """
        self.start_tables()
        try:
            yield
        except BaseException as error:
            self.close()
            if self.unwritten:
                error.add_note(self.unwritten_text())
            raise
        self.close()

    def _put_aside(self, texts: Mapping[str, str]) -> None:
        files = {f"{name}.csv": text for name, text in texts.items()}
        files |= dict(zip(RECORD, self._record, strict=False))
        with contextlib.suppress(OSError):
            self.spare = Path(tempfile.mkdtemp(prefix=f"wkernels-{self.out.name}-"))
            for name, text in files.items():
                write_text(self.spare / name, text)
        self._aside = dict(texts)

    def rows(self, table: str) -> list[dict[str, str]]:
        """The complete rows of a table, every cell as text, those that wait too; empty where the table is missing."""
        if table in self._aside:
            return parse_table(self._aside[table])
        if table in self._tables:
            return parse_table(self._tables[table].text())
        return read_table(self.out / f"{table}.csv")

    def done(self) -> set[tuple[str, int]]:
        """Label and frame (or step) of all complete ones."""
        return {(row["label"], int(row[self.place])) for row in self.rows(self.main)}

    def put_in_order(self, labels: Sequence[str]) -> None:
        """Sorts tables by place and label, as an uninterrupted run writes them: what is made again comes last."""
        at = {label: i for i, label in enumerate(labels)}
        for name, columns in self.tables.items():
            if self.place not in columns or name == "failures":
                continue
            rows = self.rows(name)
            ordered = sorted(rows, key=lambda row: (int(row[self.place] or -1), at.get(row["label"], -1)))
            if rows != ordered and not (name in self._tables and self._tables[name].unwritten):
                if name in self._tables:
                    self._tables.pop(name).close()
                with contextlib.suppress(OSError):  # the order is all that is lost
                    write_text(self.out / f"{name}.csv", table_text(columns, ordered))
