"""Mitsuba's ``mask`` materials as cut-outs, where they are textures on rectangles."""

from __future__ import annotations

import numpy as np

from experiments.scenes.importing.mitsuba_xml import Element
from experiments.scenes.masks import image_channel
from experiments.scenes.meshes.reading import Tell
from wkernels.scene.cutouts import Mask, Wrap

_WRAPS: dict[str, Wrap] = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp"}


def mask_of(element: Element, material: Element, vertices: np.ndarray, tell: Tell) -> Mask | None:
    """Where a shape under a ``mask`` material is there; None where it is drawn opaque, which is told.

    Mitsuba lets a share of the rays through where opacity lies between 0 and 1; here it is cut at one half.

    Args:
        element: The shape.
        material: Its material of type ``mask``.
        vertices: Of the shape, in its own space.
        tell: Takes what is not done as the file says.
    """
    opacity = material.named("opacity")
    if opacity is None or opacity.tag != "texture":
        constant = 0.5 if opacity is None else material.number("opacity", 0.5)
        if constant <= 0.0:
            return Mask(np.zeros((len(vertices), 2)), np.zeros((1, 1), np.float32))
        if constant < 1.0:
            tell("shapes with a mask that is half transparent throughout are drawn opaque.")
        return None
    if opacity.kind != "bitmap" or opacity.named("to_uv") is not None or element.kind != "rectangle":
        tell("shapes with a mask other than an unmoved bitmap on a rectangle are drawn opaque.")
        return None
    filename = opacity.text("filename", "")
    path = opacity.file.parent / filename
    if not path.is_file():
        raise opacity.error(f"no such file: '{path}'.")
    alpha = image_channel(path, "red")
    if np.any((alpha > 0.0) & (alpha < 1.0)):
        tell(f"the mask '{path.name}' is neither 0 nor 1 everywhere; it is cut at one half.")
    wrap = _WRAPS.get(opacity.text("wrap_mode", "repeat"), "repeat")
    nearest = opacity.text("filter_type", "bilinear") == "nearest"
    return Mask(0.5 * (vertices[:, :2] + 1.0), alpha, 0.5, (wrap, wrap), nearest)
