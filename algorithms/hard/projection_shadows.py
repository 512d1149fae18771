"""Planar projected shadows: casters flattened onto the receiver's plane by a matrix (Blinn 1988).

1. For each plane P on which something receives, and each light sample l, M = (P.l) I - l P^T takes every caster to its
   shadow on P (Schwaerzler 2009, section 2.3); on y = 0 that is x' = (l_y x - l_x y) / (l_y - y).
2. The flattened casters are drawn from the eye. A pixel that shows the plane is in shadow where anything is drawn,
   once, however many casters overlap: the stencil of the original. Only pixels of the receiver's own meshes count,
   which clips the shadow to its polygon.
3. With more than one light sample, visibility is the radiance-weighted share of them that reach the pixel (Heckbert
   and Herf 1997).

Only geometry between plane and light is flattened: what lies beyond a point light would cast an anti-shadow, and what
lies behind the plane a shadow through it.

Deviations: all planes of flat receiving meshes count, not one. The flattened casters need no offset against z-fighting,
as the eye's own G-buffer says which pixels show the plane.
Known artefacts: no shadows on receivers that are not flat, and so none of bodies on themselves or each other; a light
in the plane itself casts none (M has rank 1). The cost grows with planes times casters.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from algorithms.technique import Frame, Limit, Needs, Params, Technique, setting
from wkernels.casters.flattening import Flattener
from wkernels.casters.receiver_planes import ReceiverPlane, extent_of, pull_planes, turned_to_light
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.sampling.estimators import standard_error
from wkernels.scene.geometry import RECEIVES
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product


class Skip(Omission):
    """What planes and lights save."""

    FLAT_NONE = "flattened casters", "no receiver is flat"
    ALIKE = "flattened casters of light samples", Because.NO_AREA
    UNSEEN = "flattened casters", "no pixel shows the plane"


@wp.kernel
def add_back_lit(first: int, gbuffer: GBuffer, light_ws: wp.vec4, weight: float, hidden_out: wp.array2d(dtype=float)):
    """Adds ``weight`` to the pixels whose own surface hides one light sample."""
    row, x = wp.tid()
    y = first + row
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        if is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            hidden_out[y, x] = hidden_out[y, x] + weight


@wp.kernel
def add_flattened(
    first: int,
    gbuffer: GBuffer,
    plane_of_mesh: wp.array(dtype=int),
    plane: int,
    shadow: wp.array2d(dtype=float),
    light_ws: wp.vec4,
    weight: float,
    hidden_out: wp.array2d(dtype=float),
):
    """Adds ``weight`` to the pixels of one plane in the shadow of flattened casters, unless they are back-lit."""
    row, x = wp.tid()
    y = first + row
    if (gbuffer.flags[y, x] & RECEIVES) != 0 and shadow[y, x] < wp.inf:
        if plane_of_mesh[gbuffer.mesh[y, x]] == plane:
            if not is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
                hidden_out[y, x] = hidden_out[y, x] + weight


@wp.kernel
def light_of_hidden(
    first: int,
    hidden: wp.array2d(dtype=float),
    total: float,
    count: float,
    visibility_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
):
    """Visibility from the weight of the hidden samples, and its standard error for ``count`` of them."""
    row, x = wp.tid()
    y = first + row
    psi = hidden[y, x] / wp.max(total, 1.0e-30)
    visibility_out[y, x] = 1.0 - psi
    error_out[y, x] = standard_error(psi, count)


class ProjectionShadows(Technique):
    """One drawing of flattened casters per plane and light sample."""

    name = "projection_shadows"
    family = "hard"
    paper = ("blinn1988", "schwaerzler2009", "heckbert1997")
    products = (Product.G_BUFFER,)
    needs = Needs(planar_receiver=True, whole_casters=True)
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "a light in the receiver's plane flattens nothing onto it: the projection has rank 1",
        "grazing": "the flattened casters reach to where float32 has no digits left as the light nears the plane",
    }
    bias_sign = "none"
    may_leave_out = (Skip.ALIKE, Skip.FLAT_NONE, Skip.UNSEEN)
    limits = (
        Limit(equals="ray_cast_point_shadow", tolerance=1e-6, flips=0.01),
        Limit(equals="reference_multisample", params={"light_samples": 16}, other_params={"samples": 16}, flips=0.03),
    )

    class Params(Params):
        """How many points of the light."""

        light_samples: int = setting(
            1,
            "points on the light; 1 is its centre and hard shadows",
            unit="drawings per plane",
            source="Heckbert 1997",
            ge=1,
            le=10**5,
        )

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        count = self.params.light_samples
        error = frame.buffer("standard error", visibility.shape, wp.float32)
        frame.standard_error = error if count > 1 else None
        if frame.nothing_casts(visibility):
            error.zero_()
            return visibility
        if count > 1:
            samples = frame.light_samples(count)
            lights, weights = samples.host, samples.weights_host.astype(np.float32)
        else:
            lights, weights = frame.light.centre[None], np.ones(1, np.float32)
        total = np.add.accumulate(weights)[-1]  # in the kernels' order and precision: "all hidden" is exactly 0
        if count > 1 and not frame.light.has_area and frame.leave_out(Skip.ALIKE, count=count - 1):
            lights, weights = lights[:1], np.array([total])
        planes = pull_planes(frame, frame.geometry, frame.index, gbuffer, Skip.UNSEEN, Skip.FLAT_NONE)
        hidden = frame.buffer("hidden weight", visibility.shape, wp.float32)
        hidden.zero_()
        for light_ws, weight in zip(lights, weights, strict=True):
            with frame.timed("back-lit pixels"):
                frame.launch(add_back_lit, hidden.shape, [gbuffer, wp.vec4(*light_ws), float(weight)], [hidden])
            self._add_shadows(frame, gbuffer, planes, light_ws, float(weight), hidden)
        with frame.timed("average"):
            inputs = [hidden, float(total), float(count)]
            frame.launch(light_of_hidden, visibility.shape, inputs, [visibility, error])
        return visibility

    def _add_shadows(
        self,
        frame: Frame,
        gbuffer: GBuffer,
        planes: list[tuple[int, ReceiverPlane]],
        light_ws: np.ndarray,
        weight: float,
        hidden_out: wp.array,
    ) -> None:
        geometry = frame.geometry
        extent = extent_of(geometry)
        ways = geometry.bounds(receivers=True, noticed=True).corners - light_ws[:3]
        reach = float(np.linalg.norm(ways, axis=1).max(initial=0.0))
        plane_of_mesh = np.full(max(len(geometry.meshes), 1), -1, np.int32)
        for number, plane in planes:
            plane_of_mesh[plane.meshes] = number
        numbers = wp.array(plane_of_mesh, dtype=int, device=frame.device)
        shadow = frame.buffer("flattened casters", hidden_out.shape, wp.float32)
        flattener = frame.product(
            "memory for flattened casters", "flattener", (), lambda old: old or Flattener(frame.device, frame.threads)
        )
        for number, plane in planes:
            turned = turned_to_light(plane.plane, light_ws, extent)
            if turned is None:
                continue
            with frame.timed("flattened casters"):
                flattener.draw(geometry, turned, light_ws, extent, reach, gbuffer.view, shadow)
            with frame.timed("stencil"):
                inputs = [gbuffer, numbers, number, shadow, wp.vec4(*light_ws), weight]
                frame.launch(add_flattened, hidden_out.shape, inputs, [hidden_out])
