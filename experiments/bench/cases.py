"""What the bench times, by name, and what each row should reach."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from experiments.bench import frames, memory, passes, references, scaling, startup
from experiments.bench.plan import SCENES, Bench, SceneMissing
from experiments.bench.rows import Row, Target
from wkernels.errors import InputError, nearest

CASES: dict[str, Callable[[Bench, str], Iterator[Row]]] = {
    **{f"depth_{size}": partial(passes.draw_depth, size=size) for size in ("10k", "250k", "2500k")},
    "gbuffer_250k": passes.draw_gbuffer,
    "pcss_16_16": passes.filter_pcss,
    **{
        f"reference_{samples}": partial(references.trace_over_scenes, samples=samples, scenes=SCENES)
        for samples in (256, 1024)
    },
    "silhouettes_64": partial(references.trace_over_scenes, samples=64, scenes=SCENES, technique="silhouette_samples"),
    "reference_direct": references.render_beside_mitsuba,
    "scale_rays": references.trace_over_counts,
    "paris_1024x768": frames.compare_frame_with_passes,
    "tc_against_pcss": frames.compare_temporal,
    "nothing_casts": frames.compare_with_nothing,
    "threads_1_2": passes.compare_threads,
    **{f"frames.{scene}": partial(frames.walk_scene, scene_name=scene) for scene in ("overlap", "paris", "winter")},
    "scale_threads": scaling.over_threads,
    "scale_triangles": scaling.over_triangles,
    "scale_map": scaling.over_map_size,
    "scale_image": scaling.over_image_size,
    "scale_samples": scaling.over_samples,
    "memory_1000_frames": memory.draw_many,
    "start_help": startup.start_help,
    "start_render": startup.start_render,
    "compile_cold": startup.compile_cold,
}
"""The cases by name, in the order in which they run; a case yields one row or several."""

TARGETS = {
    "depth_10k": Target(ratio=2.2),
    "depth_250k": Target(ratio=4.5),
    "depth_2500k": Target(ratio=5.0),
    "gbuffer_250k": Target(ratio=3.5),
    "pcss_16_16": Target(ratio=5.5),
    **{f"reference_256.{scene}": Target(ratio=3.0) for scene in ("paris", "overlap")},
    **{f"reference_1024.{scene}": Target(ratio=8.0) for scene in ("paris", "overlap")},
    "paris_1024x768": Target(ratio=1.0),
    "tc_against_pcss": Target(ratio=2.0),
    "nothing_casts": Target(ratio=1.0 / 1.05),
    "threads_1_2.rasteriser": Target(ratio=1.7),
    "threads_1_2.pcss": Target(ratio=1.9),
    "start_help": Target(ms=1500.0),
    "start_render": Target(ms=4000.0),
    "compile_cold.everything": Target(ms=60_000.0),
    "compile_cold.demo": Target(ms=20_000.0),
}
"""What rows should reach, by their names or their cases', on two cores with AVX-512; shown, never enforced."""


def select(wanted: Sequence[str]) -> list[str]:
    """Names of the cases that begin with any of ``wanted``, in the order of ``CASES``; all of them if it is empty.

    Raises:
        InputError: No case begins so.
    """
    for name in wanted:
        if not any(case.startswith(name) for case in CASES):
            raise InputError(f"there is no case '{name}'." + nearest(name, CASES), key="--case")
    return [case for case in CASES if not wanted or case.startswith(tuple(wanted))]


def run_case(bench: Bench, name: str) -> list[Row]:
    """The rows of one case with their targets; one row that says so where its scene is missing."""
    try:
        rows = list(CASES[name](bench, name))
    except SceneMissing as missing:
        rows = [Row(name, None, note=str(missing))]
    return [replace(row, target=TARGETS.get(row.name, TARGETS.get(name))) for row in rows]


def summary(name: str) -> str:
    """First line of what a case's docstring says."""
    case = CASES[name]
    function = case.func if isinstance(case, partial) else case
    return (function.__doc__ or "").strip().splitlines()[0]
