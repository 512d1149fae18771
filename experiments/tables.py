"""CSV tables of which a kill at any moment leaves all complete rows."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]


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
        self._file = open(path, "a", encoding="utf-8", newline="")
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
