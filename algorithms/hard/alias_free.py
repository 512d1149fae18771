"""Alias-free hard shadows by an irregular z-buffer (Aila and Laine 2004; Johnson et al. 2005; named by Stingl 2011).

A shadow map samples the light's view on a grid of its own, which is where jagged edges and biases come from. Here the
eye's pixels are the samples: each receiver is projected into the light's view and sorted into a cell of a grid fitted
to all of them; every caster is drawn into the cells that it touches, and the samples there are tested against the
triangle itself: inside its three edges as the light sees them, and on the far side of its plane. The grid only decides
how much there is to test, so there is no resolution in the result and no bias. Soft lights are reduced to their centre.

Deviations: the papers are cited for the idea, and this entry is our own specification of it. Samples lie in sorted runs
instead of linked lists or a tree, a light within the scene has six grids of its own, and triangles are tested in the
order in which they come. Receivers are lifted off their surface by their rounding error, as shadow rays start; where
float32 cannot tell the side of an edge, a sample counts as inside, where it cannot tell the side of the plane, as lit.
Known artefacts: none of its own; facets of smooth bodies shadow each other at the terminator, as their triangles do.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Frame, Limit, Needs, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.irregular.hidden import find_hidden
from wkernels.workspace.products import Product


class AliasFree(Technique):
    """Every pixel is a sample of the light's view."""

    name = "alias_free"
    family = "hard"
    paper = ("aila2004", "johnson2005", "stingl2011")
    needs = Needs(whole_casters=True)
    products = (Product.G_BUFFER,)
    bias_sign = "none"
    limits = (Limit(equals="ray_cast_point_shadow", tolerance=1e-6, flips=0.001),)

    class Params(BaseParams):
        """The grid that samples are sorted into."""

        resolution: int = setting(
            256,
            "cells per side of each of the light's grids; changes the cost, not the image",
            unit="cells",
            source="fastest on paris, winter and overlap at 640 x 360",
            ge=1,
            le=4096,
        )

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        find_hidden(frame, frame.geometry, frame.light.centre, gbuffer, self.params.resolution, visibility)
        return visibility
