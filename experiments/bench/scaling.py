"""How time grows with threads, triangles, texels, pixels and light samples, one row per size."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from algorithms.plugins import find
from experiments.bench.frames import Walk
from experiments.bench.meshes import Mix, camera, spheres_on_terrain
from experiments.bench.passes import OurPcss, OurTriangles, depth_mismatch, sun_view
from experiments.bench.plan import Bench
from experiments.bench.rows import Row, Timed, interleaved_medians
from wkernels.device.launch import default_threads
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import eye_view

BYTES_PER_TRIANGLE = 200  # at the peak, measured 140: float64 vertices, their copies, both sides' buffers, our bins
_MOST_S = 5.0  # of timed runs of one size
_SLOW_REPEATS = 3
_SLOW_MS = 1000.0  # from here on the warm-up is nothing beside the frame


def over_threads(bench: Bench, name: str) -> Iterator[Row]:
    """The depth pass and a pixel pass on 1, 2, 4, ... threads up to all cores."""
    cores = max(default_threads(), bench.threads)
    counts = sorted({*(2**k for k in range(cores.bit_length())), cores})
    vertices, faces = spheres_on_terrain(bench.sizes.mixes["250k"])
    view = sun_view(vertices, bench.sizes.map_side)
    image = bench.sizes.image
    for part, make, what in (
        ("rasteriser", lambda n: OurTriangles(vertices, faces, view, False, n), f"{len(faces)} triangles"),
        ("pcss", lambda n: OurPcss(bench, n, image), f"16 + 16 taps, {image[0]}x{image[1]}"),
    ):
        sides: list[Timed] = [make(count).draw for count in counts]
        times = interleaved_medians(sides, bench.repeats)
        for count, ms in zip(counts, times, strict=True):
            figures = {"threads": count, "speed_up": times[0] / ms}
            note = f"{what}; peer: ourselves on 1 thread"
            yield Row(f"{name}.{part}.{count}", ms, "1 thread", times[0], note=note, figures=figures)


def over_triangles(bench: Bench, name: str) -> Iterator[Row]:
    """The depth pass of ever more triangles of the same spread; a triangle must not cost more for it."""
    for size, mix in bench.sizes.triangle_mixes.items():
        row_name, needed = f"{name}.{size}", BYTES_PER_TRIANGLE * _triangles(mix)
        available = _available_bytes()
        if available is not None and available < needed:
            why = f"needs about {needed / 1e9:.1f} GB of memory, {available / 1e9:.1f} GB are free"
            yield Row(row_name, None, note=why)
            continue
        yield _per_triangle(bench, row_name, mix, bench.sizes.map_side)


def over_map_size(bench: Bench, name: str) -> Iterator[Row]:
    """The depth pass into ever larger maps."""
    for side in bench.sizes.map_sides:
        yield _per_triangle(bench, f"{name}.{side}", bench.sizes.mixes["250k"], side)


def over_image_size(bench: Bench, name: str) -> Iterator[Row]:
    """A camera's view of 250k triangles, and the pixel pass of ``pcss``, in ever larger images."""
    vertices, faces = spheres_on_terrain(bench.sizes.mixes["250k"])
    for width, height in bench.sizes.images:
        view = eye_view(camera(), width, height, np.zeros(3))
        parts: dict[str, Any] = {
            "gbuffer": OurTriangles(vertices, faces, view, True, bench.threads),
            "pcss": OurPcss(bench, bench.threads, (width, height)),
        }
        times = interleaved_medians([part.draw for part in parts.values()], bench.repeats, most_s=_MOST_S)
        for part, ms in zip(parts, times, strict=True):
            pixels = width * height
            figures = {"pixels": pixels, "ns_per_pixel": 1e6 * ms / pixels}
            what = f"{len(faces)} triangles, depth and triangle" if part == "gbuffer" else "16 + 16 taps"
            yield Row(f"{name}.{part}.{width}x{height}", ms, note=what, figures=figures)


def over_samples(bench: Bench, name: str) -> Iterator[Row]:
    """The two methods that sample the light, in paris, with ever more samples."""
    geometry, size = Geometry(bench.scene("paris"), "cpu", bench.threads), bench.sizes.sampled_frame
    for technique_name in ("reference_multisample", "multi_shadow_map"):
        technique: Any = find(technique_name)
        rays = technique_name == "reference_multisample"
        ms = 0.0
        for count in bench.sizes.sample_counts:
            # maps that are kept from frame to frame would cost nothing; proofs are part of the other method
            instance = technique(technique.Params(samples=count))
            walk = Walk(geometry, instance, size, bench.threads, skips=rays)
            repeats = min(bench.repeats, _SLOW_REPEATS)
            warm_ups = 2 if ms < _SLOW_MS else int(rays)  # a ray structure is built but once
            (ms,) = interleaved_medians([walk.next_frame], repeats, warm_ups=warm_ups, most_s=_MOST_S)
            figures = {"samples": count, "ms_per_sample": ms / count}
            note = f"whole frames, {size[0]}x{size[1]}" + ("" if rays else ", every map drawn anew")
            yield Row(f"{name}.{technique_name}.{count}", ms, note=note, figures=figures)


def _per_triangle(bench: Bench, name: str, mix: Mix, side: int) -> Row:
    vertices, faces = spheres_on_terrain(mix)
    view = sun_view(vertices, side)
    ours = OurTriangles(vertices, faces, view, False, bench.threads)
    note = f"{len(faces)} triangles, back faces culled, {side}x{side} depth; mismatch: coverage or depth"
    row = bench.beside_peer(
        name,
        ours.draw,
        lambda peer: peer.triangle_pass(vertices, faces, view, False),
        depth_mismatch(lambda: ours.depth.numpy(), view),
        note,
        most_s=_MOST_S,
    )
    per_triangle = None if row.ours_ms is None else 1e6 * row.ours_ms / len(faces)
    return replace(row, figures={"triangles": len(faces), "map_side": side, "ns_per_triangle": per_triangle})


def _triangles(mix: Mix) -> int:
    return int(mix.spheres * 20 * 4**mix.subdivisions + 2 * mix.cells**2)


def _available_bytes() -> int | None:
    """Memory that is free for a process, None where the system does not say."""
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
