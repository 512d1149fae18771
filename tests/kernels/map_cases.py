"""Light maps of every storage and projection, and random texels in their layout, for the tests of what is built on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import small_scenes as small
import warp as wp

from algorithms.projections.composition import compose
from wkernels.filters.map_images import MapImage
from wkernels.filters.texels import components
from wkernels.frame.session import Session
from wkernels.light_maps.storage import PLACES, allocate, lay_out, layer_images, layers_on_host
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light, SphereLight

LAYOUTS = {f"{storage} x {layers}, {side}": (storage, layers, side) for storage, layers, side in (
    ("separate", 1, 64), ("separate", 3, 20), ("array", 1, 1), ("array", 2, 37), ("array", 4, 48), ("cube6", 6, 33),
    ("cube6", 6, 32), ("atlas4", 4, 24), ("atlas4", 3, 7), ("atlas9", 9, 16), ("atlas9", 7, 40), ("atlas16", 16, 20),
    ("atlas16", 5, 64))}  # fmt: skip
"""Storage, layers, resolution: all storages, full and not, resolutions that are and are not whole runs or powers of 2."""
assert {storage for storage, _, _ in LAYOUTS.values()} == set(PLACES)

SUN, LAMP = small.light("directional"), small.light("rectangle")
INSIDE = SphereLight(center=np.array([0.2, 3.2, 1.5]), radius=0.2)  # six faces
FOCUSED = {"fit": "focused"}
MAPS: dict[str, tuple[Light, dict[str, Any]]] = {
    "directional": (SUN, {}),
    "perspective": (LAMP, {}),
    "six faces": (INSIDE, {"storage": "cube6"}),
    "splits": (SUN, {**FOCUSED, "splits": 4, "scheme": "log", "storage": "atlas4"}),
    "warped sun": (SUN, {**FOCUSED, "warp": "lispsm_nopt"}),
    "warped lamp": (LAMP, {**FOCUSED, "warp": "psm", "splits": 2}),
}
"""Lights and projections: orthographic, perspective, warped, several layers."""


def on_host(image: MapImage) -> np.ndarray:
    """The layers of an image, (layers, R, R, n)."""
    host = layers_on_host(image.texels, image.layout)
    return host if host.ndim == 4 else host[..., None]


def session(light: Light, device: str, **projection: Any) -> Session:
    """A small frame of the cluttered scene."""
    geometry = Geometry(small.cluttered(light), device)
    return Session(geometry, width=60, height=40, device=device, projection=compose(projection))


def random_image(case: str, texel: type, device: str, empty: float = 0.0) -> tuple[MapImage, np.ndarray]:
    """Random texels in the layout of a case, NaN where no layer lies.

    Returns:
        The image, of whose numbers a share ``empty`` is +inf; and its layers on the host, (layers, R, R, n).
    """
    storage, layers, side = LAYOUTS[case]
    layout, count = lay_out(storage, layers, side), components(texel)
    rng = np.random.default_rng(side + layers)
    host = rng.normal(size=(layers, side, side, count)).astype(np.float32)
    host[rng.random(host.shape) < empty] = np.inf
    texels = allocate(layout, texel, device)
    texels.fill_(np.nan)
    for image, values in zip(layer_images(texels, layout), host, strict=True):
        wp.copy(image, wp.array(values[..., 0] if count == 1 else values, dtype=texel, device=device))
    return MapImage(texels=texels, layout=layout), host
