"""What a technique pulls of the light's side of a frame: depth maps, samples, structures for rays.

A product is built on first request, timed under its own name, and kept until one of its inputs (geometry, camera, light
sample) changes. What nobody asks for is never built.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import warp as wp

from wkernels.frame.eye_side import EyeSide
from wkernels.frame.map_keeper import MapKeeper
from wkernels.frame.near_plane import NearPlane
from wkernels.light_maps.host_map import HostMap, LightLook
from wkernels.light_maps.layered import LayeredMap
from wkernels.light_maps.many_maps import LightMaps
from wkernels.light_maps.storage import PLAIN_MAP, MapOptions
from wkernels.projections.jitter import Jitter, jittered_view
from wkernels.projections.light_views import fit_scene
from wkernels.raster import CULL_NONE
from wkernels.rays.caster_tree import CasterTree, CasterTreeBuilder
from wkernels.rays.light_proofs import LightHull, light_hull
from wkernels.rays.light_samples import LightSamples
from wkernels.rays.ray_casters import RayCasterBuilder, RayCasters, no_ray_casters
from wkernels.sampling.point_sets import light_set
from wkernels.scene.geometry import Bounds, Geometry
from wkernels.scene.light_motion import FrameLights
from wkernels.scene.lights import Light
from wkernels.scene.views import HostView
from wkernels.workspace.products import Product

LightViews = Callable[[np.ndarray, Bounds, Bounds, int, HostView], list[HostView]]
"""A projection: light sample (4,), receivers' box, casters' box, map resolution, eye view -> one view per layer.

It may have three attributes: ``near``, the ``NearPlane`` rule of the eye view that it gets ("user" without it);
``left_out``, members of an ``Omission``: what its last call could not or need not do; and ``map_options``, a
``MapOptions`` that says how its maps are stored and drawn.
"""


LIGHT_TEXTURE = "light texture"
"""Name of the product by which a technique reads it, besides the weights of ``light_samples``."""
FARTHEST_CASTER = 64.0
"""Distance of a caster from what is around the eye, in sizes of that, up to which one map holds the depths of both:
the comparison's allowance for rounding is 2e-6 of it (``light_map``)."""


class LightSide(EyeSide):
    """What one frame of one technique label offers under the light that is set.

    Args:
        geometry, width, height: Of ``EyeSide``.
        light_index: Which light of the scene.
        projection: Where light depth maps look; ``scene_views`` unless given.
        **options: Of ``Workspace``.

    Attributes:
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
        super().__init__(geometry, width, height, **options)
        self.lights = FrameLights(geometry.scene.lights, light_index, geometry.origin_ws)
        self.projection: LightViews = projection or fit_scene
        self.looks: list[LightLook] = []
        self.near_plane = NearPlane(getattr(self.projection, "near", "user"), self, self.widest_gbuffer)
        self._maps = MapKeeper(geometry, self.rasteriser)

    def forget_pulls(self) -> None:
        super().forget_pulls()
        self.looks.clear()

    @property
    def shown(self) -> LightLook | None:
        """What the frame's results tell of its maps: the last look from the light's centre, else the first look."""
        central = [look for look in self.looks if look.from_centre]
        return central[-1] if central else self.looks[0] if self.looks else None

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
        samples: LightSamples = self.product(Product.LIGHT_SAMPLES, ("samples", kind, count), inputs, build)
        return samples

    def caster_mesh(self) -> RayCasters:
        """The casters' triangles for single rays."""
        geometry = self.geometry
        if geometry.caster_triangles == 0:
            return no_ray_casters(self.device)

        def build(old: RayCasterBuilder | None) -> RayCasterBuilder:
            if old is None:
                cutouts, casters = geometry.cutouts, geometry.caster_indices
                return RayCasterBuilder(geometry.points_ws, casters, cutouts, self.device, self.threads)
            old.refit()
            return old

        builder: RayCasterBuilder = self.product(Product.RAY_STRUCTURE, "casters", geometry.version, build)
        return builder.casters

    def caster_tree(self) -> CasterTree:
        """The casters' triangles as a tree of boxes, for all rays of a receiver at once."""

        def build(old: CasterTreeBuilder | None) -> CasterTreeBuilder:
            if old is None:
                geometry = self.geometry
                casters, count = geometry.caster_indices, geometry.caster_triangles
                options: dict[str, Any] = {"threads": self.threads, "cutouts": geometry.cutouts}
                return CasterTreeBuilder(geometry.points_ws, casters, count, self.device, **options)
            old.refit()
            return old

        builder: CasterTreeBuilder = self.product(Product.CASTER_TREE, "caster tree", self.geometry.version, build)
        return builder.tree

    @property
    def light(self) -> Light:
        """The light that is asked for, at this frame, rebased world."""
        return self.lights.current

    @property
    def has_texture(self) -> bool:
        """Whether parts of the light that is asked for shine more than others."""
        texture = getattr(self.light, "texture", None)
        return texture is not None and bool(np.ptp(texture) > 0.0)

    def light_hull(self) -> LightHull:
        """The light's hull for proofs, and how far a ray must reach to leave the scene."""
        return light_hull(self.light, self.reach, self.device, self.span)

    @property
    def reach(self) -> float:
        """Length of a ray that leaves the scene from anywhere in it."""
        box = self.geometry.bounds(casters=True, receivers=True)
        return 1.0 if box.empty else 1.01 * float(np.linalg.norm(box.high - box.low)) + 1e-6

    @property
    def span(self) -> float:
        """Size of what is around the eye, scene units: ``reach`` in scenes that do not go on much farther."""
        return 1.01 * self.geometry.span + 1e-6 if self.geometry.span else 1.0

    @property
    def middle_of_receivers(self) -> np.ndarray:
        """The middle of the box of what receives, and is not too small to be seen, (3,), rebased world."""
        box = self.geometry.bounds(receivers=True, noticed=True)
        return np.zeros(3) if box.empty else 0.5 * (box.low + box.high)

    def casters_towards(self, light_ws: np.ndarray, moving: bool | None = None) -> Bounds:
        """Boxes of the casters that a map of what is noticed needs to hold, from a light sample (4,), rebased world.

        Those that are noticed, and of the others those between it and a directional light: no map from a point ends
        before its casters. One that lies more than ``FARTHEST_CASTER`` before it is left out, and that is told.

        Args:
            light_ws: Light sample (4,), rebased world.
            moving: As for ``Geometry.bounds``.
        """
        noticed = self.geometry.bounds(casters=True, moving=moving, noticed=True)
        out = self.geometry.bounds(casters=True, moving=moving)
        if light_ws[3] != 0.0 or len(out.corners) == len(noticed.corners):
            return noticed
        shaded = self.geometry.bounds(casters=True, receivers=True, noticed=True)
        if shaded.empty:
            return out
        middle, radius = 0.5 * (shaded.low + shaded.high), 0.5 * float(np.linalg.norm(shaded.high - shaded.low))
        held = {box.tobytes() for box in noticed.corners.reshape(-1, 8, 3)}
        for box in out.corners.reshape(-1, 8, 3):
            way = 0.5 * (box[0] + box[-1]) - middle
            along, own = float(way @ light_ws[:3]), 0.5 * float(np.linalg.norm(box[-1] - box[0]))
            aside = float(np.linalg.norm(way - along * light_ws[:3]))
            if box.tobytes() in held or along <= 0.0 or aside > 1.001 * (radius + own):
                continue
            if along - own > FARTHEST_CASTER * 2.0 * radius:
                self.record("casters in light maps", "they are so far off that depth would lose those near the eye")
            else:
                noticed.add(box)
        return noticed

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
        caster_set: str = "all",
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
            caster_set: Which casters, a key of ``Geometry.caster_sets``; the views are those of all.
            light: Whose sample it is; the light that is asked for unless given.
        """
        source = light or self.light
        sample = source.centre if light_ws is None else light_ws
        views = self._look(sample, resolution)
        if jitter is not None:
            views = [jittered_view(view, jitter) for view in views]
        drawn, empty = self._maps.pull(
            self, views, sample, slot, self._map_options, cull=cull, tagged=tag_moving_casters, caster_set=caster_set
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

    def light_maps(
        self, resolution: int, light_ws: np.ndarray, *, slot: Hashable = "samples", cull: int = CULL_NONE
    ) -> LightMaps:
        """Maps of many samples of a light side by side, so that one kernel can ask all of them (``many_maps.map_of``).

        Each has the bits that ``light_map`` has of its sample. All of them count as one product: one sample that moves
        draws them all.

        Args:
            resolution: Texels per side of each.
            light_ws: Light samples (n, 4), rebased world, n at least 1.
            slot: Sets that must live side by side need different slots.
            cull: Which faces are left out, as seen from the light.

        Raises:
            InputError: More texels than one array holds.
        """
        views = [self._look(sample, resolution) for sample in light_ws]
        out = self._maps.pull_many(self, views, light_ws, slot, self._map_options, cull)
        self.looks.append(LightLook(views=tuple(views[0]), light_ws=light_ws[0], from_centre=False))
        return out

    def layered_map(
        self,
        resolution: int,
        peels: int,
        light_ws: np.ndarray | None = None,
        *,
        slot: Hashable = "centre",
        cull: int = CULL_NONE,
        faces: bool = False,
    ) -> LayeredMap:
        """A light's depth map with the ``peels`` nearest depths of each texel; its ``map`` is that of ``light_map``.

        Args:
            resolution: Texels per side.
            peels: At least 1.
            light_ws: Light sample (4,), rebased world; the light's centre unless given.
            slot: Maps that must live side by side need different slots.
            cull: Which faces are left out, as seen from the light.
            faces: Whether it is noted which side each surface turns to the light.
        """
        sample = self.light.centre if light_ws is None else light_ws
        views = self._look(sample, resolution)
        out = self._maps.pull_layered(self, views, sample, peels, slot, self._map_options, cull=cull, faces=faces)
        self.looks.append(LightLook(views=tuple(views), light_ws=sample, from_centre=light_ws is None))
        return out

    @property
    def _map_options(self) -> MapOptions:
        return getattr(self.projection, "map_options", PLAIN_MAP)

    def _look(self, light_ws: np.ndarray, resolution: int) -> list[HostView]:
        """The views of a map from a light sample, of what receives; of what casts where nothing does.

        What is too small to be seen from anywhere on the path needs no texels.
        """
        receivers, casters = self.geometry.bounds(receivers=True, noticed=True), self.casters_towards(light_ws)
        if receivers.empty:
            receivers = casters
        if receivers.empty:  # no meshes at all: any view will do
            receivers = Bounds()
            receivers.add(np.zeros((1, 3)))
        return self.look_from_light(light_ws, receivers, casters, resolution)
