"""What is read back from a result folder is checked first: somebody may have edited, cut off or mixed up its files.

Every reader of a folder relies on this: cells of number columns are numbers, whole where they count, a label has one
row for each frame, and environment.json has what reports tell. What is not so is an InputError with file, line, column.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from experiments.config.messages import problems
from wkernels.errors import InputError

TEXTS = frozenset(
    [
        *("technique", "label", "scene", "pass", "what", "reason", "error", "over"),
        *("on_front", "dominated_by", "place", "budget_label", "target_label", "error_to_reference"),
        *("case", "level", "status", "detail"),
    ]
)
"""Columns that hold words."""
WHOLE = frozenset({"frame", "step", "repeat", "count"})
"""Columns that count."""
ABOUT_ALL = frozenset({"failures", "left_out"})
"""Tables whose rows may be about no label or no frame, but the whole run."""
_LARGEST = 10**15


def _stays_inside(name: str) -> bool:
    """Whether a folder of that name lies within the results."""
    path = Path(name)
    return bool(name) and "\0" not in name and not path.is_absolute() and ".." not in path.parts


def _folder_name(name: str) -> str:
    if not _stays_inside(name):
        raise ValueError("cannot be the name of a folder.")
    return name


_FolderName = Annotated[str, AfterValidator(_folder_name)]


class _Record(BaseModel):
    """Part of environment.json; what is not named here is told as it is."""

    model_config = ConfigDict(extra="allow", strict=True)


class _Label(_Record):
    """A label and what its technique declares."""

    label: _FolderName
    technique: str
    family: str | None
    paper: list[str]
    bias_sign: str | None
    history: bool


class _Machine(_Record):
    """Software and machine."""

    threads: int
    device: str
    device_name: str


class RunRecord(_Record):
    """What every kind tells of its run."""

    name: str


class RenderedRecord(RunRecord):
    """Of a walkthrough or of a convergence experiment."""

    scene: str
    triangles: int
    light: str
    width: int
    height: int
    frames: list[int]
    reference_samples: int | None
    reference_light: str | None
    repeats: int
    baseline: str
    labels: list[_Label]


class ConvergenceRecord(RenderedRecord):
    """Of a convergence experiment."""

    camera: str
    frame: int
    steps: list[int]
    expected: int


class _Scene(_Record):
    """A scene of a sweep."""

    name: _FolderName
    triangles: int
    light: str
    frames: list[int]
    labels: list[str]
    left_out: list[dict[str, str]]


class SweepRecord(RunRecord):
    """Of a sweep."""

    width: int
    height: int
    reference_samples: int | None
    reference_light: str | None
    repeats: int
    baseline: str
    budgets: list[str | float]
    labels: list[_Label]
    scenes: list[_Scene]


class _Environment(_Record):
    identity: dict[str, Any]
    environment: _Machine
    metrics: dict[str, int]


def check_environment(data: Mapping[str, Any], run: type[RunRecord], path: Path) -> None:
    """Raises InputError unless environment.json has what is told of a kind's runs."""
    for model, part, key in ((_Environment, data, ""), (run, data.get("run"), "run")):
        if not isinstance(part, Mapping):
            raise InputError("must be an object.", file=path, key=key)
        try:
            model.model_validate(part)
        except ValidationError as error:
            first = problems(error, model, part)[0]
            raise InputError(
                first.message, file=path, key=".".join(map(str, filter(None, (key, *first.loc))))
            ) from None


def check_config(data: Mapping[str, Any], path: Path) -> None:
    """Raises InputError unless the techniques of a resolved experiment are mappings of one name each."""
    entries = data.get("techniques", [])
    if isinstance(entries, str):  # all
        return
    if not isinstance(entries, list):
        raise InputError("must be a list.", file=path, key="techniques")
    for i, entry in enumerate(entries):
        options = next(iter(entry.values()), None) if isinstance(entry, dict) and len(entry) == 1 else None
        named = isinstance(entry, str) or isinstance(options, dict)
        if not named or (isinstance(options, dict) and not isinstance(options.get("label", ""), str)):
            raise InputError("must be one technique with its parameters.", file=path, key=f"techniques.{i}")
        published = options.get("published", {}) if isinstance(options, dict) else {}
        if not isinstance(published, dict) or not all(isinstance(v, int | float) for v in published.values()):
            raise InputError("must map quantities to numbers.", file=path, key=f"techniques.{i}.published")


def check_table(
    name: str, rows: Sequence[Mapping[str, str]], columns: Collection[str], path: Path, unique: Sequence[str] = ()
) -> None:
    """Raises InputError unless the rows of a table are what its columns say.

    Args:
        name: Of the table.
        rows: As ``read_table`` gives them.
        columns: Those that the table has when it is written; later versions may have added some.
        path: The file, for messages.
        unique: Columns that no two rows share.
    """
    if not rows:
        return
    needed = [column for column in columns if column in TEXTS or column in unique]
    missing = [column for column in needed if column not in rows[0]]
    if missing:
        raise InputError(f"has no column '{missing[0]}'.", file=path, line=1)
    seen: dict[tuple[str, ...], int] = {}
    for line, row in enumerate(rows, start=2):
        for column, text in row.items():
            may_be_empty = column not in WHOLE or (name in ABOUT_ALL and column in ("frame", "step"))
            if column not in columns or (text == "" and (may_be_empty or column == "label")):
                continue
            if column == "label" and not _stays_inside(text):
                raise InputError(f"cannot be a label: {text[:40]!r}.", file=path, line=line, key=column)
            if column in TEXTS:
                continue
            if column in WHOLE and not (text.isascii() and text.isdigit() and int(text[:18]) < _LARGEST):
                raise InputError(f"must be a whole number, not {text[:40]!r}.", file=path, line=line, key=column)
            if not _is_number(text):
                raise InputError(f"must be a number or empty, not {text[:40]!r}.", file=path, line=line, key=column)
        key = tuple(row[column] for column in unique)
        if unique and key in seen:
            raise InputError(f"is the same {' and '.join(unique)} as line {seen[key]}.", file=path, line=line)
        seen[key] = line


def _is_number(text: str) -> bool:
    try:
        return not math.isnan(float(text)) and "_" not in text
    except ValueError:
        return False
