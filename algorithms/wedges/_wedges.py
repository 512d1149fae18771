"""What the techniques of penumbra wedges share: a stage of passes from a frame, lights without an area."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Literal

import warp as wp

from algorithms.technique import Frame, Limit, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.casters.volume_counts import Uncounted
from wkernels.casters.wedges.bodies import WedgeRule
from wkernels.casters.wedges.passes import (
    Prepared,
    Stage,
    add_part,
    prepare,
    see_by_wedges,
    see_casters_apart,
    see_hard,
)
from wkernels.casters.wedges.stored import StorageRule
from wkernels.scene.lights import Light, RectangleLight
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What a light without an area saves."""

    WEDGES = "penumbra wedges", Because.NO_AREA


class WedgeParams(BaseParams):
    """What every technique of wedges may be told."""

    culling: bool = setting(
        True,
        "wedges before or behind all that a tile shows are left out of its list; the picture is the same",
        unit="yes/no",
        source="Assarsson 2003, sec. 4.4",
    )


class SummedParams(WedgeParams):
    """How shares are found and summed."""

    coverage: Literal["analytic", "table"] = setting(
        "analytic",
        "computed, or from the published tables of 4 x 128 angles and 256 x 256 sectors",
        unit="kind",
        source="Assarsson 2003, sec. 6: table",
    )
    buffer: Literal["f32", "split12", "lut10", "bits6of8"] = setting(
        "f32",
        "what shares are summed in: float32; 12 bits over four 8-bit channels; 1024 values of these; 6 of 8 bits",
        unit="kind",
        source="Assarsson 2003, sec. 4.3: split12",
    )
    overlap: Literal["sum", "probabilistic"] = setting(
        "sum",
        "casters together, or each on its own and the greater cover merged with half of the lesser",
        unit="kind",
        source="Assarsson 2003, sec. 5.1, eq. 1",
    )


class WedgeTechnique(Technique):
    """Hard shadow volumes from the light's centre, corrected edge by edge."""

    family = "wedges"
    products = (
        Product.G_BUFFER,
        Product.CASTER_EDGES,
        Product.SILHOUETTES,
        Product.VOLUMES,
        Product.WEDGES,
        Product.RAY_STRUCTURE,
    )
    may_leave_out: ClassVar[tuple[Omission, ...]] = (Uncounted.BESIDE, Skip.WEDGES)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="shadow_volume_zfail", light_scale=0.0),)

    stability_limits: ClassVar[dict[str, str]] = {
        "light_grows": "silhouettes of the centre stand for a light wider than its distance, which sees other sides"
    }

    @property
    def rule(self) -> WedgeRule:
        """Around what wedges are."""
        return "tight"

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        stage = Stage(
            frame,
            frame.rasteriser,
            frame.geometry,
            gbuffer,
            frame.eye(),
            frame.caster_mesh().mesh,
            frame.reach,
            self.rule,
            self.params.culling,
        )
        if not frame.light.has_area:
            frame.leave_out(Skip.WEDGES)
            see_hard(stage, frame.light, visibility)
        else:
            self.see(stage, frame.light, visibility)
        return visibility

    @abstractmethod
    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        """Visibility of a light with an area, float32 (H, W)."""


def see_summed(prepared: Prepared, params: Any, visibility_out: wp.array) -> None:
    """Visibility by ``SummedParams``."""
    see = see_by_wedges if params.overlap == "sum" else see_casters_apart
    see(prepared, visibility_out, StorageRule(params.coverage, params.buffer))


def see_parts(
    stage: Stage,
    light: Light,
    split: int,
    see: Callable[[Prepared, Light, wp.array], None],
    visibility_out: wp.array,
) -> None:
    """Mean visibility of the parts of a light, a rectangle if there is more than one.

    Args:
        stage: Where.
        light: Rebased world.
        split: Parts along each side.
        see: Fills an image with the visibility of one part, given prepared.
        visibility_out: float32 (H, W).
    """
    parts = _cut(light, split)
    image = visibility_out
    if len(parts) > 1:
        image = stage.work.buffer("visibility of a part", visibility_out.shape, wp.float32)
    for i, part in enumerate(parts):
        if (prepared := prepare(stage, part, (split, i))) is None:
            see_hard(stage, part, image)
        else:
            see(prepared, part, image)
        if len(parts) > 1:
            stage.work.launch(add_part, image.shape, [image, 1.0 / len(parts), int(i == 0)], [visibility_out])


def _cut(light: Light, split: int) -> list[Light]:
    if split == 1 or not isinstance(light, RectangleLight):
        return [light]
    u, v = light.edge_u / split, light.edge_v / split
    middles = [(0.5 * (2 * i + 1 - split), 0.5 * (2 * j + 1 - split)) for j in range(split) for i in range(split)]
    return [replace(light, center=light.center + a * u + b * v, edge_u=u, edge_v=v, texture=None) for a, b in middles]
