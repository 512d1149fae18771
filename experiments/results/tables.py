"""CSV tables of which a kill at any moment leaves all complete rows, and a full disk none but complete ones."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wkernels.errors import InputError

Row = Mapping[str, Any]

_READ_WRITE = os.O_RDWR | getattr(os, "O_BINARY", 0)


def cell(value: Any) -> str:
    """One CSV cell: empty for None and NaN, floats with nine digits, text on one line."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, float):
        return format(value, ".9g")
    return re.sub(r"\s*[\r\n]+\s*", " ", str(value))


def _line(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def replace_file(part: Path, path: Path, *, now: bool = True) -> None:
    """Puts a complete file in another's place; a kill or a loss of power leaves one or the other.

    With ``now`` the new one is there after a loss of power; without, once a row is in a table that is written later.
    """
    _to_disk(part, _READ_WRITE)
    os.replace(part, path)
    if now and os.name == "posix":  # elsewhere a folder cannot be opened
        _to_disk(path.parent, os.O_RDONLY)


def _to_disk(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Replaces a file in one step, so that a kill leaves the old or the new one.

    Raises:
        OSError: It cannot be written; what was there is there still.
    """
    part = path.with_name(f".part-{path.name}")
    try:
        part.write_bytes(text.encode())
        replace_file(part, path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
        raise


def table_text(columns: Sequence[str], rows: Sequence[Row]) -> str:
    """A whole CSV table as text; keys a row does not have are empty cells."""
    return "".join([_line(columns), *(_line([cell(row.get(name)) for name in columns]) for row in rows)])


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Cells in columns, for people."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


class Table:
    """An append-only CSV file; a row is on the disk when ``append`` returns.

    Where it cannot be written, complete rows stay in ``unwritten`` and go to the disk with the next that can be.

    Attributes:
        path: The file.
        columns: Names of its columns.
        unwritten: Rows, as text, that wait for the disk.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path, self.columns = path, tuple(columns)
        self.unwritten = ""
        self._file, self._size = -1, 0

    def append(self, rows: Sequence[Row]) -> None:
        """Adds rows; a key that is not a column is a defect.

        Raises:
            OSError: They are in ``unwritten``; the file holds what it held.
        """
        for row in rows:
            unknown = set(row) - set(self.columns)
            if unknown:
                raise KeyError(f"no such column: {', '.join(sorted(unknown))}")
        self.unwritten += "".join(_line([cell(row.get(name)) for name in self.columns]) for row in rows)
        self.flush()

    def flush(self) -> None:
        """Writes what waits; makes a file that was deleted or moved away anew, with all its rows.

        Raises:
            OSError: As ``append``.
        """
        if self._file < 0:
            self._file = os.open(self.path, _READ_WRITE | os.O_CREAT, 0o666)
            self._size = os.fstat(self._file).st_size
        elif self._is_gone():
            self._make_anew()
        data = ("" if self._size else _line(self.columns)).encode() + self.unwritten.encode()
        done = 0
        try:
            os.lseek(self._file, self._size, os.SEEK_SET)
            while done < len(data):  # a disk that fills up takes a part first and refuses the rest
                done += os.write(self._file, data[done:])
            if data:
                os.fsync(self._file)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise
        self._size += done
        self.unwritten = ""

    def text(self) -> str:
        """The whole table, with the rows that wait."""
        if self._file < 0:
            held = self.path.read_bytes() if self.path.is_file() else b""
        else:
            held = b""
            os.lseek(self._file, 0, os.SEEK_SET)
            while len(held) < self._size and (more := os.read(self._file, self._size - len(held))):
                held += more
        return (held.decode("utf-8", errors="replace") or _line(self.columns)) + self.unwritten

    def _is_gone(self) -> bool:
        try:
            there = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return True
        return not os.path.samestat(there, os.fstat(self._file))

    def _make_anew(self) -> None:
        text = self.text()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_text(self.path, text)
        self.close()
        self._file = os.open(self.path, _READ_WRITE)
        self._size, self.unwritten = len(text.encode()), ""

    def close(self) -> None:
        """Closes the file; closing twice is fine."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV table that are complete: a line without its line end, as a kill leaves it, is not."""
    if not path.is_file():
        return []
    try:
        return parse_table(path.read_bytes().decode("utf-8", errors="replace"))
    except csv.Error as error:
        raise InputError(f"is not a table: {error}.", file=path) from None


def parse_table(text: str) -> list[dict[str, str]]:
    """The complete rows of a table's text."""
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1], newline="")))
    if not lines:
        return []
    return [dict(zip(lines[0], line, strict=True)) for line in lines[1:] if len(line) == len(lines[0])]
