"""Checks of what a technique declares: names, documentation, papers, parameters, limits."""

from __future__ import annotations

import inspect
import math
import re
import typing
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rig import CHECKS, check, lamp, render, scenes_for, small_params
from small_scenes import box_on_ground

from algorithms.plugins import ROOT, file_of, load_all
from algorithms.technique import Technique
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.workspace.products import Product

BIBLIOGRAPHY = Path(__file__).parents[2] / "references.bib"


def bibliography() -> set[str]:
    """Keys of references.bib."""
    return set(re.findall(r"^@\w+\{([^,\s]+),", BIBLIOGRAPHY.read_text(encoding="utf-8"), flags=re.MULTILINE))


@check()
def file_name_and_class_agree(technique: type[Technique], device: str) -> None:
    path = file_of(technique)
    assert technique.name == path.stem, f"named '{technique.name}' in a file {path.name}"
    assert technique.__name__ == "".join(part.capitalize() for part in technique.name.split("_"))
    if ROOT in path.parents:
        assert technique.family == path.parent.name, f"family '{technique.family}' in the folder {path.parent.name}"


@check()
def documentation_names_papers_and_artefacts(technique: type[Technique], device: str) -> None:
    text = technique.documentation()
    assert re.search(r"known artefacts", text, re.IGNORECASE), "the docstring has no 'Known artefacts'"
    for key in technique.paper:
        found = re.match(r"([a-z]+)(\d{4})", key)
        assert found, f"the key '{key}' is no surname and year"
        surname, year = found.groups()
        assert surname in text.lower() and year in text, f"the docstring does not name {surname.capitalize()} {year}"
    for described in (technique, technique.Params):
        own = vars(described).get("__doc__")
        assert own and own.strip(), f"{described.__qualname__} has no docstring"


@check()
def papers_are_in_the_bibliography(technique: type[Technique], device: str) -> None:
    assert technique.paper, "no paper is named"
    assert BIBLIOGRAPHY.is_file(), f"{BIBLIOGRAPHY.name} is missing"
    missing = set(technique.paper) - bibliography()
    assert not missing, f"not in {BIBLIOGRAPHY.name}: {', '.join(sorted(missing))}"


@check()
def params_have_defaults_units_and_texts(technique: type[Technique], device: str) -> None:
    params = technique.Params()
    for name, field in technique.Params.model_fields.items():
        extra = field.json_schema_extra
        assert isinstance(extra, dict) and str(extra.get("unit", "")).strip(), f"'{name}' has no unit"
        assert field.description and field.description.strip(), f"'{name}' has no text"
        assert technique.Params(**{name: getattr(params, name)}) == params, f"the default of '{name}' is not valid"
    assert technique().params == params, "a technique without parameters must have the defaults"


def bounds_of(field: Any) -> dict[str, float]:
    """The declared bounds (ge, gt, le, lt) of a pydantic field."""
    return {
        kind: getattr(item, kind) for item in field.metadata for kind in ("ge", "gt", "le", "lt") if hasattr(item, kind)
    }


def wrong_values(name: str, field: Any) -> list[Any]:
    """Values that a parameter must refuse."""
    bounds = bounds_of(field)
    outside = {"ge": -1, "gt": 0, "le": 1, "lt": 0}
    wrong: list[Any] = [bounds[kind] + step for kind, step in outside.items() if kind in bounds]
    if field.annotation in (int, float):
        assert {"ge", "gt"} & set(bounds), f"'{name}' has no lower bound"
        wrong += ["many", None, [1], math.nan, math.inf]
    elif field.annotation is bool:
        wrong += ["perhaps", None, 17]
    elif typing.get_origin(field.annotation) is typing.Literal:
        wrong += ["no such choice", None, 3.5]
    else:
        wrong += [None, 3.5, [1]]
    return wrong


@check()
def wrong_params_are_refused(technique: type[Technique], device: str) -> None:
    def refused(values: dict[str, Any]) -> bool:
        try:
            params = technique.Params(**values)
        except (ValidationError, InputError):
            return True
        if not any(value == "no such choice" for value in values.values()):
            return False
        try:  # names of plain text may be looked up later, but not ignored
            render(technique, box_on_ground(lamp(technique)), device, params=params, size=(8, 6))
        except InputError:
            return True
        return False

    assert refused({"no_such_parameter": 1}), "an unknown parameter is accepted"
    for name, field in technique.Params.model_fields.items():
        for value in wrong_values(name, field):
            assert refused({name: value}), f"{name}={value!r} is accepted"
        if field.annotation is str:
            assert refused({name: "no such choice"}), f"{name}='no such choice' is accepted"
    params = small_params(technique)
    for name in technique.Params.model_fields:
        try:
            setattr(params, name, getattr(params, name))
        except (ValidationError, AttributeError):
            continue
        raise AssertionError(f"'{name}' can be changed after construction")


@check()
def declarations_resolve(technique: type[Technique], device: str) -> None:
    table = load_all()
    for limit in technique.limits:
        assert limit.equals in table, f"equals '{limit.equals}', which does not exist"
        assert limit.equals != technique.name, "a limit in which it equals itself says nothing"
        try:
            technique.Params(**limit.params)
            table[limit.equals].Params(**limit.other_params)
        except (ValidationError, InputError) as error:
            raise AssertionError(f"limit '{limit.equals}': {error}") from error
        assert 0.0 <= limit.flips <= 0.05 and 0.0 <= limit.tolerance <= 0.05, "a tolerance that lets anything pass"
    for expected in technique.expected_failures:
        assert expected.check in CHECKS, f"expects the unknown check '{expected.check}' to fail"
        assert expected.because.strip(), f"expects '{expected.check}' to fail without saying why"
        assert not re.search(expected.message, ""), f"expects '{expected.check}' to fail with any message"
    assert not inspect.isabstract(technique)


@check()
def pulls_what_it_declares(technique: type[Technique], device: str) -> None:
    pulled: set[Product] = set()
    for scene in scenes_for(technique):
        session = Session(Geometry(scene, device), width=16, height=12, device=device)
        made = technique(small_params(technique))
        for frame in range(2):
            session.begin(frame)
            session.render(made)
            session.advance()
            pulled |= session.pulled
    unlike = sorted(product.value for product in pulled ^ set(technique.products))
    assert not unlike, f"pulled and not declared, or declared and never pulled: {', '.join(unlike)}"
