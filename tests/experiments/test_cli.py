"""The command line: exit statuses, messages, and the commands that write files."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from experiments import cli
from experiments.commands import readme
from experiments.commands.doctor import findings
from experiments.commands.progress import progress_display
from experiments.results.images import read_exr

SCENE = """\
meshes:
- {primitive: plane, size: [4, 4]}
- {primitive: box, size: [1, 1, 1], transform: {translate: [0, 1, 0]}}
lights:
- {kind: point, position: [0, 4, 0]}
camera: {eye: [3, 3, 3], target: [0, 0, 0], fov_deg: 50, near: 0.1, far: 50}
"""
EXPERIMENT = "kind: walkthrough\nscene: scene.yaml\nimage: {width: 16, height: 12}\ntechniques:\n- shadow_map\n"

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def wkernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command line in a folder with a scene and an experiment; returns status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    Path("scene.yaml").write_text(SCENE)
    Path("e.yaml").write_text(EXPERIMENT)
    Path("broken.py").write_text("x = 1\ndef f(:\n")
    Path("unreadable.yaml").write_text("kind: [walkthrough\n")

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["wkernels", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return run


def test_help_loads_nothing_heavy() -> None:
    heavy = ["warp", "numpy", "trimesh", "matplotlib", "pandas", "pydantic"]
    code = f"import sys, experiments.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("module", ["experiments.api", "experiments.commands.run", "experiments.commands.bench"])
def test_openblas_has_one_thread_whatever_is_imported_first(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    code = f"import os, sys, {module}; print(os.environ.get('OPENBLAS_NUM_THREADS'), 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "True"]


def test_help_names_every_command(wkernels: Run) -> None:
    status, out, _ = wkernels("--help")
    assert status == 0
    for command in ("list", "run", "report", "explain", "render", "bench", "doctor", "new-technique"):
        assert f"\n  {command} " in out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "absent.yaml"], "error: absent.yaml: no such file."),
        (
            ["run", "e.yaml", "--set", "image.width=0"],
            "error: --set image.width=0: image.width: must be at least 1, not 0.",
        ),
        (
            ["run", "e.yaml", "--set", "techniques=[shadowmap]"],
            "there is no technique 'shadowmap'. Did you mean 'shadow_map'?",
        ),
        (
            ["run", "e.yaml", "--set", "techniques=[pcss]"],
            "'pcss' needs a light with an area; this point light has none",
        ),
        (
            ["run", "e.yaml", "--set", "scene.camera.fov_deg=.nan"],
            "scene.camera.fov_deg: must be a finite number, not nan.",
        ),
        (["run", "e.yaml", "--set", "scene.meshes.1.size=[1, -1, 1]"], "scene.meshes.1.size.1: must be"),
        (["run", "e.yaml", "--set", "scene.meshes.0={file: absent.obj}"], "absent.obj"),
        (["run", "e.yaml", "--set", "frames=0"], "--set frames=0: frames: must be at least 1"),
        (["run", "e.yaml", "--plugin", "broken.py"], "error: broken.py:2: cannot be imported: SyntaxError"),
        (["run", "unreadable.yaml"], "error: unreadable.yaml:1: is not valid YAML"),
        (["run", "e.yaml", "--device", "gpu"], "there is no device 'gpu'."),
        (["run", "e.yaml", "--plugin", "absent.py"], "error: absent.py: plugin file does not exist"),
        (["explain", "scene.yaml"], "error: scene.yaml:1: meshes: is not a known key."),
        (["report", "absent"], "error: absent"),
        (["render", "scene.yaml", "--technique", "shadowmap"], "technique 'shadowmap'. Did you mean 'shadow_map'?"),
        (
            ["render", "scene.yaml", "--technique", "shadow_map", "--out", "a.gif"],
            "error: --out a.gif: the name must end in",
        ),
        (
            ["render", "scene.yaml", "--technique", "shadow_map", "--out", "x/a.exr"],
            "error: --out x/a.exr: there is no folder",
        ),
        (
            ["render", "scene.yaml", "--technique", "shadow_map", "--param", "bias"],
            "error: --param bias: must have the form",
        ),
        (
            ["render", "scene.yaml", "--technique", "shadow_map", "--param", "bios=none"],
            "bios: is not a known key. Did you mean 'bias'?",
        ),
        (
            ["render", "scene.yaml", "--technique", "shadow_map", "--light", "1"],
            "light: the scene has 1 light(s); there is no light 1.",
        ),
        (["render", "absent.yaml", "--technique", "shadow_map"], "error: absent.yaml: no such file."),
        (["new-technique", "Not-a-name"], "error: 'Not-a-name' cannot be a technique's name"),
        (["new-technique", "class"], "error: 'class' cannot be a technique's name"),
        (["new-technique", "shadow_map"], "error: there is a technique 'shadow_map' already"),
        (["new-technique", "my_own", "--dir", "absent"], "error: --dir absent: there is no such folder."),
    ],
)
def test_wrong_input_is_one_message_and_status_2(wkernels: Run, arguments: list[str], expected: str) -> None:
    status, _, err = wkernels(*arguments)
    assert status == 2
    assert expected in err
    assert "Traceback" not in err
    assert sum(line.startswith("error:") for line in err.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments", [["run"], ["rnu", "e.yaml"], ["run", "e.yaml", "--threads", "0"], ["run", "e.yaml", "--oops"]]
)
def test_wrong_usage_is_status_2(wkernels: Run, arguments: list[str]) -> None:
    status, _, err = wkernels(*arguments)
    assert status == 2 and "Usage" in err and "Traceback" not in err


def test_a_defect_is_status_1_with_its_traceback_in_a_file(wkernels: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("the reason")

    monkeypatch.setattr("experiments.commands.listing.list_techniques", broken)
    status, _, err = wkernels("list")
    assert status == 1
    assert "this is a defect in wkernels" in err and "ZeroDivisionError: the reason" in err and "Traceback" not in err
    log = Path(err.strip().splitlines()[-1].rpartition(" ")[2])
    text = log.read_text()
    assert "Traceback" in text and "in broken" in text


def test_an_interruption_is_status_130_and_says_how_to_go_on(wkernels: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("experiments.kinds.walkthrough.run.run", interrupted)
    status, _, err = wkernels("run", "e.yaml")
    assert status == 130
    assert "--resume" in err and str(Path("out/e")) in err


def test_run_hands_its_options_to_the_runner(wkernels: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr(
        "experiments.kinds.walkthrough.run.run",
        lambda experiment, out, **options: calls.append((experiment, out, options)),
    )
    status, out, _ = wkernels(
        "run", "e.yaml", "--out", "results", "--set", "seed=3", "--threads", "2", "--resume", "--no-skips"
    )  # fmt: skip
    assert status == 0
    experiment, folder, options = calls[0]
    assert (experiment.seed, folder) == (3, Path("results"))
    assert (options["device"], options["threads"], options["resume"], options["skips"]) == ("cpu", 2, True, False)
    assert out.splitlines()[-1] == f"Report: {Path('results/report.html')}"
    wkernels("run", "e.yaml")
    assert calls[1][1] == Path("out/e")


def test_failed_techniques_are_status_1(wkernels: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from experiments.results.failures import TechniquesFailed

    def failing(*_: object, **__: object) -> None:
        raise TechniquesFailed(Path("out/e"), [{"label": "pcf", "frame": "2", "error": "ValueError: no"}])

    monkeypatch.setattr("experiments.kinds.walkthrough.run.run", failing)
    status, _, err = wkernels("run", "e.yaml")
    assert status == 1
    assert "'pcf' failed on frame 2" in err and "defect" not in err


def test_list_as_json_and_as_lines(wkernels: Run) -> None:
    status, out, _ = wkernels("list", "--json")
    assert status == 0
    entry = next(entry for entry in json.loads(out) if entry["name"] == "shadow_map")
    assert entry["family"] == "hard" and "williams1978" in entry["paper"]
    assert entry["products"] == ["g-buffer", "light depth map"]
    assert entry["params"]["resolution"]["default"] == 1024
    assert entry["params"]["resolution"]["unit"] == "texels"
    assert entry["params"]["resolution"]["maximum"] == 8192
    _, lines, _ = wkernels("list")
    assert any(line.split("\t")[:2] == ["shadow_map", "hard"] for line in lines.splitlines())


def test_explain_renders_nothing(wkernels: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def render(*_: object) -> None:
        raise AssertionError("explain rendered")

    monkeypatch.setattr("wkernels.frame.session.Session.render", render)
    status, out, _ = wkernels("explain", "e.yaml")
    assert status == 0 and "shadow_map" in out
    assert not Path("out").exists()


def test_render_writes_visibility(wkernels: Run) -> None:
    arguments = ["render", "scene.yaml", "--technique", "shadow_map", "--width", "48", "--height", "32"]
    status, out, err = wkernels(*arguments, "--out", "v.exr", "--param", "resolution=128", "--param", "bias=slope")
    assert status == 0, err
    assert out.startswith("v.exr: shadow_map, 48 x 32, frame 0; mean visibility")
    visibility = read_exr(Path("v.exr"))
    assert visibility.shape == (32, 48)
    assert {0.0, 1.0} == set(np.unique(visibility[np.isfinite(visibility)]))
    status, _, err = wkernels(*arguments, "--out", "v.png")
    assert status == 0 and Path("v.png").stat().st_size > 0, err


def test_new_technique_runs_as_it_stands(wkernels: Run) -> None:
    status, out, err = wkernels("new-technique", "my_own_test")
    assert status == 0, err
    assert Path("my_own_test.py").name in out
    arguments = ["scene.yaml", "--width", "48", "--height", "32", "--param", "resolution=256"]
    status, _, err = wkernels(
        "render", *arguments, "--technique", "my_own_test", "--plugin", "my_own_test.py", "--out", "a.exr"
    )
    assert status == 0, err
    wkernels("render", *arguments, "--technique", "shadow_map", "--out", "b.exr")
    np.testing.assert_array_equal(read_exr(Path("a.exr")), read_exr(Path("b.exr")))  # its declared limit
    text = Path("my_own_test.py").read_text()
    status, _, err = wkernels("new-technique", "my_own_test")
    assert status == 2 and "my_own_test.py: exists already" in err
    assert Path("my_own_test.py").read_text() == text


def test_doctor_finds_nothing_wrong_here() -> None:
    found = findings()
    assert [finding for finding in found if finding.ok is False] == []
    subjects = {finding.subject for finding in found}
    assert {"kernel, 1 thread", "kernel, 2 threads", "FLIP", "cache folder", "extra formats", "devices"} <= subjects


def test_doctor_reports_a_broken_cache(wkernels: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda *_, **__: str(tmp_path / "file" / "cache"))
    status, out, _ = wkernels("doctor")
    assert status == 1
    assert any(line.startswith("FAIL  cache folder") for line in out.splitlines())


def test_plain_progress_is_short(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_display() as show:
        for done in range(1000):
            show(done, 1000, f"frame {done}")
        show(1000, 1000, "done")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "0/1000 frame 0" and lines[-1] == "1000/1000 done"
    assert len(lines) == 21


def test_the_readme_has_the_current_table() -> None:
    assert readme.main(["--check"]) == 0, "run `make table`"


def test_the_readme_table_needs_its_markers() -> None:
    text = f"a\n{readme.BEGIN}\nold\n{readme.END}\nb\n"
    assert readme.with_table(text, "| new |") == f"a\n{readme.BEGIN}\n| new |\n{readme.END}\nb\n"
    with pytest.raises(Exception, match="are missing"):
        readme.with_table("a\n", "| new |")
