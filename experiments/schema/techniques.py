"""The ``techniques`` list of an experiment: names, parameters, labels and sweeps.

An entry is a name, or ``name: {parameter: value, ...}``. Four keys are not parameters: ``label`` names the run,
``projection`` changes single keys of the experiment's projection, ``sweep`` lists values per parameter, whose product
gives one run each, labelled ``pcf[taps=4]``, and ``published`` gives figures of the source to print beside ours.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from algorithms.projections.composition import compose
from algorithms.projections.schema import Projection
from experiments.config.messages import Loc, shown
from experiments.config.source import Source, validate
from experiments.schema.published import QUANTITIES, check_published
from wkernels.errors import InputError, nearest

_OPTIONS = ("label", "projection", "sweep", "published")
_MAX_RUNS = 1000


@dataclass(frozen=True, eq=False)
class TechniqueRun:
    """One line of the results.

    Attributes:
        label: Unique name in the results.
        name: Registered name of the technique.
        params: Every parameter of the technique's ``Params``.
        projection: The projection as a mapping with the keys of the experiment file; None leaves it to the technique.
        loc: Key path of the entry in the experiment file.
        published: What the source printed, by column of summary.csv.
    """

    label: str
    name: str
    params: dict[str, Any]
    projection: dict[str, Any] | None = None
    loc: Loc = ()
    published: dict[str, float] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """The entry of an experiment file that gives this run."""
        options: dict[str, Any] = {"label": self.label}
        if self.projection is not None:
            options["projection"] = self.projection
        if self.published:
            options["published"] = self.published
        return {self.name: {**options, **to_jsonable_python(self.params)}}


def expand_techniques(
    source: Source,
    plugins: Mapping[str, type],
    default: Projection | None,
    entries: Sequence[tuple[Loc, Any]] | None = None,
) -> tuple[TechniqueRun, ...]:
    """All runs of the ``techniques`` list, in order.

    Args:
        source: The experiment file.
        plugins: Techniques by name; each has a pydantic model ``Params``.
        default: The experiment's projection, if it gives one.
        entries: Places and entries, where they are not simply those of the list.

    Raises:
        InputError: An unknown technique or parameter, a wrong value, a projection that makes no sense, an empty sweep,
            or two runs with the same label.
    """
    if default is not None:
        check_projection(source, ("projection",), default.written())
    runs: list[TechniqueRun] = []
    if entries is None:
        entries = [(("techniques", i), entry) for i, entry in enumerate(source.data["techniques"])]
    for loc, entry in entries:
        for run in _expand_entry(source, loc, entry, plugins, default):
            earlier = next((other for other in runs if other.label.casefold() == run.label.casefold()), None)
            if earlier is not None:
                line = source.line(earlier.loc)
                where = f" on line {line}" if line else ""
                message = f"the label '{run.label}' is taken already{where}; give one of the two a 'label'."
                raise source.error(message, run.loc)
            runs.append(run)
            if len(runs) > _MAX_RUNS:
                raise source.error(f"the sweeps multiply to more than {_MAX_RUNS} runs.", run.loc)
    return tuple(runs)


def _expand_entry(
    source: Source,
    loc: Loc,
    entry: str | dict[str, Any],
    plugins: Mapping[str, type],
    default: Projection | None,
) -> Iterator[TechniqueRun]:
    if isinstance(entry, dict):
        if len(entry) != 1:
            raise source.error("must be one technique: a name, or one name with its parameters.", loc)
        name, options = next(iter(entry.items()))
        inner: Loc = (*loc, name)
    else:
        name, options, inner = entry, None, loc
    if name not in plugins:
        raise source.error(f"there is no technique '{name}'." + nearest(name, plugins), loc)
    if options is None:
        options = {}
    if not isinstance(options, dict):
        raise source.error(f"must be a mapping of parameters to values, not {shown(options)}.", inner)
    params_model: type[BaseModel] = plugins[name].Params  # type: ignore[attr-defined]
    known = [*params_model.model_fields, *_OPTIONS]
    for key in options:
        if key not in known:
            raise source.error(f"the technique '{name}' has no parameter '{key}'." + nearest(key, known), (*inner, key))
    fixed = {key: value for key, value in options.items() if key not in _OPTIONS}
    sweep = _sweep(source, (*inner, "sweep"), options.get("sweep"), name, fixed, params_model)
    projection = _projection(source, (*inner, "projection"), options.get("projection"), default)
    published = check_published(source, (*inner, "published"), options.get("published"), QUANTITIES)
    if published and sweep:
        raise source.error("one published figure cannot stand for a whole sweep; list the runs.", (*inner, "published"))
    label = _label(source, (*inner, "label"), options.get("label", name))
    for choice in itertools.product(*([(key, i) for i in range(len(values))] for key, values in sweep.items())):
        point = {key: sweep[key][i] for key, i in choice}
        moved: dict[str, Loc] = {key: ("sweep", key, i) for key, i in choice}
        params = validate(params_model, source, inner, {**fixed, **point}, foreign=True, moved=moved)
        suffix = " ".join(f"{key}={_text(value)}" for key, value in point.items())
        full_label = _label(source, (*inner, "sweep"), f"{label}[{suffix}]") if suffix else label
        yield TechniqueRun(full_label, name, params.model_dump(), projection, loc, published)


def _sweep(
    source: Source, loc: Loc, sweep: Any, name: str, fixed: dict[str, Any], model: type[BaseModel]
) -> dict[str, list[Any]]:
    if sweep is None:
        return {}
    if not isinstance(sweep, dict) or not sweep:
        raise source.error(f"must map parameters to lists of values, not {shown(sweep)}.", loc)
    for key, values in sweep.items():
        if key not in model.model_fields:
            message = f"the technique '{name}' has no parameter '{key}'." + nearest(key, model.model_fields)
            raise source.error(message, (*loc, key))
        if key in fixed:
            raise source.error(f"'{key}' is swept and given a fixed value as well; take one away.", (*loc, key))
        if not isinstance(values, list) or not values:
            raise source.error(f"must be a list of at least one value, not {shown(values)}.", (*loc, key))
    return sweep


def _projection(source: Source, loc: Loc, changes: Any, default: Projection | None) -> dict[str, Any] | None:
    base = default.written() if default else None
    if changes is None:
        return base
    if not isinstance(changes, dict):
        raise source.error(f"must be a mapping of keys to values, not {shown(changes)}.", loc)
    merged = validate(Projection, source, loc, {**(base or {}), **changes}).written()
    check_projection(source, loc, merged)
    return merged


def check_projection(source: Source, loc: Loc, settings: dict[str, Any]) -> None:
    """Refuses a projection whose keys make no sense together; InputError names the key."""
    try:
        compose(settings)
    except InputError as error:
        raise source.error(error.message, (*loc, *(error.key or "").split(".")[1:])) from None


def _label(source: Source, loc: Loc, label: Any) -> str:
    if not isinstance(label, str) or not label.strip():
        raise source.error(f"must be a name, not {shown(label)}.", loc)
    if not names_a_folder(label):
        raise source.error('must be at most 100 printable characters without / \\ : * ? " < > |.', loc)
    return label


def names_a_folder(name: str) -> bool:
    """Whether a label, or a scene, can be the name of its result folder."""
    odd = any(c in '/\\:*?"<>|' or not c.isprintable() for c in name)
    return name not in (".", "..") and len(name) <= 100 and not odd


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
