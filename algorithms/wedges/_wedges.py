"""What the techniques of penumbra wedges share: a stage of passes from a frame, lights without an area."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import warp as wp

from algorithms.technique import Frame, Limit, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.casters.volume_counts import Uncounted
from wkernels.scene.lights import Light
from wkernels.wedges.bodies import WedgeRule
from wkernels.wedges.passes import Stage, see_hard
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


class WedgeTechnique(Technique):
    """Hard shadow volumes from the light's centre, corrected edge by edge."""

    family = "wedges"
    products = (
        Product.G_BUFFER,
        Product.CASTER_EDGES,
        Product.SILHOUETTES,
        Product.VOLUMES,
        Product.RAY_STRUCTURE,
    )
    may_leave_out: ClassVar[tuple[Omission, ...]] = (Uncounted.BESIDE, Skip.WEDGES)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="shadow_volume_zfail", light_scale=0.0),)

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
            frame.caster_mesh(),
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
