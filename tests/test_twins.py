"""Every plain kernel against its twin in lanes: both run on the same inputs wherever anything sends them to work."""

from __future__ import annotations

import importlib
import pkgutil

import pytest
import twin_runs
import warp as wp

import wkernels
from algorithms.plugins import load_all
from wkernels.device.lanes import LANES, Floats, runs_of, uses_lanes
from wkernels.device.launch import launch
from wkernels.device.twin import Twin

LEAST_VALUES = 1000

for module in pkgutil.walk_packages(wkernels.__path__, "wkernels."):
    importlib.import_module(module.name)
load_all()
TWINS = {name: twin for name, twin in sorted(Twin.known.items()) if not name.startswith("test")}


@pytest.fixture
def on_cpu(device: str) -> None:
    if not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")


@pytest.mark.usefixtures("on_cpu")
@pytest.mark.parametrize("name", TWINS)
def test_lanes_do_what_the_plain_kernel_does(name: str) -> None:
    seen = twin_runs.watched().get(name)
    assert seen is not None and seen.values >= LEAST_VALUES, "no run sends this twin to work"
    assert seen.distinct, "all that it wrote was constant"
    assert not seen.faults, f"{len(seen.faults)} launches: {seen.faults[:5]}"


@wp.kernel
def double(first: int, values: wp.array(dtype=float), doubled_out: wp.array(dtype=float)):
    i = first + wp.tid()
    doubled_out[i] = 2.0 * values[i]


@wp.kernel
def almost_double_lanes(first: int, values: wp.array(dtype=Floats), doubled_out: wp.array(dtype=float)):
    """Wrong in the last lane of each run."""
    begin = (first + wp.tid()) * LANES
    held = values[begin]
    for k in range(LANES):
        doubled_out[begin + k] = 2.0 * held[k] + wp.where(k == LANES - 1, 1.0, 0.0)


@pytest.mark.usefixtures("on_cpu")
def test_a_twin_that_is_wrong_is_found() -> None:
    twin = Twin(double, almost_double_lanes, inputs=lambda v: [runs_of(v, Floats)], flips=0.05)
    try:
        values = wp.array(range(64), dtype=float, device="cpu")
        out = wp.zeros(64, dtype=float, device="cpu")
        watcher = twin_runs.Watcher()
        with Twin.watched(watcher):
            launch(twin, 64, [values], [out])
        assert watcher.seen[twin.name].differing == 4 and watcher.seen[twin.name].faults
    finally:
        del Twin.known[twin.name]
