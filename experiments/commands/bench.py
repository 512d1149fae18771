"""``wkernels bench``: our passes beside other renderers', as a table for people or JSON for programs."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence

from experiments.bench.cases import CASES, Bench, Sizes
from experiments.bench.llvmpipe import NAME, Llvmpipe, PeerMissing
from experiments.bench.rows import Row
from experiments.commands.progress import progress_display
from experiments.environment import describe_machine
from wkernels.errors import InputError, nearest
from wkernels.launch import default_threads


def run_bench(
    *, only: Sequence[str], as_json: bool, threads: int | None, repeats: int, sizes: Sizes | None = None
) -> None:
    """Times the cases and prints the result.

    Args:
        only: Names of cases; all of them if empty.
        as_json: Whether to print JSON (DESIGN.md section 5), else a table.
        threads: CPU threads of both sides, at least 1; None for all.
        repeats: Timed runs of each side, at least 1.
        sizes: How large the cases are; the documented sizes if not given.

    Raises:
        InputError: There is no such case.
    """
    for name in only:
        if name not in CASES:
            raise InputError(f"there is no case '{name}'." + nearest(name, CASES), key="--only")
    threads = default_threads() if threads is None else threads
    load = round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None  # others' work distorts every number
    peer = _open_peer(threads)
    try:
        bench = Bench(sizes or Sizes(), threads, repeats, peer)
        rows = _time_cases(bench, [name for name in CASES if not only or name in only])
    finally:
        if isinstance(peer, Llvmpipe):
            peer.close()
    peer_text = peer.description if isinstance(peer, Llvmpipe) else f"missing: {peer}"
    if as_json:
        environment = {
            **describe_machine("cpu", threads),
            "load_average": load,
            "peers": {NAME: peer_text},
            "repeats": repeats,
        }
        print(json.dumps({"environment": environment, "results": [row.to_json() for row in rows]}, indent=2))
        return
    busy = "" if load is None else f"; load average before the run {load}"
    print(f"{threads} thread(s), medians of {repeats}; {NAME}: {peer_text}{busy}")
    print_table(rows)


def print_table(rows: Sequence[Row]) -> None:
    """Prints the rows as aligned columns; what was not measured is a dash."""
    table = [["case", "ours ms", "peer ms", "ratio", "mismatch", "peer", "note"]]
    for row in rows:
        numbers = ((row.ours_ms, ".2f"), (row.peer_ms, ".2f"), (row.ratio, ".2f"), (row.mismatch, ".1e"))
        cells = ["-" if value is None else format(value, form) for value, form in numbers]
        table.append([row.name, *cells, row.peer or "-", row.note])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for name, *cells, peer, note in table:
        aligned = "  ".join(cell.rjust(width) for cell, width in zip(cells, widths[1:5], strict=True))
        print(f"{name:<{widths[0]}}  {aligned}  {peer:<{widths[5]}}  {note}".rstrip())


def _open_peer(threads: int) -> Llvmpipe | str:
    try:
        return Llvmpipe(threads)
    except PeerMissing as missing:
        return str(missing)


def _time_cases(bench: Bench, names: Sequence[str]) -> list[Row]:
    rows: list[Row] = []
    with progress_display() as progress:
        for done, name in enumerate(names):
            progress(done, len(names), name)
            rows += CASES[name](bench, name)
        progress(len(names), len(names), "done")
    return rows
