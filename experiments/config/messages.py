"""pydantic's validation errors in plain words, with the nearest valid name where a name is wrong."""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from wkernels.errors import nearest

Loc = tuple[str | int, ...]


@dataclass(frozen=True)
class Problem:
    """One mistake: where it is in the data, and a sentence that says what is wrong."""

    loc: Loc
    message: str
    unknown_key: bool = False


_KINDS = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a word",
    "path_type": "a file name",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "model_attributes_type": "a mapping of keys to values",
    "none_required": "left empty",
    "finite_number": "a finite number",
}

_WRONG_TYPE = re.compile(rf"must be ({'|'.join(set(_KINDS.values()))}), (not .+\.)", re.DOTALL)

_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
    "multiple_of": ("multiple_of", "a multiple of"),
}


def problems(error: ValidationError, model: type[BaseModel], data: Any) -> list[Problem]:
    """All mistakes of a validation, at most one per place in the data, in pydantic's order."""
    by_place: dict[Loc, list[str]] = {}
    unknown: set[Loc] = set()
    for item in error.errors(include_url=False):
        loc = _place(item["loc"], data)
        if item["type"] == "missing" and item["loc"]:
            last = item["loc"][-1]
            if isinstance(last, str):
                loc = (*_place(item["loc"][:-1], data), last)
        elif item["type"] == "union_tag_invalid":
            loc = (*loc, item["ctx"]["discriminator"].strip("'"))
        elif item["type"] == "extra_forbidden":
            unknown.add(loc)
        by_place.setdefault(loc, []).append(_sentence(item, model))
    return [
        Problem(loc, _joined(list(dict.fromkeys(sentences))), loc in unknown)
        for loc, sentences in by_place.items()
        if not _is_other_member(loc, sentences, by_place)
    ]


def _is_other_member(loc: Loc, sentences: list[str], by_place: dict[Loc, list[str]]) -> bool:
    """Whether these are complaints of union members that were not meant: another one got further into the data."""
    deeper = any(len(other) > len(loc) and other[: len(loc)] == loc for other in by_place)
    return deeper and all(_WRONG_TYPE.fullmatch(sentence) for sentence in sentences)


def _joined(sentences: list[str]) -> str:
    # The members of a union fail one by one: "must be a number, not 'x'." + "must be a list, not 'x'." is one message.
    heads = [match for s in sentences if (match := _WRONG_TYPE.fullmatch(s))]
    if len(heads) < len(sentences):
        return next(s for s in sentences if not _WRONG_TYPE.fullmatch(s))
    return f"must be {' or '.join(head[1] for head in heads)}, {heads[0][2]}"


def _place(loc: Loc, data: Any) -> Loc:
    """The part of a pydantic location that exists in the data (it also lists union members and validators)."""
    place: list[str | int] = []
    for part in loc:
        if isinstance(data, dict) and isinstance(part, str) and part in data:
            data = data[part]
        elif isinstance(data, list) and isinstance(part, int) and 0 <= part < len(data):
            data = data[part]
        else:
            continue
        place.append(part)
    return tuple(place)


def shown(value: Any) -> str:
    """A value as it may stand in a message: short, None as "nothing"."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value)
    return text if len(text) < 40 else text[:36] + "..."


def _sentence(item: Any, model: type[BaseModel]) -> str:
    kind, ctx, loc = item["type"], item.get("ctx", {}), item["loc"]
    value = shown(item["input"])
    if kind == "extra_forbidden":
        return "is not a known key." + nearest(str(loc[-1]), _known_keys(model, loc[:-1]))
    if kind == "missing":
        if isinstance(loc[-1], int):
            return f"has too few items: {value}."
        return "is required."
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}, not {value}."
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"must be {words} {ctx[name]:g}, not {value}."
    if kind in ("too_short", "too_long"):
        words, bound = ("at least", ctx["min_length"]) if kind == "too_short" else ("at most", ctx["max_length"])
        return f"must have {words} {bound} item{'' if bound == 1 else 's'}, not {ctx['actual_length']}."
    if kind in ("string_too_short", "string_pattern_mismatch"):
        return f"must not be {value}: {item['msg']}."
    if kind in ("literal_error", "enum"):
        return f"{value} is not a valid name." + nearest(str(item["input"]), _quoted(ctx["expected"]))
    if kind == "union_tag_invalid":
        return f"'{ctx['tag']}' is not a valid name." + nearest(ctx["tag"], _quoted(ctx["expected_tags"]))
    if kind == "union_tag_not_found":
        return f"needs the key {ctx['discriminator']}."
    if kind == "value_error":
        return str(ctx["error"])
    return f"{item['msg'][:1].lower()}{item['msg'][1:]}, not {value}."


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _known_keys(model: type[BaseModel], loc: Loc) -> list[str]:
    """Names of the fields of the model (or union of models) that pydantic was filling at ``loc``."""
    candidates: list[Any] = [model]
    for part in loc:
        inner = [found for candidate in candidates for found in _inner(candidate, part)]
        if inner:
            candidates = inner
        else:  # not a key but the name of a union member: its class name or its tag
            candidates = [c for c in candidates if _answers_to(c, str(part))] or candidates
    return [key for c in candidates if _is_model(c) for key in _fields(c)]


def _is_model(candidate: Any) -> bool:
    return isinstance(candidate, type) and issubclass(candidate, BaseModel)


def _fields(model: type[BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _inner(candidate: Any, part: str | int) -> Iterable[Any]:
    if _is_model(candidate):
        return _members(_fields(candidate).get(str(part)))
    arguments = typing.get_args(candidate)
    origin = typing.get_origin(candidate)
    if isinstance(part, int) and origin in (list, tuple, set, frozenset):
        return [m for argument in arguments if argument is not Ellipsis for m in _members(argument)]
    if isinstance(part, str) and origin is dict:
        return _members(arguments[1])
    return []


def _members(annotation: Any) -> list[Any]:
    """The alternatives of an annotation: ``Annotated`` is taken off, unions are flattened."""
    if annotation is None:
        return []
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _members(typing.get_args(annotation)[0])
    if origin in (typing.Union, types.UnionType):
        return [m for argument in typing.get_args(annotation) for m in _members(argument)]
    return [annotation]


def _answers_to(candidate: Any, name: str) -> bool:
    if not _is_model(candidate):
        return False
    tags = {str(tag) for f in candidate.model_fields.values() for tag in typing.get_args(f.annotation)}
    return candidate.__name__ == name or name in tags
