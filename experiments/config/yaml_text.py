"""YAML text to plain data and back, restricted to what a config needs.

Scalars follow the YAML 1.2 core schema, so that ``1e-3`` is a number and ``on`` a word; mapping keys are always
strings, as written. Nothing in a file can run code: mappings, sequences, numbers, booleans, strings and null are all
there is.
"""

from __future__ import annotations

import math
import re
from typing import Any

import yaml
import yaml.reader

from wkernels.errors import InputError

_MAX_VALUES = 1_000_000  # after aliases are expanded; stops "billion laughs" files
_DEEPEST_FAST = 100  # levels
_TAG = "tag:yaml.org,2002:"


def read_yaml(text: str, file: str | None) -> tuple[Any, yaml.Node]:
    """The data of a YAML document and its node graph, which knows the lines.

    Raises:
        InputError: The text is empty, no valid YAML, has a duplicate key or a tag; names ``file`` and the line.
    """
    try:
        loader = _Loader(text) if _fast_loader is None or not _is_plain(text, _fast_loader) else _fast_loader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                raise InputError("is empty.", file=file, line=1)
            return _Builder(loader, file).build(root), root
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = error.problem or error.context or "cannot be parsed"
        if "<stream end>" in what and error.context_mark:  # what was opened and never closed says more than the end
            mark = error.context_mark
        raise InputError(f"is not valid YAML: {what}.", file=file, line=mark.line + 1 if mark else None) from None
    except yaml.reader.ReaderError as error:
        line = text[: error.position].count("\n") + 1
        raise InputError(f"is not valid YAML: {error.reason}.", file=file, line=line) from None
    except RecursionError:
        raise InputError("is nested too deeply.", file=file) from None


def dump_yaml(data: Any) -> str:
    """Plain data as YAML text that ``parse_yaml`` reads back to the same values; keys keep their order."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100)


_RESOLVERS: tuple[tuple[str, str, str], ...] = (
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("int", r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", "-+0123456789"),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        "-+0123456789.",
    ),
    ("null", r"^(?:~|null|Null|NULL|)$", "~nN\0"),
    ("merge", r"^(?:<<)$", "<"),
)


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - PyYAML's own protocol


_fast_loader: type | None = None  # libyaml's, ten times faster: what loads scenes of 20 000 meshes in seconds
if yaml.__with_libyaml__:

    class _FastLoader(yaml.CSafeLoader):
        yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers

    _fast_loader = _FastLoader


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _name, _pattern, _firsts in _RESOLVERS:
    for _class in (_Loader, _Dumper):
        _first_characters = [c if c != "\0" else "" for c in _firsts]
        _class.add_implicit_resolver(_TAG + _name, re.compile(_pattern), _first_characters)


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    text = repr(value) if math.isfinite(value) else ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return dumper.represent_scalar(_TAG + "float", text)


_Dumper.add_representer(float, _represent_float)


def _is_plain(text: str, loader: type) -> bool:
    """Whether libyaml may read a text: it is valid, which PyYAML words better where it is not, and not nested deeply.

    Its composer recurses in C without a limit; its events come one by one.
    """
    depth = 0
    try:
        for event in yaml.parse(text, Loader=loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST_FAST:
                return False
    except (yaml.YAMLError, UnicodeError):
        return False
    return True


class _Builder:
    """Turns a node graph into plain data; shared nodes (aliases) become shared values."""

    def __init__(self, loader: yaml.SafeLoader, file: str | None) -> None:
        self.loader, self.file = loader, file
        self.built: dict[int, tuple[Any, int]] = {}  # id(node) -> value, number of values in it
        self.open: set[int] = set()

    def build(self, node: yaml.Node) -> Any:
        return self._build(node)[0]

    def _error(self, message: str, node: yaml.Node) -> InputError:
        return InputError(message, file=self.file, line=node.start_mark.line + 1)

    def _build(self, node: yaml.Node) -> tuple[Any, int]:
        if id(node) in self.built:
            return self.built[id(node)]
        if id(node) in self.open:
            raise self._error("an alias refers to itself.", node)
        self.open.add(id(node))
        result: tuple[Any, int]
        if isinstance(node, yaml.MappingNode):
            result = self._mapping(node)
        elif isinstance(node, yaml.SequenceNode):
            self._check_tag(node, "seq")
            items = [self._build(item) for item in node.value]
            result = [value for value, _ in items], 1 + sum(count for _, count in items)
        else:
            result = self._scalar(node), 1
        if result[1] > _MAX_VALUES:
            raise self._error(f"aliases expand to more than {_MAX_VALUES} values.", node)
        self.open.remove(id(node))
        self.built[id(node)] = result
        return result

    def _check_tag(self, node: yaml.Node, *names: str) -> None:
        if node.tag not in {_TAG + name for name in names}:
            raise self._error(f"the tag '{node.tag.replace(_TAG, '!!')}' is not allowed.", node)

    def _mapping(self, node: yaml.MappingNode) -> tuple[dict[str, Any], int]:
        self._check_tag(node, "map")
        seen: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self._error("a key must be a word, not a list or mapping.", key)
            if key.value in seen:
                raise self._error(f"the key '{key.value}' is here twice (first on line {seen[key.value]}).", key)
            seen[key.value] = key.start_mark.line + 1
        self.loader.flatten_mapping(node)
        data: dict[str, Any] = {}
        count = 1
        for key, value_node in node.value:
            value, size = self._build(value_node)
            data[key.value] = value
            count += size
        return data, count

    def _scalar(self, node: yaml.Node) -> str | int | float | bool | None:
        self._check_tag(node, "str", "int", "float", "bool", "null")
        text, kind = node.value, node.tag.removeprefix(_TAG)
        try:
            if kind == "int":
                return int(text, 0) if text[:2] in ("0x", "0o") else int(text)
            if kind == "float":
                return float(re.sub(r"\.(?=[in])", "", text.lower()))  # ".inf" and ".nan" are Python's "inf" and "nan"
        except ValueError:
            raise self._error(f"'{text}' is not a valid {kind}.", node) from None
        if kind == "bool":
            return text.lower() == "true"
        return None if kind == "null" else text
