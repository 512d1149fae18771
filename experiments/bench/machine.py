"""The machine and the versions that a bench was run with."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from experiments.bench.llvmpipe import NAME, Llvmpipe
from experiments.results.environment import describe_machine, package_version

_FLAGS = ("avx2", "fma", "avx512f", "avx512vl")  # what the compiled kernels' speed depends on most


def describe_bench(threads: int, repeats: int, peer: Llvmpipe | str) -> dict[str, Any]:
    """The block ``environment`` of the result. Call it before anything is timed: it holds the load of others."""
    peers = {NAME: peer.description if isinstance(peer, Llvmpipe) else f"missing: {peer}"}
    for package in ("mitsuba", "embreex"):
        peers[package] = package_version(package) or "missing: not installed; pip install 'wkernels[peers]'"
    return {
        **describe_machine("cpu", threads),
        "cpu_flags": cpu_flags(),
        "load_average": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "openblas_num_threads": os.environ.get("OPENBLAS_NUM_THREADS"),
        "peers": peers,
        "repeats": repeats,
    }


def cpu_flags() -> list[str] | None:
    """Which of the instruction sets that matter here the processor has; None where the system does not say."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    for line in lines:
        if line.startswith("flags"):
            held = set(line.partition(":")[2].split())
            return [flag for flag in _FLAGS if flag in held]
    return None
