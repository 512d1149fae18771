"""The command line where its surroundings fail it: folders that cannot be written, outputs that are lost, odd names."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from test_cli import EXPERIMENT, SCENE, Run, wkernels  # noqa: F401 - a fixture

import wkernels as package
from experiments.commands.failures import OutputLost, ToldStream

RENDER = ("render", "scene.yaml", "--technique", "shadow_map", "--width", "16", "--height", "9", "--out", "o.exr")
FULL = Path("/dev/full")
LATIN = os.fsdecode(b"d\xe9j\xe0")  # no UTF-8
linux = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's devices and its names of bytes")


def run(
    folder: Path, *arguments: str, module: str = "experiments", stdout: object = subprocess.PIPE, **environment: str
) -> subprocess.CompletedProcess[str]:
    """``python -m MODULE`` in a folder with a scene and an experiment."""
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "e.yaml").write_text(EXPERIMENT)
    paths = os.pathsep.join([str(Path(package.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, **environment},
        stdout=stdout,  # type: ignore[call-overload]
        stderr=subprocess.PIPE,
        text=True,
        errors="backslashreplace",
        check=False,
    )


@pytest.mark.parametrize("module", ["wkernels", "experiments"])
def test_packages_run_as_the_command(tmp_path: Path, module: str) -> None:
    done = run(tmp_path, "--help", module=module)
    assert done.returncode == 0 and done.stdout.startswith("Usage: wkernels ") and not done.stderr
    wrong = run(tmp_path, "render", "nowhere.yaml", "--technique", "shadow_map", module=module)
    assert wrong.returncode == 2 and wrong.stderr == "error: nowhere.yaml: no such file.\n"


@pytest.mark.parametrize("kind", ["a file", "no such place", "a folder that takes nothing"])
@linux
def test_a_home_that_cannot_be_written_is_told_in_a_line(tmp_path: Path, kind: str) -> None:
    (tmp_path / "file").write_text("")
    homes = {"a file": f"{tmp_path}/file", "no such place": "/dev/null/x", "a folder that takes nothing": "/proc/self"}
    home = homes[kind]
    variables = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "WARP_CACHE_PATH"), home)
    done = run(tmp_path, *RENDER, **variables, TMPDIR=str(tmp_path))
    assert done.returncode == 0 and done.stdout.startswith("o.exr: shadow_map"), done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith("warning: the kernel cache cannot be written to (") and "WARP_CACHE_PATH" in line
    assert not list(tmp_path.glob("wkernels-kernels-*")), "the folder of this process alone goes with it"


@linux
def test_a_cache_folder_that_cannot_be_written_keeps_nothing_and_stops_nothing(tmp_path: Path) -> None:
    done = run(tmp_path, "run", "e.yaml", "--out", "r", WKERNELS_CACHE="/dev/null/x")
    assert done.returncode == 0 and (tmp_path / "r" / "report.html").is_file(), done.stderr


@pytest.mark.parametrize("arguments", [("--help",), ("list",), ("list", "--json"), RENDER])
@linux
def test_a_full_stdout_is_told_in_a_line(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    with FULL.open("w") as stdout:
        done = run(tmp_path, *arguments, stdout=stdout)
    assert done.returncode == 2
    assert done.stderr == "error: standard output cannot be written: No space left on device.\n"


@linux
def test_a_reader_that_went_away_is_told_in_a_line(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        done = run(tmp_path, "list", stdout=write)
    finally:
        os.close(write)
    assert done.returncode == 2 and done.stderr == "error: standard output cannot be written: Broken pipe.\n"


@linux
def test_an_output_that_is_no_place_for_files(wkernels: Run) -> None:
    status, _, error = wkernels(*RENDER[:-1], "/dev/full/o.exr")
    assert (
        status == 2 and error.startswith("error: --out /dev/full/o.exr: there is no folder") and error.count("\n") == 1
    )
    status, _, error = wkernels("run", "e.yaml", "--out", "/dev/full")
    assert status == 2 and error == "error: /dev/full: is a file; results need a folder.\n"


@pytest.mark.parametrize("suffix", [".exr", ".png"])
@linux
def test_an_image_whose_path_is_not_utf8_is_refused(tmp_path: Path, suffix: str) -> None:
    (tmp_path / LATIN).mkdir()
    done = run(tmp_path, *RENDER[:-1], f"{LATIN}/o{suffix}")
    assert done.returncode == 2 and not list((tmp_path / LATIN).iterdir())
    expected = rf"error: d\udce9j\udce0/o{suffix}: cannot be written: the path is not UTF-8, which image files need."
    assert done.stderr.splitlines() == [expected]


@linux
def test_a_result_folder_whose_path_is_not_utf8_is_refused(tmp_path: Path) -> None:
    done = run(tmp_path, "run", "e.yaml", "--out", LATIN)
    assert done.returncode == 2 and done.stderr.endswith("the path is not UTF-8, which image files need.\n")
    assert not (tmp_path / LATIN).exists()


@linux
def test_a_scene_whose_path_is_not_utf8_is_read_and_told_of(tmp_path: Path) -> None:
    (tmp_path / LATIN).mkdir()
    (tmp_path / LATIN / "scene.yaml").write_text(SCENE.replace("size: [4, 4]", "size: [4, -4]"))
    done = run(tmp_path, "render", f"{LATIN}/scene.yaml", *RENDER[2:])
    assert done.returncode == 2 and r"d\udce9j\udce0/scene.yaml:2: meshes.0.size.1" in done.stderr
    (tmp_path / LATIN / "scene.yaml").write_text(SCENE)
    done = run(tmp_path, "render", f"{LATIN}/scene.yaml", *RENDER[2:])
    assert done.returncode == 0 and done.stdout.startswith("o.exr")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_what_a_terminal_cannot_show_is_escaped(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "日本").mkdir()
    done = run(tmp_path, *RENDER[:-1], "日本/o.exr", PYTHONIOENCODING=encoding, PYTHONUTF8="0")
    assert done.returncode == 0 and done.stdout.startswith(r"\u65e5\u672c/o.exr: shadow_map"), done.stderr


class Lossy:
    """A stream that takes nothing."""

    def write(self, text: str) -> int:
        raise OSError(28, "No space left on device")

    def flush(self) -> None:
        """Nothing waits."""

    def fileno(self) -> int:
        raise OSError("no file")


def test_a_lost_output_stays_lost() -> None:
    """Some callers try to write first and hide what they find: the loss is to come up again at the end."""
    stream = ToldStream(Lossy())  # type: ignore[arg-type]
    stream.flush()
    for attempt in (lambda: stream.write(""), stream.flush):
        with pytest.raises(OutputLost, match="No space left on device"):
            attempt()


def test_stdout_is_as_it_was_when_the_command_ends(wkernels: Run) -> None:
    before, shown = sys.stdout, warnings.showwarning
    wkernels("list")
    assert sys.stdout is before and warnings.showwarning is shown


@pytest.mark.parametrize("kind", [np.int64, np.uint8, np.int32])
def test_numpys_integers_are_numbers(kind: type) -> None:
    """Short unsigned ones wrap around below 0 in sums, as frame - frames + 1 is."""
    from experiments import reference_visibility, render_visibility

    scene = {
        "meshes": [{"primitive": "plane", "size": [4, 4]}, {"primitive": "box", "size": [1, 1, 1]}],
        "lights": [{"kind": "rectangle", "center": [0, 4, 0], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}],
        "camera": {"eye": [3, 3, 3], "target": [0, 0, 0]},
        "path": {"orbit": {"center": [0, 0, 0], "radius": 4.0, "height": 3.0}, "frames": 6},
    }
    numbers = {"frame": 1, "width": 24, "height": 18, "light": 0, "seed": 200, "threads": 1}
    short = {name: kind(value) for name, value in numbers.items()}
    params = {"resolution": kind(64), "blocker_taps": kind(8), "rotate": np.bool_(True), "bias_slope": np.float32(1.5)}
    plain = {"resolution": 64, "blocker_taps": 8, "rotate": True, "bias_slope": 1.5}
    for technique, given, same in (
        ("pcss", params, plain),
        ("tc_soft_paper", {"resolution": kind(64)}, {"resolution": 64}),
    ):
        actual = render_visibility(scene, technique, given, frames=kind(3), **short).visibility
        expected = render_visibility(scene, technique, same, frames=3, **numbers).visibility
        np.testing.assert_array_equal(actual, expected)
    projection = {"fit": "focused", "splits": kind(2), "lambda": np.float64(0.5)}
    images = [
        render_visibility(scene, "shadow_map", projection=one, **some).visibility
        for one, some in ((projection, short), ({"fit": "focused", "splits": 2, "lambda": 0.5}, numbers))
    ]
    np.testing.assert_array_equal(*images)
    of = [
        reference_visibility(scene, samples, cache=False, **some)[0]
        for samples, some in ((kind(16), short), (16, numbers))
    ]
    np.testing.assert_array_equal(*of)
