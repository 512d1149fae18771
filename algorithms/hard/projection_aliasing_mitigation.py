"""Hard shadows smoothed in the eye's view, which hides projection aliasing (Stingl 2011, section 2.2.2).

Where a surface lies almost parallel to the light, few texels of the map fall on it, and their jagged edges show. The
thesis names three remedies. The one built here is Scherzer 2005's: the result of the shadow test is blurred in eye
space and then used to scale the light.

1. One depth map and one comparison a pixel, as ``shadow_map``.
2. The mean of a pixel and of taps around it, over pixels of about the same depth, wherever N.L is below ``cosine``.

The others need no technique: a lower ambient term, so that the diffuse N.L hides the steps (Schwaerzler 2009, section
2.3.1), is a matter of shading, and adaptive maps are another representation.

Deviations: ``depth_aware`` leaves out neighbours of another depth; the source blurs across everything, which is what
you get without it.
Known artefacts: all edges get softer, by the same number of pixels near and far; detail of shadows smaller than the
filter is lost. Without ``depth_aware`` shadows bleed across the outlines of what stands before them. Acne is smeared,
not removed.
"""

from __future__ import annotations

import warp as wp

from algorithms.technique import Frame, Limit, MapParams, Technique, setting
from wkernels.device.lanes import LANES, Floats, runs_of
from wkernels.device.twin import Twin
from wkernels.filters.neighbourhood_filter import filter_image
from wkernels.light_maps.comparison_lanes import compare_nearest_run
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest
from wkernels.light_maps.point_lanes import points_of_run
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import PADDING, GBuffer, to_light
from wkernels.scene.geometry import RECEIVES
from wkernels.workspace.products import Product

ANY_DEPTH = 1e30  # as a share of the pixel's own


@wp.kernel
def hide_pixels(
    first: int, gbuffer: GBuffer, light_map: LightMap, bias: Bias, psi_depth_out: wp.array2d(dtype=wp.vec2)
):
    """One depth comparison per pixel: (1 where it is in shadow, linear eye depth); (0, 0) where nothing receives."""
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    visible = receiver.visible
    if receiver.layer >= 0:
        visible = compare_nearest(light_map, receiver)
    depth = wp.where((gbuffer.flags[y, x] & RECEIVES) != 0, gbuffer.depth[y, x], 0.0)
    psi_depth_out[y, x] = wp.vec2(1.0 - visible, depth)


@wp.kernel
def hide_pixels_lanes(
    first: int,
    views: LaneViews,
    eye_depth: wp.array(dtype=Floats),
    light_map: LightMap,
    bias: Bias,
    psi_depth_out: wp.array2d(dtype=wp.vec2),
):
    """``hide_pixels`` of a run of pixels."""
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    receivers = locate_run(views, light_map, bias, x0, y)
    visible = compare_nearest_run(views, light_map, receivers)
    depths = points_of_run(views, eye_depth, x0, y).depth
    for k in range(wp.min(LANES, psi_depth_out.shape[1] - x0)):
        psi_depth_out[y, x0 + k] = wp.vec2(1.0 - visible[k], depths[k])


def _in_lanes(gbuffer: GBuffer, light_map: LightMap, bias: Bias) -> list:
    return [lane_views(gbuffer, light_map), runs_of(gbuffer.depth, Floats, PADDING), light_map, bias]


HIDE_PIXELS = Twin(hide_pixels, hide_pixels_lanes, inputs=_in_lanes, flips=1e-3)


@wp.kernel
def choose_width(
    first: int,
    gbuffer: GBuffer,
    light_ws: wp.vec4,
    cosine: float,
    half_width_px: float,
    half_width_px_out: wp.array2d(dtype=float),
):
    """The filter's half width where the surface is steeper to the light than ``cosine`` says, else 0."""
    row, x = wp.tid()
    y = first + row
    width = float(0.0)
    if gbuffer.mesh[y, x] >= 0:
        way = to_light(light_ws, gbuffer.position_ws[y, x])
        # a cosine of 1 must not leave out what rounding puts above it
        if wp.abs(wp.dot(gbuffer.normal_ws[y, x], way)) <= 1.000001 * cosine * wp.length(way):
            width = half_width_px
    half_width_px_out[y, x] = width


class ProjectionAliasingMitigation(Technique):
    """One map, one comparison a pixel, and a filter over the picture."""

    name = "projection_aliasing_mitigation"
    family = "hard"
    paper = ("scherzer2005", "stingl2011", "schwaerzler2009")
    products = (Product.G_BUFFER, Product.LIGHT_MAP)
    bias_sign = "none"
    limits = (Limit(equals="shadow_map", params={"half_width": 0.0}),)

    class Params(MapParams):
        """The filter."""

        half_width: float = setting(2.0, "radius of the filter", unit="pixels", ge=0.0, le=256.0)
        taps: int = setting(16, "neighbours looked at, in opposite pairs", unit="taps", ge=2, le=1024, multiple_of=2)
        cosine: float = setting(
            1.0,
            "only surfaces with N.L up to this are smoothed; 1: all",
            unit="cosine",
            source="Scherzer 2005",
            ge=0.0,
            le=1.0,
        )
        depth_aware: bool = setting(True, "leave out neighbours of another depth", unit="yes/no")
        depth_range: float = setting(
            0.02, "largest difference of depth, where depths count", unit="share of the pixel's depth", ge=0.0, le=1e3
        )

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        p = self.params
        light_map = frame.light_map(p.resolution, cull=p.cull)
        psi_depth = frame.buffer("psi and depth", visibility.shape, wp.vec2)
        width = frame.buffer("filter width", visibility.shape, wp.float32)
        with frame.timed("compare depth"):
            frame.launch(HIDE_PIXELS, visibility.shape, [gbuffer, light_map.map, p.device_bias], [psi_depth])
        with frame.timed("smooth"):
            inputs = [gbuffer, wp.vec4(*frame.light.centre), p.cosine, p.half_width]
            frame.launch(choose_width, width.shape, inputs, [width])
            depth_range = p.depth_range if p.depth_aware else ANY_DEPTH
            filter_image(frame, psi_depth, width, p.taps, depth_range, visibility)
        return visibility
