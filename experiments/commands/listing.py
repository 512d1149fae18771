"""``wkernels list``: the techniques, for people as a table and for programs as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic_core import PydanticUndefined, to_jsonable_python

from algorithms.plugins import load_all
from algorithms.technique import ALL_LIGHTS, Technique


def list_techniques(*, as_json: bool, plugin_files: Sequence[Path]) -> None:
    """Prints every technique, sorted by family and name."""
    techniques = by_family(load_all(plugin_files))
    if as_json:
        print(json.dumps([describe(technique) for technique in techniques], indent=2))
        return
    rows = [(t.name, t.family, needs_text(t), summary(t)) for t in techniques]
    if sys.stdout.isatty():
        _print_table(rows)
        return
    for row in rows:
        print("\t".join(row))


def by_family(techniques: Mapping[str, type[Technique]]) -> list[type[Technique]]:
    """Techniques in the order of listings."""
    return sorted(techniques.values(), key=lambda technique: (technique.family, technique.name))


def summary(technique: type[Technique]) -> str:
    """First line of the technique's documentation."""
    return technique.documentation().split("\n", 1)[0].strip()


def needs_text(technique: type[Technique]) -> str:
    """What the technique needs of a scene, in a few words; a dash for nothing."""
    needs = technique.needs
    words = [
        "" if needs.lights == ALL_LIGHTS else "light: " + "/".join(sorted(needs.lights)),
        "light with an area" if needs.area else "",
        "closed meshes" if needs.closed_meshes else "",
        "whole casters" if needs.whole_casters else "",
        "planar receiver" if needs.planar_receiver else "",
        "earlier frames" if needs.history else "",
        "still light" if needs.still_light else "",
    ]
    return ", ".join(word for word in words if word) or "-"


def describe(technique: type[Technique]) -> dict[str, Any]:
    """Everything a technique declares, as plain data; parameters with type, default, range, unit and source."""
    needs = technique.needs
    return {
        "name": technique.name,
        "family": technique.family,
        "paper": list(technique.paper),
        "summary": summary(technique),
        "needs": {
            "lights": sorted(needs.lights),
            "area": needs.area,
            "closed_meshes": needs.closed_meshes,
            "whole_casters": needs.whole_casters,
            "planar_receiver": needs.planar_receiver,
            "history": needs.history,
            "still_light": needs.still_light,
        },
        "products": [product.value for product in technique.products],
        "bias_sign": technique.bias_sign,
        "bias_turns": technique.bias_turns,
        "limits": [limit.equals for limit in technique.limits],
        "params": _parameters(technique),
    }


def _parameters(technique: type[Technique]) -> dict[str, dict[str, Any]]:
    schema = technique.Params.model_json_schema()["properties"] if technique.Params.model_fields else {}
    out = {}
    for name, field in technique.Params.model_fields.items():
        entry = {key: value for key, value in schema.get(name, {}).items() if key not in ("title", "default")}
        default = None if field.default is PydanticUndefined else field.default
        out[name] = {"default": to_jsonable_python(default), **entry}
    return out


def _print_table(rows: Sequence[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("technique", "family", "needs", ""):
        table.add_column(head, no_wrap=head in ("technique", "family"))
    for row in rows:
        table.add_row(*row)
    Console().print(table)
