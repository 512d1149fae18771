"""A torus knot about y, one closed tube: a detailed caster that shadows itself."""

from __future__ import annotations

from math import gcd
from typing import Annotated

from pydantic import Field

from experiments.scenes.generators._shapes import sampling_of, torus_knot_tube
from wkernels.scene.model import Mesh


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=2_000, le=4_000_000)] = 12_000,
    radius: Annotated[float, Field(gt=0)] = 1.0,
    thickness: Annotated[float, Field(gt=0)] = 0.16,
    p: Annotated[int, Field(ge=1, le=20)] = 2,
    q: Annotated[int, Field(ge=1, le=20)] = 3,
) -> list[Mesh]:
    """Builds the knot; it is the same for every seed.

    Args:
        seed: Accepted as by every generator.
        triangles: Target of the total.
        radius: Of the circle that the knot winds around; the knot reaches half of it further out.
        thickness: Radius of the tube.
        p: Turns about the axis.
        q: Turns through the hole. A common divisor of p and q is taken out, it would only repeat the curve.
    """
    common = gcd(p, q)
    segments, sides = sampling_of(triangles, 24.0)
    tube = torus_knot_tube(radius, 0.5 * radius, thickness, p // common, q // common, segments, sides)
    return [Mesh("torus_knot", *tube, diffuse=(0.78, 0.55, 0.25))]
