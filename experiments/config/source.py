"""Plain data that remembers the file and the lines it was read from, and models that report mistakes with them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from experiments.config.messages import Loc, Problem, problems, shown
from experiments.config.yaml_text import dump_yaml, read_yaml
from wkernels.errors import InputError

__all__ = ["Source", "StrictModel", "dotted", "dump_yaml", "from_dict", "load_yaml", "parse_yaml", "validate"]


class StrictModel(BaseModel):
    """Base of all models read from YAML: unknown keys, coerced types and non-finite numbers are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True, validate_default=True)


M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Source:
    """Plain data and where it came from.

    Attributes:
        data: Nested dict, list, str, int, float, bool and None.
        file: The file it was read from; None for data that never was in a file.
    """

    data: Any
    file: str | None = None
    _root: yaml.Node | None = None
    _overrides: Mapping[Loc, str] = field(default_factory=dict)

    def get(self, loc: Loc = ()) -> Any:
        """The value at a key path; raises KeyError, IndexError or TypeError where there is none."""
        value = self.data
        for part in loc:
            value = value[part]
        return value

    def line(self, loc: Loc) -> int | None:
        """1-based line of the key or list item at ``loc`` or of its closest existing parent; None without a file."""
        if self._root is None:
            return None
        node, line = self._root, self._root.start_mark.line
        for part in loc:
            child = _child(node, part)
            if child is None:
                break
            line, node = child
        return int(line) + 1

    def place(self, loc: Loc) -> tuple[str | None, int | None]:
        """File and line to name in a message about ``loc``; the override itself where one supplied the value."""
        for length in range(len(loc), 0, -1):
            if loc[:length] in self._overrides:
                return self._overrides[loc[:length]], None
        return self.file, self.line(loc)

    def error(self, message: str, loc: Loc = ()) -> InputError:
        """An InputError about the value at ``loc``, to be raised by the caller."""
        file, line = self.place(loc)
        return InputError(message, file=file, line=line, key=dotted(loc) or None)

    def replaced(self, loc: Loc, value: Any, origin: str) -> Source:
        """A copy with ``value`` at ``loc``; ``origin`` is named instead of file and line in messages about it."""
        return Source(_replaced(self.data, loc, value), self.file, self._root, {**self._overrides, loc: origin})


def dotted(loc: Loc) -> str:
    """``('meshes', 0, 'size')`` as ``meshes.0.size``, the form that ``--set`` takes too."""
    return ".".join(str(part) for part in loc)


def load_yaml(path: str | Path) -> Source:
    """Reads one YAML file.

    Raises:
        InputError: The file is missing, unreadable, not UTF-8, empty, no valid YAML, has a duplicate key or a tag.
    """
    file = str(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file.", file=file) from None
    except IsADirectoryError:
        raise InputError("is a folder, not a file.", file=file) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError("is not UTF-8 text.", file=file, line=line) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InputError(f"cannot be read: {reason}.", file=file) from None
    return parse_yaml(text, file)


def parse_yaml(text: str, file: str | None = None) -> Source:
    """Parses YAML text; ``file`` is only named in messages. Raises InputError like ``load_yaml``."""
    data, root = read_yaml(text, file)
    return Source(data, file, root)


def from_dict(data: Any) -> Source:
    """Wraps data that never was in a file; tuples, paths and NumPy values become plain ones.

    Raises:
        InputError: A value is of a type that no YAML file could hold.
    """
    return Source(_plain(data, ()))


def validate(
    model: type[M],
    source: Source,
    loc: Loc = (),
    data: Any = None,
    *,
    foreign: bool = False,
    moved: Mapping[str, Loc] | None = None,
) -> M:
    """Builds ``model`` from the source, strictly (no string is taken for a number, no number for a boolean).

    Args:
        model: The pydantic model.
        source: Where the data came from; names file and line in messages.
        loc: Key path of the data within the source.
        data: The data, if it is not simply what the source holds at ``loc``.
        foreign: The model is no StrictModel (a plugin's ``Params``) and is to be as strict as one.
        moved: Top-level keys of ``data`` that stand elsewhere in the source, with their place relative to ``loc``.

    Raises:
        InputError: The data does not fit; names the first mistake and counts the others.
    """
    if data is None:
        data = source.get(loc)
    if not isinstance(data, dict):
        raise source.error(f"must be a mapping of keys to values, not {shown(data)}.", loc)
    try:
        # Through JSON, because only there strict mode takes lists for tuples and strings for enums and paths.
        if foreign:
            return model.model_validate_json(json.dumps(data), strict=True, extra="forbid")
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise _as_input_error(problems(error, model, data), source, loc, moved or {}) from None


def _as_input_error(found: Sequence[Problem], source: Source, loc: Loc, moved: Mapping[str, Loc]) -> InputError:
    # A misspelt key often comes with "... is required": the misspelling is the one to show.
    first = min(found, key=lambda p: (not p.unknown_key, source.line((*loc, *p.loc)) or 0))
    head = first.loc[:1]
    place = moved[str(head[0])] + first.loc[1:] if head and head[0] in moved else first.loc
    more = f" ({len(found) - 1} more mistake{'s' if len(found) > 2 else ''}.)" if len(found) > 1 else ""
    return source.error(first.message + more, (*loc, *place))


def _child(node: yaml.Node, part: str | int) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for key, value in reversed(node.value):  # merged keys come first, the mapping's own win
            if key.value == part:
                return key.start_mark.line, value
    elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and 0 <= part < len(node.value):
        return node.value[part].start_mark.line, node.value[part]
    return None


def _replaced(data: Any, loc: Loc, value: Any) -> Any:
    if not loc:
        return value
    first, rest = loc[0], loc[1:]
    if isinstance(data, list) and isinstance(first, int):
        return [_replaced(item, rest, value) if i == first else item for i, item in enumerate(data)]
    mapping = data if isinstance(data, dict) else {}
    return {**mapping, first: _replaced(mapping.get(first), rest, value)}


def _plain(value: Any, loc: Loc) -> Any:
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        value = value.tolist()
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item, (*loc, str(key))) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, (*loc, i)) for i, item in enumerate(value)]
    if isinstance(value, Path):
        return str(value)
    raise InputError(f"a value of type {type(value).__name__} cannot be used here.", key=dotted(loc) or None)
