"""Whole frames: every technique along a scene's path, and two comparisons that the project has targets for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from algorithms.plugins import find, load_all
from experiments.bench.passes import depth_mismatch
from experiments.bench.plan import Bench
from experiments.bench.rows import WARM_UPS, Row, Timed, interleaved_medians, interleaved_times
from experiments.schema.needs import unmet_need
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import depths_on_host
from wkernels.scene.geometry import Geometry

FEW_MS_REPEATS = 41  # of frames so short that fewer do not tell 5 % apart


class Walk:
    """One technique on its way along the scene's path; every call renders the frame after the last one.

    Args:
        geometry: The scene.
        technique: An instance.
        size: Width and height [pixels].
        threads: CPU threads.
        skips: Whether a map of a scene that stands still may be kept from frame to frame.
    """

    def __init__(
        self, geometry: Geometry, technique: Any, size: tuple[int, int], threads: int, skips: bool = True
    ) -> None:
        self.session = Session(geometry, width=size[0], height=size[1], device="cpu", threads=threads, skips=skips)
        self._technique, self._index = technique, 0
        self._spent: Counter[str] = Counter()

    def next_frame(self) -> float:
        """Milliseconds of one frame."""
        self.session.begin(self._index)
        result = self.session.render(self._technique)
        self.session.advance()
        self._index += 1
        if self._index > WARM_UPS:
            self._spent.update(dict(result.passes))
        return result.frame_ms

    def shares(self) -> dict[str, float]:
        """Share of each pass in the time of all frames after the warm-up, the largest first."""
        total = sum(self._spent.values()) or 1.0
        return {name: round(ms / total, 4) for name, ms in self._spent.most_common()}


def walk_scene(bench: Bench, name: str, scene_name: str) -> Iterator[Row]:
    """Every technique with its defaults, but few light samples, in turns along the path of a scene."""
    scene, size = bench.scene(scene_name), bench.sizes.frame
    geometry = Geometry(scene, "cpu", bench.threads)
    unmet: dict[str, str | None] = {}
    walks: dict[str, Walk] = {}
    changed: dict[str, str] = {}
    for technique in load_all().values():
        unmet[technique.name] = unmet_need(technique, scene, scene.lights[0])
        if unmet[technique.name] is None:
            params = _few_samples(technique, bench.sizes.samples)
            changed[technique.name] = "".join(f"; {key}: {value}" for key, value in params.items())
            walks[technique.name] = Walk(geometry, technique(technique.Params(**params)), size, bench.threads)
    sides: list[Timed] = [walk.next_frame for walk in walks.values()]
    times = dict(zip(walks, interleaved_medians(sides, bench.repeats) if sides else [], strict=True))
    kept = "everything moves" if geometry.moving else "only the camera moves, maps are kept"
    for technique_name, why in unmet.items():
        row_name = f"{name}.{technique_name}"
        if why is not None:
            yield Row(row_name, None, note=why)
            continue
        shares = walks[technique_name].shares()
        largest = ", ".join(f"{part} {share:.0%}" for part, share in list(shares.items())[:3])
        note = f"{size[0]}x{size[1]}, {kept}{changed[technique_name]}; {largest}"
        yield Row(row_name, times[technique_name], note=note, figures={"passes": shares})


class AllLit:
    """The least that a frame can cost: G-buffer and shading."""

    def render(self, frame: Session) -> wp.array:
        """1 everywhere."""
        visibility = frame.visibility_buffer(frame.gbuffer())
        visibility.fill_(1.0)
        return visibility


def compare_with_nothing(bench: Bench, name: str) -> Iterator[Row]:
    """Every technique in a scene whose meshes cast nothing, beside G-buffer and shading alone, the eye moving."""
    whole, size = bench.scene("paris"), bench.sizes.frame
    scene = replace(whole, meshes=tuple(replace(mesh, casts=False) for mesh in whole.meshes))
    geometry = Geometry(scene, "cpu", bench.threads)
    for technique in load_all().values():
        if why := unmet_need(technique, scene, scene.lights[0]):
            yield Row(f"{name}.{technique.name}", None, note=why)
            continue
        ours, least = (Walk(geometry, made, size, bench.threads) for made in (technique(), AllLit()))
        times = interleaved_times([ours.next_frame, least.next_frame], max(bench.repeats, FEW_MS_REPEATS))
        ours_ms, least_ms = np.median(times, axis=0)
        paired = float(np.median(times[:, 1] / times[:, 0]))
        note = f"whole frames, {size[0]}x{size[1]}, the eye moves; ratio of frames in turns"
        yield Row(
            f"{name}.{technique.name}",
            float(ours_ms),
            "G-buffer and shading",
            float(least_ms),
            note=note,
            paired=paired,
        )


def compare_temporal(bench: Bench, name: str) -> Iterator[Row]:
    """``tc_soft_paper`` beside ``pcss`` with 16 + 16 taps, frame by frame along the demo's walkthrough."""
    geometry, size = Geometry(bench.scene("overlap"), "cpu", bench.threads), bench.sizes.frame
    pcss: Any = find("pcss")
    ours = Walk(geometry, find("tc_soft_paper")(), size, bench.threads)
    other = Walk(geometry, pcss(pcss.Params(blocker_taps=16, filter_taps=16)), size, bench.threads)
    frames = bench.sizes.walk_frames
    ours_ms, other_ms = interleaved_medians([ours.next_frame, other.next_frame], frames)
    note = f"whole frames, {size[0]}x{size[1]}, median of {frames} frames of the demo's walkthrough"
    yield Row(name, ours_ms, "our pcss 16/16", other_ms, note=note, figures={"passes": ours.shares()})


def compare_frame_with_passes(bench: Bench, name: str) -> Iterator[Row]:
    """A whole frame with a hard shadow beside three depth passes of the peer, same mesh, map and culling."""
    scene, size = bench.scene("paris"), bench.sizes.image
    geometry = Geometry(scene, "cpu", bench.threads)
    technique: Any = find("shadow_map")
    params = technique.Params(resolution=bench.sizes.map_side)
    walk = Walk(geometry, technique(params), size, bench.threads, skips=False)
    walk.next_frame()
    look = walk.session.shown
    assert look is not None
    view = look.views[0]
    vertices, faces = geometry.points_ws.numpy(), geometry.caster_indices.numpy().reshape(-1, 3)

    def depth() -> np.ndarray:
        return depths_on_host(walk.session.light_map(params.resolution, cull=params.cull).map)[0]

    note = (
        f"ours: a whole shadow_map frame, {size[0]}x{size[1]}, map drawn anew; peer: 3 depth passes, {len(faces)} "
        f"triangles, {view.width}x{view.height}, no culling on either side; mismatch: coverage or depth of the map"
    )
    yield bench.beside_peer(
        name,
        walk.next_frame,
        lambda peer: peer.triangle_pass(vertices, faces, view, False, cull=False),
        depth_mismatch(depth, view),
        note,
        draws=3,
    )


def _few_samples(technique: Any, most: int) -> dict[str, int]:
    held = technique.Params.model_fields.get("samples")
    return {"samples": most} if held is not None and held.default > most else {}
