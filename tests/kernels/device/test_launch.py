from __future__ import annotations

import threading

import numpy as np
import pytest
import warp as wp

from wkernels.device import launch as launching
from wkernels.device.launch import default_threads, launch


@wp.kernel
def visit_1d(first: int, visits_out: wp.array(dtype=int)):
    i = first + wp.tid()
    visits_out[i] = visits_out[i] + i + 1


@wp.kernel
def visit_2d(first: int, visits_out: wp.array2d(dtype=int)):
    row, x = wp.tid()
    y = first + row
    visits_out[y, x] = visits_out[y, x] + y * 1000 + x + 1


@wp.kernel
def visit_3d(first: int, visits_out: wp.array3d(dtype=int)):
    layer, y, x = wp.tid()
    z = first + layer
    visits_out[z, y, x] = visits_out[z, y, x] + z * 10000 + y * 100 + x + 1


KERNELS = {1: (visit_1d, (1,)), 2: (visit_2d, (1000, 1)), 3: (visit_3d, (10000, 100, 1))}


@pytest.mark.parametrize("tile", [None, 1, 5])
@pytest.mark.parametrize("threads", [1, 2, 3, 7])
@pytest.mark.parametrize("shape", [(1,), (7,), (5000,), (1, 3000), (97, 31), (3, 1), (5, 33, 27)])
def test_every_cell_is_visited_once(shape: tuple[int, ...], threads: int, tile: int | None, device: str) -> None:
    visits = wp.zeros(shape, dtype=int, device=device)
    kernel, strides = KERNELS[len(shape)]
    launch(kernel, shape if len(shape) > 1 else shape[0], [], [visits], device=device, threads=threads, tile=tile)
    expected = sum(i * stride for i, stride in zip(np.indices(shape), strides, strict=True)) + 1
    np.testing.assert_array_equal(visits.numpy(), expected)


@pytest.mark.parametrize("shape", [0, (0, 5), (5, 0), (0, 0, 0)])
def test_a_grid_without_cells_is_no_launch(shape: int | tuple[int, ...], device: str) -> None:
    launch(visit_1d, shape, [], ["not an array: launching would fail"], device=device)


def test_launches_from_several_threads_do_not_mix(device: str) -> None:
    arrays = [wp.zeros((200, 60), dtype=int, device=device) for _ in range(4)]
    workers = [
        threading.Thread(target=launch, args=(visit_2d, (200, 60), [], [a]), kwargs={"device": device, "threads": 3})
        for a in arrays
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    rows, columns = np.indices((200, 60))
    for array in arrays:
        np.testing.assert_array_equal(array.numpy(), rows * 1000 + columns + 1)


def test_threads_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WKERNELS_THREADS", raising=False)
    plain = default_threads()
    assert plain >= 1
    monkeypatch.setenv("WKERNELS_THREADS", str(plain + 1))
    assert default_threads() == plain + 1
    for nonsense in ("0", "-2", "many", ""):
        monkeypatch.setenv("WKERNELS_THREADS", nonsense)
        assert default_threads() == plain


def test_only_launches_worth_it_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first launch of its size is shared, as nothing is known of it; a later one if the last took long enough."""
    shared: list[int] = []
    run = launching._team.run
    monkeypatch.setattr(launching._team, "run", lambda *job: [shared.append(job[2]), run(*job)])
    visits = wp.zeros((640, 80), dtype=int, device="cpu")
    for limit, expected in ((1e9, [2]), (1e-9, [2, 2, 2])):
        monkeypatch.setattr(launching, "WORTH_SHARING_S", limit)
        monkeypatch.setattr(launching, "_cell_s", {})
        shared.clear()
        for _ in range(3):
            launch(visit_2d, (640, 80), [], [visits], device="cpu", threads=2)
        assert shared == expected
    assert (visits.numpy() == 6 * (np.arange(640)[:, None] * 1000 + np.arange(80) + 1)).all()
