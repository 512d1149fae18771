"""Penumbra wedges of spheres, discs and the sun (Assarsson et al. 2003; Schwaerzler 2009, section 4.12).

1. Silhouettes as the light's centre sees them, found once for light and casters; hard shadow volumes are counted
   behind what is seen (``shadow_volume_zfail``): how many faces hide the centre from each pixel.
2. Each silhouette edge matters to points from which it lies before the light: within its penumbra wedge. Wedges are
   listed in tiles of pixels; of a list those that lie before or behind all that the tile shows are left out.
3. A pixel goes through its tile's list. It sees the light as a disc of radius 1; the edge is clipped to the cone from
   the pixel to the disc, then projected. The share of the disc between the rays from its centre through the edge's
   ends, less the triangle of these, lies beyond the edge. In the inner half of the wedge, where the edge passes the
   centre counter-clockwise, that share is visible all the same and is added; in the outer half it is hidden and taken
   away.
4. Visibility is 1 less the faces before the centre, plus the sum of shares, kept within [0, 1].

For one silhouette loop that is exact, inside and outside of the hard shadow.

Deviations: a wedge is the hull of the edge and the directions in which the light is mirrored at its ends, which is
tighter than the published wedge. All lies on tiles and lanes of pixels, there is no stencil and no order. Pixels next
to a hard volume's side are counted again by the wedges' own edges (``casters.wedges.recounting``). A surface that casts
shows no more of the light than lies before its own plane. Edges are clipped at the light too, so that it may be within
the casters' box. Casters need not be closed, as for ``shadow_volume_zpass``.
Known artefacts: casters that overlap on the light, and parts of one that is not convex, take the same part away twice,
too dark (``overlap: probabilistic`` halves it between casters); silhouettes are those of the centre, so that a caster
that shows other sides to other points of the light has a penumbra too narrow or too wide; spheres count as discs, 0.5 %
too small at ten radii and 6 % at three.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Needs
from algorithms.wedges._wedges import SummedParams, WedgeTechnique, see_parts, see_summed
from wkernels.casters.wedges.passes import Stage
from wkernels.scene.lights import Light


class WedgeSpherical(WedgeTechnique):
    """Edges over a disc."""

    name = "wedge_spherical"
    paper = ("assarsson2003", "schwaerzler2009")
    needs = Needs(whole_casters=True, lights=frozenset({"sphere", "disc", "directional", "point"}))
    bias_sign = "none"
    Params = SummedParams

    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        see_parts(stage, light, 1, lambda prepared, _, out: see_summed(prepared, self.params, out), visibility_out)
