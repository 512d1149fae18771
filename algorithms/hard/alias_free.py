"""Hard shadows without a shadow map's samples: the irregular z-buffer (Aila and Laine 2004; Johnson et al. 2005).
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Limit, Params, Technique, setting
from wkernels.frame import Session as Frame
from wkernels.irregular import find_hidden


class AliasFree(Technique):
    """Every pixel is a sample of the light's view."""

    name = "alias_free"
    family = "hard"
    paper = ("aila2004", "johnson2005")
    bias_sign = "none"
    limits = (Limit(equals="ray_cast_point_shadow", tolerance=1e-6, flips=0.001),)

    class Params(Params):
        """The grid that samples are sorted into."""

        resolution: int = setting(512, "cells per side of the light's grid", unit="cells", source="measured", ge=1, le=8192)

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        find_hidden(frame, gbuffer, self.params.resolution, visibility)
        return visibility
