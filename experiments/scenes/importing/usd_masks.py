"""Opacity masks of UsdPreviewSurface: where ``opacityThreshold`` leaves nothing of a mesh (USD, "UsdPreviewSurface").

Textures of USD begin at the bottom: v is turned over.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.masks import image_channel
from experiments.scenes.meshes.reading import Tell
from experiments.scenes.meshes.usd_prims import Corners, mesh_corners
from wkernels.scene.cutouts import Mask, Wrap

_WRAPS: dict[str, Wrap] = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "useMetadata": "repeat"}
_CHANNELS = {"r": "red", "g": "green", "b": "blue", "a": "alpha"}


@dataclass(frozen=True, eq=False)
class MaskedTriangles:
    """A mesh whose vertices are its faces' corners, which may differ in texture coordinates, and its mask."""

    vertices: np.ndarray
    faces: np.ndarray
    mask: Mask


def masked_triangles(prim: Any, time: Any, tell: Tell) -> MaskedTriangles | None:
    """A mesh with an opacity mask; None where there is none, or where it is drawn opaque, which is told."""
    from pxr import UsdGeom, UsdShade

    if not prim.IsA(UsdGeom.Mesh):
        return None
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    shader = material.ComputeSurfaceSource("")[0] if material else None
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        return None
    threshold = _value(shader, "opacityThreshold", 0.0)
    opacity = shader.GetInput("opacity")
    if not threshold > 0.0:
        if opacity and (opacity.HasConnectedSource() or _value(shader, "opacity", 1.0) < 1.0):
            tell("surfaces that are transparent are drawn opaque.")
        return None

    def opaque(why: str) -> None:
        tell(f"the opacity mask of {prim.GetPath()} {why}; it is drawn opaque.")

    corners = mesh_corners(UsdGeom.Mesh(prim), time, tell)
    if not (opacity and opacity.HasConnectedSource()):
        if _value(shader, "opacity", 1.0) >= threshold:
            return None
        nothing = Mask(np.zeros((len(corners.points), 2)), np.zeros((1, 1), np.float32), 0.5)
        return MaskedTriangles(corners.points, corners.faces, nothing)
    connection = opacity.GetConnectedSources()[0][0]
    texture, channel = UsdShade.Shader(connection.source.GetPrim()), connection.sourceName
    if texture.GetIdAttr().Get() != "UsdUVTexture" or str(channel) not in _CHANNELS:
        opaque("is no channel of a UsdUVTexture")
        return None
    file = _value(texture, "file", None)
    path = Path(str(file.resolvedPath or file.path)) if file is not None else None
    if path is None or not path.is_file():
        opaque("has a texture that is missing")
        return None
    reader = texture.GetInput("st")
    varname = "st"
    if reader and reader.HasConnectedSource():
        named = UsdShade.Shader(reader.GetConnectedSources()[0][0].source.GetPrim())
        if named.GetIdAttr().Get() != "UsdPrimvarReader_float2":
            opaque("has texture coordinates that are transformed")
            return None
        varname = str(_value(named, "varname", "st"))
    uv = _texture_coordinates(UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(varname), corners, time)
    if uv is None:
        opaque(f"has no texture coordinates '{varname}' that fit it")
        return None
    at = "rgba".index(str(channel))
    scale, bias = (float(_value(texture, key, (fill,) * 4)[at]) for key, fill in (("scale", 1.0), ("bias", 0.0)))
    alpha = scale * image_channel(path, _CHANNELS[str(channel)]) + bias
    wraps = [_WRAPS.get(str(_value(texture, key, "useMetadata")), "clamp") for key in ("wrapS", "wrapT")]
    uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)
    mask = Mask(uv, alpha.astype(np.float32), float(threshold), (wraps[0], wraps[1]))
    return MaskedTriangles(corners.points, corners.faces, mask)


def _texture_coordinates(primvar: Any, corners: Corners, time: Any) -> np.ndarray | None:
    """Of each corner, float64 (C, 2); None where they do not fit."""
    if not primvar or not primvar.HasValue():
        return None
    flat = np.array(primvar.ComputeFlattened(time) or [], np.float64).reshape(-1, 2)
    rows = {
        "faceVarying": corners.number,
        **dict.fromkeys(("vertex", "varying"), corners.vertex),
        "uniform": corners.face,
        "constant": np.zeros(len(corners.vertex), np.int64),
    }[str(primvar.GetInterpolation())]
    if not len(flat) or rows.max(initial=0) >= len(flat) or not np.isfinite(flat).all():
        return None
    out: np.ndarray = flat[rows]
    return out


def _value(shader: Any, name: str, default: Any) -> Any:
    """The value of an input, of what it is connected to where that is no shader's output."""
    found = shader.GetInput(name)
    value = found.Get() if found else None
    return default if value is None else value
