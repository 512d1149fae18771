"""What techniques share that keep a shadow buffer: their parameters' way into ``temporal.shadow_buffer``."""

from __future__ import annotations

from typing import ClassVar

from algorithms.technique import Frame, Needs, Technique
from wkernels.device.structs import filled
from wkernels.sampling.estimators import FLOAT32_LIMIT, UNLIMITED
from wkernels.temporal.sample_window import SampleWindow
from wkernels.temporal.shadow_buffer.many_lights import Lights, light_window
from wkernels.temporal.shadow_buffer.mover_shadow import MoverMap, add_mover_shadows, needs_own_map
from wkernels.temporal.shadow_buffer.own_umbra import pull_light_corners
from wkernels.temporal.shadow_buffer.recall import Recall, recall_from
from wkernels.temporal.shadow_buffer.record import storage_of
from wkernels.temporal.shadow_buffer.rules import (
    AT_ONCE,
    DISOCCLUDE,
    GRADUAL,
    BlockerMean,
    Counting,
    MoverRule,
    Smoothing,
    UpdateRules,
)
from wkernels.temporal.shadow_buffer.start import Start
from wkernels.temporal.shadow_buffer.step import ShadowStep, StepSkip, add_samples, begin_step, is_settled, keep_views
from wkernels.workspace.left_out import Omission
from wkernels.workspace.products import Product

MOVERS = {"disocclude": DISOCCLUDE, "at_once": AT_ONCE, "gradual": GRADUAL, "ignore": DISOCCLUDE}
"""Treatment of moving casters' shadows by name; to ``ignore`` them no map is tagged."""
SKIPS: tuple[Omission, ...] = (
    Lights.BLACK_LIGHT,
    StepSkip.UNTAGGED,
    StepSkip.UNSMOOTHED,
    StepSkip.SETTLED,
    MoverMap.NO_MOVERS,
)


class ShadowBufferTechnique(Technique):
    """One light sample a frame and a shadow buffer; what starts, and what is shown, is the technique's own."""

    family = "temporal"
    needs = Needs(area=True, history=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "no texel falls on a receiver in whose plane the light lies"
    }
    bias_sign = "none"
    products = (Product.G_BUFFER, Product.LIGHT_MAP, Product.LIGHT_SAMPLES, Product.HISTORY)

    def leaves_out(self) -> tuple[Omission, ...]:
        p = self.params
        never = {MoverMap.NO_MOVERS: p.mover_map == "none", StepSkip.SETTLED: p.stop_error == 0.0}
        return tuple(omission for omission in self.may_leave_out if not never.get(omission, False))

    def begin(self, frame: Frame) -> ShadowStep:
        """The frame's buffers, lights and maps."""
        p = self.params
        # old shadows of movers that nothing tags would come back with an earlier view
        untagged = p.movers == "ignore" and p.mover_map == "none" and frame.geometry.casters_move
        return begin_step(
            frame,
            overscan=p.overscan,
            format=p.buffer,
            lights=p.lights,
            apart=p.mover_map != "none" and needs_own_map(frame),
            keeps_buffers=p.kept_views > 1 and not untagged,
        )

    def is_settled(self, frame: Frame, step: ShadowStep) -> bool:
        """Whether the last frame's picture stands."""
        return is_settled(frame, step, self.params.stop_error, self.params.stop_samples)

    def add_samples(
        self,
        frame: Frame,
        step: ShadowStep,
        *,
        start: Start,
        mean: BlockerMean,
        smoothing: Smoothing,
        epsilon: float = 0.0,
        relative: float = 0.0,
    ) -> None:
        """Adds this frame's tests to what pixels remember.

        Args:
            frame: The session. step: The frame's. start, mean, smoothing: As ``rules`` has them.
            epsilon: Largest difference of depth of a point and its history, scene units. relative: The same as a share
                of the depth.
        """
        p = self.params
        turned_away = p.turned_away == "dark" and len(step.seen) == 1
        rules: UpdateRules = filled(
            UpdateRules,
            bias=p.device_bias,
            # what turns away from one light may face another: their tests tell
            light_corners=pull_light_corners(frame, frame.lights.lights[step.seen[0]]) if turned_away else None,
            recall=self.recall(frame, step, epsilon, relative),
            movers=self.mover_rule(frame, step),
            start=start,
            mean=mean,
            counting=self.counting(frame, step),
            smoothing=smoothing,
        )
        add_samples(frame, step, rules, resolution=p.resolution, sample_set=p.sample_set, cull=p.cull)
        keep_views(frame, step, p.kept_views - 1, p.kept_overlap)

    def add_movers(self, frame: Frame, step: ShadowStep) -> None:
        """Adds the shadows of movers to what is shown, where they have a map of their own."""
        p = self.params
        if step.apart:
            add_mover_shadows(
                frame,
                step.gbuffer,
                step.visibility,
                step.error,
                resolution=p.resolution,
                cull=p.cull,
                bias=p.device_bias,
                taps=p.mover_taps,
                overlap=p.mover_overlap,
            )

    def recall(self, frame: Frame, step: ShadowStep, epsilon: float, relative: float) -> Recall:
        """Where history is looked for; arguments as for ``add_samples``."""
        p = self.params
        return recall_from(
            frame,
            step.history,
            step.shelf.on_device if step.shelf else None,
            reading=p.history,
            epsilon=epsilon,
            relative=storage_of(p.buffer).rounding + relative,
            followed_samples=p.mover_samples if p.mover_surfaces == "own_motion" else 0.0,
        )

    def mover_rule(self, frame: Frame, step: ShadowStep) -> MoverRule:
        """What becomes of movers' shadows."""
        p = self.params
        tags = not step.apart and p.movers != "ignore"
        if tags and not frame.geometry.casters_move:
            tags = not frame.leave_out(StepSkip.UNTAGGED)
        # net of all lights' tests
        joined = sum(turn.weight for turn in step.turns[1:])
        return filled(
            MoverRule, tagged=int(tags), treatment=int(MOVERS[p.movers]), decrement=p.mover_decrement + joined
        )

    def counting(self, frame: Frame, step: ShadowStep) -> Counting:
        """For how long tests count."""
        p, then = self.params, step.history.previous_index
        window = filled(
            SampleWindow,
            largest=p.largest_n if p.largest_n < FLOAT32_LIMIT else UNLIMITED,
            agreement=p.agreement,
            least=p.least_window,
        )
        frames = 0.0
        if then is not None:
            frames = light_window(frame, step.seen, then, p.ageing, p.age_factor, p.age_displacement)
        tests = sum(turn.weight for turn in step.turns)
        return filled(Counting, window=window, light_window=frames * tests, limit=storage_of(p.buffer, p.cap).limit)
