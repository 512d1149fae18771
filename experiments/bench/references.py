"""The ray-cast reference, and what claims to be as exact, beside other ray casters on the same rays.

Both sides get the same float32 receiver points and the same float32 samples of the light. They differ where a ray
grazes an edge, by how either side rounds ways and triangles. Such receivers are counted and shown, not excused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from algorithms.plugins import find
from experiments.bench.plan import Bench
from experiments.bench.ray_peers import EMBREEX, MITSUBA, MITSUBA_DIRECT, Embreex, Mitsuba, ShadowRays, shadow_rays
from experiments.bench.rows import PeerMissing, Row, Timed, interleaved_medians
from experiments.rendering.reference import AREA_TECHNIQUE
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry

_MOST_S = 15.0  # of timed runs in one row
_WARM_UPS = 2  # compiles, and finds out that the launch is worth sharing between threads
_PEER_RAYS = 80_000_000  # of a frame that Mitsuba holds at once: about 2 GB


class OurRays:
    """A technique of N exact samples, without a cache; casters' structure and light samples are there already.

    Args:
        bench: Sizes and threads.
        scene: Name of the scene.
        samples: Points on the light.
        technique_name: It has parameters ``samples`` and ``sample_set``, and its samples are the reference's.
    """

    def __init__(self, bench: Bench, scene: str, samples: int, technique_name: str = AREA_TECHNIQUE) -> None:
        sizes = bench.sizes
        technique: Any = find(technique_name)
        self._technique = technique(technique.Params(samples=samples))
        self._frame = sizes.reference_frame if scene == "paris" else 0
        width, height = sizes.reference
        geometry = Geometry(bench.scene(scene), "cpu", bench.threads)
        self.session = Session(geometry, width=width, height=height, device="cpu", threads=bench.threads)
        self.whole_ms: list[float] = []
        self.visibility = np.zeros(0)
        self._what = f"{scene}, frame {self._frame}, {width}x{height}"

    def draw(self) -> float:
        """Milliseconds of the rays; notes those of the whole frame, with a G-buffer of its own and shading."""
        self.session.begin(self._frame + 1)
        self.session.gbuffer()
        self.session.begin(self._frame)
        result = self.session.render(self._technique)
        self.whole_ms.append(result.frame_ms)
        self.visibility = result.visibility
        return result.shadow_ms

    def rays(self) -> ShadowRays:
        """What it casts, or would if it proved nothing."""
        params = self._technique.params
        return shadow_rays(self.session, params.samples, params.sample_set)

    def describe(self, rays: ShadowRays) -> str:
        """Scene, frame, size and rays, for a row's note."""
        return f"{self._what}, {rays.count / 1e6:.1f} million rays without proofs"

    def mismatch(self, theirs: np.ndarray) -> float:
        """Share of receivers in which as much as one sample differs."""
        mine = self.visibility
        seen = np.isfinite(mine)
        return float((np.abs(mine - theirs)[seen] > 0.5 / self._technique.params.samples).mean())


def trace_over_scenes(
    bench: Bench, name: str, *, samples: int, scenes: Sequence[str], technique: str = AREA_TECHNIQUE
) -> Iterator[Row]:
    """Exact shadows of each scene: shadow rays only, beside Mitsuba and embreex on the same rays."""
    for scene in scenes:
        ours = OurRays(bench, scene, samples, technique)
        yield from _beside_both(bench, f"{name}.{scene}", ours, samples)


def trace_over_counts(bench: Bench, name: str) -> Iterator[Row]:
    """The reference in paris with ever more samples, beside Mitsuba and embreex on the same rays."""
    for count in bench.sizes.reference_counts:
        ours = OurRays(bench, "paris", count)
        yield from _beside_both(bench, f"{name}.{count}", ours, count, by_peer=True)


def _beside_both(bench: Bench, name: str, ours: OurRays, samples: int, *, by_peer: bool = False) -> Iterator[Row]:
    """A row beside Mitsuba and one beside embreex; the three take turns."""
    ours.draw()
    rays = ours.rays()
    what, figures = f"{ours.describe(rays)}; shadow rays only", {"samples": samples}
    prefix, _, size = name.rpartition(".")
    names = (name, f"{prefix}.embreex.{size}" if by_peer else f"{name}.embreex")
    sides: list[Timed] = [ours.draw]
    makers = (
        lambda: Mitsuba(ours.session, bench.threads).upload(rays, _PEER_RAYS),
        lambda: Embreex(ours.session, rays, bench.threads, bench.sizes.embree_rays),
    )
    peers: list[Any] = []
    for make in makers:
        try:
            peers.append(make())
            sides.append(peers[-1].draw)
        except PeerMissing as missing:
            peers.append(missing)
    ours_ms, *peer_ms = interleaved_medians(sides, bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
    for row_name, peer_name, peer in zip(names, (MITSUBA, EMBREEX), peers, strict=True):
        row = Row(row_name, ours_ms, peer_name, figures=figures)
        if isinstance(peer, PeerMissing):
            yield replace(row, note=f"{what}; {peer_name} is missing: {peer}")
            continue
        theirs, mismatch, differing = peer.visibility(), None, 0
        if theirs is not None:
            pixels = rays.pixel[peer.kept]
            off = np.abs(ours.visibility.ravel()[pixels] - theirs) > 0.5 / samples
            mismatch, differing = float(off.mean()), int(off.sum())
        counted = (
            "no mismatch told: its rays do not end at lights"
            if theirs is None
            else (f"mismatch: a sample or more, {differing} of {len(pixels)} receivers")
        )
        note = f"{what}; peer: {peer.share:.1%} of the receivers, its time scaled to all; {counted}"
        yield replace(row, peer_ms=peer_ms.pop(0), mismatch=mismatch, note=note, figures=figures)


def render_beside_mitsuba(bench: Bench, name: str) -> Iterator[Row]:
    """Whole images of paris beside Mitsuba's integrator of direct light."""
    samples = 256
    ours = OurRays(bench, "paris", samples)
    ours.draw()
    what = f"{ours.describe(ours.rays())}; whole frame"
    try:
        direct = Mitsuba(ours.session, bench.threads).direct(samples)
    except PeerMissing as missing:
        interleaved_medians([ours.draw], bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
        note = f"{what}; {MITSUBA_DIRECT} is missing: {missing}"
        yield Row(name, float(np.median(ours.whole_ms[1 + _WARM_UPS :])), MITSUBA_DIRECT, note=note)
        return
    _, direct_ms = interleaved_medians([ours.draw, direct.draw], bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
    note = (
        f"{what}; both: G-buffer or camera rays, shadow rays and shading; equal counts of shadow rays, Mitsuba's are "
        "random and so have the larger error, which is not made up for here"
    )
    yield Row(name, float(np.median(ours.whole_ms[1 + _WARM_UPS :])), MITSUBA_DIRECT, direct_ms, note=note)
