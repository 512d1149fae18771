"""The plugin table: what it finds, and how it refuses what it cannot use."""

from __future__ import annotations

import importlib.metadata
import textwrap
from pathlib import Path

import pytest

from algorithms.plugins import FAMILIES, ROOT, file_of, find, load_all
from wkernels.errors import InputError

GOOD = '''
"""A technique for tests (Williams 1978).

Known artefacts: all of them.
"""
from algorithms.technique import Params, Technique, setting


class {camel}(Technique):
    """Nothing but light."""

    name = "{name}"
    family = "hard"
    paper = ("williams1978",)
    bias_sign = "none"

    class Params(Params):
        """One."""

        radius: float = setting(1.0, "a radius", unit="texels", ge=0.0)

    def render(self, frame):
        raise NotImplementedError
'''


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.py"
    path.write_text(textwrap.dedent(text).lstrip(), encoding="utf-8")
    return path


def good(name: str) -> str:
    camel = "".join(part.capitalize() for part in name.split("_"))
    return GOOD.replace("{camel}", camel).replace("{name}", name)


def test_every_file_of_every_family_is_in_the_table() -> None:
    files = {path.stem for family in FAMILIES for path in (ROOT / family).glob("*.py") if path.stem[0] != "_"}
    table = load_all()
    assert set(table) == files and list(table) == sorted(table)
    for name, technique in table.items():
        assert file_of(technique).stem == name and find(name) is technique


def test_folders_of_algorithms_are_families_or_projections() -> None:
    folders = {path.name for path in ROOT.iterdir() if path.is_dir() and any(path.glob("*.py"))}
    assert folders <= {*FAMILIES, "projections"}, "a file in an unknown folder would never be found"


def test_a_file_joins_the_table(tmp_path: Path) -> None:
    path = write(tmp_path, "joins_table", good("joins_table"))
    table = load_all([path])
    assert file_of(table["joins_table"]) == path
    assert find("joins_table", [path]) is table["joins_table"], "the same file is imported once"
    assert "joins_table" not in load_all()


BAD: dict[str, tuple[str, str, str | None]] = {
    # name of the file: (its text, what the message must say, a piece of the line that it must name)
    "bad_syntax": (good("bad_syntax") + "\ndef broken(:\n", "cannot be imported: SyntaxError", "def broken(:"),
    "bad_import": (
        "import algorithms\n\nimport no_such_module_anywhere\n",
        "ModuleNotFoundError.*no_such_module_anywhere",
        "import no_such_module_anywhere",
    ),
    "bad_module": (good("bad_module") + "\nvalue = 1 / 0\n", "ZeroDivisionError", "1 / 0"),
    "no_technique": ('"""Nothing here."""\n', r"exactly one Technique, this one holds 0 \(none\)", None),
    "two_techniques": (
        good("two_techniques") + good("second_one").split("setting\n", 1)[1],
        r"exactly one Technique, this one holds 2 \(TwoTechniques, SecondOne\)",
        None,
    ),
    "wrong_name": (good("right_name"), "named 'right_name' but its file is wrong_name.py", "class RightName"),
    "wrong_class": (
        good("wrong_class").replace("class WrongClass", "class Misnamed"),
        "class of 'wrong_class' must be called WrongClass",
        "class Misnamed",
    ),
    "no_name": (good("no_name").replace('name = "no_name"', ""), "declares no `name`", "class NoName"),
    "no_sign": (good("no_sign").replace('bias_sign = "none"', ""), "declares no `bias_sign`", "class NoSign"),
    "bad_sign": (
        good("bad_sign").replace('bias_sign = "none"', 'bias_sign = "bright"'),
        "`bias_sign` is 'darker', 'lighter' or 'none', not 'bright'",
        "class BadSign",
    ),
    "no_turn": (
        good("no_turn").replace('bias_sign = "none"', 'bias_sign = "none"\n    bias_turns = "it rains"'),
        "`bias_turns` says where `bias_sign` is the opposite one",
        "class NoTurn",
    ),
    "bad_family": (
        good("bad_family").replace('"hard"', '"filterin"'),
        "unknown family 'filterin'.*Did you mean 'filtering'",
        "class BadFamily",
    ),
    "bad_paper": (
        good("bad_paper").replace('("williams1978",)', '"williams1978"'),
        "`paper` is a tuple of keys",
        "class BadPaper",
    ),
    "bad_light": (
        good("bad_light")
        .replace("import Params", "import Needs, Params")
        .replace('bias_sign = "none"', 'bias_sign = "none"\n    needs = Needs(lights=frozenset({"rectangel"}))'),
        "unknown light kind 'rectangel'.*Did you mean 'rectangle'",
        "class BadLight",
    ),
    "bad_unit": (
        good("bad_unit").replace('setting(1.0, "a radius", unit="texels", ge=0.0)', "1.0"),
        "parameter 'radius' must be made with `setting",
        "class BadUnit",
    ),
    "no_docstring": (good("no_docstring").lstrip().split('"""', 2)[2], "has no docstring", "class NoDocstring"),
    "no_render": (
        good("no_render").replace("def render(self, frame)", "def draw(self, frame)"),
        "does not implement `render`",
        "class NoRender",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_file_and_line(name: str, tmp_path: Path) -> None:
    text, message, named_line = BAD[name]
    path = write(tmp_path, name, text)
    with pytest.raises(InputError, match=rf"(?s){message}") as caught:
        load_all([path])
    assert caught.value.file == str(path) and str(path) in str(caught.value)
    if named_line is not None:
        assert caught.value.line is not None, "the message must name the line"
        assert named_line in path.read_text(encoding="utf-8").splitlines()[caught.value.line - 1]
    with pytest.raises(InputError):  # no memory of the first attempt makes the second one pass
        load_all([path])


def test_a_parameter_without_a_default_is_refused(tmp_path: Path) -> None:
    text = good("no_default").replace("setting(1.0,", "setting(...,")
    with pytest.raises(InputError, match="parameter 'radius' has no default"):
        load_all([write(tmp_path, "no_default", text)])


def test_names_are_unique(tmp_path: Path) -> None:
    path = write(tmp_path, "shadow_map", good("shadow_map"))
    with pytest.raises(InputError, match=r"'shadow_map' exists already, in .*hard.*shadow_map\.py") as caught:
        load_all([path])
    assert caught.value.file == str(path)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_all([tmp_path / "nowhere.py"])
    with pytest.raises(InputError, match="does not exist"):
        load_all([tmp_path])
    text = tmp_path / "plugin.txt"
    text.write_text("x")
    with pytest.raises(InputError, match="Python file"):
        load_all([text])


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "noise.py"
    path.write_bytes(b"\xff\xfe\x00nonsense\x80")
    with pytest.raises(InputError, match="cannot be imported") as caught:
        load_all([path])
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("name", "hint"), [("shadow_mpa", "Did you mean 'shadow_map'"), ("zzz", "Valid names: .*pcss")]
)
def test_unknown_names_get_a_hint(name: str, hint: str) -> None:
    with pytest.raises(InputError, match=hint):
        find(name)


class FakeEntry:
    """An entry point of an installed package."""

    def __init__(self, name: str, result: object) -> None:
        self.name, self.value, self._result = name, f"package:{name}", result

    def load(self) -> object:
        if isinstance(self._result, Exception):
            raise self._result
        return self._result


def test_entry_points_join_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, "from_package", good("from_package"))
    technique = load_all([path])["from_package"]
    entries = [FakeEntry("from_package", technique)]
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: entries if group == "wkernels.algorithms" else []
    )
    assert load_all()["from_package"] is technique
    entries.append(FakeEntry("faulty", ImportError("no such thing")))
    with pytest.raises(InputError, match=r"entry point 'faulty'.*no such thing"):
        load_all()
