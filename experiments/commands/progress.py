"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from experiments.kinds.kind import Progress

_LINES = 20  # about as many lines as this for the whole work, however long it is


@contextmanager
def progress_display() -> Iterator[Progress]:
    """Yields a function of (done, total, what) that shows them on stderr."""
    if not sys.stderr.isatty():
        yield _plain_lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Bar(*columns, console=Console(stderr=True)) as bar:

        def show(done: int, total: int, what: str) -> None:
            task = bar.task_ids[0] if bar.task_ids else bar.add_task("", total=None)  # none for work without progress
            bar.update(task, completed=done, total=total, description=what)

        yield show


def _plain_lines() -> Progress:
    last = -1

    def show(done: int, total: int, what: str) -> None:
        nonlocal last
        step = done * _LINES // max(total, 1)
        if done == 0 or step != last:
            print(f"{done}/{total} {what}", file=sys.stderr, flush=True)
        last = step

    return show
