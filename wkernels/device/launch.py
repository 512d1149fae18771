"""Launches: one kernel spread in tiles over CPU threads, or one plain launch on CUDA.

Warp runs a CPU launch on the calling thread; ``workers`` has other threads take tiles of it. Every kernel of this
project takes ``first: int`` as its first argument, the offset of its tile along the first launch axis, and must write
only what its own grid cells own: then the result cannot depend on the number of threads.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from typing import SupportsIndex

import warp as wp

from wkernels.device.twin import Twin
from wkernels.device.workers import Team, available_cpus

TILES_PER_THREAD = 6  # enough for uneven tiles to even out, few enough that the cost of launching stays small
SHORTEST_TILE_S = 20e-6
WORTH_SHARING_S = 60e-6
"""A shorter launch runs on the calling thread, as handing a part of it over costs 10 to 20 us. 0 cuts all
into tiles, even for one thread."""
_cell_s: dict[tuple[wp.Kernel, int], float] = {}
"""How long a cell takes on one thread, by kernel and binary order of magnitude of the grid; decides who runs a launch,
never what is computed."""


def default_threads() -> int:
    """Threads used when none are asked for: ``WKERNELS_THREADS`` or the CPUs this process may run on."""
    wanted = os.environ.get("WKERNELS_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return available_cpus()


_team = Team()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_team.forget)


def wake_workers(device: str, threads: int | None) -> None:
    """Prepares for launches that follow at once: the first of them would find sleeping workers. Changes no result."""
    if wp.get_device(device).is_cpu:
        _team.wake(default_threads() if threads is None else threads)


def launch(
    kernel: wp.Kernel | Twin,
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
        kernel: Its first argument is ``first: int``, to be added to the first index of ``wp.tid()``. Of a twin the
            kernel that suits the device; grid and arguments are those of the plain one.
        dim: Grid size, 1 to 3 axes. A grid with no cells is no launch.
        inputs: Arguments after ``first``.
        outputs: Further arguments, written by the kernel.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads, at least 1; ``default_threads()`` if not given. The result does not depend on it.
        tile: Cells of the first axis per tile; chosen from the grid and the threads if not given.
    """
    shape = (int(dim),) if isinstance(dim, SupportsIndex) else tuple(dim)  # NumPy's numbers are no int
    if isinstance(kernel, Twin):
        _launch_twin(kernel, shape, inputs, outputs, device, threads, tile)
        return
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
    key = (kernel, cells.bit_length())
    # recording compiles if it must, which has no part in the time taken
    command = wp.launch(kernel, dim=shape, inputs=arguments, device="cpu", record_cmd=True)
    expected_s = _cell_s[key] * cells if key in _cell_s else math.inf
    begin = time.perf_counter()
    if rows == 1 or (WORTH_SHARING_S > 0.0 and (threads <= 1 or expected_s < WORTH_SHARING_S)):
        command.launch()
        _cell_s[key] = (time.perf_counter() - begin) / cells
        return
    if tile is None:
        tiles = threads * TILES_PER_THREAD
        if WORTH_SHARING_S > 0.0:
            tiles = max(threads, int(min(tiles, expected_s / SHORTEST_TILE_S)))
        tile = -(-rows // tiles)
    workers = min(threads, -(-rows // tile))
    command.set_dim((min(tile, rows), *shape[1:]))
    _team.run(command, rows, workers)
    spent_s = (time.perf_counter() - begin) * workers / cells
    _cell_s[key] = min(_cell_s.get(key, spent_s), spent_s)


def _launch_twin(
    twin: Twin,
    shape: tuple[int, ...],
    inputs: Sequence,
    outputs: Sequence,
    device: str,
    threads: int | None,
    tile: int | None,
) -> None:
    kernel, grid, inputs_of, outputs_of = twin.chosen(shape, inputs, outputs, device)

    def run() -> None:
        launch(kernel, grid, inputs_of, outputs_of, device=device, threads=threads, tile=tile)

    if kernel is twin.plain or not twin.is_watched:
        run()
        return
    with twin.observed(
        lambda others: launch(twin.plain, shape, inputs, others, device=device, threads=threads), outputs
    ):
        run()
