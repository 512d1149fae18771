"""Shadow volumes counted behind what is seen: z-fail (Everitt and Kilgard 2002; Assarsson et al. 2003, section 2).

1. The silhouette of each caster, seen from the light's centre, found once for light and casters; each edge sweeps a
   side away from the light to infinity, as in ``shadow_volume_zpass``.
2. Caps close the volumes: at the caster, and infinitely far away, where positions p become directions p - l.
3. In each pixel every face behind what is seen adds 1 where it is turned away from the eye, and takes 1 away where not:
   the volumes that the eye's ray has still to leave. A pixel is lit where there is none.

What lies before what is seen does not count, so that the eye may be in shadow, or in a caster, and the near plane may
cut whatever it likes; the far plane cuts no volume.

``volume: per_caster`` counts casters by z-pass, without caps, where nothing of their volumes can be at the near plane:
where the caster's box does not meet the pyramid from the near plane's rectangle to the light. The picture is the same
to the bit.

Casters need not be closed; see ``shadow_volume_zpass``.

Deviations: the light's centre stands for soft lights. A light inside a body is hidden by it from all outside. Caps at
the caster count without a depth test: they are faces of the caster, which the picture shows, and so none lies before
what is seen. That keeps them from fighting with their own depths.
Known artefacts: receivers within a body that intersects itself so that parts of it are inside out may lose its shadow.
Along edges of shadows a pixel in a thousand differs from a ray's answer, as corners are drawn on a grid of 1/256 pixel.
"""

from __future__ import annotations

from typing import Literal

from algorithms.technique import Params as BaseParams
from algorithms.technique import setting
from algorithms.volumes._hard_volumes import HardVolumes
from wkernels.casters.volume_counts import VolumeRule


class ShadowVolumeZfail(HardVolumes):
    """Back faces less front faces behind what is seen."""

    name = "shadow_volume_zfail"
    paper = ("everitt2002", "assarsson2003")
    bias_sign = "none"

    class Params(BaseParams):
        """How volumes are counted."""

        volume: Literal["zfail", "per_caster"] = setting(
            "per_caster",
            "zfail for all casters, or z-pass for those of whose volumes nothing can be at the near plane",
            unit="kind",
            source="Everitt 2002",
        )

    @property
    def rule(self) -> VolumeRule:
        return "zfail" if self.params.volume == "zfail" else "per_caster"
