"""Shadow rays against the casters' triangles: the exact answers that everything else is measured by.

Origins are moved off their own surface by the rounding error of their position, towards the side that is seen; nothing
else is biased. A sample behind the seen side of a casting surface is hidden by that surface and needs no ray.
"""

from __future__ import annotations

import warp as wp

from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.rays.light_proofs import LightHull, proves_dark, proves_lit
from wkernels.rays.ray_casters import RayCasters, is_cut_hidden
from wkernels.sampling.estimators import standard_error
from wkernels.scene.geometry import RECEIVES

ORIGIN_ERROR = wp.constant(4.0e-6)  # relative to the coordinates and the eye distance: a few float32 roundings
PROBES = wp.constant(4)  # rays cast before a proof is tried: they say which one can succeed


@wp.func
def ray_origin(gbuffer: GBuffer, y: int, x: int):
    """The receiver point, lifted off its surface by its rounding error."""
    p = gbuffer.position_ws[y, x]
    size = wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.max(wp.abs(p[2]), wp.abs(gbuffer.depth[y, x])))
    return p + gbuffer.normal_ws[y, x] * (ORIGIN_ERROR * size)


@wp.func
def is_occluded(casters: RayCasters, origin_ws: wp.vec3, light_ws: wp.vec4, reach: float):
    """Whether any caster lies between a point and a light sample."""
    way = to_light(light_ws, origin_ws)
    length = wp.length(way)
    blocked = bool(False)
    if length > 0.0:
        end = wp.where(light_ws[3] > 0.0, length * (1.0 - 1.0e-6), reach)
        if casters.mesh != wp.uint64(0):
            blocked = wp.mesh_query_ray_anyhit(casters.mesh, origin_ws, way / length, end)
        if not blocked:
            blocked = is_cut_hidden(casters, origin_ws, way / length, end)
    return blocked


@wp.kernel
def trace_point(
    first: int,
    gbuffer: GBuffer,
    casters: RayCasters,
    light_ws: wp.vec4,
    reach: float,
    visibility_out: wp.array2d(dtype=float),
):
    """Hard visibility of one light sample, 0 or 1."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        if is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
        elif is_occluded(casters, ray_origin(gbuffer, y, x), light_ws, reach):
            visible = 0.0
    visibility_out[y, x] = visible


PROVEN_LIT, PROVEN_DARK, TRACED, NO_RECEIVER = wp.constant(1), wp.constant(2), wp.constant(0), wp.constant(3)


@wp.kernel
def trace_light(
    first: int,
    gbuffer: GBuffer,
    casters: RayCasters,
    samples_ws: wp.array(dtype=wp.vec4),
    weights: wp.array(dtype=float),
    hull: LightHull,
    prove: int,
    visibility_out: wp.array2d(dtype=float),
    proof_out: wp.array2d(dtype=int),
):
    """Weighted share of the light samples that a receiver sees, all samples in one go (Heckbert and Herf 1997 by rays).

    Pixels that a proof settles cast no further ray after the first ``PROBES``; a proof never changes the result.
    """
    row, x = wp.tid()
    y = first + row
    proof = NO_RECEIVER
    visible = float(1.0)
    count = samples_ws.shape[0]
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        proof = TRACED
        origin = ray_origin(gbuffer, y, x)
        normal = gbuffer.normal_ws[y, x]
        provable = bool(False)
        if prove != 0 and casters.mesh == wp.uint64(0) and casters.cut == wp.uint64(0):
            proof = PROVEN_LIT
        elif prove != 0:
            behind = bool(True)  # the whole hull is behind a casting surface
            ahead = bool(True)
            for i in range(hull.corners.shape[0]):
                way = hull.corners[i] - gbuffer.position_ws[y, x] * hull.is_point
                hidden = is_back_lit(gbuffer, y, x, way)
                behind = behind and hidden
                ahead = ahead and not hidden
            if behind:
                proof = PROVEN_DARK
            provable = ahead and casters.cut == wp.uint64(0)  # proofs know whole triangles only
        if proof == PROVEN_DARK:
            visible = 0.0
        if proof == TRACED:
            seen = float(0.0)
            total = float(0.0)
            for s in range(count):
                if s == PROBES and provable:
                    # where the first samples disagree no proof can succeed
                    if seen == total:
                        if proves_lit(casters.mesh, origin, normal, hull):
                            proof = PROVEN_LIT
                            break
                    elif seen == 0.0:
                        if proves_dark(casters.mesh, origin, hull):
                            proof = PROVEN_DARK
                            break
                light = samples_ws[s]
                total += weights[s]
                lit = not is_back_lit(gbuffer, y, x, to_light(light, gbuffer.position_ws[y, x]))
                if lit:
                    lit = not is_occluded(casters, origin, light, hull.reach)
                if lit:
                    seen += weights[s]
            visible = seen / wp.max(total, 1.0e-30)
    proof_out[y, x] = proof
    visibility_out[y, x] = visible


@wp.kernel
def binomial_standard_error(
    first: int, visibility: wp.array2d(dtype=float), count: float, error_out: wp.array2d(dtype=float)
):
    """sqrt(psi (1 - psi) / (n - 1)); 1 where n = 1 says nothing (Scherzer et al. 2009, equation 3)."""
    row, x = wp.tid()
    y = first + row
    error_out[y, x] = standard_error(visibility[y, x], count)  # psi (1 - psi) is the same for 1 - psi
