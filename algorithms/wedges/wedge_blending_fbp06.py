"""Penumbra wedges over a light in cells, so that penumbrae that overlap are blended (Forest, Barthe and Paulin 2006).

As ``wedge_spherical`` and ``wedge_rectangular`` up to the sum. There is none: the light is cut into 8 x 8 cells, and
the faces before each cell's middle are counted. What two casters hide both is hidden once.

Deviations: of the paper the abstract was at hand; cells and counts are this project's specification of "computes the
light's occluded regions, detects overlapping penumbrae and blends them" (after Schwaerzler 2009, section 4.12).
Known artefacts: visibility in steps of 1/64, of a disc 1/52; silhouettes are those of the light's centre.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Needs
from algorithms.wedges._wedges import WedgeParams, WedgeTechnique, see_parts
from wkernels.casters.wedges.passes import Stage, see_cells
from wkernels.scene.lights import Light


class WedgeBlendingFbp06(WedgeTechnique):
    """Edges over 64 cells."""

    name = "wedge_blending_fbp06"
    paper = ("forest2006", "schwaerzler2009")
    needs = Needs(whole_casters=True, lights=frozenset({"rectangle", "sphere", "disc", "directional", "point"}))
    bias_sign = "none"
    Params = WedgeParams

    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        see_parts(stage, light, 1, lambda prepared, _, out: see_cells(prepared, out), visibility_out)
