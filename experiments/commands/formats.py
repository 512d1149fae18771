"""The tables of docs/formats.md: ``python -m experiments.commands.formats`` brings them up to date.

The page is written by hand but for what lies between its markers: the keys of files, from their pydantic models and the
``Attributes`` of these models' docstrings; the projections' parts, from their files; the columns of result tables.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from algorithms.projections.schema import Projection
from algorithms.projections.table import fits, stabilisers, warps
from algorithms.technique import MapParams
from experiments.commands.markdown import bring_up_to_date, table, with_block
from experiments.kinds import kind as kinds
from experiments.kinds.analysis import config as analysis
from experiments.kinds.convergence import config as convergence
from experiments.metrics.registry import METRICS
from experiments.results import store
from experiments.results.meanings import meaning
from experiments.scenes import generators, schema
from experiments.scenes.importing.schema import ImportingSceneFile
from experiments.schema import models
from experiments.schema.experiment import Experiment

PAGE = "docs/formats.md"
BEGIN, END = "<!-- table: {} -->", "<!-- end of table -->"
NO_UNITS = ("1", "name", "kind", "choice", "yes/no")
NO_BOUND = 1e12  # the largest coordinate: a bound that says nothing


# ---- keys of files -------------------------------------------------------------------------------------------------


def meanings(classes: Iterable[type]) -> dict[str, str]:
    """What the docstrings of classes and of their bases say of attributes; earlier classes win."""
    out: dict[str, str] = {}
    for cls in classes:
        for base in cls.__mro__:
            text = inspect.cleandoc(base.__dict__.get("__doc__") or "").partition("Attributes:\n")[2]
            for names, what in re.findall(r"^    (\w[\w, ]*): (.*(?:\n {8}.*)*)", text, re.MULTILINE):
                for name in names.split(", "):
                    out.setdefault(name, in_markdown(what))
    return out


def in_markdown(text: str) -> str:
    """Text of a docstring on one line."""
    line = re.sub(r"\s+", " ", text.replace("``", "`")).strip()
    return line if re.search(r"\. [A-Z]", line) else line.removesuffix(".")


def type_text(part: Mapping[str, Any]) -> str:
    """A JSON schema in words."""
    if "$ref" in part:
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", part["$ref"].rpartition("/")[2]).lower()
        words = words.removesuffix(" options").removesuffix(" file")
        return f"[{words}](#{words.replace(' ', '-')})"
    if "anyOf" in part:
        return " or ".join(dict.fromkeys(type_text(one) for one in part["anyOf"] if one.get("type") != "null"))
    if "enum" in part or "const" in part:
        return " | ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    kind = part.get("type")
    if kind == "array":
        if "prefixItems" in part:
            return f"{len(part['prefixItems'])} {_many(part['prefixItems'][0])}"
        return f"list of {_many(part['items']) if part['items'] else 'mappings'}"
    names = {"integer": "whole number", "number": "number", "string": "text", "boolean": "`true` | `false`"}
    return names.get(str(kind), "mapping") + _bounds(part)


def _many(part: Mapping[str, Any]) -> str:
    return re.sub(r"\b(number|text|mapping)\b", r"\1s", type_text(part))


def _bounds(part: Mapping[str, Any]) -> str:
    low, high = part.get("minimum"), part.get("maximum")
    words = []
    if low is not None and high is not None and high < NO_BOUND:
        words.append(f"{low:.12g} to {high:.12g}")
    elif low is not None and low > -NO_BOUND:
        words.append(f"{low:.12g} or more")
    elif high is not None and high < NO_BOUND:
        words.append(f"up to {high:.12g}")
    if "exclusiveMinimum" in part:
        words.append(f"above {part['exclusiveMinimum']:g}")
    if "exclusiveMaximum" in part:
        words.append(f"below {part['exclusiveMaximum']:g}")
    return "".join(f", {text}" for text in words)


def default_text(value: Any) -> str:
    """A default as YAML would have it; a dash where leaving the key out means something of its own."""
    if value is PydanticUndefined:
        return "required"
    if value is None or isinstance(value, BaseModel):
        return "-"
    return f"`{json.dumps(value)}`" if not isinstance(value, str) else f"`{value}`"


def keys_of(model: type[BaseModel], without: Iterable[type[BaseModel]] = ()) -> Iterator[tuple[str, str, str, str]]:
    """Attribute, key, type and default of each field that may vary and that none of the models ``without`` has."""
    parts = model.model_json_schema(by_alias=True)["properties"]
    left_out = {name for other in without for name in other.model_fields}
    for name, field in model.model_fields.items():
        key = field.alias or name
        if name not in left_out and "const" not in parts[key]:
            default = field.get_default(call_default_factory=True)
            yield name, key, type_text(parts[key]), default_text(default)


def key_table(model: type[BaseModel], *told_by: type, without: Sequence[type[BaseModel]] = ()) -> str:
    """The keys of a mapping.

    Args:
        model: Its model.
        told_by: Further classes whose docstrings say what the keys mean.
        without: Models whose keys stand in another table.
    """
    told = meanings([model, *told_by])
    rows = []
    for name, key, kind, default in keys_of(model, without):
        field = model.model_fields[name]
        more: Any = field.json_schema_extra or {}
        unit = f" [{more['unit']}]" if more.get("unit") not in (None, *NO_UNITS) else ""
        rows.append((f"`{key}`", kind, default, f"{field.description}{unit}" if field.description else told[name]))
    return table(("key", "value", "default", "meaning"), rows)


def kind_table(name: str) -> str:
    """The keys of an experiment file of a kind; those of a sweep that a walkthrough has too stand there."""
    model = kinds.find(name).schemas[0]
    resolved = [
        cls
        for _, cls in inspect.getmembers(inspect.getmodule(model), inspect.isclass)
        if cls.__module__ == model.__module__ and not issubclass(cls, BaseModel)
    ]
    return key_table(model, *resolved, Experiment, without=[models.RunFile] if name == "sweep" else [])


def kinds_table(head: str, kinds: Mapping[str, type[BaseModel]], shared: type[BaseModel]) -> str:
    """A line per kind of mesh or light: what it is, and the keys that the others do not have."""
    rows = []
    for name, model in kinds.items():
        own = [
            f"`{key}`: {kind}" + ("" if default in ("-", "required") else f" ({default})")
            for _, key, kind, default in keys_of(model, [shared])
        ]
        rows.append((f"`{name}`", in_markdown((model.__doc__ or "").split("\n\n")[0]), "; ".join(own)))
    return table((head, "what it is", "keys"), rows)


def generators_table() -> str:
    """The generators of scenes with their parameters."""
    rows = []
    for name in generators.names():
        what = inspect.getmodule(generators.load(name)).__doc__ or ""
        keys = keys_of(generators.parameters_model(name), [schema.MeshOptions])
        own = [f"`{key}` ({default})" for _, key, _, default in keys if key != "generate"]
        rows.append((f"`{name}`", in_markdown(what.strip().split("\n\n")[0]), ", ".join(own)))
    return table(("generator", "what it makes", "keys and defaults"), rows)


def parts_table(parts: Mapping[str, type]) -> str:
    """The plugins of one part of a projection."""
    rows = []
    for name, part in parts.items():
        what = (inspect.getmodule(part).__doc__ or "").strip().split("\n\n")[0]
        rows.append((f"`{name}`", in_markdown(what.partition(": ")[2] or what), ", ".join(part.paper)))  # type: ignore[attr-defined]
    return table(("name", "what it is", "papers"), rows)


def metrics_table() -> str:
    """The names under ``metrics``."""
    rows = []
    for metric in METRICS.values():
        when = "always" if metric.always else "if asked for"
        rows.append((f"`{metric.name}`", metric.unit, when, in_markdown(metric.description)))
    return table(("metric", "unit", "computed", "meaning"), rows)


# ---- columns of tables ---------------------------------------------------------------------------------------------


def columns_table(name: str, columns: Sequence[str]) -> str:
    """Columns of a result table; those of summary.csv that sum up frames.csv stand together at its end."""
    rows, summed = [], []
    for column in columns:
        has_quartiles = f"{column}_q1" in columns
        if name == "summary.csv" and has_quartiles and column in store.FRAME_COLUMNS:
            summed.append(f"`{column}`")
        elif column[-3:] not in ("_q1", "_q3"):
            quartiles = f", `{column}_q1`, `{column}_q3`" if has_quartiles else ""
            rows.append((f"`{column}`{quartiles}", in_markdown(meaning(name, column)) + (quartiles and "; quartiles")))
    if summed:
        what = "median over frames of the column of frames.csv; with `_q1` and `_q3` behind its name the quartiles"
        rows.append((", ".join(summed), what))
    return table(("column", "meaning"), rows)


RESULTS: Mapping[str, Sequence[str]] = {
    name: columns for kind in kinds.names() for name, columns in kinds.find(kind).tables().items()
}

TABLES: Mapping[str, Callable[[], str]] = {
    "scene": lambda: key_table(schema.SceneFile),
    "import": lambda: key_table(ImportingSceneFile),
    "mesh": lambda: key_table(schema.MeshOptions),
    "primitives": lambda: kinds_table("primitive", schema.PRIMITIVES, schema.MeshOptions),
    "generators": generators_table,
    "cutout": lambda: key_table(schema.Cutout),
    "transform": lambda: key_table(schema.Transform),
    "motion": lambda: key_table(schema.Motion),
    "motion keyframe": lambda: key_table(schema.MotionKeyframe, without=[schema.Transform]),
    "light": lambda: key_table(schema.LightOptions),
    "lights": lambda: kinds_table("kind", schema.LIGHTS, schema.LightOptions),
    "camera": lambda: key_table(schema.CameraOptions),
    "path": lambda: key_table(schema.PathOptions),
    "camera keyframe": lambda: key_table(schema.CameraKeyframe),
    "orbit": lambda: key_table(schema.Orbit),
    **{f"kind {name}": partial(kind_table, name) for name in kinds.names()},
    "estimates": lambda: key_table(convergence.EstimatesFile, convergence.Estimates),
    "analysis camera": lambda: key_table(analysis.AnalysisCamera),
    "curve": lambda: key_table(analysis.CurveFile, analysis.Curve),
    "image": lambda: key_table(models.Image),
    "reference": lambda: key_table(models.Reference),
    "crop": lambda: key_table(convergence.Crop),
    "frame range": lambda: key_table(models.FrameRange),
    "views": lambda: key_table(models.Views),
    "third person": lambda: key_table(models.ThirdPerson),
    "metrics": metrics_table,
    "parameters": lambda: key_table(MapParams),
    "projection": lambda: key_table(Projection),
    "fits": lambda: parts_table(fits()),
    "warps": lambda: parts_table(warps()),
    "stabilisers": lambda: parts_table(stabilisers()),
    **{name: partial(columns_table, name, columns) for name, columns in RESULTS.items()},
}


def with_tables(page: str) -> str:
    """The page with every table as it is now.

    Raises:
        InputError: A table has no place on the page.
    """
    for name, build in TABLES.items():
        page = with_block(page, BEGIN.format(name), END, build(), file=PAGE)
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Brings docs/formats.md up to date; with ``--check`` only says whether it is (status 1 if not)."""
    command = "python -m experiments.commands.formats"
    return bring_up_to_date(PAGE, with_tables, arguments, about=__doc__, command=command)


if __name__ == "__main__":
    sys.exit(main())
