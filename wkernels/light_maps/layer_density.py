"""How many texels of each layer of a light map a unit length takes, for filters of a size in the world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wkernels.light_maps.host_map import HostMap
from wkernels.scene.views import HostView
from wkernels.workspace.workspace import Workspace


def layer_densities(views: Sequence[HostView], light_ws: np.ndarray, reference_ws: np.ndarray) -> np.ndarray:
    """Texels per unit length across the map axes, in the middle of each view.

    Without a warp a directional light's map has this density everywhere, and a point's at this distance from it.

    Args:
        views: The layers.
        light_ws: Light sample (4,).
        reference_ws: A point (3,) as far from a point light as the density is asked for.

    Returns:
        float64 (layers, 2), along right and up.
    """
    distance = float(np.linalg.norm(reference_ws - light_ws[:3])) if light_ws[3] else 0.0
    out = []
    for view in views:
        x, y, depth, w = view.ws_to_ss
        planes = np.stack([x, y, depth])
        middle = np.linalg.solve(planes[:, :3], np.array([0.0, 0.0, max(distance, view.near)]) - planes[:, 3])
        scale = 0.5 / max(float(w[:3] @ middle + w[3]), 1e-30)
        out.append([scale * view.width * abs(x[:3] @ view.right_ws), scale * view.height * abs(y[:3] @ view.up_ws)])
    return np.array(out)


def pull_layer_densities(work: Workspace, light_map: HostMap, reference_ws: np.ndarray) -> wp.array:
    """``layer_densities`` of a map as a product, vec2 (layers,); ``reference_ws`` must follow the map's geometry."""

    def build(old: wp.array | None) -> wp.array:
        densities = layer_densities(light_map.views, light_map.light_ws, reference_ws).astype(np.float32)
        return wp.array(densities, dtype=wp.vec2, device=work.device)

    key = ("texels per length", light_map.slot)
    densities: wp.array = work.product("texels per length", key, (light_map.map,), build)
    return densities
