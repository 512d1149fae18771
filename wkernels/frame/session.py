"""One technique's way through a walkthrough: products built on request, history, timing, what is left out.

A technique's ``render`` gets the session and *pulls* what it needs: the G-buffer, light depth maps, the casters' ray
structure, light samples, history buffers. A product is built on first request, timed under its own name, and kept until
one of its inputs (geometry, camera, light sample) changes. What nobody asks for is never built.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
import warp as wp

from wkernels.device.launch import launch, wake_workers
from wkernels.device.timing import PassTimer
from wkernels.frame.history import History
from wkernels.frame.map_shelf import MapShelf
from wkernels.frame.near_plane import NearPlane
from wkernels.frame.result import G_BUFFER, SHADING, FrameResult, check_image, read_back, tell_turned_away
from wkernels.frame.shading import shade
from wkernels.light_maps.light_map import LightMap
from wkernels.projections.jitter import Jitter, jittered_view
from wkernels.projections.light_views import fit_scene
from wkernels.raster import CULL_NONE, Rasteriser
from wkernels.raster import gbuffer as gb
from wkernels.rays.caster_tree import CasterTree, CasterTreeBuilder
from wkernels.rays.light_proofs import LightHull, light_hull
from wkernels.rays.light_samples import LightSamples
from wkernels.sampling.point_sets import light_set
from wkernels.scene.geometry import Bounds, Geometry
from wkernels.scene.light_motion import FrameLights
from wkernels.scene.lights import Light
from wkernels.scene.model import Camera
from wkernels.scene.views import HostView, eye_view
from wkernels.workspace.left_out import LeavesOut, Omission
from wkernels.workspace.products import OPTIONAL, UNASKED, Products

LightViews = Callable[[np.ndarray, Bounds, Bounds, int, HostView], list[HostView]]
"""A projection: light sample (4,), receivers' box, casters' box, map resolution, eye view -> one view per layer.

It may have three attributes: ``near``, the ``NearPlane`` rule of the eye view that it gets ("user" without it);
``left_out``, pairs (what, reason) of what its last call could not or need not do; and ``map_options``, a ``MapOptions``
that says how its maps are stored and drawn.
"""


class Renders(Protocol):
    """What a session needs of a technique."""

    def render(self, frame: Session) -> wp.array:
        """Visibility, float32, of the frame's size or of an overscanned G-buffer's."""


class Session(LeavesOut):
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
        done_anyway: Collection[Omission] = (),
        index: int = 0,
    ) -> None:
        super().__init__(skips, done_anyway)
        self.geometry = geometry
        self.width, self.height = width, height
        self.device, self.threads, self.seed = device, threads, seed
        self.lights = FrameLights(geometry.scene.lights, light_index, geometry.origin_ws)
        self.projection: LightViews = projection or fit_scene
        self.index = index  # frame index in the scene's path
        self.count = 0  # frames since the last reset: how often history has been committed
        self.standard_error: wp.array | None = None  # a technique may set it in render
        self.near_plane = NearPlane(getattr(self.projection, "near", "user"))
        self._rasteriser = Rasteriser(device, threads)
        self._maps = MapShelf(geometry, self._rasteriser)
        self._timer = PassTimer(device)
        self._products = Products(self.timed, self.leave_out)
        self._buffers: dict[Hashable, wp.array] = {}
        self._histories: dict[str, History] = {}
        self._previous_camera: Any = None
        self._previous_index: int | None = None
        self.light_views: tuple[list[HostView], np.ndarray] | None = None
        self.read_map: LightMap | None = None  # the map with these views
        self._gbuffers: dict[tuple[int, int], gb.GBuffer] = {}
        self._camera: Any = None
        self._eyes: dict[tuple[int, int], HostView] = {}
        self.begin(index)

    # ---- frame by frame
    # -------------------------------------------------------------------------------------------------

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

    def look(self, camera: Camera) -> None:
        """Puts another camera in the place of the path's, until ``begin`` is called again."""
        self._camera = camera
        self._eyes.clear()

    def render(self, technique: Renders) -> FrameResult:
        """Runs one technique on the current frame and reads its results back (reading back is not timed)."""
        self.forget_left_out()
        self._products.asked.clear()
        self.light_views = self.read_map = None
        self._gbuffers.clear()
        self.standard_error = None
        wake_workers(self.device, self.threads)
        self._timer.start()
        visibility = technique.render(self)
        self.near_plane.look_back(self)
        own = self._gbuffers.get(visibility.shape) if isinstance(visibility, wp.array) else None
        gbuffer = own or self.gbuffer()
        check_image(f"{type(technique).__name__}.render returned", visibility, gbuffer.depth.shape)
        if self.standard_error is not None:
            check_image(f"{type(technique).__name__}'s standard error is", self.standard_error, gbuffer.depth.shape)
        with self._timer.timed(SHADING):
            color = self.buffer("color", visibility.shape, wp.vec3)
            shade(gbuffer, self.geometry.mesh_diffuse, self.light, visibility, color, self.device, self.threads)
        spent = self._timer.stop()
        for name in OPTIONAL:
            if name not in self._products.asked:
                self.tell(name, UNASKED)
        tell_turned_away(self, gbuffer)
        self.count_left_out()
        return read_back(self, gbuffer, visibility, color, spent)

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

    # ---- what a technique asks for
    # --------------------------------------------------------------------------------------

    def timed(self, name: str) -> AbstractContextManager[None]:
        """Charges the block to the pass ``name``."""
        return self._timer.timed(name)

    def launch(self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list, outputs: list) -> None:
        """Launches on the session's device and threads; the kernel's first argument is its tile's offset."""
        launch(kernel, dim, inputs, outputs, device=self.device, threads=self.threads)

    def buffer(self, name: str, shape: tuple[int, ...], dtype: type) -> wp.array:
        """Scratch memory that lives as long as the session; its content is whatever was left there."""
        key = (name, shape, dtype)
        if key not in self._buffers:
            self._buffers[key] = wp.zeros(shape, dtype=dtype, device=self.device)
        return self._buffers[key]

    def visibility_buffer(self, gbuffer: gb.GBuffer) -> wp.array:
        """The float32 (H, W) array, of a G-buffer's size, that a technique fills and returns."""
        return self.buffer("visibility", gbuffer.depth.shape, wp.float32)

    def nothing_casts(self, visibility_out: wp.array) -> bool:
        """Fills ``visibility_out`` with 1 and returns True where the scene has no casters (and skips are on)."""
        if self.geometry.caster_triangles or not self.leave_out("light depth map and comparisons", "nothing casts"):
            return False
        visibility_out.fill_(1.0)
        return True

    def lit_without_casters(self, standard_error: float | None = None) -> wp.array | None:
        """Visibility 1 in the frame's own G-buffer where the scene has no casters (and skips are on), else None.

        To be asked for before anything else is built, such as an overscanned G-buffer. ``standard_error`` is what a
        method that samples the light reports then.
        """
        if self.geometry.caster_triangles or not self.leave_out("all but G-buffer and shading", "nothing casts"):
            return None
        visibility = self.visibility_buffer(self.gbuffer())
        visibility.fill_(1.0)
        if standard_error is not None:
            self.standard_error = self.buffer("standard error", visibility.shape, wp.float32)
            self.standard_error.fill_(standard_error)
        return visibility

    def product(self, name: str, key: Hashable, inputs: Hashable, build: Callable[[Any], Any]) -> Any:
        """Anything that outlives a frame while its inputs stay the same.

        Args:
            name: Pass name in the timings.
            key: Identity of the product within the session.
            inputs: Everything it depends on, comparable; it is rebuilt when they differ.
            build: Called with the old value (or None), whose memory it may reuse; returns the new one.
        """
        return self._products.pull(name, key, inputs, build)

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
            gb.fill_gbuffer(out, self.geometry, view, self._rasteriser)
            return out

        inputs = (self.geometry.version, self._camera.key)
        out: gb.GBuffer = self.product(G_BUFFER, ("g-buffer", margin), inputs, build)
        self._gbuffers[out.depth.shape] = out
        return out

    def widest_gbuffer(self) -> gb.GBuffer:
        """The largest G-buffer that this frame has asked for so far, or else the frame's own."""
        asked = list(self._gbuffers.values()) or [self.gbuffer()]
        return max(asked, key=lambda gbuffer: gbuffer.depth.size)

    def light_samples(self, count: int, kind: str = "halton", start: int = 0) -> LightSamples:
        """``count`` points of the light from sample ``start`` on (rebased world)."""

        def build(old: LightSamples | None) -> LightSamples:
            u = light_set(kind, count, 3, start, 0 if self.seed == 1 else self.seed + 1)
            host, weights = self.light.sample(u), self.light.weights(u)
            return LightSamples(
                host,
                wp.array(host.astype(np.float32), dtype=wp.vec4, device=self.device),
                wp.array(weights.astype(np.float32), dtype=float, device=self.device),
                weights,
            )

        # the set of a temporal method moves on every frame: one slot per size, so that nothing piles up
        inputs = (start, self.seed, self.lights.stamp)
        samples: LightSamples = self.product("light samples", ("samples", kind, count), inputs, build)
        return samples

    def casters(self) -> wp.uint64:
        """Id of the casters' triangles for ray queries; 0 where nothing casts."""
        if self.geometry.caster_triangles == 0:
            return wp.uint64(0)

        def build(old: wp.Mesh | None) -> wp.Mesh:
            if old is None:
                return wp.Mesh(points=self.geometry.points_ws, indices=self.geometry.caster_indices)
            old.refit()
            return old

        mesh: wp.Mesh = self.product("caster ray structure", "casters", self.geometry.version, build)
        return mesh.id

    def caster_tree(self) -> CasterTree:
        """The casters' triangles as a tree of boxes, for all rays of a receiver at once."""

        def build(old: CasterTreeBuilder | None) -> CasterTreeBuilder:
            if old is None:
                geometry = self.geometry
                return CasterTreeBuilder(
                    geometry.points_ws, geometry.caster_indices, geometry.caster_triangles, self.device, self.threads
                )
            old.refit()
            return old

        builder: CasterTreeBuilder = self.product("caster tree", "caster tree", self.geometry.version, build)
        return builder.tree

    @property
    def light(self) -> Light:
        """The light that is asked for, at this frame, rebased world."""
        return self.lights.current

    def light_hull(self) -> LightHull:
        """The light's hull for proofs, and how far a ray must reach to leave the scene."""
        return light_hull(self.light, self.reach, self.device)

    @property
    def reach(self) -> float:
        """Length of a ray that leaves the scene from anywhere in it."""
        box = self.geometry.bounds(casters=True, receivers=True)
        return 1.0 if box.empty else 1.01 * float(np.linalg.norm(box.high - box.low)) + 1e-6

    def look_from_light(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int
    ) -> list[HostView]:
        """The projection's views from a light sample (4,), rebased world, of these boxes, one per layer of a map."""
        views = self.projection(light_ws, receivers, casters, resolution, self.near_plane.eye(self, receivers))
        for what, reason in getattr(self.projection, "left_out", ()):
            self.record(what, reason)
        return views

    def light_map(
        self,
        resolution: int,
        light_ws: np.ndarray | None = None,
        *,
        slot: Hashable = "centre",
        cull: int = CULL_NONE,
        tag_moving_casters: bool = False,
        jitter: Jitter | None = None,
        casters: str = "all",
    ) -> LightMap:
        """The light's linear depth map, seen from one sample of the light.

        Args:
            resolution: Texels per side, 1 to 8192.
            light_ws: Light sample (4,), rebased world; the light's centre unless given.
            slot: Maps that must live side by side need different slots.
            cull: Which faces are left out, as seen from the light.
            tag_moving_casters: Negative depth where the nearest caster moves.
            jitter: Shift and turn of whatever views the projection gives; what changes it draws the map anew.
            casters: Which of them, a key of ``Geometry.caster_sets``; the views are those of all.
        """
        sample = self.light.centre if light_ws is None else light_ws
        receivers, box = self.geometry.bounds(receivers=True), self.geometry.bounds(casters=True)
        if receivers.empty:
            receivers = box
        if receivers.empty:  # no meshes at all: any view will do
            receivers = Bounds()
            receivers.add(np.zeros((1, 3)))
        views = self.look_from_light(sample, receivers, box, resolution)
        if jitter is not None:
            views = [jittered_view(view, jitter) for view in views]
        shown = light_ws is None or self.light_views is None
        if shown:
            self.light_views = (views, sample)
        out = self._maps.pull(self, views, sample, slot, cull, tag_moving_casters, casters)
        if shown:
            self.read_map = out
        return out

    def map_is_empty(self, light_map: LightMap) -> bool:
        """Whether nothing was drawn into a map of this session, because no caster lies in its views."""
        return self._maps.is_empty(light_map)

    def history(self, name: str, allocate: Callable[[], Any], margin: tuple[int, int] = (0, 0)) -> History:
        """Two buffers made by ``allocate``, and the eye's view when the previous one was written."""
        self._products.asked.add("history")
        if name not in self._histories:
            self._histories[name] = History(allocate(), allocate())
        out = self._histories[name]
        out.previous_view, out.previous_index = None, self._previous_index if out.valid else None
        if out.valid and self._previous_camera is not None:
            view = eye_view(self._previous_camera, self.width, self.height, self.geometry.origin_ws, margin)
            out.previous_view = view.to_device()
        return out
