"""What a technique pulls of the eye's side of a frame: the view, the receivers in it, visibility to fill."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wkernels.raster import Rasteriser
from wkernels.raster import gbuffer as gb
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Camera
from wkernels.scene.views import HostView, eye_view
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace


class NothingCasts(Omission):
    """What a scene without casters saves."""

    MAP = "light depth map and comparisons", Because.NOTHING_CASTS
    ALL = "all but G-buffer and shading", Because.NOTHING_CASTS


class EyeSide(Workspace):
    """What one frame of one technique label offers under the eye that is set.

    Args:
        geometry: Scene triangles, shared between labels.
        width, height: Frame size in pixels, at least 1.
        **options: Of ``Workspace``.

    Attributes:
        rasteriser: Draws and counts triangles as the eye or a light sees them.
        standard_error: A technique may set it in ``render``; float32, of its visibility's size.
    """

    def __init__(self, geometry: Geometry, width: int, height: int, **options: Any) -> None:
        super().__init__(**options)
        self.geometry = geometry
        self.width, self.height = width, height
        self.standard_error: wp.array | None = None
        self.rasteriser = Rasteriser(self.device, self.threads)
        self._gbuffers: dict[tuple[int, int], gb.GBuffer] = {}  # by margin
        self._receivers: dict[int, gb.GBuffer] = {}  # by the visibility buffer that was given for them
        self._camera: Any = None
        self._eyes: dict[tuple[int, int], HostView] = {}

    def look(self, camera: Camera) -> None:
        """Puts another camera in the place of the path's, until the next frame begins."""
        self._camera = camera
        self._eyes.clear()

    def forget_pulls(self) -> None:
        """Begins a new frame's account of what is asked for; products stay."""
        self._products.asked.clear()
        self._gbuffers.clear()
        self._receivers.clear()
        self.standard_error = None

    @property
    def pulled(self) -> frozenset[Product]:
        """What of all that a frame offers this frame's technique has asked for so far."""
        return frozenset(product for product in Product if product.value in self._products.asked)

    def receivers_of(self, visibility: object) -> gb.GBuffer:
        """The G-buffer that a ``visibility_buffer`` was given for; the frame's own for anything else."""
        return self._receivers.get(getattr(visibility, "ptr", None) or 0) or self.gbuffer()

    def visibility_buffer(self, gbuffer: gb.GBuffer) -> wp.array:
        """The float32 (H, W) array, of a G-buffer's size, that a technique fills and returns."""
        out = self.buffer("visibility", gbuffer.depth.shape, wp.float32)
        self._receivers[out.ptr] = gbuffer
        return out

    def nothing_casts(self, visibility_out: wp.array) -> bool:
        """Fills ``visibility_out`` with 1 and returns True where the scene has no casters (and skips are on)."""
        if self.geometry.caster_triangles or not self.leave_out(NothingCasts.MAP):
            return False
        visibility_out.fill_(1.0)
        return True

    def lit_without_casters(self, standard_error: float | None = None) -> wp.array | None:
        """Visibility 1 in the frame's own G-buffer where the scene has no casters (and skips are on), else None.

        To be asked for before anything else is built, such as an overscanned G-buffer. ``standard_error`` is what a
        method that samples the light reports then.
        """
        if self.geometry.caster_triangles or not self.leave_out(NothingCasts.ALL):
            return None
        visibility = self.visibility_buffer(self.gbuffer())
        visibility.fill_(1.0)
        if standard_error is not None:
            self.standard_error = self.buffer("standard error", visibility.shape, wp.float32)
            self.standard_error.fill_(standard_error)
        return visibility

    def eye(self, margin: tuple[int, int] = (0, 0)) -> HostView:
        """The eye's view of this frame, with ``margin`` extra pixels at each side."""
        if margin not in self._eyes:
            self._eyes[margin] = eye_view(self._camera, self.width, self.height, self.geometry.origin_ws, margin)
        return self._eyes[margin]

    def margin(self, overscan: float) -> tuple[int, int]:
        """Extra pixels at each side for an overscan of, say, 0.05 of the frame's size."""
        return int(np.ceil(0.5 * overscan * self.width)), int(np.ceil(0.5 * overscan * self.height))

    def gbuffer(self, overscan: float = 0.0) -> gb.GBuffer:
        """What the eye sees, ``overscan`` (share of width and height) larger than the frame."""
        margin = self.margin(overscan)
        view = self.eye(margin)

        def build(old: gb.GBuffer | None) -> gb.GBuffer:
            out = old or gb.allocate_gbuffer(view.width, view.height, self.device)
            gb.fill_gbuffer(out, self.geometry, view, self.rasteriser)
            return out

        inputs = (self.geometry.version, self._camera.key)
        out: gb.GBuffer = self.product(Product.G_BUFFER, ("g-buffer", margin), inputs, build)
        self._gbuffers[margin] = out
        return out

    def widest_gbuffer(self) -> gb.GBuffer:
        """The largest G-buffer that this frame has asked for so far, or else the frame's own."""
        asked = list(self._gbuffers.values()) or [self.gbuffer()]
        return max(asked, key=lambda gbuffer: gbuffer.depth.size)
