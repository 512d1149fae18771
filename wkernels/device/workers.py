"""Worker threads that take tiles of a launch without touching Python: a launch that is shared costs 10 us more.

A worker waits in native code, without the GIL, for a word of memory to change; then it takes tickets until no tile is
left. A sleeping thread would take 60 to 300 microseconds to wake up, and one that has to win the GIL first about 40, as
long as a whole pass. When nothing comes for a while it goes to sleep in earnest, so that an idle process uses no CPU.
The calling thread works too, and never waits for a worker that has not started.
"""

from __future__ import annotations

import ctypes
import os
import threading
import time
from typing import Any

import numpy as np
import warp as wp

SPIN_S = 0.5e-3
"""How long a worker looks for work before it sleeps: longer than the host's work between two launches of a frame."""
MAX_WORKERS = 255

# words of the memory that all threads share (int64); those that change while tiles are taken are on lines of their own
_OPEN, _ACTIVE, _TICKET, _JOB = 0, 8, 16, 24
_ENTRY, _TILE, _ROWS, _BOUNDS, _LAST_BOUNDS, _THREADS = (_JOB + k for k in range(6))
_ARGUMENTS = 32  # of each thread, as each sets another offset
_SEEN = _ARGUMENTS + MAX_WORKERS + 1
_WORDS = _SEEN + MAX_WORKERS + 1

_PAUSE = """
#if defined(__x86_64__)
            __builtin_ia32_pause();
#elif defined(__aarch64__)
            __asm__ __volatile__("yield");
#endif
"""
_TAKE_TILES = f"""
    auto take_tiles = [&](long long me) {{
        typedef void (*Entry)(void*, void*);
        Entry entry = (Entry)w[{_ENTRY}];
        const long long tile = w[{_TILE}], rows = w[{_ROWS}];
        void* arguments = (void*)w[{_ARGUMENTS} + me];
        for (;;) {{
            const long long first = tile * __atomic_fetch_add(w + {_TICKET}, 1, __ATOMIC_RELAXED);
            if (first >= rows) break;
            *(wp::int32*)arguments = (wp::int32)first;
            entry((void*)w[first + tile <= rows ? {_BOUNDS} : {_LAST_BOUNDS}], arguments);
        }}
    }};
"""


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
    long long* w = (long long*)words.data;
{_TAKE_TILES}
    __atomic_store_n(w + {_TICKET}, 0, __ATOMIC_RELAXED);
    __atomic_store_n(w + {_OPEN}, (long long)job, __ATOMIC_SEQ_CST);
    take_tiles(0);
    __atomic_store_n(w + {_OPEN}, 0, __ATOMIC_SEQ_CST);
    for (wp::int32 i = 0; i < spins && __atomic_load_n(w + {_ACTIVE}, __ATOMIC_SEQ_CST) != 0; ++i) {{
{_PAUSE}
    }}
#endif
""")
def offer_and_work(words: wp.array(dtype=wp.int64), job: int, spins: int):
    """``offer``, on the CPU."""


@wp.func_native(f"""
#if !defined(__CUDA_ARCH__)
    long long* w = (long long*)words.data;
{_TAKE_TILES}
    for (wp::int32 i = 0; i < spins; ++i) {{
        const long long job = __atomic_load_n(w + {_OPEN}, __ATOMIC_SEQ_CST);
        if (job != 0 && job != w[{_SEEN} + me]) {{
            // enters first and looks again then: either the caller still sees it inside, or it sees the job closed
            __atomic_fetch_add(w + {_ACTIVE}, 1, __ATOMIC_SEQ_CST);
            if (__atomic_load_n(w + {_OPEN}, __ATOMIC_SEQ_CST) == job && me < w[{_THREADS}]) take_tiles(me);
            __atomic_fetch_sub(w + {_ACTIVE}, 1, __ATOMIC_SEQ_CST);
            w[{_SEEN} + me] = job;
            i = 0;
        }} else {{
{_PAUSE}
        }}
    }}
#endif
""")
def serve_until_idle(words: wp.array(dtype=wp.int64), me: int, spins: int):
    """``serve``, on the CPU."""


@wp.kernel
def offer(first: int, words: wp.array(dtype=wp.int64), job: int, spins: int):
    """Opens a job for the workers, takes tiles until none is left, and waits for the workers that are still busy."""
    offer_and_work(words, job, spins)


@wp.kernel
def serve(first: int, words: wp.array(dtype=wp.int64), spins: int):
    """As thread ``first`` of the team, takes tiles of every job that is opened, until none was for so many looks."""
    serve_until_idle(words, first + wp.tid(), spins)


def available_cpus() -> int:
    """CPUs that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Team:
    """Worker threads that live as long as the process. One launch at a time; others wait for it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._workers: list[_Worker] = []
        self._cpus = available_cpus()
        self.job = 0  # the number of the newest launch

    def run(self, command: wp.Launch, rows: int, threads: int) -> None:
        """Runs a recorded launch over ``rows``, a tile at a time, on the calling thread and ``threads - 1`` workers.

        Args:
            command: A CPU launch whose first argument is the tile's offset, and whose first dimension is the tile's.
            rows: Size of the first dimension in all, at least that of the tile.
            threads: At least 1; at most ``MAX_WORKERS`` workers are used.
        """
        threads = min(threads, MAX_WORKERS + 1)
        with self._lock:
            if not self._workers:
                self._start()
            while len(self._workers) < threads - 1:
                self._workers.append(_Worker(self, self._memory, len(self._workers) + 1))
            tile = command.bounds.shape[0]
            bounds, last = command.bounds, _resized(command.bounds, rows % tile or tile)
            arguments = _arguments(command)
            each = [arguments, *(type(arguments).from_buffer_copy(arguments) for _ in range(threads - 1))]
            words = self._words
            words[_ENTRY] = ctypes.cast(command.hooks.forward, ctypes.c_void_p).value
            words[_TILE], words[_ROWS], words[_THREADS] = tile, rows, threads
            words[_BOUNDS], words[_LAST_BOUNDS] = ctypes.addressof(bounds), ctypes.addressof(last)
            words[_ARGUMENTS : _ARGUMENTS + threads] = [ctypes.addressof(a) for a in each]
            self._wake(threads)
            self._offer.set_param_at_index(2, self.job)
            self._offer.launch()
            while words[_ACTIVE]:  # a worker that the system has put aside for longer than the caller spins
                time.sleep(20e-6)

    def wake(self, threads: int) -> None:
        """Has workers that sleep look for work: to be called a little before ``run``, as waking up takes a while."""
        if threads > 1 and self._workers and self._lock.acquire(blocking=False):
            self._wake(threads)
            self._lock.release()

    def _wake(self, threads: int) -> None:
        self.job = self.job % 2**30 + 1
        # spinning threads beyond the CPUs would only keep others from working
        spins = self._spins if threads <= self._cpus else 0
        for worker in self._workers[: threads - 1]:
            worker.wake(spins)

    def forget(self) -> None:
        """In a forked child: the workers are the parent's."""
        self.__init__()  # type: ignore[misc]

    def _start(self) -> None:
        self._memory = wp.zeros(_WORDS, dtype=wp.int64, device="cpu")
        self._words = self._memory.numpy()
        # one word that never changes: how many looks take how long, and both kernels compiled before threads start
        idle = wp.launch(serve, dim=1, inputs=[0, self._memory, 10_000], device="cpu", record_cmd=True)
        idle.launch()
        begin = time.perf_counter()
        idle.launch()
        spent_s = max(time.perf_counter() - begin, 1e-6)
        self._spins = int(np.clip(SPIN_S / spent_s * 10_000, 100, 10_000_000))
        patience = min(4 * self._spins, 2**31 - 1)
        self._offer = wp.launch(offer, dim=1, inputs=[0, self._memory, 0, patience], device="cpu", record_cmd=True)


class _Worker:
    """One thread: in native code while jobs come, asleep when they do not."""

    def __init__(self, team: Team, memory: wp.array, me: int) -> None:
        self._team = team
        self._serve = wp.launch(serve, dim=1, inputs=[me, memory, 0], device="cpu", record_cmd=True)
        self._asleep, self._wake, self._spins = False, threading.Semaphore(0), 1
        threading.Thread(target=self._work, daemon=True, name=f"wkernels-{me}").start()

    def wake(self, spins: int) -> None:
        """Makes sure that it will look for the job just numbered; if it is late the others have done the work."""
        self._spins = max(spins, 1)
        if self._asleep:
            self._wake.release()

    def _work(self) -> None:
        while True:
            job = self._team.job
            self._serve.set_param_at_index(2, self._spins)
            self._serve.launch()
            # In this order, as ``wake`` comes after the job's number: one of both sees what the other did. A worker
            # that waited for the GIL while a job was prepared must not fall asleep over it.
            self._asleep = True
            if self._team.job == job:
                self._wake.acquire()
            self._asleep = False


_structs: dict[tuple[wp.Kernel, tuple[type, ...]], type[ctypes.Structure]] = {}


def _arguments(command: wp.Launch) -> ctypes.Structure:
    """The C struct of a recorded launch's arguments, as ``Launch.launch`` builds it."""
    values = command.params[1:]
    key = (command.kernel, tuple(type(value) for value in values))
    if key not in _structs:
        names = [argument.label for argument in command.kernel.adj.args]
        _structs[key] = type("Arguments", (ctypes.Structure,), {"_fields_": list(zip(names, key[1], strict=True))})
    return _structs[key](*values)


def _resized(bounds: Any, rows: int) -> Any:
    """Launch bounds with another first dimension."""
    out = type(bounds).from_buffer_copy(bounds)
    out.size = bounds.size // bounds.shape[0] * rows
    out.shape[0] = rows
    return out
