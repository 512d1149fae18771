"""Penumbra wedges of rectangles (Assarsson et al. 2003, sections 4.1, 4.2.2, 5; Schwaerzler 2009, section 4.12).

As ``wedge_spherical``, but that a pixel sees the light as a square: the light's plane is the near plane of a projection
from the pixel, edges are clipped to its four sides before they are divided, and the sector between two rays from the
centre is half the way between them along the border. No arc tangent is needed.

``wedge``: ``tight`` wedges are pyramids, which the rectangle's corners mirrored at the edge's ends make;
``sphere_bounded`` ones enclose its bounding sphere instead, as in the authors' earlier work. ``light_split: n`` cuts
the light into n x n, each with silhouettes of its own, and takes the mean of what they show.

Deviations: as ``wedge_spherical``.
Known artefacts: as there but for the disc. Both errors fall with every further cut; the cost grows with n x n, though
less, as wedges become thin.
"""

from __future__ import annotations

from typing import Literal

import warp as wp

from algorithms.technique import Needs, setting
from algorithms.wedges._wedges import SummedParams, WedgeTechnique, see_parts, see_summed
from wkernels.casters.wedges.bodies import WedgeRule
from wkernels.casters.wedges.passes import Stage
from wkernels.scene.lights import Light


class WedgeRectangular(WedgeTechnique):
    """Edges over a square."""

    name = "wedge_rectangular"
    paper = ("assarsson2003", "schwaerzler2009")
    needs = Needs(whole_casters=True, lights=frozenset({"rectangle", "point"}))
    bias_sign = "none"

    class Params(SummedParams):
        """Wedges, and parts of the light."""

        wedge: Literal["tight", "sphere_bounded"] = setting(
            "tight",
            "around what wedges are: the rectangle, or its bounding sphere; changes the cost, not the picture",
            unit="kind",
            source="Assarsson 2003, sec. 4.1",
        )
        light_split: int = setting(
            1,
            "parts of the light along each side, each with silhouettes of its own",
            unit="parts",
            source="Assarsson 2003, sec. 5.2",
            ge=1,
            le=16,
        )

    @property
    def rule(self) -> WedgeRule:
        return "tight" if self.params.wedge == "tight" else "sphere_bounded"

    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        see_parts(
            stage,
            light,
            self.params.light_split,
            lambda prepared, _, out: see_summed(prepared, self.params, out),
            visibility_out,
        )
