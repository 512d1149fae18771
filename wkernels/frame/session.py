"""One technique's way through a walkthrough: products built on request, history, timing, what is left out.

A technique's ``render`` gets the session and *pulls* what it needs: the G-buffer, light depth maps, the casters' ray
structure, light samples, history buffers. A product is built on first request, timed under its own name, and kept until
one of its inputs (geometry, camera, light sample) changes. What nobody asks for is never built.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Protocol

import warp as wp

from wkernels.device.launch import wake_workers
from wkernels.frame.history import History
from wkernels.frame.light_side import LIGHT_TEXTURE, LightSide, LightViews
from wkernels.frame.result import (
    SHADING,
    FrameResult,
    Rendered,
    TurnedAway,
    Unread,
    check_image,
    count_turned_away,
    read_back,
)
from wkernels.frame.shading import shade
from wkernels.light_maps.host_map import HostMap
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import eye_view
from wkernels.workspace.left_out import Reasoned
from wkernels.workspace.products import Product, Unasked


class Renders(Protocol):
    """What a session needs of a technique."""

    def render(self, frame: Session) -> wp.array:
        """Visibility of the frame's receivers, float32: a ``visibility_buffer``, or an array of the frame's size."""


class Session(LightSide):
    """Products, history and timers of one technique label; the geometry is shared between labels.

    Args:
        geometry: Scene triangles; the session moves it to its frame in ``begin``.
        width, height: Frame size in pixels, at least 1.
        light_index: Which light of the scene.
        device: Warp device, the geometry's.
        threads: CPU threads; None for all. Never changes a result.
        seed: Shift of all sample sets; 1 is the plain, unshifted set.
        projection: Where light depth maps look; ``scene_views`` unless given.
        skips: Whether work that the scene cannot need may be left out.
        done_anyway: Pairs (what, reason) of it that are done nevertheless.
        index: Frame to begin with; the geometry's, where others are using it.

    Attributes:
        index: Frame index in the scene's path.
    """

    def __init__(
        self,
        geometry: Geometry,
        *,
        width: int,
        height: int,
        light_index: int = 0,
        device: str = "cpu",
        threads: int | None = None,
        seed: int = 1,
        projection: LightViews | None = None,
        skips: bool = True,
        done_anyway: Collection[Reasoned] = (),
        index: int = 0,
    ) -> None:
        options = {"device": device, "threads": threads, "seed": seed, "skips": skips, "done_anyway": done_anyway}
        super().__init__(geometry, width, height, light_index, projection, **options)
        self.index = index
        self._histories: dict[str, History] = {}
        self._previous_camera: Any = None
        self._previous_index: int | None = None
        self.begin(index)

    def begin(self, frame_index: int) -> None:
        """Moves camera, geometry and lights to a frame. Again with the same index it forgets what it built for it."""
        if frame_index == self.index:
            self._products.expire()
        else:
            self._products.visit += 1
        self.index = frame_index
        self.geometry.set_frame(frame_index)
        self.lights.begin(frame_index)
        self.look(self.geometry.scene.camera(frame_index))

    def render(self, technique: Renders) -> FrameResult:
        """Runs one technique on the current frame and reads its results back (reading back is not timed)."""
        self.forget_left_out()
        self.forget_pulls()
        wake_workers(self.device, self.threads)
        self._timer.start()
        visibility = technique.render(self)
        self.near_plane.look_back(self.eye(), self.geometry.version)
        gbuffer = self.receivers_of(visibility)
        check_image(f"{type(technique).__name__}.render returned", visibility, gbuffer.depth.shape)
        if self.standard_error is not None:
            check_image(f"{type(technique).__name__}'s standard error is", self.standard_error, gbuffer.depth.shape)
        with self._timer.timed(SHADING):
            color = self.buffer("color", visibility.shape, wp.vec3)
            shade(gbuffer, self.geometry.mesh_diffuse, self.light, visibility, color, self.device, self.threads)
        spent = self._timer.stop()
        for omission in Unasked:
            if omission.product not in self.pulled:
                self.tell(omission)
        if self.has_texture and self._products.asked.isdisjoint((Product.LIGHT_SAMPLES.value, LIGHT_TEXTURE)):
            self.tell(Unread.TEXTURE)
        read = self.shown
        if isinstance(read, HostMap):
            self.tell(TurnedAway.PIXELS, count=lambda: count_turned_away(gbuffer, read))
        self.count_left_out()
        eye = self.near_plane.used or self.eye()
        rendered = Rendered(gbuffer, visibility, self.standard_error, color, read, eye)
        return read_back(rendered, (self.height, self.width), self.geometry.origin_ws, spent, self.left_out)

    def advance(self) -> None:
        """Commits the frame: what history buffers hold now is what the next frame finds as ``previous``."""
        for history in self._histories.values():
            history.previous, history.current = history.current, history.previous
            history.valid = True
        self.near_plane.advance()
        self._previous_camera, self._previous_index = self._camera, self.index
        self.count += 1
        self._products.visit += 1

    def reset(self) -> None:
        """Forgets history and products, as before the first frame."""
        self._products.clear()
        self._maps.clear()
        for history in self._histories.values():
            history.valid = False
        self.near_plane.reset()
        self._previous_camera = self._previous_index = None
        self.count = 0
        self._products.visit += 1

    def history(self, name: str, allocate: Callable[[], Any], margin: tuple[int, int] = (0, 0)) -> History:
        """Two buffers made by ``allocate``, and the eye's view when the previous one was written."""
        self._products.asked.add(Product.HISTORY.value)
        if name not in self._histories:
            self._histories[name] = History(allocate(), allocate())
        out = self._histories[name]
        out.previous_view, out.previous_index = None, self._previous_index if out.valid else None
        if out.valid and self._previous_camera is not None:
            view = eye_view(self._previous_camera, self.width, self.height, self.geometry.origin_ws, margin)
            out.previous_view = view.to_device()
        return out
