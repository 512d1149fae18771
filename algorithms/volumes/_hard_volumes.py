"""What both counts of hard shadow volumes share: from a light's centre to visibility."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import warp as wp

from algorithms.technique import Frame, Limit, Needs, Technique
from wkernels.casters.volume_counts import Uncounted, VolumeRule, count_volumes
from wkernels.casters.volume_stencil import darken_in_volumes
from wkernels.workspace.left_out import Omission
from wkernels.workspace.products import Product


class HardVolumes(Technique):
    """Counts the faces of the volumes behind all casters, as seen from the light's centre."""

    family = "volumes"
    hard = True
    needs = Needs(whole_casters=True)
    products = (Product.G_BUFFER, Product.CASTER_EDGES, Product.SILHOUETTES, Product.VOLUMES)
    may_leave_out: ClassVar[tuple[Omission, ...]] = (Uncounted.BESIDE,)
    limits: ClassVar[tuple[Limit, ...]] = (Limit(equals="ray_cast_point_shadow", tolerance=1e-6, flips=0.002),)

    @property
    @abstractmethod
    def rule(self) -> VolumeRule:
        """How faces are counted."""

    @property
    def negative_hides(self) -> bool:
        """Whether counts below 0, which a z-pass with the eye in shadow has, are taken for shadow."""
        return False

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        light_ws = frame.light.centre
        counts = count_volumes(frame, frame.rasteriser, frame.geometry, gbuffer, frame.eye(), light_ws, self.rule)
        visibility.fill_(1.0)
        darken_in_volumes(frame, gbuffer, counts, light_ws, visibility, self.negative_hides)
        return visibility
