"""YAML reading and the messages about mistakes in it: file, line, key and the nearest name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field

from experiments.config.source import StrictModel, dump_yaml, from_dict, load_yaml, parse_yaml, validate
from wkernels.errors import InputError


class Point(StrictModel):
    kind: Literal["point"]
    position: tuple[float, float, float]


class Disc(StrictModel):
    kind: Literal["disc"]
    radius: Annotated[float, Field(ge=0)]


class Thing(StrictModel):
    width: int = Field(8, gt=0, le=100)
    casts: bool = True
    scale: float | tuple[float, float, float] = 1.0
    lights: list[Annotated[Point | Disc, Field(discriminator="kind")]] = Field([])
    tint: Literal["red", "green"] = "red"
    blend: float = Field(0.5, alias="lambda")


def message(text: str) -> str:
    with pytest.raises(InputError) as caught:
        validate(Thing, parse_yaml(text, "thing.yaml"))
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("width: 4\nwidht: 5", "thing.yaml:2: widht: is not a known key. Did you mean 'width'?"),
        ("\nwidth: -1", "thing.yaml:2: width: must be greater than 0, not -1."),
        ("width: 101", "thing.yaml:1: width: must be at most 100, not 101."),
        ("width: '4'", "thing.yaml:1: width: must be a whole number, not '4'."),
        ("width: 4.5", "thing.yaml:1: width: must be a whole number, not 4.5."),
        ("width: true", "thing.yaml:1: width: must be a whole number, not true."),
        ("width:", "thing.yaml:1: width: must be a whole number, not nothing."),
        ("casts: 1", "thing.yaml:1: casts: must be true or false, not 1."),
        ("casts: yes", "thing.yaml:1: casts: must be true or false, not 'yes'."),
        ("scale: big", "thing.yaml:1: scale: must be a number or a list, not 'big'."),
        ("scale: .nan", "thing.yaml:1: scale: must be a finite number or a list, not nan."),
        ("scale: [1, 2]", "thing.yaml:1: scale: has too few items: [1, 2]."),
        ("tint: gren", "thing.yaml:1: tint: 'gren' is not a valid name. Did you mean 'green'?"),
        ("lambda: -.inf", "thing.yaml:1: lambda: must be a finite number, not -inf."),
        ("blend: 1", "thing.yaml:1: blend: is not a known key."),
        ("lights:\n- {kind: pont}", "thing.yaml:2: lights.0.kind: 'pont' is not a valid name. Did you mean 'point'?"),
        ("lights:\n- {radius: 1}", "thing.yaml:2: lights.0: needs the key 'kind'."),
        (
            "lights:\n- kind: disc\n  radios: 1",
            "thing.yaml:3: lights.0.radios: is not a known key. Did you mean 'radius'?",
        ),
        ("lights:\n- kind: disc\n", "thing.yaml:2: lights.0.radius: is required."),
        ("lights:\n- kind: disc\n  radius: -1", "thing.yaml:3: lights.0.radius: must be at least 0, not -1."),
        (
            "lights:\n- kind: point\n  position:\n  - 1\n  - 2\n  - x",
            "thing.yaml:6: lights.0.position.2: must be a number",
        ),
        ("lights:\n- kind: point\n  position: [1, 2]", "thing.yaml:3: lights.0.position: has too few items: [1, 2]."),
        ("lights: 3", "thing.yaml:1: lights: must be a list, not 3."),
        ("- width", "thing.yaml:1: must be a mapping of keys to values, not ['width']."),
        ("width: 0\ncasts: 3\nhue: 1", "thing.yaml:3: hue: is not a known key."),
    ],
)
def test_a_mistake_is_named_with_file_line_and_key(text: str, expected: str) -> None:
    assert message(text).startswith(expected)


def test_further_mistakes_are_counted() -> None:
    assert message("width: 0\ncasts: 3\nhue: 1").endswith("(2 more mistakes.)")
    assert message("width: 0\ncasts: 3").endswith("(1 more mistake.)")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "f.yaml:1: is empty."),
        ("# only a comment\n", "f.yaml:1: is empty."),
        ("a: 1\nb: 2\na: 3", "f.yaml:3: the key 'a' is here twice (first on line 1)."),
        ("a:\n  - {x: 1, x: 2}", "f.yaml:2: the key 'x' is here twice"),
        ("a: [1, 2", "f.yaml:1: is not valid YAML"),
        ("a: 1\n  b: 2", "f.yaml:2: is not valid YAML"),
        ("a: 1\n---\nb: 2", "f.yaml:2: is not valid YAML"),
        ("a: *b", "f.yaml:1: is not valid YAML: found undefined alias"),
        (
            "a: !!python/object/apply:os.system [ls]",
            "f.yaml:1: the tag '!!python/object/apply:os.system' is not allowed.",
        ),
        ("a: !!binary aGk=", "f.yaml:1: the tag '!!binary' is not allowed."),
        ("a: &a [*a]", "f.yaml:1: an alias refers to itself."),
        ("? [1]\n: 2", "f.yaml:1: a key must be a word"),
        ("a: 1\nb: \x01", "f.yaml:2: is not valid YAML: special characters"),
        ("[" * 5000, "f.yaml: is nested too deeply."),
        ("[" * 100_000 + "]" * 100_000, "f.yaml: is nested too deeply."),  # libyaml's composer would end the process
    ],
)
def test_unreadable_yaml(text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "f.yaml")
    assert str(caught.value).startswith(expected)


def test_aliases_cannot_explode() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    with pytest.raises(InputError, match="expand to more than"):
        parse_yaml("\n".join(lines), "f.yaml")


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_yaml(tmp_path / "absent.yaml")
    with pytest.raises(InputError, match="is a folder"):
        load_yaml(tmp_path)
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"a: 1\nb: \xe9\n")
    with pytest.raises(InputError) as caught:
        load_yaml(path)
    assert str(caught.value) == f"{path}:2: is not UTF-8 text."


def test_scalars_follow_yaml_1_2() -> None:
    text = "{a: 1e-3, b: on, c: 012, d: 0x10, e: 1:30, f: 2020-01-01, g: ~, h: .5, i: -.inf, on: 1, 7: x}"
    data = parse_yaml(text).data
    assert data == {
        "a": 1e-3,
        "b": "on",
        "c": 12,
        "d": 16,
        "e": "1:30",
        "f": "2020-01-01",
        "g": None,
        "h": 0.5,
        "i": -math.inf,
        "on": 1,
        "7": "x",
    }
    assert isinstance(data["c"], int) and isinstance(data["h"], float)


def test_lines_of_keys_items_and_missing_keys() -> None:
    source = parse_yaml("a:\n  b:\n  - 1\n  - c: 2\nd: 3\n", "f.yaml")
    assert [source.line(loc) for loc in [("a",), ("a", "b"), ("a", "b", 1), ("a", "b", 1, "c"), ("d",)]] == [
        1,
        2,
        4,
        4,
        5,
    ]
    assert source.line(("a", "b", 1, "absent")) == 4
    assert source.line(("a", "b", 9)) == 2
    assert from_dict({"a": 1}).line(("a",)) is None


def test_merge_keys_are_overridden_by_own_keys() -> None:
    source = parse_yaml("base: &base\n  x: 1\n  y: 2\nown:\n  <<: *base\n  y: 3\n")
    assert source.data["own"] == {"x": 1, "y": 3}
    assert source.line(("own", "y")) == 6
    assert source.line(("own", "x")) == 2


def test_written_yaml_reads_back_to_the_same_values() -> None:
    data: dict[str, Any] = {
        "a": [
            1e-05,
            1e30,
            1,
            True,
            None,
            "1e3",
            "yes",
            "true",
            "",
            "~",
            "12",
            "0x1",
            "a: b",
            "- c",
            "é",
            " x ",
            "n\nm",
        ],
        "b": {"c": [], "d": {}, "nan": math.inf, "on": {"deep": [{"k": [1.5]}]}},
    }
    assert parse_yaml(dump_yaml(data)).data == data


def test_python_data_is_made_plain() -> None:
    source = from_dict({"a": np.arange(3), "b": (1, np.float64(0.5)), "c": Path("x/y"), "d": np.bool_(True)})
    assert source.data == {"a": [0, 1, 2], "b": [1, 0.5], "c": "x/y", "d": True}
    with pytest.raises(InputError, match=r"a\.1: a value of type object"):
        from_dict({"a": [1, object()]})


def test_an_override_is_named_instead_of_the_line() -> None:
    source = parse_yaml("width: 4\n", "thing.yaml").replaced(("width",), -4, "--set width=-4")
    with pytest.raises(InputError) as caught:
        validate(Thing, source)
    assert str(caught.value) == "--set width=-4: width: must be greater than 0, not -4."
