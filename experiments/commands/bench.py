"""``wkernels bench``: our passes beside other renderers', as a table for people or JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from experiments.bench.cases import CASES, run_case, select, summary
from experiments.bench.llvmpipe import Llvmpipe
from experiments.bench.machine import describe_bench
from experiments.bench.plan import Bench, Sizes
from experiments.bench.rows import PeerMissing, Row
from experiments.commands.progress import progress_display
from wkernels.device.launch import default_threads
from wkernels.errors import InputError


def run_bench(
    *,
    cases: Sequence[str],
    as_json: bool,
    threads: int | None,
    repeats: int,
    out: Path | None = None,
    sizes: Sizes | None = None,
) -> None:
    """Times the cases and prints the result.

    Args:
        cases: Beginnings of names of cases; all of them if empty.
        as_json: Whether to print JSON (docs/formats.md), else a table.
        threads: CPU threads of both sides, at least 1; None for all.
        repeats: Timed runs of each side, at least 1.
        out: Where the plots of the scaling cases go; none are drawn if not given.
        sizes: How large the cases are; the documented sizes if not given.

    Raises:
        InputError: There is no such case, or ``out`` cannot be written to.
    """
    names = select(cases)
    if out is not None:
        _make_folder(out)
    threads = default_threads() if threads is None else threads
    peer = _open_peer(threads)
    try:
        environment = describe_bench(threads, repeats, peer)
        rows = _time_cases(Bench(sizes or Sizes(), threads, repeats, peer), names)
    finally:
        if isinstance(peer, Llvmpipe):
            peer.close()
    plots = _draw_plots(rows, out)
    if as_json:
        print(json.dumps({"environment": environment, "results": [row.to_json() for row in rows]}, indent=2))
        return
    flags = " ".join(environment["cpu_flags"] or [])
    print(f"{environment['cpu']} ({flags}), Warp {environment['packages']['warp-lang']}")
    print("; ".join(f"{name}: {text}" for name, text in environment["peers"].items()))
    load = environment["load_average"]
    busy = "" if load is None else f"; load average before the run {load}"
    print(f"{threads} thread(s), medians of {repeats}{busy}")
    print_table(rows)
    for path in plots:
        print(path)


def list_cases() -> None:
    """Prints the cases and what they time."""
    width = max(map(len, CASES))
    for name in CASES:
        print(f"{name:<{width}}  {summary(name)}")


def print_table(rows: Sequence[Row]) -> None:
    """Prints the rows as aligned columns; what was not measured is a dash."""
    table = [["case", "ours ms", "peer ms", "ratio", "mismatch", "target", "", "peer", "note"]]
    for row in rows:
        numbers = ((row.ours_ms, ".2f"), (row.peer_ms, ".2f"), (row.ratio, ".2f"), (row.mismatch, ".1e"))
        cells = ["-" if value is None else format(value, form) for value, form in numbers]
        reached = {True: "reached", False: "MISSED", None: "" if row.target is None else "unknown"}[row.reached]
        target = "-" if row.target is None else str(row.target)
        table.append([row.name, *cells, target, reached, row.peer or "-", row.note])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for name, *cells, target, reached, peer, note in table:
        aligned = "  ".join(cell.rjust(width) for cell, width in zip(cells, widths[1:5], strict=True))
        asked = f"{target:<{widths[5]}}  {reached:<{widths[6]}}"
        print(f"{name:<{widths[0]}}  {aligned}  {asked}  {peer:<{widths[7]}}  {note}".rstrip())


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror or error}.") from None


def _draw_plots(rows: Sequence[Row], out: Path | None) -> list[Path]:
    if out is None:
        return []
    from experiments.bench.plots import write_plots

    return write_plots(rows, out)


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
            rows += run_case(bench, name)
        progress(len(names), len(names), "done")
    return rows
