"""Several lights in one shadow buffer: what they weigh, which one is drawn, and how one more joins a frame's sums.

Source: Scherzer et al. 2009, section 5: "a shadow map for each light source each frame", rho and n gathered from all of
them. Equal weights are right for equal lights only; here a light weighs its radiance. The buffer then holds the hidden
share of all lights together, psi = sum w_l psi_l of weights that sum to 1.

Tests of one frame that weigh w_l are worth 1 / sum w_l^2 equal ones (the effective number, sum of weights squared over
sum of squares): that is by how much n grows a frame, from 1 for a single light to L for L equal ones.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.filters.neighbourhood_filter import pixels_per_length
from wkernels.filters.penumbra import LightFootprint, penumbra_ratio
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import LightMap, locate
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.estimators import add_test, hidden_share, standard_error
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.light_motion import ageing_window, displacement
from wkernels.scene.lights import Light
from wkernels.temporal.shadow_buffer.record import (
    TEXEL_TYPES,
    ShadowRecord,
    read_record,
    refine_blocker,
    shadow_test,
    write_record,
)
from wkernels.temporal.shadow_buffer.rules import DISOCCLUDE, SampledLight, UpdateRules
from wkernels.temporal.shadow_buffer.update import FULL_WIDTH_ERROR
from wkernels.workspace.left_out import Omission

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec. 709 colours (ITU-R BT.709)


class Lights(Omission):
    """What a light saves."""

    BLACK_LIGHT = ("light depth map", "the light is black")


GOLDEN = 0.6180339887498949


def light_weights(lights: Sequence[Light]) -> np.ndarray:
    """What each light's visibility weighs in that of all: its share of their luminance; float64 (L,), sum 1.

    Equal where all are black.
    """
    bright = np.array([light.radiance for light in lights], float) @ LUMINANCE
    return bright / bright.sum() if bright.sum() > 0.0 else np.full(len(lights), 1.0 / len(lights))


def drawn_light(weights: np.ndarray, frame: int) -> int:
    """The light whose map a frame draws if it draws one: each as often as it weighs, evenly spread over the frames.

    A test of it then weighs w_l / p_l = 1.
    """
    return int(np.searchsorted(np.cumsum(weights)[:-1], np.mod(0.5 + GOLDEN * frame, 1.0), side="right"))


@dataclass(frozen=True)
class LightTurn:
    """One light's map in a frame.

    Attributes:
        light: Whose it is, rebased world.
        weight: Of a test in it: by how much n grows.
        slot: What tells the map from those of other turns.
    """

    light: Light
    weight: float
    slot: Hashable


def seen_lights(frame: Session, lights: str) -> list[int]:
    """The lights that psi is of: the one that is ``asked`` for, or else all."""
    return [frame.lights.index] if lights == "asked" else list(range(len(frame.lights.lights)))


def light_turns(frame: Session, seen: Sequence[int], lights: str) -> list[LightTurn]:
    """Whose maps a frame draws for a psi of these lights: one that is ``drawn``, or of each, the brightest first."""
    held = [frame.lights.lights[i] for i in seen]
    if len(held) == 1:
        return [LightTurn(held[0], 1.0, "centre")]
    weights = light_weights(held)
    if lights == "drawn":
        return [LightTurn(held[drawn_light(weights, frame.count)], 1.0, "centre")]
    worth = 1.0 / float((weights**2).sum())
    order = [int(i) for i in np.argsort(-weights, kind="stable")]
    order = [i for i in order if weights[i] > 0.0 or not frame.leave_out(Lights.BLACK_LIGHT)]
    return [LightTurn(held[i], float(weights[i]) * worth, i) for i in order]


def light_window(frame: Session, seen: Sequence[int], then: int, ageing: str, factor: float, reach: float) -> float:
    """``ageing_window`` since frame ``then``, in frames: as the one of these lights that has gone furthest wants it."""
    moved = max(displacement(frame.lights.lights[i], frame.lights.at(then, i)) for i in seen)
    return ageing_window(moved, ageing, factor, reach)


@wp.kernel
def join_light(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    footprint: LightFootprint,
    rules: UpdateRules,
    light: SampledLight,
    texels_out: wp.array2d(dtype=Any),
    psi_depth_out: wp.array2d(dtype=wp.vec2),
    error_out: wp.array2d(dtype=float),
    half_width_out: wp.array2d(dtype=float),
):
    """One more light's test, added to what the first one's update of this frame has written.

    Args:
        first: Tile offset.
        gbuffer: Receivers, (H, W).
        light_map: Depths from this light's sample of the frame.
        footprint: The light in that map.
        rules: As for ``update_shadow_buffer``.
        light: Whose sample it is.
        texels_out: This frame's texels, in and out.
        psi_depth_out: Hidden share and linear eye depth, out.
        error_out: Its standard error, out.
        half_width_out: In and out: the widest penumbra's counts.
    """
    row, x = wp.tid()
    y = first + row
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        record = read_record(texels_out, y, x, gbuffer.view.far)
        test = shadow_test(gbuffer, y, x, light_map, rules.bias)
        if test.blocker_rise > 0.0:
            known = wp.where(rules.mean.counts_tests != 0, record.n, record.rho) + rules.mean.first_blockers
            record.blocker_rise = refine_blocker(record.blocker_rise, test.blocker_rise, known)
        sums = add_test(record.rho, record.n, test.tau, light.weight, rules.counting.limit)
        record.rho = sums[0]
        record.n = sums[1]
        psi = hidden_share(record.rho, record.n)
        error = standard_error(psi, record.n)
        half_width = float(0.0)
        is_uncertain = record.n < rules.smoothing.least_samples or error > rules.smoothing.error_threshold
        if rules.smoothing.asks != 0 and is_uncertain and record.blocker_rise > 0.0:
            depth = locate(light_map, position_ws)[2]
            ratio = penumbra_ratio(footprint.is_point, depth, depth * (1.0 - record.blocker_rise))
            own = rules.smoothing.half_widths * light.size * ratio * pixels_per_length(gbuffer.view, record.depth)
            if rules.smoothing.narrows != 0:
                own = own * wp.min(1.0, error / FULL_WIDTH_ERROR)
            widest = wp.max(wp.abs(half_width_out[y, x]), own)
            half_width = wp.where(half_width_out[y, x] < 0.0, -widest, widest)
        if rules.movers.tagged != 0:
            if test.moves != 0:
                record.of_mover = 1
            if light.is_last != 0 and record.of_mover != 0 and rules.movers.treatment == DISOCCLUDE:
                depth_vs = record.depth
                record = ShadowRecord()
                record.depth = depth_vs
        write_record(texels_out, y, x, record, gbuffer.view.far)
        psi_depth_out[y, x] = wp.vec2(psi, gbuffer.depth[y, x])
        error_out[y, x] = error
        half_width_out[y, x] = half_width


JOIN = {texel: wp.overload(join_light, {"texels_out": wp.array2d(dtype=texel)}) for texel in TEXEL_TYPES.values()}
"""The kernel by texel type."""
