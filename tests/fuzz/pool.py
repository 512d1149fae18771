"""Worker processes that try inputs one after the other; what kills, stops or swells one is named and kept.

A worker says in shared memory which input it is at, so that the parent knows what it was when the worker is gone, and
starts another one behind it. Every input is a folder of files, made from a target's name, a seed and an index alone.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from types import MappingProxyType
from typing import Any

from isolation import Rooms, processor_seconds
from trying import Finding, Job, Limits, Target, keep, work

BATCH = 50
"""Inputs of one seed."""
TOLD_EVERY = 2
"""Seconds between two words of progress."""


@dataclass
class Tally:
    """What a run came to: outcomes counted by target, and faults."""

    outcomes: dict[str, Counter[str]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def count(self) -> int:
        """How many inputs were tried."""
        return sum(sum(counts.values()) for counts in self.outcomes.values())

    def add(self, target: str, outcome: str, times: int = 1) -> None:
        """Counts an outcome."""
        self.outcomes.setdefault(target, Counter())[outcome] += times

    def kinds(self) -> dict[tuple[str, str, str], list[Finding]]:
        """Faults that are the same one: of a target, a kind, and a place."""
        out: dict[tuple[str, str, str], list[Finding]] = {}
        for finding in self.findings:
            out.setdefault((finding.target, finding.kind, finding.where), []).append(finding)
        return out


class _Worker:
    """One process, the job that it has, and the input that it is at."""

    def __init__(
        self, make: Callable, rooms: Rooms, faults: Path, limits: Limits, environment: Mapping[str, str], context: Any
    ) -> None:
        self.rooms, self._limits = rooms, limits
        self.pipe, theirs = context.Pipe()
        self._at = context.Array("l", [-2], lock=False)
        arguments = (make, rooms, faults, theirs, self._at, limits, environment)
        self.process = context.Process(target=work, args=arguments, daemon=True)
        self.process.start()
        theirs.close()
        self.job: Job | None = None
        self.done = 0  # index behind the last answer
        self._seen, self._begun, self._used = -1, 0.0, 0.0  # input, and processor time then and at the last look
        self._idle, self._looked = 0.0, 0.0

    def give(self, job: Job | None) -> None:
        """Hands out a job, or ends the worker."""
        self.job = job
        self.done = job.begin if job else 0
        with contextlib.suppress(OSError):
            self.pipe.send(job)

    def never_began(self) -> bool:
        """Whether it had not come to any input."""
        return self._at[0] == -2

    def overdue(self) -> bool:
        """Whether its input takes longer than one may."""
        index, now = self._at[0], time.monotonic()
        used, sleeps = processor_seconds(self.process.pid or 0)
        if index < 0 or index != self._seen:
            self._seen, self._begun, self._idle, self._used = index, used, 0.0, used
        elif sleeps and used == self._used:
            self._idle += now - self._looked
        self._used, self._looked = used, now
        return index >= 0 and (used - self._begun > self._limits.seconds or self._idle > self._limits.idle)

    def ended(self, how: str) -> tuple[str, str, str]:
        """Kind, place and text of what ended it."""
        tail = ""
        with contextlib.suppress(OSError):
            tail = (self.rooms.root / "log").read_bytes()[-4000:].decode(errors="replace")
        if how == "hang":
            return "hang", f"more than {self._limits.seconds:g} s", tail
        code = self.process.exitcode
        name = signal.Signals(-code).name if code is not None and code < 0 else f"exit status {code}"
        return "crash", name, tail

    def kill(self) -> None:
        """Ends the process at once."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def jobs(shares: Mapping[str, float], count: int, seed: int) -> Iterator[Job]:
    """Batches of all targets, mixed in proportion to their shares, ``count`` inputs in all."""
    total, given = sum(shares.values()), dict.fromkeys(shares, 0)
    for done in range(0, count, BATCH):
        size = min(BATCH, count - done)
        target = max(shares, key=lambda name: (shares[name] / total) * (done + size) - given[name])
        yield Job(target, seed + given[target] // BATCH, 0, size)
        given[target] += size


def run(
    make_targets: Callable[[], Mapping[str, Target]],
    todo: Sequence[Job] | Iterator[Job],
    out: Path,
    *,
    workers: int = 1,
    limits: Limits | None = None,
    caches: Mapping[str, Path] = MappingProxyType({}),
    tell: Callable[[Tally], None] = lambda tally: None,
) -> Tally:
    """Tries all jobs in worker processes.

    Args:
        make_targets: Makes the targets by name, in every worker; importable.
        todo: The jobs.
        out: Folder for the workers' rooms and for ``faults``.
        workers: How many processes.
        limits: Of one input.
        caches: Folders that inputs may write besides their output folder, by the variables that name them.
        tell: Is told now and then how far it is.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([make_targets.__module__])
    limits, tally, begun = limits or Limits(), Tally(), time.monotonic()
    faults = out / "faults"
    faults.mkdir(parents=True, exist_ok=True)
    environment = {**{name: str(path) for name, path in caches.items()}, "WKERNELS_THREADS": "1"}
    waiting: deque[Job] = deque()
    slow: set[Job] = set()  # inputs that had their time once; the second time they are hangs
    source = iter(todo)

    def following() -> Job | None:
        return waiting.popleft() if waiting else next(source, None)

    def started(number: int) -> _Worker:
        rooms = Rooms(out / f"worker-{number}", tuple(caches.values()))
        return _Worker(make_targets, rooms, faults, limits, environment, context)

    crew = {number: started(number) for number in range(workers)}
    for worker in crew.values():
        worker.give(following())
    told = 0.0
    try:
        while any(worker.job for worker in crew.values()):
            wait([worker.pipe for worker in crew.values() if worker.job], timeout=0.2)
            for number, worker in crew.items():
                if worker.job is None:
                    continue
                how = "" if _heard(worker, tally) else "crash"
                if not how and worker.job is not None and worker.overdue():
                    how = "hang"
                if how:
                    if how == "hang" and (again := _once_more(worker, slow)):
                        waiting.append(again)
                        worker.kill()
                    else:
                        _record_end(worker, how, tally, faults, waiting)
                    worker = crew[number] = started(number)
                if worker.job is None:
                    worker.give(following())
            tally.seconds = time.monotonic() - begun
            if tally.seconds - told >= TOLD_EVERY:
                told = tally.seconds
                tell(tally)
    finally:
        for worker in crew.values():
            worker.kill()
    return tally


def _heard(worker: _Worker, tally: Tally) -> bool:
    """Takes in what a worker says; False where it has ended."""
    try:
        while worker.job is not None and worker.pipe.poll():
            answer = worker.pipe.recv()
            if isinstance(answer, str):
                raise RuntimeError(f"an input could not be made:\n{answer}")
            job, index, outcome, finding = answer
            tally.add(job.target, outcome)
            if finding is not None:
                tally.findings.append(finding)
            worker.done = index + 1
            if worker.done == job.end:
                worker.job = None
    except (EOFError, OSError):
        return False
    return worker.job is None or worker.process.is_alive() or worker.pipe.poll()


def _once_more(worker: _Worker, slow: set[Job]) -> Job | None:
    """The rest of a worker's job, with the input that took too long; None where that has been tried again already.

    The first time it may have been a kernel that had to be compiled, or a machine with other things to do.
    """
    job = worker.job
    assert job is not None
    only = Job(job.target, job.seed, worker.done, worker.done + 1)
    if only in slow:
        return None
    slow.add(only)
    return Job(job.target, job.seed, worker.done, job.end)


def _record_end(worker: _Worker, how: str, tally: Tally, faults: Path, waiting: deque[Job]) -> None:
    """Keeps the input that ended a worker; the rest of its job waits for whoever is free."""
    job = worker.job
    assert job is not None
    worker.kill()
    if worker.never_began():
        raise RuntimeError(f"a worker ended before its first input:\n{worker.ended(how)[2]}")
    kind, where, text = worker.ended(how)
    tally.findings.append(keep(faults, job.target, job.seed, worker.done, kind, where, text, worker.rooms.input))
    tally.add(job.target, "fault")
    if worker.done + 1 < job.end:
        waiting.append(Job(job.target, job.seed, worker.done + 1, job.end))
