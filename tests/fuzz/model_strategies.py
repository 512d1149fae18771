"""Hypothesis strategies made from pydantic models, and places in data where a model's rules can be broken.

A strategy walks ``model_fields``: types, unions, literals, tuples, nested models, and the bounds of ``Field``. What a
model says is all it knows; rules that span several keys are up to who uses it, who may also give single fields
strategies of their own.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import annotated_types
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from algorithms.projections.schema import OneOf

Overrides = Mapping[tuple[type[BaseModel], str], SearchStrategy]
"""Strategies of single fields, by the class that declares them (or one derived from it) and the field's name."""

WORDS = ("a", "b", "two words", "ü", "x-1", "ground", "reference", "0", "true", "~")
"""Names; YAML would take some of them for something else unless they are quoted."""
_OF = 4  # of so many examples one is taken
_ORDINARY = 10.0  # numbers of up to this size are as likely as all others together


@dataclass(frozen=True)
class Bounds:
    """What a field asks of a number, or of the length of a list or word."""

    low: float | None = None
    high: float | None = None
    above: bool = False
    below: bool = False
    least: int = 0
    most: int | None = None


def bounds_of(metadata: Sequence[Any]) -> Bounds:
    """The bounds among the metadata of an annotation."""
    found: dict[str, Any] = {}
    for item in metadata:
        if isinstance(item, FieldInfo):
            found |= vars(bounds_of(item.metadata))
        if isinstance(item, annotated_types.Ge | annotated_types.Gt):
            strict = isinstance(item, annotated_types.Gt)
            found |= {"low": item.gt if strict else item.ge, "above": strict}
        if isinstance(item, annotated_types.Le | annotated_types.Lt):
            strict = isinstance(item, annotated_types.Lt)
            found |= {"high": item.lt if strict else item.le, "below": strict}
        if isinstance(item, annotated_types.MinLen):
            found["least"] = item.min_length
        if isinstance(item, annotated_types.MaxLen):
            found["most"] = item.max_length
    return Bounds(**found)


def examples(strategy: SearchStrategy, number: int, count: int) -> list[Any]:
    """``count`` examples of a strategy, the same ones for the same number whatever ran before."""
    out: list[Any] = []

    @seed(number)
    @settings(
        max_examples=_OF * count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def collect(example: Any) -> None:
        out.append(example)

    collect()
    out = out[_OF - 1 :: _OF] or out  # neighbours are often varied from one another
    return [out[i % len(out)] for i in range(count)]  # a strategy with few values runs out of them


def from_model(model: type[BaseModel], overrides: Overrides, optional: float = 0.3) -> SearchStrategy[dict[str, Any]]:
    """Mappings that a model accepts, as a file writes them.

    Args:
        model: The model.
        overrides: Strategies in place of those of single fields.
        optional: How often a field that has a default is given.
    """

    @st.composite
    def mapping(draw: st.DrawFn) -> dict[str, Any]:
        out = {}
        for name, field in model.model_fields.items():
            if not field.is_required() and draw(st.floats(0.0, 1.0)) > optional:
                continue
            out[field.alias or name] = draw(of_field(model, name, field, overrides))
        return out

    return mapping()


def of_field(model: type[BaseModel], name: str, field: FieldInfo, overrides: Overrides) -> SearchStrategy:
    """Values that a field accepts."""
    for owner in model.__mro__:
        if (owner, name) in overrides:
            return overrides[owner, name]
    return of_annotation(field.annotation, field.metadata, overrides)


def of_annotation(annotation: Any, metadata: Sequence[Any], overrides: Overrides) -> SearchStrategy:
    """Values of a type with bounds; raises TypeError for one that it does not know."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return of_annotation(arguments[0], [*arguments[1:], *metadata], overrides)
    for item in metadata:
        if isinstance(item, OneOf):
            return st.sampled_from(sorted(item.names()))
    limits = bounds_of(metadata)
    if origin in (typing.Union, types.UnionType):
        return st.one_of([of_annotation(part, metadata, overrides) for part in arguments])
    if origin is typing.Literal:
        return st.sampled_from(arguments)
    if origin is list:
        most = limits.least + 2 if limits.most is None else min(limits.most, limits.least + 2)
        return st.lists(of_annotation(arguments[0], [], overrides), min_size=limits.least, max_size=most)
    if origin is tuple and Ellipsis not in arguments:
        return st.tuples(*(of_annotation(part, [], overrides) for part in arguments)).map(list)
    if annotation is type(None):
        return st.none()
    if annotation is bool:
        return st.booleans()
    if annotation is int:
        return _integers(limits)
    if annotation is float:
        return _floats(limits)
    if annotation is str:
        return st.sampled_from(WORDS)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return from_model(annotation, overrides)
    raise TypeError(f"no strategy for {annotation}")


def _integers(limits: Bounds) -> SearchStrategy[int]:
    low = None if limits.low is None else int(limits.low) + limits.above
    high = None if limits.high is None else int(limits.high) - limits.below
    few = (low if low is not None else 0, (low if low is not None else 0) + 8)
    near = st.integers(few[0], few[1] if high is None else min(few[1], high))
    return st.one_of(near, near, st.integers(low, high))


def _floats(limits: Bounds) -> SearchStrategy[float]:
    """Numbers of the size that people write, half the time; else any, down to the smallest and up to the bounds."""
    low, high = limits.low, limits.high
    every = st.floats(
        low, high, allow_nan=False, allow_infinity=False, exclude_min=limits.above, exclude_max=limits.below
    )
    near_low, near_high = max(-_ORDINARY, _or(low, -_ORDINARY)), min(_ORDINARY, _or(high, _ORDINARY))
    if not near_low < near_high:
        return every
    steps = [near_low + (near_high - near_low) * step / 40.0 for step in range(1, 40)]
    return st.one_of(st.sampled_from(steps), st.sampled_from(steps), st.sampled_from(steps), every)


def _or(value: float | None, other: float) -> float:
    return other if value is None else float(value)


# ---- Breaking -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Breakage:
    """A change that no model may accept.

    Attributes:
        loc: Where.
        what: In words.
        value: What to put there; ``DELETED`` to take the key away.
    """

    loc: tuple[str | int, ...]
    what: str
    value: Any


DELETED = PydanticUndefined
_NOT_FINITE = (float("nan"), float("inf"), float("-inf"))


def breakages(model: type[BaseModel], data: Mapping[str, Any], loc: tuple[str | int, ...] = ()) -> Iterator[Breakage]:
    """Every way to break one rule of a model in data that it accepts: keys, types, bounds, lengths, names."""
    yield Breakage((*loc, "no_such_key"), "a key that is not known", 1)
    for name, field in model.model_fields.items():
        key = field.alias or name
        if field.is_required() and key in data:
            yield Breakage((*loc, key), "a key that is required and missing", DELETED)
        if key in data:
            yield from _of_value(field.annotation, field.metadata, data[key], (*loc, key))


def _of_value(annotation: Any, metadata: Sequence[Any], value: Any, loc: tuple) -> Iterator[Breakage]:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        yield from _of_value(arguments[0], [*arguments[1:], *metadata], value, loc)
    elif origin in (typing.Union, types.UnionType):
        fitting = [part for part in arguments if part is not type(None)]
        if len(fitting) == 1:
            found = _of_value(fitting[0], metadata, value, loc)
            yield from (one for one in found if one.value is not None or one.loc != loc)  # nothing is right here
    elif origin is typing.Literal or any(isinstance(item, OneOf) for item in metadata):
        yield Breakage(loc, "a name that there is not", "no_such_name")
        yield Breakage(loc, "a list for a name", [1])
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel) and isinstance(value, dict):
        yield Breakage(loc, "a word for a mapping", "word")
        yield from breakages(annotation, value, loc)
    elif annotation in (int, float):
        yield from _of_number(annotation, bounds_of(metadata), loc)
    elif annotation is bool:
        yield from (Breakage(loc, "no truth value", wrong) for wrong in ("maybe", 1, 0.0, []))
    elif annotation is str:
        yield from (Breakage(loc, "no word", wrong) for wrong in (7, 0.5, True, [], {}))
    elif origin in (list, tuple) and isinstance(value, list):
        yield from (Breakage(loc, "no list", wrong) for wrong in ("word", {"a": 1}, True))
        limits = bounds_of(metadata)
        if origin is tuple:
            yield Breakage(loc, "an item too few", value[:-1])
            yield Breakage(loc, "an item too many", [*value, value[-1]])
        elif limits.least:
            yield Breakage(loc, "too few items", value[: limits.least - 1])
        for i, item in enumerate(value):
            part = arguments[i] if origin is tuple else arguments[0]
            if part is not Any:
                yield from _of_value(part, [], item, (*loc, i))


def _of_number(kind: type, limits: Bounds, loc: tuple) -> Iterator[Breakage]:
    yield from (Breakage(loc, "no number", wrong) for wrong in ("word", "1", True, [1, 2], {}, None, ""))
    yield from (Breakage(loc, "not finite", wrong) for wrong in _NOT_FINITE)
    if kind is int:
        yield Breakage(loc, "not whole", 1.5)
    if limits.low is not None:
        yield Breakage(loc, "below its bound", limits.low if limits.above else limits.low - max(1.0, abs(limits.low)))
    if limits.high is not None:
        yield Breakage(
            loc, "above its bound", limits.high if limits.below else limits.high + max(1.0, abs(limits.high))
        )


def broken(data: Any, breakage: Breakage) -> Any:
    """A copy of data with a breakage."""
    return _put(data, breakage.loc, breakage.value)


def _put(data: Any, loc: tuple, value: Any) -> Any:
    if not loc:
        return value
    first, rest = loc[0], loc[1:]
    if isinstance(data, list):
        return [_put(item, rest, value) if i == first else item for i, item in enumerate(data)]
    out = dict(data)
    if not rest and value is DELETED:
        del out[first]
    else:
        out[first] = _put(out.get(first), rest, value)
    return out
