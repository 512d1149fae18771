"""Whether memory grows while frames are drawn."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from algorithms.plugins import find
from experiments.bench.frames import Walk
from experiments.bench.plan import Bench
from experiments.bench.rows import Row
from wkernels.scene.geometry import Geometry

TECHNIQUES = ("tc_soft_paper", "pcss", "shadow_map")
WARM_UP_FRAMES = 100  # kernels load, buffers and the pools of the allocator reach their size


def resident_bytes() -> int | None:
    """Memory of this process that is in RAM; None where the system does not say (it is read from /proc)."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def growth_bytes(walk: Walk, frames: int) -> tuple[int | None, float]:
    """How much more memory the process holds after ``frames`` frames than after the warm-up, and their median [ms]."""
    for _ in range(WARM_UP_FRAMES):
        walk.next_frame()
    _give_back()
    before = resident_bytes()
    times = [walk.next_frame() for _ in range(frames)]
    _give_back()
    after = resident_bytes()
    return None if before is None or after is None else after - before, float(np.median(times))


def _give_back() -> None:
    """Frees garbage down to the system: pages that the allocator holds back would hide what grows into them."""
    gc.collect()
    with suppress(OSError, AttributeError):  # only glibc has it
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def draw_many(bench: Bench, name: str) -> Iterator[Row]:
    """Many small frames of a scene in which everything moves."""
    geometry = Geometry(bench.scene("overlap"), "cpu", bench.threads)
    size, frames = bench.sizes.memory_frame, bench.sizes.memory_frames
    for technique_name in TECHNIQUES:
        technique: Any = find(technique_name)
        grown, ms = growth_bytes(Walk(geometry, technique(), size, bench.threads), frames)
        text = "unknown: no /proc" if grown is None else f"{grown / 2**20:.2f} MiB"
        note = f"growth of resident memory {text} over {frames} frames of {size[0]}x{size[1]} after {WARM_UP_FRAMES}"
        figures = {"frames": frames, "growth_bytes": grown}
        yield Row(f"{name}.{technique_name}", ms, note=note, figures=figures)
