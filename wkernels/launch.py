"""Launches: one kernel spread in tiles over CPU threads, or one plain launch on CUDA.

Warp runs a CPU launch on the calling thread and releases the GIL while it does, so threads that each launch a part of
the grid scale almost linearly. Every kernel of this project takes ``first: int`` as its first argument, the offset of
its tile along the first launch axis, and must write only what its own grid cells own: then the result cannot depend on
the number of threads.
"""

from __future__ import annotations

import functools
import itertools
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from queue import SimpleQueue

import warp as wp

TILES_PER_THREAD = 6  # enough for uneven tiles to even out, few enough that the cost of launching stays small
WORTH_SHARING_S = 0.5e-3
"""A shorter launch runs on the calling thread, as waking another takes 0.1 to 0.3 ms. 0 shares every launch."""
_expected_s: dict[tuple[wp.Kernel, tuple[int, ...]], float | None] = {}
"""How long a launch of this size took on one thread; decides who runs it, never what it computes."""


def default_threads() -> int:
    """Threads used when none are asked for: ``WKERNELS_THREADS`` or the CPUs this process may run on."""
    wanted = os.environ.get("WKERNELS_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Team:
    """Worker threads that live as long as the process; the calling thread works too."""

    def __init__(self) -> None:
        self._inboxes: list[SimpleQueue] = []
        self._done: SimpleQueue = SimpleQueue()
        self._busy = threading.Lock()

    def _grow(self, workers: int) -> None:
        while len(self._inboxes) < workers:
            inbox: SimpleQueue = SimpleQueue()
            self._inboxes.append(inbox)
            threading.Thread(
                target=self._work, args=(inbox,), daemon=True, name=f"wkernels-{len(self._inboxes)}"
            ).start()

    def _work(self, inbox: SimpleQueue) -> None:
        while True:
            job = inbox.get()
            try:
                job()
                self._done.put(None)
            except BaseException as error:  # handed to the caller, who raises it
                self._done.put(error)

    def run(self, jobs: Sequence[Callable[[], None]]) -> None:
        """Runs all jobs at once, the first one here, and raises the first error any of them met."""
        with self._busy:
            self._grow(len(jobs) - 1)
            for inbox, job in zip(self._inboxes, jobs[1:], strict=False):
                inbox.put(job)
            errors: list[BaseException | None] = []
            try:
                jobs[0]()
            except BaseException as error:
                errors.append(error)
            errors += [self._done.get() for _ in jobs[1:]]
        for met in errors:
            if met is not None:
                raise met


# A worker that wakes up waits for the GIL this long; the default of 5 ms is more than a whole pass
sys.setswitchinterval(1e-4)
_team = _Team()


def launch(
    kernel: wp.Kernel,
    dim: int | Sequence[int],
    inputs: Sequence,
    outputs: Sequence = (),
    *,
    device: str = "cpu",
    threads: int | None = None,
    tile: int | None = None,
) -> None:
    """Runs ``kernel`` over ``dim``; on the CPU in tiles along the first axis, spread over threads.

    Args:
        kernel: Its first argument is ``first: int``, to be added to the first index of ``wp.tid()``.
        dim: Grid size, 1 to 3 axes. A grid with no cells is no launch.
        inputs: Arguments after ``first``.
        outputs: Further arguments, written by the kernel.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads, at least 1; ``default_threads()`` if not given. The result does not depend on it.
        tile: Cells of the first axis per tile; chosen from the grid and the threads if not given.
    """
    shape = (dim,) if isinstance(dim, int) else tuple(dim)
    cells = 1
    for extent in shape:
        cells *= extent
    if cells == 0:
        return
    arguments = [0, *inputs, *outputs]
    if not wp.get_device(device).is_cpu:
        wp.launch(kernel, dim=shape, inputs=arguments, device=device)
        return
    threads = default_threads() if threads is None else threads
    rows = shape[0]
    key = (kernel, shape)
    expected = _expected_s.get(key)
    begin = time.perf_counter()
    too_short = WORTH_SHARING_S > 0.0 and (expected is None or expected < WORTH_SHARING_S)
    if threads <= 1 or rows == 1 or too_short:
        wp.launch(kernel, dim=shape, inputs=arguments, device="cpu")
        # the first launch may compile, so that it is the second one that tells
        _expected_s[key] = time.perf_counter() - begin if key in _expected_s else None
        return
    tile = tile or max(1, -(-rows // (threads * TILES_PER_THREAD)))
    workers = min(threads, -(-rows // tile))
    # recorded here, one for each worker: recording refreshes the arguments' C structs in place, which must not race
    commands = [
        wp.launch(kernel, dim=(tile, *shape[1:]), inputs=arguments, device="cpu", record_cmd=True)
        for _ in range(workers)
    ]
    ticket = itertools.count()

    def job(command: wp.Launch) -> None:
        size = tile
        while (first := next(ticket) * tile) < rows:
            if min(tile, rows - first) != size:
                size = min(tile, rows - first)
                command.set_dim((size, *shape[1:]))
            command.set_param_at_index(0, first)
            command.launch()

    _team.run([functools.partial(job, command) for command in commands])
    spent = (time.perf_counter() - begin) * workers
    _expected_s[key] = spent if expected is None else min(expected, spent)
