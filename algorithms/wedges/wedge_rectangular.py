"""Penumbra wedges of rectangles.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Needs
from algorithms.wedges._wedges import WedgeParams, WedgeTechnique
from wkernels.scene.lights import Light
from wkernels.wedges.passes import Stage, prepare, see_by_wedges


class WedgeRectangular(WedgeTechnique):
    """Edges over a square."""

    name = "wedge_rectangular"
    paper = ("assarsson2003", "schwaerzler2009")
    needs = Needs(lights=frozenset({"rectangle", "point"}))
    bias_sign = "darker"
    Params = WedgeParams

    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        if (prepared := prepare(stage, light)) is not None:
            see_by_wedges(prepared, visibility_out)
