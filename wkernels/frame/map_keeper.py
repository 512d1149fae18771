"""The light depth maps of a session: drawn when asked for, kept for later frames up to a budget of memory."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
import warp as wp

from wkernels.frame.empty_maps import EmptyMaps, may_see
from wkernels.light_maps.drawing import CasterBlocks, Drawing, draw_light_map
from wkernels.light_maps.layered import LayeredMap, draw_layered_map
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.many_maps import LightMaps, draw_light_maps
from wkernels.light_maps.map_look import views_stamp
from wkernels.light_maps.storage import MapOptions, lay_out
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import HostView
from wkernels.workspace.left_out import Omission
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace

MOVING = {"all": None, "still": False, "moving": True}
"""``Geometry.bounds``' argument for each key of ``Geometry.caster_sets``."""
MAP_BUDGET_BYTES = 512 * 2**20  # maps of many light samples are kept for later frames up to this much memory


class BesideViews(Omission):
    """What drawing passes over."""

    BLOCKS = "blocks of casters in light views", "they lie beside the view"


class MapKeeper:
    """Draws and keeps maps.

    Args:
        geometry: What casts.
        rasteriser: Draws it.
    """

    def __init__(self, geometry: Geometry, rasteriser: Rasteriser) -> None:
        self._geometry, self._rasteriser = geometry, rasteriser
        self._blocks = CasterBlocks(geometry, rasteriser.device, rasteriser.threads)
        self._kept_bytes: dict[Hashable, int] = {}
        self._total_bytes = 0  # of them: summed anew for each map, 10 000 maps would take minutes
        self._empty: dict[Hashable, bool] = {}

    def clear(self) -> None:
        """Forgets all maps."""
        self._kept_bytes.clear()
        self._total_bytes = 0
        self._empty.clear()

    def pull(
        self,
        work: Workspace,
        views: Sequence[HostView],
        light_ws: np.ndarray,
        slot: Hashable,
        options: MapOptions,
        *,
        cull: int,
        tagged: bool,
        caster_set: str,
    ) -> tuple[LightMap, bool]:
        """The map of these views, and whether it is empty; see ``Session.light_map``.

        Beyond the budget all new slots share one map.
        """
        resolution = views[0].width
        layout = lay_out(options.storage, len(views), resolution)
        key: Hashable = ("map", slot, resolution, cull, tagged, caster_set)
        if key not in self._kept_bytes and self._total_bytes + 4 * layout.texels > MAP_BUDGET_BYTES:
            key = ("map", "shared", resolution, cull, tagged, caster_set)
        triangle = work.buffer("map triangles", (resolution, layout.pitch), wp.int32) if tagged else None

        def build(old: LightMap | None) -> LightMap:
            drawing = self._drawing(work, options, cull, caster_set, triangle)
            box = self._geometry.bounds(casters=True, moving=MOVING[caster_set])
            draws = may_see(views, box) or not work.leave_out(EmptyMaps.UNDRAWN, count=len(views))
            made, beside = draw_light_map(drawing, views, light_ws, old, draws)
            self._empty[key] = not draws
            self._total_bytes += 4 * made.depth.size - self._kept_bytes.get(key, 0)
            self._kept_bytes[key] = 4 * made.depth.size
            if beside:
                work.leave_out(BesideViews.BLOCKS, count=beside)
            return made

        inputs = (self._geometry.version, views_stamp(views))
        out: LightMap = work.product(Product.LIGHT_MAP, key, inputs, build)
        return out, self._empty[key]

    def pull_many(
        self,
        work: Workspace,
        views: Sequence[Sequence[HostView]],
        light_ws: np.ndarray,
        slot: Hashable,
        options: MapOptions,
        cull: int,
    ) -> LightMaps:
        """Maps of many samples (n, 4) of a light side by side; see ``LightSide.light_maps``."""

        def build(old: LightMaps | None) -> LightMaps:
            box = self._geometry.bounds(casters=True)
            draws = [may_see(own, box) or not work.leave_out(EmptyMaps.UNDRAWN, count=len(own)) for own in views]
            made, beside = draw_light_maps(self._drawing(work, options, cull), views, light_ws, old, draws)
            if beside:
                work.leave_out(BesideViews.BLOCKS, count=beside)
            return made

        inputs = (self._geometry.version, tuple(views_stamp(own) for own in views))
        key = ("maps", slot, len(views), views[0][0].width, cull)
        out: LightMaps = work.product(Product.LIGHT_MAP, key, inputs, build)
        return out

    def pull_layered(
        self,
        work: Workspace,
        views: Sequence[HostView],
        light_ws: np.ndarray,
        peels: int,
        slot: Hashable,
        options: MapOptions,
        *,
        cull: int,
        faces: bool,
    ) -> LayeredMap:
        """A map with the nearest depths of each texel; see ``LightSide.layered_map``."""

        def build(old: LayeredMap | None) -> LayeredMap:
            drawing = self._drawing(work, options, cull)
            return draw_layered_map(drawing, views, light_ws, peels, faces=faces, old=old)

        inputs = (self._geometry.version, views_stamp(views))
        key = ("layered map", slot, peels, views[0].width, cull, faces)
        out: LayeredMap = work.product(Product.LIGHT_MAP, key, inputs, build)
        return out

    def _drawing(
        self,
        work: Workspace,
        options: MapOptions,
        cull: int,
        caster_set: str = "all",
        triangle: wp.array | None = None,
    ) -> Drawing:
        return Drawing(
            geometry=self._geometry,
            rasteriser=self._rasteriser,
            cull=cull,
            caster_set=caster_set,
            options=options,
            blocks=self._blocks,
            everything=not work.may_leave_out(BesideViews.BLOCKS),
            triangle=triangle,
        )
