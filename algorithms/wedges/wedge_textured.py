"""Penumbra wedges of rectangles with a texture (Assarsson et al. 2003, sections 4.2.2 and 6).

As ``wedge_rectangular``, but that the share beyond an edge is that of the texture's light: ``coverage: exact``
integrates it, constant in each texel, over the region beyond the edge; ``table`` reads the published four-dimensional
table of 32 steps for each coordinate of both ends, 1 MB, and is off by what ends move within a step.

Where the texture is constant, the analytic share is the same and is taken.

Deviations: as ``wedge_spherical``. Textures are luminance, as everywhere here, so that one table does.
Known artefacts: as there. A surface that hides a part of the light by its own plane hides it by area, not by the
texture's light.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp

from algorithms.technique import Needs, setting
from algorithms.wedges._wedges import WedgeParams, WedgeTechnique, see_parts
from wkernels.casters.wedges.passes import Prepared, Stage, see_by_wedges, see_textured
from wkernels.casters.wedges.textures import LightTexture, light_texture
from wkernels.frame.light_side import LIGHT_TEXTURE
from wkernels.scene.lights import Light, RectangleLight
from wkernels.workspace.workspace import Workspace


class WedgeTextured(WedgeTechnique):
    """Edges over a picture."""

    name = "wedge_textured"
    paper = ("assarsson2003",)
    needs = Needs(whole_casters=True, lights=frozenset({"rectangle", "point"}))
    bias_sign = "none"

    class Params(WedgeParams):
        """Where shares of the texture come from."""

        coverage: Literal["exact", "table"] = setting(
            "exact", "integrated, or from the table of 32^4 bytes", unit="kind", source="Assarsson 2003, sec. 6: table"
        )

    def see(self, stage: Stage, light: Light, visibility_out: wp.array) -> None:
        texels = light.texture if isinstance(light, RectangleLight) else None
        constant = texels is None or np.ptp(texels) == 0.0

        def see(prepared: Prepared, part: Light, out: wp.array) -> None:
            if constant:
                see_by_wedges(prepared, out)
                return
            values = np.asarray(texels, np.float64)
            see_textured(prepared, _pull_texture(stage.work, values, self.params.coverage == "table"), out)

        see_parts(stage, light, 1, see, visibility_out)


def _pull_texture(work: Workspace, values: np.ndarray, stored: bool) -> LightTexture:
    key = (values.shape, values.tobytes(), stored)
    out: LightTexture = work.product(LIGHT_TEXTURE, LIGHT_TEXTURE, key, lambda old: light_texture(work, values, stored))
    return out
