"""Blob shadows: a blurry dark spot where a caster's ellipse falls (Schwaerzler 2009, section 2.3, figure 2.10).

The source only tells of "blurry dark textures, placed underneath the objects"; the rest is ours. Each casting mesh is
its bounding ellipsoid (``casters.blobs``). From a receiver at distance d of its projected ellipse (0 at the middle, 1
on the outline), h below it, the blob takes away

    alpha = strength (1 - smoothstep(inner, outer, d)) max(0, 1 - h / fade),

h and ``fade`` in sizes of the caster along the way to the light; visibility is the product of (1 - alpha) over the
casters. ``down`` drops blobs along -Y, as games do, instead of away from the light's centre. A mesh gets none of its
own.

Deviations: the blob falls on whatever lies below, not on one ground.
Known artefacts: wrong by design. No shape but an ellipse, no self-shadow, nothing fully dark at a distance. A caster in
one piece is too light in the mean, the more the higher it floats, and hardly wrong where it rests on the ground. A mesh
of parts that lie apart, such as a town in one file, or a house and one loose tile, has one blob round them all and is
far too dark, the more the wider they lie; so has a card of leaves, whatever its texture cuts out.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp
from pydantic import ValidationInfo, field_validator

from algorithms.technique import ExpectedFailure, Frame, Technique, setting
from algorithms.technique import Params as BaseParams
from wkernels.casters.blobs import Blob, bounding_ellipsoid, distance_to_blob, placed_ellipsoid
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES
from wkernels.workspace.products import Product


@wp.struct
class BlobLook:
    """How blobs look; see the docstring above."""

    strength: float
    inner: float
    outer: float
    fade: float
    down: int


@wp.kernel
def darken_under_blobs(
    first: int,
    gbuffer: GBuffer,
    blobs: wp.array(dtype=Blob),
    light_ws: wp.vec4,
    look: BlobLook,
    visibility_out: wp.array2d(dtype=float),
):
    """What all blobs leave of the light in each pixel."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        way = to_light(light_ws, position_ws)
        if is_back_lit(gbuffer, y, x, way):
            visible = 0.0
        end = wp.where(light_ws[3] > 0.0, 1.0, wp.inf)  # beyond a point light nothing counts
        if look.down != 0:
            way = wp.vec3(0.0, 1.0, 0.0)
            end = wp.inf
        for i in range(blobs.shape[0]):
            blob = blobs[i]
            passed = distance_to_blob(blob, position_ws, way)
            if blob.mesh != gbuffer.mesh[y, x] and passed[1] > 0.0 and passed[1] < end and passed[0] < look.outer:
                height = passed[1] * wp.length(way) / blob.size
                dark = 1.0 - wp.smoothstep(look.inner, look.outer, passed[0])
                visible *= 1.0 - look.strength * dark * wp.max(1.0 - height / look.fade, 0.0)
    visibility_out[y, x] = visible


class BlobShadows(Technique):
    """One ellipse a caster."""

    name = "blob_shadows"
    family = "hard"
    paper = ("schwaerzler2009",)
    products = (Product.G_BUFFER,)
    bias_sign = "lighter"
    bias_turns = "a mesh has parts that lie apart"
    expected_failures = (
        ExpectedFailure(
            check="behind_an_opaque_slab_all_is_dark",
            because="a blob fades with the height of its caster",
            message=r"^up to 0\.\d+ under",
        ),
        ExpectedFailure(
            check="a_cut_out_caster_shades_by_what_is_left_of_it",
            because="a blob is the ellipse round all of a caster",
            message=r"of the pixels differ from those of two squares",
        ),
    )
    stability_limits: ClassVar[dict[str, str]] = {
        "light_place": "a blob is a spot on what lies behind a caster: a light inside one darkens nothing else"
    }

    class Params(BaseParams):
        """How blobs look."""

        strength: float = setting(1.0, "darkness of a blob whose caster lies on the receiver", unit="1", ge=0.0, le=1.0)
        inner: float = setting(0.5, "where it begins to fade", unit="half-axes of the ellipse", ge=0.0, le=100.0)
        outer: float = setting(1.0, "where it ends; more than inner", unit="half-axes of the ellipse", gt=0.0, le=100.0)
        fade: float = setting(8.0, "height at which it has faded away", unit="sizes of the caster", gt=0.0, le=1e6)
        along: Literal["light", "down"] = setting("light", "which way blobs fall", unit="name")

        @field_validator("outer")
        @classmethod
        def _leave_a_ramp(cls, outer: float, info: ValidationInfo) -> float:
            if outer <= info.data.get("inner", 0.0):
                raise ValueError("a blob ends outside of where it begins to fade: outer must be more than inner")
            return outer

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        blobs = self._blobs(frame)
        look = BlobLook()
        look.strength, look.inner, look.outer = self.params.strength, self.params.inner, self.params.outer
        look.fade, look.down = self.params.fade, int(self.params.along == "down")
        with frame.timed("blobs"):
            inputs = [gbuffer, blobs, wp.vec4(*frame.light.centre), look]
            frame.launch(darken_under_blobs, visibility.shape, inputs, [visibility])
        return visibility

    def _blobs(self, frame: Frame) -> wp.array:
        def build(old: tuple | None) -> tuple:
            meshes = frame.geometry.meshes
            own = old[1] if old else {i: bounding_ellipsoid(m.vertices) for i, m in enumerate(meshes) if m.casts}
            out = []
            for i, ellipsoid in own.items():
                if meshes[i].deformed is not None:
                    ellipsoid = bounding_ellipsoid(meshes[i].vertices_at(frame.index))
                placed = placed_ellipsoid(ellipsoid, meshes[i], frame.index, frame.geometry.origin_ws)
                if placed is not None:
                    blob = Blob()
                    blob.centre_ws, blob.to_unit = wp.vec3(*placed.centre), wp.mat33(*placed.to_unit.ravel())
                    blob.size, blob.mesh = placed.size, i
                    out.append(blob)
            return wp.array(out, dtype=Blob, shape=len(out), device=frame.device), own

        blobs: wp.array = frame.product("blobs of casters", "blobs", frame.geometry.version, build)[0]
        return blobs
