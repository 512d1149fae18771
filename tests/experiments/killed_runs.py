"""Runs that are killed (SIGKILL) and resumed, in children of a process that has compiled everything already.

    python tests/experiments/killed_runs.py KILLS SEED [FOLDER]    kill the real renderer at random moments
    python tests/experiments/killed_runs.py --each-write [STRIDE [FOLDER]]
                                          kill at every STRIDE-th write to the disk, torn lines included; 1 is every one

Prints what was killed where; ends with 1 if a resumed run differs from the uninterrupted one. A process of its own,
because a fork of one with running threads may hang: nothing here writes an image before it forks.
"""

from __future__ import annotations

import filecmp
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.colors
import numpy as np
import OpenImageIO
from fake_engine import FakeEngine, make_experiment, make_run

import experiments.kinds.walkthrough.report
from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.run import run
from experiments.results.images import read_exr
from experiments.results.store import Store
from experiments.schema.experiment import Experiment

CONFIG = """
kind: walkthrough
scene:
  meshes:
    - {primitive: plane, size: [8, 8]}
    - primitive: box
      size: [1, 0.4, 1]
      transform: {translate: [0, 1.2, 0]}
      motion: {keyframes: [{frame: 0, translate: [0, 0, 0]}, {frame: 3, translate: [0.4, 0, 0]}]}
  lights:
    - {kind: rectangle, center: [0, 5, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1]}
  path: {frames: 4, keyframes: [{frame: 0, eye: [0, 3, 5], target: [0, 0.5, 0]},
                                {frame: 3, eye: [0.6, 3, 5], target: [0, 0.5, 0]}]}
image: {width: 64, height: 48}
reference: {samples: 64, every: 2}
metrics: [rmse, flip, flicker]
techniques:
  - shadow_map: {resolution: 128}
  - tc_soft_paper: {resolution: 128}
  - multi_shadow_map: {samples: 16, resolution: 128}
repeats: 2
"""
# what a run imports on its way would be imported in every child
IMPORTED = (matplotlib.colors, OpenImageIO, experiments.kinds.walkthrough.report)
TIMES = ("frame_ms", "shadow_ms", "fps", "frame_ms_q1", "frame_ms_q3", "shadow_ms_q1", "shadow_ms_q3", "ms")


def without_times(row: dict[str, str]) -> dict[str, str]:
    return {name: value for name, value in row.items() if name not in TIMES}


def differences(whole: Path, parts: Path) -> list[str]:
    """What a resumed run's folder has that the uninterrupted one's has not, or the other way round; times do not count."""
    out = [f"config.yaml of {parts}"] * (not filecmp.cmp(whole / "config.yaml", parts / "config.yaml", shallow=False))
    one, other = Store(whole), Store(parts)
    for table in Store.tables:
        kept, found = ([without_times(row) for row in store.rows(table)] for store in (one, other))
        out += [f"{table}.csv: {len(found)} rows, not {len(kept)}"] * (len(kept) != len(found))
        out += [
            f"{table}.csv, row {i}: {b}, not {a}" for i, (a, b) in enumerate(zip(kept, found, strict=False)) if a != b
        ]
        lines = [(folder / f"{table}.csv").read_bytes() for folder in (whole, parts)]
        out += [f"{table}.csv: head"] * (lines[0].splitlines()[:1] != lines[1].splitlines()[:1])
    names = [
        sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()) for folder in (whole, parts)
    ]
    out += [f"files: {set(names[0]) ^ set(names[1])}"] * (names[0] != names[1])
    for name in names[0]:
        if name.endswith(".exr") and (parts / name).is_file():
            out += [name] * (not np.array_equal(read_exr(whole / name), read_exr(parts / name), equal_nan=True))
        if name.endswith(".png") and (parts / name).is_file():
            out += [name] * (not filecmp.cmp(whole / name, parts / name, shallow=False))
    return out


def forked(work: Callable[[], Any], kill_after: float = float("inf")) -> tuple[bool, float]:
    """Runs ``work`` in a child; whether it was killed, and seconds spent. Anything but that or success ends us."""
    begin = time.perf_counter()
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException as error:
            print(f"child: {type(error).__name__}: {error}", flush=True)
            os._exit(9)
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        spent = time.perf_counter() - begin
        if done:
            break
        if spent >= kill_after:
            os.kill(child, signal.SIGKILL)
            kill_after = float("inf")
        time.sleep(2e-4)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL:
        return True, spent
    if status:
        sys.exit(f"the child ended with {status}")
    return False, spent


def real(experiment: Experiment, out: Path) -> None:
    os.environ["WKERNELS_CACHE"] = str(out.with_name(f"{out.name} cache"))
    run(experiment, out, threads=1, resume=True, report=False)


def fake(out: Path) -> None:
    runs = (make_run("good"), make_run("bad", fails_on=1), make_run("history", "remembering", own_error=True))
    experiment = make_experiment(runs, frames=range(2), every=1, repeats=2, metrics=("rmse", "flicker"))
    try:
        run(experiment, out, engine=FakeEngine(experiment), resume=True, report=False)
    except RuntimeError as error:
        assert "deliberate" in str(error)


def at_random(kills: int, seed: int, folder: Path) -> list[str]:
    """Kills and resumes until there have been enough; each run that comes to its end is compared."""
    (folder / "small.yaml").write_text(CONFIG)
    experiment, rng = load_experiment(folder / "small.yaml"), random.Random(seed)
    forked(lambda: real(experiment, folder / "compiles"))
    _compile_here(experiment, folder)
    _, whole_s = forked(lambda: real(experiment, folder / "whole"))
    found, done, runs = [], 0, 0
    while done < kills:
        runs += 1
        parts = folder / f"parts {runs}"
        while True:
            again, after = done < kills, rng.uniform(0.0, 1.1 * whole_s)
            killed, _ = forked(lambda parts=parts: real(experiment, parts), after if again else float("inf"))  # type: ignore[misc]
            if not killed:
                break
            done += 1
            rows = len(Store(parts).rows("frames"))
            print(f"run {runs}, kill {done}: after {after:.3f} s of {whole_s:.3f}, {rows} of 12 rows")
        found += [f"run {runs}: {what}" for what in differences(folder / "whole", parts)]
    print(f"{done} kills in {runs} runs")
    return found


def _compile_here(experiment: Experiment, folder: Path) -> None:
    """Loads every kernel into this process, so that children have them; writes no image."""
    from experiments.rendering.engine import WarpEngine

    os.environ["WKERNELS_CACHE"] = str(folder / "cache here")
    engine = WarpEngine(experiment, threads=1)
    for lane in experiment.runs:
        session, technique = engine.open(lane)
        for frame in range(3):
            session.begin(frame)
            session.render(technique)
            session.advance()
    engine.reference(0)


def at_each_write(stride: int, folder: Path) -> list[str]:
    """Kills before every replacement, flush and reservation of a file, and in the middle of every write."""
    forked(lambda: fake(folder / "whole"))
    found, point, kills = [], 1, 0
    parts = folder / "parts"
    while True:
        shutil.rmtree(parts, ignore_errors=True)
        killed, _ = forked(lambda point=point: _killed_at(point, lambda: fake(parts)))  # type: ignore[misc]
        if not killed:
            break
        forked(lambda: fake(parts))
        found += [f"write {point}: {what}" for what in differences(folder / "whole", parts)]
        point, kills = point + stride, kills + 1
    print(f"{kills} kills, one in {stride} of about {kills * stride} writes")
    return found


def _killed_at(point: int, work: Callable[[], None]) -> None:
    left = point

    def watched(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def instead(*arguments: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                if name == "write":
                    call(arguments[0], arguments[1][: len(arguments[1]) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments)

        return instead

    for name in ("write", "fsync", "replace", "posix_fallocate", "unlink"):
        setattr(os, name, watched(name, getattr(os, name)))
    work()


def main(arguments: list[str]) -> int:
    with tempfile.TemporaryDirectory() as scratch:
        if arguments[0] == "--each-write":
            folder = Path(arguments[2] if len(arguments) > 2 else scratch)
            found = at_each_write(int((*arguments, 1)[1]), folder)
        else:
            folder = Path(arguments[2] if len(arguments) > 2 else scratch)
            found = at_random(int(arguments[0]), int(arguments[1]), folder)
    print("\n".join(["the resumed runs differ:", *found] if found else ["the resumed runs are the same"]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
