from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest
import warp as wp

from wkernels.device.launch import launch
from wkernels.device.workers import MAX_WORKERS, SPIN_S, Team

ROWS = 61


@wp.kernel
def add_row_number(first: int, work: int, sum_out: wp.array2d(dtype=float)):
    row, x = wp.tid()
    slow = float(0.0)
    for _i in range(work):
        slow = 0.5 * slow + 1.0
    sum_out[first + row, x] = sum_out[first + row, x] + float(first + row) + wp.min(slow, 0.0)


def record(sums: wp.array, tile: int, work: int = 1) -> wp.Launch:
    return wp.launch(add_row_number, dim=(tile, sums.shape[1]), inputs=[0, work, sums], device="cpu", record_cmd=True)


@pytest.mark.parametrize("threads", [1, 2, 5, MAX_WORKERS + 40])
@pytest.mark.parametrize("tile", [1, 7, ROWS])
def test_a_team_runs_every_row_once(threads: int, tile: int) -> None:
    team, sums = Team(), wp.zeros((ROWS, 3), dtype=float, device="cpu")
    for _ in range(50):
        team.run(record(sums, tile), ROWS, threads)
    np.testing.assert_array_equal(sums.numpy(), np.tile(50.0 * np.arange(ROWS)[:, None], 3))


def test_launches_after_pauses_of_any_length() -> None:
    """Workers look for work, fall asleep and wake up again, and no launch is lost or run twice meanwhile."""
    team, sums, rng = Team(), wp.zeros((ROWS, 1), dtype=float, device="cpu"), np.random.default_rng(5)
    pauses = np.concatenate([np.zeros(100), rng.uniform(0.0, 3.0 * SPIN_S, 300), [20.0 * SPIN_S] * 5])
    for k, pause in enumerate(rng.permutation(pauses)):
        until = time.perf_counter() + pause
        if k % 2:
            time.sleep(pause)
        while time.perf_counter() < until:  # with the GIL held, which a worker may be waiting for
            pass
        team.run(record(sums, 4, work=int(rng.integers(1, 3000))), ROWS, int(rng.integers(1, 5)))
    np.testing.assert_array_equal(sums.numpy()[:, 0], len(pauses) * np.arange(ROWS))


def test_launches_of_other_sizes_follow_each_other() -> None:
    team = Team()
    for rows in (1, 300, 2, 57, 1000, 3):
        sums = wp.zeros((rows, 2), dtype=float, device="cpu")
        team.run(record(sums, max(1, rows // 7)), rows, 3)
        np.testing.assert_array_equal(sums.numpy(), np.tile(np.arange(rows, dtype=np.float32)[:, None], 2))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_forked_child_has_workers_of_its_own() -> None:
    sums = wp.zeros((ROWS, 40), dtype=float, device="cpu")
    launch(add_row_number, sums.shape, [1], [sums], device="cpu", threads=3)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            launch(add_row_number, sums.shape, [1], [sums], device="cpu", threads=3)
            status = 0 if np.array_equal(sums.numpy()[:, 0], 2.0 * np.arange(ROWS)) else 2
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_worker_that_died_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    team, sums, deaths = Team(), wp.zeros((ROWS, 3), dtype=float, device="cpu"), []
    monkeypatch.setattr(threading, "excepthook", deaths.append)
    team.run(record(sums, 7), ROWS, 3)
    # what the thread runs is not there any more: it ends with an exception when it looks for work again
    del team._workers[0]._serve
    for _ in range(50):
        team.run(record(sums, 7), ROWS, 3)
        time.sleep(1e-3)
    assert len(deaths) == 1
    np.testing.assert_array_equal(sums.numpy(), np.tile(51.0 * np.arange(ROWS)[:, None], 3))
