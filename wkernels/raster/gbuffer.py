"""G-buffer: what the eye sees in every pixel, the receiver points that all techniques and the reference share."""

from __future__ import annotations

import warp as wp

from wkernels.device.launch import launch
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import CASTS, Geometry
from wkernels.scene.views import HostView, View, pixel_along_ws, pixel_base_ws

RUN = 64  # pixels of a row that one CPU cell resolves
PADDING = 64  # pixels of memory behind the last one, so that a run of lanes may begin at any pixel


@wp.struct
class GBuffer:
    """Per-pixel surface data, arrays of shape (H, W)."""

    view: View
    depth: wp.array2d(dtype=float)  # linear eye depth; +inf where nothing is seen
    position_ws: wp.array2d(dtype=wp.vec3)  # rebased world
    normal_ws: wp.array2d(dtype=wp.vec3)  # geometric, unit, facing the eye
    mesh: wp.array2d(dtype=int)  # -1 where nothing is seen
    triangle: wp.array2d(dtype=int)  # -1 where nothing is seen
    flags: wp.array2d(dtype=int)  # CASTS | RECEIVES | MOVES of the mesh; 0 where nothing is seen


@wp.kernel
def resolve_surface(
    first: int,
    run: int,
    view: View,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    triangle_normal_ws: wp.array(dtype=wp.vec3),
    triangle_mesh: wp.array(dtype=int),
    mesh_flags: wp.array(dtype=int),
    gbuffer: GBuffer,
):
    """Turns the rasterised triangles of ``run`` neighbouring pixels into exact surface data.

    The position is where the ray of the pixel centre meets the triangle's plane, not the interpolated depth: it carries
    no snapping and no accumulated rounding, so that a ray cast from it starts on its own triangle. Neighbours mostly
    see the same triangle, which is fetched when another one comes.
    """
    row, column = wp.tid()
    y = first + row
    held = int(-1)
    corner = wp.vec3()
    plane = wp.vec3()
    mesh = int(-1)
    flags = int(0)
    for x in range(column * run, wp.min((column + 1) * run, view.width)):
        t = gbuffer.triangle[y, x]
        if t < 0:
            gbuffer.mesh[y, x] = -1
            gbuffer.flags[y, x] = 0
            gbuffer.position_ws[y, x] = wp.vec3()
            gbuffer.normal_ws[y, x] = wp.vec3()
            continue
        if t != held:
            held = t
            corner = points_ws[indices[3 * t]]
            plane = triangle_normal_ws[t]
            mesh = triangle_mesh[t]
            flags = mesh_flags[mesh]
        base = pixel_base_ws(view, float(x) + 0.5, float(y) + 0.5)
        along = pixel_along_ws(view, float(x) + 0.5, float(y) + 0.5)
        depth = gbuffer.depth[y, x]
        slope = wp.dot(plane, along)
        if slope * slope > 1.0e-12 * wp.dot(along, along):
            exact = wp.dot(plane, corner - base) / slope
            # seen edge-on the plane says little; the rasterised depth is right to the size of a pixel
            if wp.abs(exact - depth) < 0.1 * depth and exact > 0.0:
                depth = exact
        normal = plane
        if slope > 0.0:
            normal = -plane
        gbuffer.depth[y, x] = depth
        gbuffer.position_ws[y, x] = base + depth * along
        gbuffer.normal_ws[y, x] = normal
        gbuffer.mesh[y, x] = mesh
        gbuffer.flags[y, x] = flags


def allocate_gbuffer(width: int, height: int, device: str) -> GBuffer:
    """An unfilled G-buffer of ``height`` x ``width`` pixels."""

    def image(dtype: type) -> wp.array:
        memory = wp.zeros(width * height + PADDING, dtype=dtype, device=device)
        return memory[: width * height].reshape((height, width))

    out = GBuffer()
    out.depth = image(float)
    out.position_ws, out.normal_ws = image(wp.vec3), image(wp.vec3)
    out.mesh, out.triangle, out.flags = image(int), image(int), image(int)
    return out


def fill_gbuffer(gbuffer: GBuffer, geometry: Geometry, view: HostView, rasteriser: Rasteriser) -> None:
    """Renders ``geometry`` from ``view`` into ``gbuffer`` (same size)."""
    gbuffer.view = view.to_device()
    points, cutouts = geometry.points_ws, geometry.cutouts
    rasteriser.draw(points, geometry.indices, gbuffer.view, gbuffer.depth, gbuffer.triangle, cutouts=cutouts)
    run = RUN if wp.get_device(rasteriser.device).is_cpu else 1
    launch(
        resolve_surface,
        (view.height, -(-view.width // run)),
        [
            run,
            gbuffer.view,
            geometry.points_ws,
            geometry.indices,
            geometry.triangle_normal_ws,
            geometry.triangle_mesh,
            geometry.mesh_flags,
        ],
        [gbuffer],
        device=rasteriser.device,
        threads=rasteriser.threads,
    )


@wp.func
def to_light(light_ws: wp.vec4, position_ws: wp.vec3):
    """Unnormalised way from a position to a light sample."""
    return wp.vec3(light_ws[0], light_ws[1], light_ws[2]) - position_ws * light_ws[3]


@wp.func
def is_back_lit(gbuffer: GBuffer, y: int, x: int, to_light: wp.vec3):
    """Whether the pixel's own surface hides the light: it casts, and the light is behind the side that is seen.

    Such a pixel needs no lookup and no ray. A surface that does not cast is never hidden by itself.
    """
    return (gbuffer.flags[y, x] & CASTS) != 0 and wp.dot(gbuffer.normal_ws[y, x], to_light) <= 0.0
