"""The ray-cast reference beside other ray casters, on the same rays."""

from __future__ import annotations

from collections.abc import Iterator
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

_MOST_S = 15.0  # of timed runs in one case
_WARM_UPS = 2  # compiles, and finds out that the launch is worth sharing between threads


class OurReference:
    """The reference as a run makes it, without its cache; casters' structure and light samples are there already."""

    def __init__(self, bench: Bench) -> None:
        sizes = bench.sizes
        technique: Any = find(AREA_TECHNIQUE)
        self._technique = technique(technique.Params(samples=sizes.reference_samples))
        self._frame = sizes.reference_frame
        width, height = sizes.reference
        geometry = Geometry(bench.scene("paris"), "cpu", bench.threads)
        self.session = Session(geometry, width=width, height=height, device="cpu", threads=bench.threads)
        self.whole_ms: list[float] = []
        self.visibility = np.zeros(0)

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

    def mismatch(self, theirs: np.ndarray) -> float:
        """Share of receivers in which as much as one sample differs."""
        mine = self.visibility
        seen = np.isfinite(mine)
        return float((np.abs(mine - theirs)[seen] > 0.5 / self._technique.params.samples).mean())


def trace_beside_mitsuba(bench: Bench, name: str) -> Iterator[Row]:
    """Shadow rays only, beside ``Scene.ray_test``; then whole images beside the integrator of direct light."""
    ours = OurReference(bench)
    ours.draw()
    whole_name, samples, rays = f"{name}.direct", bench.sizes.reference_samples, ours.rays()
    what = _what(bench, rays)
    try:
        mitsuba = Mitsuba(ours.session, bench.threads)
    except PeerMissing as missing:
        (ours_ms,) = interleaved_medians([ours.draw], bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
        why = f"; {MITSUBA} is missing: {missing}"
        yield Row(name, ours_ms, MITSUBA, note=f"{what}; shadow rays only{why}")
        whole_ms = float(np.median(ours.whole_ms[1 + _WARM_UPS :]))
        yield Row(whole_name, whole_ms, MITSUBA_DIRECT, note=f"{what}; whole frame{why}")
        return
    traced = mitsuba.upload(rays)
    sides: list[Timed] = [ours.draw, traced.draw]
    absent = ""
    try:
        sides.append(mitsuba.direct(samples).draw)
    except PeerMissing as missing:
        absent = f"; {MITSUBA_DIRECT} is missing: {missing}"
    ours_ms, traced_ms, *direct_ms = interleaved_medians(sides, bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
    whole_ms = float(np.median(ours.whole_ms[1 + _WARM_UPS :]))
    note = (
        f"{what}; both: shadow rays only, same points, same {samples} samples of the light, so the same standard error "
        "at the same count; mismatch: a sample or more"
    )
    yield Row(name, ours_ms, MITSUBA, traced_ms, ours.mismatch(rays.image(traced.visibility())), note)
    note = (
        f"{what}; both: G-buffer or camera rays, shadow rays and shading; equal counts of shadow rays, Mitsuba's are "
        "random and so have the larger error, which is not made up for here"
    )
    yield Row(whole_name, whole_ms, MITSUBA_DIRECT, direct_ms[0] if direct_ms else None, note=note + absent)


def trace_beside_embreex(bench: Bench, name: str) -> Iterator[Row]:
    """Shadow rays only, beside embreex on some of the pixels."""
    ours = OurReference(bench)
    ours.draw()
    rays = ours.rays()
    row = Row(name, None, EMBREEX, note=f"{_what(bench, rays)}; shadow rays only")
    try:
        other = Embreex(ours.session, rays, bench.threads, bench.sizes.embree_rays)
    except PeerMissing as missing:
        (ours_ms,) = interleaved_medians([ours.draw], bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
        yield replace(row, ours_ms=ours_ms, note=f"{row.note}; {EMBREEX} is missing: {missing}")
        return
    sides = [ours.draw, other.draw]
    ours_ms, other_ms = interleaved_medians(sides, bench.repeats, warm_ups=_WARM_UPS, most_s=_MOST_S)
    theirs, mismatch = other.visibility(), None
    if theirs is not None:
        mine = ours.visibility.ravel()[rays.pixel[other.kept]]
        mismatch = float((np.abs(mine - theirs) > 0.5 / len(rays.light_ws)).mean())
    note = (
        f"{row.note}; peer: {bench.threads} Python thread(s), {other.share:.1%} of the rays, its time scaled to all; "
        "mismatch: a sample or more, of its pixels"
    )
    yield replace(row, ours_ms=ours_ms, peer_ms=other_ms, mismatch=mismatch, note=note)


def _what(bench: Bench, rays: ShadowRays) -> str:
    (width, height), frame = bench.sizes.reference, bench.sizes.reference_frame
    return f"paris, frame {frame}, {width}x{height}, {rays.count / 1e6:.1f} million rays without proofs"
