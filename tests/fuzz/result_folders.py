"""Result folders that were cut off, edited or mixed up, at ``report``, ``compare`` and ``run --resume``."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

import mutations
from isolation import Fault
from mesh_files import check_message

from experiments.commands.compare import compare_folders
from experiments.commands.run import report_folder, run_experiment
from experiments.config.source import dump_yaml
from experiments.results.failures import TechniquesFailed
from wkernels.errors import InputError

_SCENE = {
    "meshes": [
        {"primitive": "plane", "size": [12, 12]},
        {"primitive": "box", "size": [2, 1, 2], "transform": {"translate": [0, 2, 0]}},
    ],
    "lights": [{"kind": "rectangle", "center": [0, 8, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2]}],
    "camera": {"eye": [0, 6, 9], "target": [0, 0, 0]},
    "path": {"frames": 2, "orbit": {"center": [0, 1, 0], "radius": 9, "height": 5, "degrees": 4}},
}
_SMALL = {"image": {"width": 16, "height": 9}, "techniques": ["pcf", "pcss"]}
FILES: dict[str, dict] = {
    "walkthrough": {"scene": _SCENE, "reference": {"samples": 4}, "repeats": 2, **_SMALL},
    "sweep": {"scenes": [{"name": "one", **_SCENE}], "reference": {"samples": 4}, "frames": 1, **_SMALL},
    "convergence": {"scene": _SCENE, "reference": {"samples": 4}, "steps": [1, 2], **_SMALL},
    "analysis": {
        "camera": {"fov_deg": 60.0, "near": 1.0, "far": 100.0},
        "curves": [{"label": "a"}, {"label": "b", "warp": "lispsm_nopt", "splits": 2}],
    },
}
_OPTIONS = {"device": "cpu", "threads": 1, "skips": True, "overrides": [], "plugin_files": []}
_CELLS = ("", "0", "-1", "1", "7", "1e400", "nan", "inf", "x", "1.5", "99999999999999999999", '"', "a,b", "pcf", "\0")


@cache
def healthy(kind: str) -> Path:
    """The folder of a finished run of a kind, with its experiment file beside it; made once in a process."""
    home = Path.cwd().parent / "out"
    kept = Path.cwd().parent / "healthy"
    if (kept / kind / "made").is_file():  # by an earlier process of this worker
        return kept / kind
    folder = home / "healthy"
    with contextlib.redirect_stdout(io.StringIO()):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "a.yaml").write_text(dump_yaml({"kind": kind, **FILES[kind]}))
        run_experiment(folder / "a.yaml", folder / "run", resume=False, **_OPTIONS)
    shutil.copytree(folder, kept / kind, dirs_exist_ok=True)
    (kept / kind / "made").touch()
    shutil.rmtree(folder)
    return kept / kind


class ResultFolders:
    """A result folder with one to three faults, and what is done with it."""

    name = "results"

    def __init__(self, kinds: tuple[str, ...] = tuple(FILES)) -> None:
        self._kinds = kinds

    def write(self, seed: int, index: int, folder: Path) -> None:
        """The folder ``run``, a healthy one ``other``, the experiment file, and ``do.txt`` with the command."""
        rng = Random(f"results {seed} {index}")
        kind = rng.choice(self._kinds)
        shutil.copytree(healthy(kind), folder, dirs_exist_ok=True)
        todo = rng.choice(("report", "report", "recompute", "compare", "compare", "resume", "resume"))
        if todo == "compare":
            shutil.copytree(folder / "run", folder / "other")
        (folder / "do.txt").write_text(todo)
        if todo == "resume" and kind == "walkthrough" and rng.random() < 0.5:
            _cut_rows(rng, folder / "run" / "frames.csv")
        for _ in range(rng.choice((1, 1, 2, 3))):
            _damage(rng, folder / "run")

    def check(self, folder: Path, out: Path) -> str:
        """What the command makes of it, or a message."""
        todo = (folder / "do.txt").read_text()
        shutil.copytree(folder / "run", out / "run", symlinks=True)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                if todo == "compare":
                    compare_folders(folder / "other", out / "run", as_json=False, out=out / "table.csv", gate=5.0)
                    compare_folders(out / "run", folder / "other", as_json=True, out=None, gate=None)
                elif todo == "resume":
                    run_experiment(folder / "a.yaml", out / "run", resume=True, **_OPTIONS)
                else:
                    report_folder(out / "run", recompute=todo == "recompute")
        except InputError as error:
            check_message(error)
            return "refused"
        except TechniquesFailed:  # what failures.csv says after its faults may be that one did
            if "defect" in _reports_that_failed(out / "run"):
                raise Fault(_reports_that_failed(out / "run")) from None
            return "failed, and said so"
        return todo


def _reports_that_failed(out: Path) -> str:
    note = out / "failures" / "report.txt"
    text = note.read_text(errors="replace") if note.is_file() else ""
    return "" if not text or "InputError" in text else "defect in the report: " + text.strip().splitlines()[-1]


def _cut_rows(rng: Random, path: Path) -> None:
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: rng.randrange(1, len(lines) + 1)]))


def _damage(rng: Random, run: Path) -> None:
    files = sorted(path for path in run.rglob("*") if path.is_file())
    if not files:
        return
    tables = [path for path in files if path.suffix in (".csv", ".json", ".yaml")]
    path = rng.choice(tables if tables and rng.random() < 0.75 else files)
    ways: list[Callable[[Random, Path], None]] = [_truncate, _flip, _remove, _swap, _empty]
    if path.suffix == ".csv":
        ways += [_edit_cells] * 5
    elif path.suffix == ".json":
        ways += [_edit_json] * 5
    elif path.suffix == ".yaml":
        ways += [_edit_words] * 3
    rng.choice(ways)(rng, path)


def _truncate(rng: Random, path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: rng.randrange(len(data) + 1)])


def _flip(rng: Random, path: Path) -> None:
    path.write_bytes(mutations.mutated_bytes(rng, path.read_bytes()))


def _empty(rng: Random, path: Path) -> None:
    path.write_bytes(b"")


def _remove(rng: Random, path: Path) -> None:
    if path.parent.name != "run" and rng.random() < 0.3:
        shutil.rmtree(path.parent)
    elif rng.random() < 0.2:
        path.unlink()
        path.mkdir()
    else:
        path.unlink()


def _swap(rng: Random, path: Path) -> None:
    others = sorted(other for other in path.parent.iterdir() if other.is_file() and other != path)
    if others:
        other = rng.choice(others)
        mine, theirs = path.read_bytes(), other.read_bytes()
        path.write_bytes(theirs)
        other.write_bytes(mine)


def _edit_cells(rng: Random, path: Path) -> None:
    """One cell, row or column of a table."""
    rows = list(csv.reader(io.StringIO(path.read_text(errors="replace").replace("\0", ""))))
    if not rows or not rows[0]:
        return
    at, column = rng.randrange(len(rows)), rng.randrange(len(rows[0]))
    kind = rng.randrange(8)
    if kind < 4 and column < len(rows[at]):
        rows[at][column] = rng.choice(_CELLS)
    elif kind == 4:
        del rows[at]
    elif kind == 5:
        rows.insert(at, rows[at])
    elif kind == 6:
        rows = [row[:column] + row[column + 1 :] for row in rows]
    else:
        rows = [[*row[:column], rng.choice(_CELLS), *row[column + 1 :]] if i else row for i, row in enumerate(rows)]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    path.write_text(text.getvalue())


def _edit_json(rng: Random, path: Path) -> None:
    with contextlib.suppress(ValueError):
        path.write_text(json.dumps(mutations.mutated_tree(rng, json.loads(path.read_text(errors="replace")))))


def _edit_words(rng: Random, path: Path) -> None:
    path.write_bytes(mutations.mutated_text(rng, path.read_bytes()))
