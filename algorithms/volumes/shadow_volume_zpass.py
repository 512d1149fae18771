"""Shadow volumes counted before what is seen: z-pass (Crow 1977; Heidmann 1991; Schwaerzler 2009, section 2.3.2).

1. The silhouette of each caster, seen from the light's centre: edges between a face that is turned to the light and one
   that is not. It is found once for light and casters, not per frame.
2. Each silhouette edge sweeps a side away from the light, to infinity.
3. In each pixel every side before what is seen adds 1 where it is turned to the eye, and takes 1 away where not: the
   volumes that the eye's ray has entered and not left. A pixel is lit where the count is none.

The count begins at the near plane as if it were lit. Where the eye is in shadow, or the near plane cuts a volume, all
pixels behind lack what the ray had entered before: ``shadowed`` says what their negative counts mean. Schwaerzler 2009
has "larger than zero" for shadow, with which the eye's own shadow is lost and nothing else; Assarsson et al. 2003,
section 2, "anything else" than zero, with which light and that shadow change places. ``volume: per_caster`` heals it:
casters of whose volumes something may lie at the near plane are counted behind what is seen, as ``shadow_volume_zfail``
does (Everitt and Kilgard 2002); all others still by z-pass, to the same bits. With ``volume: zpass`` such casters are
counted and told among what a frame leaves out.

Casters need not be closed. Of a body that is (two faces at every edge, which agree on the outside) the lit faces count;
of all others both sides, and every edge by the difference of what meets there, so that all volumes are closed (Kim et
al. 2008; ``casters.silhouettes``). Faces without an area or with a corner that is no number cast nothing.

Deviations: the light's centre stands for soft lights. A light inside a body is hidden by it from all outside.
Known artefacts: with ``volume: zpass``, all of the above for an eye in shadow. Receivers within a body that intersects
itself so that parts of it are inside out may lose its shadow. Along edges of shadows a pixel in a thousand differs from
a ray's answer, as corners are drawn on a grid of 1/256 pixel.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from algorithms.technique import ExpectedFailure, setting
from algorithms.technique import Params as BaseParams
from algorithms.volumes._hard_volumes import HardVolumes
from wkernels.casters.volume_counts import Uncounted, VolumeRule
from wkernels.workspace.left_out import Omission


class ShadowVolumeZpass(HardVolumes):
    """Front faces less back faces before what is seen."""

    name = "shadow_volume_zpass"
    paper = ("crow1977", "heidmann1991", "schwaerzler2009", "assarsson2003", "everitt2002", "kim2008")
    bias_sign = "lighter"
    may_leave_out = (Uncounted.BESIDE, Uncounted.AT_EYE)
    expected_failures = (
        ExpectedFailure(
            check="behind_an_opaque_slab_all_is_dark",
            because="the eye is behind the slab too, in its volume",
            message=r"^up to 1\.0 under",
        ),
    )
    stability_limits: ClassVar[dict[str, str]] = {
        "eye_place": "z-pass takes the near plane for lit: an eye in a volume, or a near plane that cuts it, miscounts",
        "light_before_eye": "the eye looks into the light from within a shadow",
        "light_place": "of a body that holds the light all outside is its volume, the eye too",
    }

    class Params(BaseParams):
        """How volumes are counted, and what counts mean."""

        volume: Literal["zpass", "per_caster"] = setting(
            "zpass",
            "zpass for all casters, or z-fail for those whose volumes may lie at the near plane",
            unit="kind",
            source="Crow 1977",
        )
        shadowed: Literal["positive", "nonzero"] = setting(
            "positive",
            "which counts are shadow; they differ for an eye in shadow only",
            unit="counts",
            source="Schwaerzler 2009, sec. 2.3.2 (positive); Assarsson 2003, sec. 2 (nonzero)",
        )

    def leaves_out(self) -> tuple[Omission, ...]:
        return self.may_leave_out if self.params.volume == "zpass" else (Uncounted.BESIDE,)

    @property
    def rule(self) -> VolumeRule:
        return "zpass" if self.params.volume == "zpass" else "per_caster"

    @property
    def negative_hides(self) -> bool:
        return bool(self.params.shadowed == "nonzero")
