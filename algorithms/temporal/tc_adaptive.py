"""Soft shadows from light depth maps that are kept, not drawn anew: our own, after Scherzer et al. 2009.

Scherzer, Schwaerzler, Mattausch and Wimmer 2009 draw one map a frame from the next point of the light and remember in
screen space what it said. A good part of a frame then goes into a map that is thrown away, and the error that is left
has other causes than few samples: most of it lies where n > 16, and grows with the age of interpolated history; and
shadows of movers start anew in every frame (docs/tc_adaptive.md has the figures). So here

1. maps of the casters that stand still are kept, a pool of ``samples`` points of the light (Halton), drawn ``draws`` a
   frame until it is full, those of several layers a part at a time; meanwhile a pixel is tested only against what is
   new. A frame then draws none, and a pixel that is new to the eye is tested against ``new_tests`` maps at once: no
   start by another method, and a cut costs nothing more once the pool is full;
2. a pixel is tested against ``tests`` maps a frame, the pool's in turn. Sums rho and n (equations 1, 2 and 5) are
   remembered up to n = ``samples``, and under a moving eye clipped to ``clip`` standard errors round what the frame's
   own tests say;
3. history is carried, not interpolated (``carried_history``): a pixel takes over one texel of the last frame whole and
   remembers how far off its place is. Without that it sticks to the screen under a slow eye;
4. movers have maps of their own, ``mover_maps`` small ones that hold nothing else, drawn in one go in every frame from
   points of the light that the pool has too. What they hide of the light, where the pool's map of the same point finds
   it open, is taken from the visibility of what stands still. History never sees a mover: nothing trails and nothing
   starts anew;
5. a view that stands still goes on: once its pixels have met every map, a new point of the light replaces an old one
   in each frame, and the error goes on falling. After ``still_samples`` frames nothing is done any more.

The standard error knows that Halton points are spread evenly over the light: only those err through whose part of it
the border of what is hidden passes, so that it falls with n^-3/4 (``hidden_variance``). That of equation 3,
sqrt(psi (1 - psi) / (n - 1)), is 0 where all tests agree so far, false certainty for 44 % of pixels with psi = .05 at
n = 16: half a test of either outcome is added here (Jeffreys' prior). Other sample sets get the standard error of
independent points, that of the Beta distribution. Neither knows of the maps' texels, which are most of the error where
these are coarse.

Deviations from Scherzer et al. 2009: all of the above, and no overscan (a pixel at the border is as cheap as any new
one), no start by percentage-closer soft shadows, no filter for show. Their depth test of history is kept.
Layers of a map are chosen by the first that holds a point; a point that a map does not hold is not counted.

Known artefacts: the frames in which the pool is filled take longer than later ones, and the first two or three have
steps; noise where pixels have just come into view; ``mover_maps`` + 1 levels in the shadow of a mover; the maps' own
aliasing, which different points average but do not remove; memory, 4 ``samples`` ``resolution``^2 bytes, for which
fewer maps are kept beyond 512 MiB. With projections that follow the eye maps go out of date and some are drawn in every
frame. A scene whose casters all move has the cost of drawing them ``mover_maps`` times a frame. Lights that move
are refused: all maps would be of another light.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
import warp as wp

from algorithms.projections.composition import Composition
from algorithms.technique import Frame, Limit, MapParams, Needs, Technique, setting
from wkernels.device.structs import filled
from wkernels.raster.gbuffer import GBuffer
from wkernels.temporal.forgetting import forget_changes
from wkernels.temporal.map_pool.kept_maps import KeptMaps, Schedule
from wkernels.temporal.map_pool.mover_maps import MoverMaps
from wkernels.temporal.map_pool.update import PoolSteps
from wkernels.temporal.map_pool.update_lanes import ADD_MOVERS, UPDATE_SUMS
from wkernels.temporal.reach import mover_reach
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What rest saves."""

    STANDS_STILL = "light depth maps and tests", "the view has stood still for all samples"
    NO_MOVERS = "maps of moving casters", Because.NO_CASTER_MOVES


NO_LIMIT = 2.0**22  # a quarter of where whole numbers in float32 stop being exact


class TcAdaptive(Technique):
    """Kept maps, carried history, and movers apart."""

    name = "tc_adaptive"
    family = "temporal"
    paper = ("scherzer2009tc",)
    products = (Product.G_BUFFER, Product.LIGHT_SAMPLES, Product.KEPT_MAPS, Product.HISTORY)
    needs = Needs(area=True, history=True, still_light=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "no texel falls on a receiver in whose plane the light lies"
    }
    bias_sign = "none"
    may_leave_out = (Skip.STANDS_STILL, Skip.NO_MOVERS)
    limits = (
        Limit(
            equals="multi_shadow_map",
            params={"samples": 16, "draws": 16, "new_tests": 16},
            other_params={"samples": 16},
            tolerance=1e-5,
            flips=0.005,
        ),
    )

    class Params(MapParams):
        """The pool, how often it is read, and the movers' maps."""

        samples: int = setting(
            16, "points of the light, and maps that are kept", unit="maps", source="measured", ge=1, le=4096
        )
        sample_set: Literal["halton", "r2", "poisson_disc", "random"] = setting(
            "halton", "point set on the light", unit="name", source="Scherzer 2009, sec. 4"
        )
        draws: float = setting(
            0.5,
            "maps drawn per frame until the pool is full, at least a layer of one",
            unit="maps per frame",
            source="measured",
            gt=0.0,
            le=4096.0,
        )
        tests: int = setting(
            4, "maps that a pixel is tested against", unit="tests per frame", source="measured", ge=1, le=4096
        )
        new_tests: int = setting(
            4, "the same of a pixel without history", unit="tests per frame", source="measured", ge=1, le=4096
        )
        clip: float = setting(
            2.0,
            "how far history may differ from a frame's own tests under a moving eye; 0: not clipped",
            unit="standard errors",
            source="measured",
            ge=0.0,
            le=100.0,
        )
        mover_maps: int = setting(6, "maps of moving casters", unit="maps per frame", source="measured", ge=1, le=1024)
        mover_resolution: int = setting(
            128, "texels per side of those maps", unit="texels", source="measured", ge=8, le=2048
        )
        still_samples: int = setting(
            1024,
            "frames for which a still view goes on, with a point of the light in each",
            unit="frames",
            ge=0,
            le=10**6,
        )
        depth_epsilon: float = setting(
            1e-4, "largest depth difference of a point and its history", unit="scene diagonals", gt=0.0, le=1.0
        )

        @property
        def even(self) -> int:
            """1 where points of the light are spread so evenly that errors are known to be smaller than by chance."""
            return int(self.sample_set == "halton")

    def render(self, frame: Frame) -> wp.array:
        p = self.params
        if (lit := frame.lit_without_casters(standard_error=0.0)) is not None:
            return lit
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        shape = visibility.shape
        error = frame.standard_error = frame.buffer("standard error", shape, wp.float32)
        kept: KeptMaps = frame.product(
            Product.KEPT_MAPS, "kept maps", (), lambda old: old or KeptMaps(frame, p.samples, p.resolution)
        )
        history = frame.history("carried", lambda: wp.zeros(shape, dtype=wp.vec4, device=frame.device))

        kept.follow(frame)
        forget_changes(frame, history, [frame.light], depth_unit=1.0)

        # 1: maps
        seen = frame.geometry.version, bytes(np.array(gbuffer.view.ws_to_ss, dtype=np.float32))
        wanted = frame, seen, p.draws, p.tests, isinstance(frame.projection, Composition)
        plan = kept.schedule(*wanted)
        if plan.refines and kept.still_frames(frame) >= p.still_samples:
            if frame.leave_out(Skip.STANDS_STILL):
                wp.copy(history.current, history.previous)
                return visibility
            plan = replace(plan, draws=(), added=0)
        while not kept.draw(frame, plan.draws, p.sample_set, p.cull):  # a map has more layers than there was room for
            plan = kept.schedule(*wanted)

        # 2: tests of what stands still, added to what each pixel already knows
        steps = self._steps(frame, kept, plan, history.valid)
        with frame.timed("tests"):
            inputs = [gbuffer, kept.pool, steps, history.previous_view or gbuffer.view, history.previous]
            frame.launch(UPDATE_SUMS, shape, inputs, [history.current, visibility, error])

        # 3: movers
        if frame.geometry.casters_move or not frame.leave_out(Skip.NO_MOVERS):
            self._add_movers(frame, gbuffer, kept, plan.filled, visibility, error)
        return visibility

    def _add_movers(
        self, frame: Frame, gbuffer: GBuffer, kept: KeptMaps, filled: int, visibility: wp.array, error: wp.array
    ) -> None:
        p = self.params
        box = frame.casters_towards(frame.light.centre, moving=True)
        if box.empty:
            return
        maps = min(p.mover_maps, filled)
        points = kept.points[:maps]

        def draw(old: MoverMaps | None) -> MoverMaps:
            made = old if old and old.resting == frame.geometry.resting else None
            made = made or MoverMaps(frame, p.mover_maps, p.mover_resolution)
            made.draw(points, box, p.cull)
            return made

        shown = frame.geometry.version, points.tobytes()
        movers = frame.product("mover maps", "mover maps", shown, draw).pool
        with frame.timed("mover tests"):
            inputs = [
                gbuffer,
                kept.pool,
                movers,
                maps,
                p.device_bias,
                mover_reach(frame.light, box.low, box.high),
                p.even,
            ]
            frame.launch(ADD_MOVERS, visibility.shape, inputs, [visibility, error])

    def _steps(self, frame: Frame, kept: KeptMaps, plan: Schedule, has_history: bool) -> PoolSteps:
        p = self.params
        still = kept.still_frames(frame) > 0
        # sums of other casters' maps are as good where those that came to rest, or left it, cast nothing
        tests, limit = p.tests, float(kept.maps if kept.restarted else plan.filled)
        if plan.fills and (plan.added or still):  # every map counts once, and the time is needed to draw it
            tests = plan.added
        if plan.refines:
            tests, limit = plan.added, NO_LIMIT
        return filled(
            PoolSteps,
            bias=p.device_bias,
            head=plan.head,
            filled=plan.filled,
            tests=tests,
            new_tests=p.new_tests,
            limit=limit,
            even=p.even,
            clip=0.0 if still else p.clip,  # where the eye stands still nothing drifts
            has_history=int(has_history),
            depth_epsilon=p.depth_epsilon * frame.span,
        )
