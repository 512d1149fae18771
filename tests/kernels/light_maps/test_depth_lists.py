"""Lists of depths with counts, against lists in Python."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wkernels.device.launch import launch
from wkernels.light_maps.depth_lists import NOT_FOUND, DepthLists, add_points, allocate_lists, find_entry


class TwinLists:
    """One list a texel: [depth, count] in the order of depth; what has no room is lost."""

    def __init__(self, texels: int, capacity: int) -> None:
        self.capacity = capacity
        self.entries: list[list[list[float]]] = [[] for _ in range(texels)]
        self.lost = [0] * texels

    def add(self, texel: int, depth: np.float32, tolerance: np.float32, amount: int) -> None:
        own = self.entries[texel]
        away = [abs(np.float32(z) - depth) for z, _ in own]
        if away and min(away) <= tolerance:
            own[int(np.argmin(away))][1] += amount
            return
        own.append([depth, amount])
        own.sort(key=lambda entry: entry[0])
        for _, count in own[self.capacity :]:
            self.lost[texel] += int(count)
        del own[self.capacity :]


def assert_same(lists: DepthLists, twin: TwinLists) -> None:
    depth, count = lists.depth.numpy(), lists.count.numpy()
    for texel, own in enumerate(twin.entries):
        n = len(own)
        np.testing.assert_array_equal(depth[texel, :n], np.array([z for z, _ in own], np.float32))
        np.testing.assert_array_equal(count[texel, :n], [c for _, c in own])
        assert np.isposinf(depth[texel, n:]).all()
    np.testing.assert_array_equal(lists.lost.numpy(), twin.lost)


@pytest.mark.parametrize("capacity", [1, 2, 5, 8])
@pytest.mark.parametrize("spread", [0.0, 0.01, 0.3, 2.0])
def test_points_are_counted_where_they_fall(capacity: int, spread: float, device: str) -> None:
    rng, texels, points = np.random.default_rng(capacity), 37, 900
    twin, made = TwinLists(texels, capacity), [allocate_lists(texels, capacity, device) for _ in range(2)]
    for amount in (1, 3, -2):
        texel = rng.integers(-3, texels, points).astype(np.int32)
        depth = (rng.integers(1, 7, points) + rng.uniform(-spread, spread, points)).astype(np.float32)
        tolerance = rng.uniform(0.0, 0.2, points).astype(np.float32)
        inputs = [wp.array(texel, dtype=int, device=device)]
        inputs += [wp.array(values, dtype=float, device=device) for values in (depth, tolerance)]
        for lists, threads in zip(made, (1, 3), strict=True):
            add_points(lists, *inputs, amount, threads=threads)
        for t, z, away in zip(texel, depth, tolerance, strict=True):
            if t >= 0:
                twin.add(t, z, away, amount)
    assert capacity > 6 or any(twin.lost)
    for lists in made:
        assert_same(lists, twin)


def test_no_points_change_nothing(device: str) -> None:
    lists = allocate_lists(4, 2, device)
    texel = wp.array([-1, -1], dtype=int, device=device)
    depth = wp.array([1.0, 2.0], dtype=float, device=device)
    add_points(lists, texel, depth, depth)
    add_points(lists, texel[:0], depth[:0], depth[:0])
    assert_same(lists, TwinLists(4, 2))


@wp.kernel
def ask_entries(
    first: int,
    lists: DepthLists,
    texel: wp.array(dtype=int),
    depth: wp.array(dtype=float),
    tolerance: float,
    found_out: wp.array(dtype=int),
):
    i = first + wp.tid()
    found_out[i] = find_entry(lists, texel[i], depth[i], tolerance)


def test_lookups_find_the_nearest_entry(device: str) -> None:
    lists = allocate_lists(2, 3, device)
    lists.depth.assign(np.array([[1.0, 2.0, 4.0], [3.0, np.inf, np.inf]], np.float32))
    asked = [(0, 1.2, 0), (0, 1.5, 0), (0, 1.6, 1), (0, 2.9, int(NOT_FOUND)), (0, 4.5, 2), (0, 9.0, int(NOT_FOUND)),
             (1, 3.0, 0), (1, 2.5, 0), (1, 3.6, int(NOT_FOUND))]  # fmt: skip
    texel, depth, expected = (np.array(column) for column in zip(*asked, strict=True))
    out = wp.zeros(len(asked), dtype=int, device=device)
    places = [wp.array(texel, dtype=int, device=device), wp.array(depth, dtype=float, device=device)]
    launch(ask_entries, len(asked), [lists, *places, 0.5], [out], device=device)
    np.testing.assert_array_equal(out.numpy(), expected)
