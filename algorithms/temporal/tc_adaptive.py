"""Prototype. Scherzer 2009. Known artefacts: """

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from algorithms.technique import Limit, MapParams, Needs, Technique, setting
from wkernels.frame import Session as Frame
from wkernels.kept_maps import KeptMaps
from wkernels.lanes import flat_floats, runs_per_row, uses_lanes
from wkernels.mover_maps import MoverMaps
from wkernels.pool_update import PoolSteps, add_movers, take_root, update_sums
from wkernels.pool_update_lanes import add_movers_lanes, point_views, pool_views, update_sums_lanes


class TcAdaptive(Technique):
    """Kept maps, carried history."""

    name = "tc_adaptive"
    family = "temporal"
    paper = ("scherzer2009tc",)
    needs = Needs(area=True, history=True)
    bias_sign = "none"

    class Params(MapParams):
        """x"""

        samples: int = setting(64, "points of the light, and maps that are kept", unit="maps", ge=1, le=4096)
        draws: int = setting(2, "maps drawn per frame", unit="maps per frame", ge=1, le=64)
        tests: int = setting(8, "tests", unit="tests", ge=1, le=64)
        new_tests: int = setting(16, "tests", unit="tests", ge=1, le=64)
        refresh: int = setting(4, "tests", unit="tests", ge=0, le=64)
        settled: int = setting(1, "tests", unit="tests", ge=0, le=64)
        mover_maps: int = setting(8, "maps", unit="maps", ge=1, le=64)
        mover_resolution: int = setting(256, "maps", unit="maps", ge=1, le=8192)
        depth_epsilon: float = setting(1e-4, "x", unit="scene diagonals", gt=0.0, le=1.0)
        carry: bool = setting(True, "x", unit="x")

    def render(self, frame: Frame) -> wp.array:
        p = self.params
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        shape = visibility.shape
        error = frame.standard_error = frame.buffer("standard error", shape, wp.float32)
        variance = frame.buffer("variance", shape, wp.float32)
        if frame.nothing_casts(visibility):
            error.zero_()
            return visibility
        kept = frame.product("pool", "pool", (), lambda old: old or KeptMaps(frame, p.samples, p.resolution))
        history = frame.history("carried", lambda: wp.zeros(shape, dtype=wp.vec4, device=frame.device))
        since = frame.count
        fresh = range(min(since * p.draws, p.samples), min((since + 1) * p.draws, p.samples))
        if len(fresh):
            samples = frame.light_samples(p.samples)
            box = kept.receivers(frame)
            casters = frame.geometry.bounds(casters=True, moving=False)
            for slot in fresh:
                views = frame.projection(samples.host[slot], box, casters, p.resolution, frame.eye())
                pool = kept.hold(frame, len(views))
                with frame.timed("light depth map"):
                    kept.draw(frame, slot, views, samples.host[slot], samples.weights_host[slot], p.cull)
        pool = kept.pool
        filled = min(kept.maps, (since + 1) * p.draws)
        first_full = -(-p.samples // p.draws)
        steps = PoolSteps()
        steps.bias, steps.filled = p.device_bias, filled
        steps.head = filled if len(fresh) else (filled + (since - first_full + 1) * p.tests) % filled
        steps.tests = len(fresh) if len(fresh) else p.tests
        steps.new_tests = p.new_tests
        steps.refresh = p.refresh
        steps.settled = p.settled
        steps.full = float(kept.maps)
        steps.limit = float(kept.maps)
        steps.has_history = int(history.valid)
        steps.depth_epsilon = p.depth_epsilon * frame.reach
        lanes = uses_lanes(frame.device)
        runs = (shape[0], runs_per_row(shape[1]))
        with frame.timed("tests"):
            previous_view = history.previous_view or gbuffer.view
            outputs = [history.current, visibility, variance]
            if lanes:
                inputs = [point_views(gbuffer), pool_views(pool), pool, steps, previous_view, flat_floats(history.previous)]
                frame.launch(update_sums_lanes, runs, inputs, outputs)
            else:
                frame.launch(update_sums, shape, [gbuffer, pool, steps, previous_view, history.previous], outputs)
        if frame.geometry.moving and len(kept.moving[1]):
            maps = min(p.mover_maps, filled)
            with frame.timed("mover maps"):
                made = frame.product("movers", "movers", (), lambda old: old or MoverMaps(frame, p.mover_maps, p.mover_resolution))
                movers = made.draw(kept.points[:maps], frame.geometry.bounds(casters=True, moving=True), p.cull)
            with frame.timed("mover tests"):
                if lanes:
                    inputs = [point_views(gbuffer), pool_views(pool), pool_views(movers), pool, movers, maps, steps.bias]
                    frame.launch(add_movers_lanes, runs, inputs, [visibility, variance])
                else:
                    frame.launch(add_movers, shape, [gbuffer, pool, movers, maps, steps.bias], [visibility, variance])
        with frame.timed("error"):
            frame.launch(take_root, shape, [variance], [error])
        return visibility
