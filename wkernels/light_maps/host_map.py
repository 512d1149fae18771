"""A light depth map as the host knows it: the kernels' struct, and where it looked from."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from wkernels.light_maps.light_map import LightMap, layout_of
from wkernels.light_maps.storage import MapLayout
from wkernels.scene.lights import Light
from wkernels.scene.views import HostView


@dataclass(frozen=True, eq=False, kw_only=True)
class LightLook:
    """Where a frame's technique looked from the light.

    Attributes:
        views: One per layer.
        light_ws: The light sample (4,), rebased world.
        from_centre: Whether that is the sample that stands for the whole light.
    """

    views: tuple[HostView, ...]
    light_ws: np.ndarray
    from_centre: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class HostMap(LightLook):
    """One pull of a light depth map.

    Attributes:
        map: For kernels. A map that is drawn anew is a new struct, so that the struct itself stands for everything that
            the map depends on, among the inputs of products.
        light: Whose map it is.
        slot: What tells it from other maps that live side by side.
        empty: Whether nothing was drawn into it, because no caster lies in its views.
    """

    map: LightMap
    light: Light
    slot: Hashable
    empty: bool

    @property
    def layout(self) -> MapLayout:
        """Where its layers lie in memory."""
        return layout_of(self.map)
