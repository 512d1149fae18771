"""What a technique pulls of one frame: receivers, light depth maps, light samples, rays' structures.

A product is built on first request, timed under its own name, and kept until one of its inputs (geometry, camera, light
sample) changes. What nobody asks for is never built.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import warp as wp

from wkernels.frame.map_keeper import MapKeeper
from wkernels.frame.near_plane import NearPlane
from wkernels.light_maps.host_map import HostMap, LightLook
from wkernels.light_maps.storage import PLAIN_MAP
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
from wkernels.workspace.left_out import Because, Omission
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace

LightViews = Callable[[np.ndarray, Bounds, Bounds, int, HostView], list[HostView]]
"""A projection: light sample (4,), receivers' box, casters' box, map resolution, eye view -> one view per layer.

It may have three attributes: ``near``, the ``NearPlane`` rule of the eye view that it gets ("user" without it);
``left_out``, members of an ``Omission``: what its last call could not or need not do; and ``map_options``, a
``MapOptions`` that says how its maps are stored and drawn.
"""


class NothingCasts(Omission):
    """What a scene without casters saves."""

    MAP = "light depth map and comparisons", Because.NOTHING_CASTS
    ALL = "all but G-buffer and shading", Because.NOTHING_CASTS


class Pulls(Workspace):
    """What one frame of one technique label offers, under the eye and the light that are set.

    Args:
        geometry: Scene triangles, shared between labels.
        width, height: Frame size in pixels, at least 1.
        light_index: Which light of the scene.
        projection: Where light depth maps look; ``scene_views`` unless given.
        **options: Of ``Workspace``.

    Attributes:
        rasteriser: Draws and counts triangles as the eye or a light sees them.
        looks: Where this frame's technique has looked from the light so far, its maps among them.
    """

    def __init__(
        self,
        geometry: Geometry,
        width: int,
        height: int,
        light_index: int,
        projection: LightViews | None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.geometry = geometry
        self.width, self.height = width, height
        self.lights = FrameLights(geometry.scene.lights, light_index, geometry.origin_ws)
        self.projection: LightViews = projection or fit_scene
        self.looks: list[LightLook] = []
        self.rasteriser = Rasteriser(self.device, self.threads)
        self.near_plane = NearPlane(getattr(self.projection, "near", "user"), self, self.widest_gbuffer)
        self._maps = MapKeeper(geometry, self.rasteriser)
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
        self.looks.clear()
        self._gbuffers.clear()
        self._receivers.clear()

    @property
    def pulled(self) -> frozenset[Product]:
        """What of all that a frame offers this frame's technique has asked for so far."""
        return frozenset(product for product in Product if product.value in self._products.asked)

    @property
    def shown(self) -> LightLook | None:
        """What the frame's results tell of its maps: the last look from the light's centre, else the first look."""
        central = [look for look in self.looks if look.from_centre]
        return central[-1] if central else self.looks[0] if self.looks else None

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
        out: gb.GBuffer = self.product(Product.G_BUFFER.value, ("g-buffer", margin), inputs, build)
        self._gbuffers[margin] = out
        return out

    def widest_gbuffer(self) -> gb.GBuffer:
        """The largest G-buffer that this frame has asked for so far, or else the frame's own."""
        asked = list(self._gbuffers.values()) or [self.gbuffer()]
        return max(asked, key=lambda gbuffer: gbuffer.depth.size)

    def light_samples(
        self, count: int, kind: str = "halton", start: int = 0, light: Light | None = None
    ) -> LightSamples:
        """``count`` points of a light, the one that is asked for unless given, from sample ``start`` on (rebased)."""
        source = light or self.light

        def build(old: LightSamples | None) -> LightSamples:
            u = light_set(kind, count, 3, start, 0 if self.seed == 1 else self.seed + 1)
            host, weights = source.sample(u), source.weights(u)
            return LightSamples(
                host,
                wp.array(host.astype(np.float32), dtype=wp.vec4, device=self.device),
                wp.array(weights.astype(np.float32), dtype=float, device=self.device),
                weights,
            )

        # the set of a temporal method moves on every frame: one slot per size, so that nothing piles up
        inputs = (start, self.seed, source)
        samples: LightSamples = self.product(Product.LIGHT_SAMPLES.value, ("samples", kind, count), inputs, build)
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

        mesh: wp.Mesh = self.product(Product.RAY_STRUCTURE.value, "casters", self.geometry.version, build)
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

        name = Product.CASTER_TREE.value
        builder: CasterTreeBuilder = self.product(name, name, self.geometry.version, build)
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

    @property
    def middle_of_receivers(self) -> np.ndarray:
        """The middle of the box of everything that receives, (3,), rebased world."""
        box = self.geometry.bounds(receivers=True)
        return np.zeros(3) if box.empty else 0.5 * (box.low + box.high)

    def look_from_light(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int
    ) -> list[HostView]:
        """The projection's views from a light sample (4,), rebased world, of these boxes, one per layer of a map."""
        eye = self.near_plane.raised(self.eye(), receivers, self.geometry.version)
        views = self.projection(light_ws, receivers, casters, resolution, eye)
        for omission in getattr(self.projection, "left_out", ()):
            self.record(omission)
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
        light: Light | None = None,
    ) -> HostMap:
        """A light's linear depth map, seen from one of its samples.

        Args:
            resolution: Texels per side, 1 to 8192.
            light_ws: Light sample (4,), rebased world; the light's centre unless given.
            slot: Maps that must live side by side need different slots.
            cull: Which faces are left out, as seen from the light.
            tag_moving_casters: Negative depth where the nearest caster moves.
            jitter: Shift and turn of whatever views the projection gives; what changes it draws the map anew.
            casters: Which of them, a key of ``Geometry.caster_sets``; the views are those of all.
            light: Whose sample it is; the light that is asked for unless given.
        """
        source = light or self.light
        sample = source.centre if light_ws is None else light_ws
        receivers, box = self.geometry.bounds(receivers=True), self.geometry.bounds(casters=True)
        if receivers.empty:
            receivers = box
        if receivers.empty:  # no meshes at all: any view will do
            receivers = Bounds()
            receivers.add(np.zeros((1, 3)))
        views = self.look_from_light(sample, receivers, box, resolution)
        if jitter is not None:
            views = [jittered_view(view, jitter) for view in views]
        options = getattr(self.projection, "map_options", PLAIN_MAP)
        drawn, empty = self._maps.pull(
            self, views, sample, slot, options, cull=cull, tagged=tag_moving_casters, casters=casters
        )
        out = HostMap(
            map=drawn,
            views=tuple(views),
            light_ws=sample,
            from_centre=light_ws is None,
            light=source,
            slot=slot,
            empty=empty,
        )
        self.looks.append(out)
        return out
