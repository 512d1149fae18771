"""Kinds of experiment are found by scanning folders, and a new folder is all that a new kind needs."""

from __future__ import annotations

import sys
import typing
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from test_cli import Run, wkernels  # noqa: F401 - a fixture

from experiments import kinds
from experiments.commands import formats
from experiments.kinds.kind import find, kind_of_file, kind_of_folder, names

NEW = '''
"""A kind for tests."""
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

from experiments.config.overrides import apply_overrides
from experiments.config.source import StrictModel, load_yaml, validate
from experiments.kinds.kind import Kind


class CountFile(StrictModel):
    kind: Literal["count"]
    upto: int


class CountKind(Kind):
    """Counts."""

    name = "count"
    schemas = (CountFile,)
    techniques = False

    def load(self, path, overrides, plugins):
        file = validate(CountFile, apply_overrides(load_yaml(path), overrides))
        return SimpleNamespace(name=path.stem, upto=file.upto)

    def run(self, experiment, out, plugins, progress, **options):
        out.mkdir(parents=True)
        (out / "environment.json").write_text(json.dumps({"run": {"kind": "count"}}))
        for i in range(experiment.upto):
            progress(i, experiment.upto, "counting")
        return f"counted to {experiment.upto} on {options['device']}"

    def explain(self, experiment, plugins):
        return f"will count to {experiment.upto}"

    def write_report(self, out):
        return out / "counted.html"
'''


@pytest.mark.parametrize("name", names())
def test_a_kind_is_its_folder(name: str) -> None:
    kind = find(name)
    assert kind.name == name and kind.schemas and kind.__doc__
    for schema in kind.schemas:
        assert typing.get_args(schema.model_fields["kind"].annotation) == (name,)


def test_what_there_is() -> None:
    assert names() == sorted(names()) and {"walkthrough", "sweep", "analysis"} <= set(names())


def test_every_kinds_tables_are_on_the_page_of_formats() -> None:
    """Each once: file names tell them apart there."""
    declared = [table for name in names() for table in find(name).tables().items()]
    assert dict(declared) == formats.RESULTS and len(declared) == len(formats.RESULTS)
    assert {"frames.csv", "savings.csv", "estimates.csv", "pareto.csv"} <= set(formats.RESULTS)
    assert all(find(name).tables() for name in names())


def test_files_and_folders_that_name_no_kind_are_walkthroughs(tmp_path: Path) -> None:
    (tmp_path / "odd.yaml").write_text("kind: [sweep]\n")
    (tmp_path / "sweep.yaml").write_text("kind: sweep\n")
    assert kind_of_file(tmp_path / "odd.yaml").name == kind_of_file(tmp_path / "absent.yaml").name == "walkthrough"
    assert kind_of_file(tmp_path / "sweep.yaml").name == "sweep"
    assert kind_of_file(tmp_path / "sweep.yaml", ["kind=savings", "no override"]).name == "savings"
    assert kind_of_folder(tmp_path).name == "walkthrough"


@pytest.fixture
def count(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The new kind, in a folder beside ours."""
    folder = tmp_path_factory.mktemp("kinds")
    (folder / "count").mkdir()
    (folder / "count" / "kind.py").write_text(NEW)
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(folder)])
    yield
    for name in [name for name in sys.modules if name.partition("experiments.kinds.count")[1]]:
        del sys.modules[name]
    if hasattr(kinds, "count"):
        del kinds.count


def test_a_new_folder_is_a_new_kind(count: None, wkernels: Callable[..., tuple[int, str, str]]) -> None:
    Path("c.yaml").write_text("kind: count\nupto: 3\n")
    assert wkernels("explain", "c.yaml", "--set", "upto=4")[:2] == (0, "will count to 4\n")
    status, out, err = wkernels("run", "c.yaml", "--out", "o", "--device", "cuda:7")
    assert (status, out) == (0, "counted to 3 on cuda:7\n") and "0/3 counting" in err
    assert wkernels("report", "o")[:2] == (0, f"Report: {Path('o/counted.html')}\n")
    status, _, err = wkernels("report", "o", "--recompute")
    assert status == 2 and "is of the kind count, whose rows cannot be computed again" in err
    status, _, err = wkernels("run", "c.yaml", "--set", "kind=cuont")
    assert status == 2 and "'cuont' is not a kind of experiment. Did you mean 'count'?" in err


def test_kinds_without_a_report_say_so(wkernels: Run) -> None:
    Path("a.yaml").write_text("kind: analysis\ncamera: {fov_deg: 60, near: 1, far: 40}\ncurves: [{label: one}]\n")
    assert wkernels("run", "a.yaml", "--out", "o")[0] == 0
    status, _, err = wkernels("report", "o")
    assert status == 2 and "is of the kind analysis, which has no report" in err
