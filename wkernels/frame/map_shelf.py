"""The light depth maps of a session: drawn when asked for, kept for later frames up to a budget of memory."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wkernels.frame.empty_maps import UNDRAWN, may_see
from wkernels.light_maps.drawing import CasterBlocks, draw_light_map, views_stamp
from wkernels.light_maps.light_map import LightMap
from wkernels.light_maps.storage import PLAIN_MAP, MapOptions, lay_out
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import HostView

if TYPE_CHECKING:
    from wkernels.frame.session import Session

MOVING = {"all": None, "still": False, "moving": True}
"""``Geometry.bounds``' argument for each key of ``Geometry.caster_sets``."""

BESIDE = "blocks of casters in light views", "they lie beside the view"
MAP_BUDGET_BYTES = 512 * 2**20  # maps of many light samples are kept for later frames up to this much memory


class MapShelf:
    """Draws and keeps maps.

    Args:
        geometry: What casts.
        rasteriser: Draws it.
    """

    def __init__(self, geometry: Geometry, rasteriser: Rasteriser) -> None:
        self._geometry, self._rasteriser = geometry, rasteriser
        self._blocks = CasterBlocks(geometry, rasteriser.device, rasteriser.threads)
        self._kept: dict[Hashable, int] = {}
        self._bytes = 0
        self._empty: dict[Hashable, LightMap] = {}

    def is_empty(self, light_map: LightMap) -> bool:
        """Whether a map is one that nothing was drawn into, because no caster lies in its views."""
        return any(light_map is held for held in self._empty.values())

    def clear(self) -> None:
        """Forgets all maps."""
        self._kept.clear()
        self._empty.clear()
        self._bytes = 0

    def pull(
        self,
        frame: Session,
        views: Sequence[HostView],
        light_ws: np.ndarray,
        slot: Hashable,
        cull: int,
        tagged: bool,
        casters: str,
    ) -> LightMap:
        """The map of these views; see ``Session.light_map``. Beyond the budget all new slots share one map."""
        resolution = views[0].width
        options: MapOptions = getattr(frame.projection, "map_options", PLAIN_MAP)
        layout = lay_out(options.storage, len(views), resolution)
        key: Hashable = ("map", slot, resolution, cull, tagged, casters)
        if key not in self._kept and self._bytes + 4 * layout.texels > MAP_BUDGET_BYTES:
            key = ("map", "shared", resolution, cull, tagged, casters)
        triangle = frame.buffer("map triangles", (resolution, layout.pitch), wp.int32) if tagged else None

        def build(old: LightMap | None) -> LightMap:
            way = (self._rasteriser, cull, triangle, options, self._blocks, not frame.may_leave_out(*BESIDE))
            box = self._geometry.bounds(casters=True, moving=MOVING[casters])
            draws = may_see(views, box) or not frame.leave_out(*UNDRAWN, len(views))
            made, beside = draw_light_map(old, self._geometry, views, light_ws, *way, draws=draws, casters=casters)
            self._empty.pop(key, None)
            if not draws:
                self._empty[key] = made
            self._bytes += 4 * made.depth.size - self._kept.get(key, 0)
            self._kept[key] = 4 * made.depth.size
            if beside:
                frame.leave_out(*BESIDE, beside)
            return made

        out: LightMap = frame.product("light depth map", key, (self._geometry.version, views_stamp(views)), build)
        return out
