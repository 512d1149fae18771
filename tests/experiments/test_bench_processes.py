"""The bench's cases about whole processes: how they start, and whether their memory grows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from algorithms.plugins import find
from experiments.bench import frames, memory, startup
from experiments.bench.cases import run_case
from experiments.bench.plan import Bench, Sizes
from experiments.bench.rows import Row
from experiments.scenes import load_scene
from wkernels.scene.geometry import Geometry

MOVING = Path(__file__).parents[2] / "configs" / "scenes" / "moving_blocker.yaml"
BENCH = Bench(Sizes(scenes={"overlap": load_scene(MOVING)}, memory_frames=3), 1, 1, "not wanted here")
LEAK_FRAMES, LEAK_SIZE = 150, (160, 90)
LEAK_BOUND = LEAK_FRAMES * LEAK_SIZE[0] * LEAK_SIZE[1] * 4 // 3
"""Bytes: a third of one float image per frame, 2.7 MiB; without a leak there was at most 0.2."""


def rows_of(name: str, bench: Bench = BENCH) -> dict[str, Row]:
    return {row.name: row for row in run_case(bench, name)}


def test_processes_use_an_empty_cache_where_they_start_cold(monkeypatch: pytest.MonkeyPatch) -> None:
    empty = "import os; folder = os.environ['WARP_CACHE_PATH']; assert not os.listdir(folder); open(folder + '/x', 'w')"
    monkeypatch.setattr(startup, "EVERYTHING", empty)
    monkeypatch.setattr(startup, "DEMO", f"import sys; assert sys.argv[1].endswith('demo.yaml'); {empty}")
    rows = rows_of("compile_cold", replace(BENCH, repeats=2))
    assert all(row.ours_ms and row.target is not None for row in rows.values()), rows
    assert list(rows) == ["compile_cold.everything", "compile_cold.demo"]


def test_a_process_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "_CLI", "raise SystemExit('out of order')")
    (row,) = rows_of("start_help").values()
    assert row.ours_ms is None and "ended with status 1: out of order" in row.note
    monkeypatch.setattr(startup, "_CLI", "import time; time.sleep(60)")
    monkeypatch.setattr(startup, "TIMEOUT_S", 0.2)
    (row,) = rows_of("start_render").values()
    assert row.ours_ms is None and "did not end within 0.2 s" in row.note


def test_help_starts_for_real() -> None:
    (row,) = rows_of("start_help").values()
    assert row.ours_ms and row.target is not None and row.target.ms == 1500.0


def test_memory_is_reported_for_each_technique() -> None:
    rows = rows_of("memory_1000_frames")
    assert list(rows) == [f"memory_1000_frames.{name}" for name in memory.TECHNIQUES]
    for row in rows.values():
        assert row.ours_ms and row.figures["frames"] == 3
        assert row.figures["growth_bytes"] is None or "MiB over 3 frames" in row.note


@pytest.mark.skipif(memory.resident_bytes() is None, reason="resident memory is read from /proc")
@pytest.mark.parametrize("name", memory.TECHNIQUES)
def test_frames_leave_no_memory_behind(name: str) -> None:
    technique: Any = find(name)
    walk = frames.Walk(Geometry(load_scene(MOVING), "cpu", 2), technique(), LEAK_SIZE, 2)
    grown, _ = memory.growth_bytes(walk, LEAK_FRAMES)
    assert grown is not None and grown <= LEAK_BOUND


@pytest.mark.skipif(memory.resident_bytes() is None, reason="resident memory is read from /proc")
def test_an_image_kept_from_every_frame_would_be_found() -> None:
    class Keeps:
        def __init__(self) -> None:
            technique: Any = find("shadow_map")
            self._inner, self._kept = technique(), []

        def render(self, frame: Any) -> wp.array:
            self._kept.append(wp.full(LEAK_SIZE[::-1], 1.0, dtype=float, device="cpu"))
            return self._inner.render(frame)

    walk = frames.Walk(Geometry(load_scene(MOVING), "cpu", 2), Keeps(), LEAK_SIZE, 2)
    grown, _ = memory.growth_bytes(walk, LEAK_FRAMES)
    assert grown is not None and grown > LEAK_BOUND
