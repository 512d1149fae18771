"""What a worker process does: it tries inputs one after the other, and keeps those that are faults."""

from __future__ import annotations

import os
import shutil
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

import isolation
from isolation import Fault, Rooms, Watch


class Target(Protocol):
    """A kind of input.

    Attributes:
        name: Of the target, and the beginning of the names of its kept inputs.
    """

    name: str

    def write(self, seed: int, index: int, folder: Path) -> None:
        """Makes an input: files in an empty folder, the same ones whenever seed and index are."""

    def check(self, folder: Path, out: Path) -> str:
        """Reads an input as a user's command would.

        Returns:
            What became of it, in a word: ``read``, ``rendered``, ``refused``, ...

        Raises:
            Fault: A result is wrong. Any other exception is a fault as well.
        """


@dataclass(frozen=True)
class Job:
    """Inputs ``begin`` to ``end`` of a seed."""

    target: str
    seed: int
    begin: int
    end: int


@dataclass(frozen=True)
class Finding:
    """A fault.

    Attributes:
        target, seed, index: What repeats it.
        kind: ``crash``, ``hang``, ``memory``, ``wrong``, ``stray`` or the name of an exception.
        where: What tells it from others: the place in our code, or the fault's words without their numbers.
        text: Traceback, or the end of the worker's output.
        folder: Where the input is kept.
    """

    target: str
    seed: int
    index: int
    kind: str
    where: str
    text: str
    folder: Path


@dataclass
class Limits:
    """Of one input; ``idle`` for those that wait instead of computing."""

    seconds: float = isolation.MOST_SECONDS
    idle: float = isolation.MOST_IDLE_SECONDS
    memory: int = isolation.MOST_BYTES


def work(
    make_targets: Callable[[], Mapping[str, Target]],
    rooms: Rooms,
    faults: Path,
    pipe: Connection,
    at: Any,
    limits: Limits,
    environment: Mapping[str, str],
) -> None:
    """Tries the inputs of jobs from a pipe until None comes; answers with outcomes and findings."""
    rooms.make()
    os.environ |= environment
    log = os.open(rooms.root / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(log, stream)
    isolation.enter(rooms)
    warnings.simplefilter("ignore")
    targets = make_targets()
    watch = Watch(rooms)
    while (job := pipe.recv()) is not None:
        target = targets[job.target]
        os.truncate(rooms.root / "log", 0)
        for index in range(job.begin, job.end):
            _empty(rooms.input)
            _empty(rooms.out)
            try:
                target.write(job.seed, index, rooms.input)
            except BaseException:  # ours, not what is tried
                pipe.send(traceback.format_exc())
                return
            isolation.limit_memory(limits.memory)  # more than now: kernels and caches of earlier inputs stay
            at[0] = index  # begun, and the clock runs
            outcome, finding = _tried(target, job.seed, index, rooms, faults, watch)
            at[0] = -1
            pipe.send((job, index, outcome, finding))


def _tried(target: Target, seed: int, index: int, rooms: Rooms, faults: Path, watch: Watch) -> tuple[str, Any]:
    """The outcome of one input, and the finding if it is a fault."""
    before = {path.name for path in rooms.input.iterdir()}
    kind, where, text, outcome = "", "", "", ""
    try:
        with watch:
            outcome = target.check(rooms.input, rooms.out)
    except MemoryError as error:
        kind, where, text = "memory", place_of(error), traceback.format_exc()
    except Fault as error:
        kind, where, text = "wrong", without_numbers(str(error)), str(error)
    except BaseException as error:
        kind, where, text = type(error).__name__, place_of(error), traceback.format_exc()
    strays = [*watch.found, *rooms.strays(), *sorted({path.name for path in rooms.input.iterdir()} - before)]
    if strays and not kind:
        kind, where, text = "stray", without_numbers(strays[0]), "\n".join(strays)
    for name in ("home", "tmp", "cwd") if strays else ():
        _empty(rooms.root / name)
    if not kind:
        return outcome, None
    return "fault", keep(faults, target.name, seed, index, kind, where, text, rooms.input)


def place_of(error: BaseException) -> str:
    """The last line of the traceback that lies in our packages, and the exception's words without numbers."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "/fuzz/" not in f.filename and "site-packages" not in f.filename] or frames
    last = own[-1] if own else None
    where = f"{Path(last.filename).name}:{last.name}" if last else "?"
    return f"{where}: {without_numbers(str(error))}"


def without_numbers(text: str) -> str:
    """The first words of a text, digits and quoted parts taken out: equal for equal faults."""
    line = (text.splitlines() or [""])[0][:300]
    out, quoted = [], False
    for letter in line:
        quoted ^= letter == "'"
        if not letter.isdigit() and not (quoted and letter != "'"):
            out.append(letter)
    return "".join(out)[:100]


def keep(faults: Path, target: str, seed: int, index: int, kind: str, where: str, text: str, source: Path) -> Finding:
    """Copies an input beside a note of what happened; of many that are alike the first ones."""
    folder = faults / f"{target}-{seed}-{index}-{kind}"
    shutil.copytree(source, folder / "input", dirs_exist_ok=True, symlinks=True)
    (folder / "what.txt").write_text(
        f"{target}, seed {seed}, index {index}: {kind}\n{where}\n\n{text}\n", errors="replace"
    )
    return Finding(target, seed, index, kind, where, text, folder)


def _empty(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
