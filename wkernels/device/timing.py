"""Pass times of one frame: every moment belongs to exactly one pass, the innermost that is open."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

OUTSIDE = "other"


class PassTimer:
    """Splits the time between ``start`` and ``stop`` among named passes; with events on CUDA, so nothing waits there.

    Args:
        device: Warp device whose work is timed.
    """

    def __init__(self, device: str) -> None:
        self._cuda = not wp.get_device(device).is_cpu
        self._device = device
        self._marks: list[tuple[float | wp.Event, str]] = []
        self._open: list[str] = []

    def start(self) -> None:
        """Begins a frame."""
        self._marks, self._open = [], []
        self._mark(OUTSIDE)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Charges what happens inside to ``name``, except for passes that are opened within."""
        self._open.append(name)
        self._mark(name)
        try:
            yield
        finally:
            self._open.pop()
            self._mark(self._open[-1] if self._open else OUTSIDE)

    def stop(self) -> dict[str, float]:
        """Ends the frame; milliseconds per pass, in the order in which passes were first opened."""
        self._mark(OUTSIDE)
        if self._cuda:
            wp.synchronize_device(self._device)
        spent: dict[str, float] = {}
        for (begin, name), (end, _) in zip(self._marks[:-1], self._marks[1:], strict=True):
            if self._cuda:
                span = wp.get_event_elapsed_time(begin, end, synchronize=False)
            else:
                span = (end - begin) * 1e3
            spent[name] = spent.get(name, 0.0) + span
        return spent

    def _mark(self, name: str) -> None:
        if not self._cuda:
            self._marks.append((time.perf_counter(), name))
            return
        event = wp.Event(self._device, enable_timing=True)
        wp.get_stream(self._device).record_event(event)
        self._marks.append((event, name))
