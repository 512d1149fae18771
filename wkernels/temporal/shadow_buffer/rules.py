"""What is done with a frame's shadow tests: small structs, each made whole (``filled``) and not changed.

Sources: Scherzer et al. 2009, sections 3.1 to 3.4; Schwaerzler 2009, section 5.2 and appendix A. What they differ in is
a value here.
"""

from __future__ import annotations

import warp as wp

from wkernels.light_maps.light_map import Bias
from wkernels.temporal.sample_window import SampleWindow
from wkernels.temporal.shadow_buffer.recall import Recall
from wkernels.temporal.shadow_buffer.start import Start

DISOCCLUDE, AT_ONCE, GRADUAL = wp.constant(0), wp.constant(1), wp.constant(2)
"""What becomes of sums gathered under the shadow of a moving caster, where every frame starts anew: they are not stored
at all; stored, tagged and dropped in the first frame without that shadow; or faded out from there on."""


@wp.struct
class MoverRule:
    """What becomes of shadows that moving casters cast."""

    tagged: int  # 1: the maps tell which casters move
    treatment: int  # DISOCCLUDE, AT_ONCE or GRADUAL
    decrement: float  # for GRADUAL: by how much n falls a frame, tests of further lights included


@wp.struct
class Counting:
    """For how long a test counts."""

    window: SampleWindow
    light_window: float  # tests that count where the light moves, ``age_sums``; 0: all do
    limit: float  # largest n that a texel holds, ``add_test``


@wp.struct
class BlockerMean:
    """How one more blocker joins the mean blocker depth, equation 7."""

    first_blockers: float  # k: what those of the start count for
    counts_tests: int  # 1: as printed; 0: only shadowed tests are behind the mean


@wp.struct
class Smoothing:
    """Which pixels ask for a neighbourhood, and how wide."""

    asks: int
    narrows: int  # 1: in proportion to the error that is left
    half_widths: float  # radius in penumbra widths
    error_threshold: float  # t, s_min: smoothed from this standard error up
    least_samples: float  # smoothed below this n


@wp.struct
class UpdateRules:
    """All of it, in the order in which a pixel asks."""

    bias: Bias
    light_corners: wp.array(dtype=wp.vec4)  # of its hull: what turns away from all of it is dark at once; none: tested
    recall: Recall
    movers: MoverRule
    start: Start
    mean: BlockerMean
    counting: Counting
    smoothing: Smoothing


@wp.struct
class SampledLight:
    """One light's part in a frame."""

    weight: float  # of its sample
    size: float  # L: scene units, or 2 tan(angle / 2)
    is_last: int  # 1: no other light joins the frame's sums
