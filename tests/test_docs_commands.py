"""Commands and code that pages show do what they say.

A ``wkernels run`` in a block is really run, with fewer pixels, frames and samples; it is only explained, over a scene
that loads soon, where it names large scenes or every technique, and where its block has run that experiment already.
Commands in running text are checked for their options and files. The ids of the tests say which. docs/tutorial.md is
gone through step by step.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml
from docs_pages import PAGES, PROGRAMS, ROOT, Piece, blocks, commands, spans
from typer.testing import CliRunner

from experiments.cli import app

COSTLY = (
    "paris",
    "winter",
    "savings",
    "sweep_all",
    "real_scenes",
    "cost.yaml",
    "flicker",
    "mover_map",
    "moving_light",
    "overlap_cuts",
)
"""Where one of these stands in a block, what it runs is explained only: all of them together take a minute then."""
STANDS_FOR = {
    "CONFIG": "configs/experiments/demo.yaml",
    "SCENE": "configs/scenes/overlap.yaml",
    "NAME": "shadow_map",
    "COMMAND": "run",
    "PERCENT": "2",
    **dict.fromkeys(("A", "B", "DIR", "OUT"), "out/demo"),
}
FEW = {
    "walkthrough": ["image={width: 48, height: 27}", "frames=1", "repeats=1", "lead_in=0", "reference={samples: 4}"],
    "convergence": ["image={width: 32, height: 24}", "steps=[1, 2]", "reference={samples: 16}"],
}
FEW["sweep"] = FEW["walkthrough"]
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def check(words: list[str]) -> None:
    """Refuses unknown commands, options, targets and files; runs nothing."""
    program, *rest = words
    if program == "make":
        targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert set(rest) <= set(targets), words
    elif program == "python":
        module = ROOT / rest[1].replace(".", "/")
        runs = module.with_suffix(".py").is_file() or (module / "__main__.py").is_file()
        assert rest[1] == "pytest" or runs, words
    elif program == "wkernels" and rest[0] != "--help":
        assert rest[0] in COMMANDS, words
        if rest[1:] and "--help" not in rest:  # the name alone speaks of the command
            COMMANDS[rest[0]].make_context(rest[0], rest[1:])
    files = [word for word in words if word.startswith(("configs/", "tests/")) or word == "constraints.txt"]
    assert all((ROOT / file).is_file() for file in files), words


def invoke(*words: str) -> None:
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, f"wkernels {shlex.join(words)}: {done.exception!r}\n{done.output}"


def explain(config: Path, options: list[str]) -> None:
    """Explains what a command would run, over a scene that loads soon."""
    data = yaml.safe_load(config.read_text(encoding="utf-8"))
    given = [option.partition("=")[2] for option in options if option.startswith("scene=")]
    scenes = given or data.get("scenes") or [data["scene"]]
    assert all((config.parent / scene).is_file() for scene in scenes if isinstance(scene, str)), (config, options)
    soon = ["scenes=[../scenes/overlap.yaml]" if "scenes" in data else "scene=../scenes/overlap.yaml"]
    out = [i for i, option in enumerate(options) if option == "--out"]
    kept = [option for i, option in enumerate(options) if i not in out and i - 1 not in out]
    invoke("explain", str(config), *kept, *(f"--set={text}" for text in soon))


def run(words: list[str], *, costly: bool) -> None:
    """Runs a command as a reader would, at a smaller size."""
    check(words)
    program, name, *rest = words
    if program == "python" and rest[0] != "pytest":
        files = [str(file) for word in rest[1:] for file in sorted(Path().glob(word))]
        command = [sys.executable, "-m", rest[0], *files]
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    elif program == "wkernels" and name == "run":
        kind = yaml.safe_load(Path(rest[0]).read_text(encoding="utf-8"))["kind"]
        if costly:
            explain(Path(rest[0]), rest[1:])
        else:
            invoke("run", *rest, *(f"--set={text}" for text in FEW[kind]))
    elif program == "wkernels" and name == "render":
        invoke(name, *rest, "--width=64", "--height=36")
    elif program == "wkernels":
        invoke(name, *(rest if name != "bench" else ["--list"]))


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder from which commands see the repository's files, and write into nothing else."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def is_costly(block: Piece) -> bool:
    return any(name in block.text for name in COSTLY)


SHOWN = [b for page in PAGES for b in blocks(page, "", "sh") if commands(b.text) and page.name != "tutorial.md"]
SHOWN_IDS = [f"{block.name}-{'explained' if is_costly(block) else 'run'}" for block in SHOWN]


@pytest.mark.parametrize("block", SHOWN, ids=SHOWN_IDS)
def test_commands_that_are_shown_run(block: Piece, desk: Path) -> None:
    seen: set[str] = set()
    for words in commands(block.text):
        names = STANDS_FOR | ({"NAME": "my_technique"} if words[1] == "new-technique" else {})
        meant = [names.get(word, word) for word in words]
        run(meant, costly=is_costly(block) or (words[1] == "run" and meant[2] in seen))
        seen.update(meant[2:3])


SPANS = [s for page in PAGES for s in spans(page) if s.text.startswith(PROGRAMS) and "<-" not in s.text]


@pytest.mark.parametrize("span", SPANS, ids=[f"{span.name}-checked" for span in SPANS])
def test_commands_in_running_text_are_valid(span: Piece) -> None:
    check([STANDS_FOR.get(word, word) for word in shlex.split(span.text)])


def test_mistakes_in_commands_are_found(desk: Path) -> None:
    def is_refused(text: str) -> bool:
        try:
            check(text.split())
        except Exception:  # of a library's own kind where an option is wrong
            return True
        return False

    wrong = ("wkernels walk", "wkernels run --fast a.yaml", "wkernels explain configs/none.yaml", "make coffee")
    assert all(is_refused(text) for text in wrong) and not is_refused("wkernels run configs/experiments/demo.yaml")
    with pytest.raises(AssertionError, match="pcff"):
        run(["wkernels", "run", "configs/experiments/demo.yaml", "--set", "techniques=[pcff]"], costly=True)


CODE = [b for page in PAGES for b in blocks(page, "python") if page.name not in ("lanes.md", "tutorial.md")]


@pytest.mark.parametrize("block", CODE, ids=[block.name for block in CODE])
def test_python_that_is_shown_runs(block: Piece, desk: Path) -> None:
    text = re.sub(r"width(\W+)\d+(\W+)height(\W+)\d+", r"width\1 64\2height\3 36", block.text)
    assert text != block.text, "no size to make smaller"
    exec(compile(text, block.name, "exec"), {})


def test_the_tutorial_goes_all_the_way(desk: Path) -> None:
    """Every step in turn: the file is changed as the page says, the check that it names fails, and then none."""
    page = ROOT / "docs" / "tutorial.md"
    told = next(blocks(page, "text")).text.partition(":")[0]
    expected = [[told], []]
    for block in blocks(page, "", "python", "yaml"):
        if block.language:
            sys.modules.pop("wkernels_plugin_five_taps", None)
            file = {"python": "five_taps.py", "yaml": "my_sweep.yaml"}[block.language]
            (desk / file).write_text(block.text, encoding="utf-8")
        for words in commands(block.text) if not block.language else []:
            if words[2] == "pytest":
                check(words)
                paths = [str(desk / word) if word == "five_taps.py" else word for word in words[1:]]
                command, env = [sys.executable, *paths], {k: v for k, v in os.environ.items() if "PYTEST" not in k}
                done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
                failed = re.findall(r"^FAILED .*\[five_taps-(\w+)\]", done.stdout, re.MULTILINE)
                assert failed == expected.pop(0), done.stdout + done.stderr
            else:
                run(words, costly=False)
    assert not expected
    assert "five_taps[radius=8]" in (desk / "out/sweep/pareto.csv").read_text(encoding="utf-8")
