"""What a user waits for before anything is drawn: compiling, ``--help``, a first image. In processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import experiments
from experiments.bench.plan import CONFIGS, Bench
from experiments.bench.rows import Row, interleaved_medians

COLD_REPEATS, WARM_REPEATS = 2, 5
TIMEOUT_S = 300.0
_CLI = "from experiments.cli import main; main()"
EVERYTHING = """
import importlib, pkgutil
import wkernels, warp
from algorithms.plugins import load_all
for module in pkgutil.walk_packages(wkernels.__path__, "wkernels."):
    importlib.import_module(module.name)
load_all()
warp.force_load(device="cpu")
"""
DEMO = """
import sys
from experiments import reference_visibility, render_visibility
from experiments.kinds.walkthrough.config import load_experiment
demo = load_experiment(sys.argv[1])
for run in demo.runs:
    few = {"samples": 2} if "samples" in run.params else {}
    render_visibility(demo.loaded_scene, run.name, few, frames=2, width=64, height=36)
reference_visibility(demo.loaded_scene, samples=4, width=64, height=36, cache=False)
"""


class _Failed(Exception):
    """A process ended badly; the message says how."""


def compile_cold(bench: Bench, name: str) -> Iterator[Row]:
    """Processes that find an empty kernel cache: one that loads every kernel, one that draws with the demo's."""
    demo = CONFIGS / "experiments" / "demo.yaml"
    repeats = min(bench.repeats, COLD_REPEATS)
    note = f"a fresh process and an empty kernel cache, median of {repeats}"
    everything = [sys.executable, "-c", EVERYTHING]
    yield _measured(f"{name}.everything", everything, repeats, f"every kernel; {note}", cold=True)
    if not demo.is_file():
        yield Row(f"{name}.demo", None, note=f"{demo.name} is missing: configs/ is not beside the installed packages")
        return
    drawn = [sys.executable, "-c", DEMO, str(demo)]
    what = f"the demo's techniques and reference, two frames of 64x36; {note}"
    yield _measured(f"{name}.demo", drawn, repeats, what, cold=True)


def start_help(bench: Bench, name: str) -> Iterator[Row]:
    """``wkernels --help`` in a process of its own."""
    repeats = min(bench.repeats, WARM_REPEATS)
    command = [sys.executable, "-c", _CLI, "--help"]
    yield _measured(name, command, repeats, f"wkernels --help, a process each, median of {repeats}")


def start_render(bench: Bench, name: str) -> Iterator[Row]:
    """``wkernels render`` of the demo's scene to a PNG, kernels being compiled already."""
    scene = CONFIGS / "scenes" / "overlap.yaml"
    if not scene.is_file():
        yield Row(name, None, note=f"{scene.name} is missing: configs/ is not beside the installed packages")
        return
    repeats = min(bench.repeats, WARM_REPEATS)
    with tempfile.TemporaryDirectory() as folder:
        out = ["--technique", "pcss", "--out", str(Path(folder) / "image.png")]
        command = [sys.executable, "-c", _CLI, "render", str(scene), *out]
        what = f"wkernels render overlap.yaml --technique pcss, 640x360, a process each, median of {repeats}"
        yield _measured(name, command, repeats, what)


def _measured(name: str, command: Sequence[str], repeats: int, note: str, *, cold: bool = False) -> Row:
    def side() -> float:
        return _run_cold(command) if cold else _run(command)

    try:
        (ms,) = interleaved_medians([side], repeats, warm_ups=0 if cold else 1)
    except _Failed as failed:
        return Row(name, None, note=f"{note}; {failed}")
    return Row(name, ms, note=note)


def _run_cold(command: Sequence[str]) -> float:
    with tempfile.TemporaryDirectory() as cache:
        return _run(command, WARP_CACHE_PATH=cache)


def _run(command: Sequence[str], **variables: str) -> float:
    """Milliseconds of a process that uses this source tree.

    Raises:
        _Failed: It did not end with status 0 in time.
    """
    root = str(Path(experiments.__file__).parents[1])
    search = os.pathsep.join(part for part in (root, os.environ.get("PYTHONPATH", "")) if part)
    environment = {**os.environ, **variables, "PYTHONPATH": search}
    begin = time.perf_counter()
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise _Failed(f"did not end within {TIMEOUT_S:g} s") from None
    spent = (time.perf_counter() - begin) * 1e3
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise _Failed(f"ended with status {done.returncode}: {last}")
    return spent
