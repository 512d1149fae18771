"""UsdLux lights as our own, in the space of their prims (Universal Scene Description, schema usdLux)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from experiments.scenes.meshes.reading import MeshError
from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    PointLight,
    RectangleLight,
    SphereLight,
)

_AHEAD = np.array([0.0, 0.0, -1.0])  # all that have a direction shine along -z


def usd_light(prim: Any, time: Any, tell: Callable[[str], None]) -> Light | None:
    """The light of a prim, its size on the first frame; None of a kind that there is not. Raises MeshError."""
    kind = str(prim.GetTypeName())
    if kind not in ("RectLight", "DiskLight", "SphereLight", "CylinderLight", "DistantLight"):
        return None

    def number(name: str) -> float:
        attribute = prim.GetAttribute(f"inputs:{name}")
        if attribute.ValueMightBeTimeVarying():
            tell(f"the {name} of light {prim.GetPath()} changes with time; it is held as on the first frame.")
        value = attribute.Get(time)
        if not isinstance(value, float) or not 0.0 <= value < float("inf"):
            raise MeshError(f"light {prim.GetPath()} has the {name} {value}.")
        return value

    def flag(name: str) -> bool:
        return bool(prim.GetAttribute(name).Get(time))

    _tell_of_shaping(prim, time, tell)
    light: Light
    if kind == "RectLight":
        edges = np.array([number("width"), 0.0, 0.0]), np.array([0.0, number("height"), 0.0])
        light = RectangleLight(center=np.zeros(3), edge_u=edges[0], edge_v=edges[1])
        area = float(edges[0][0] * edges[1][1])
        if prim.GetAttribute("inputs:texture:file").Get(time):
            tell(f"the texture of light {prim.GetPath()} is left out: it shines evenly.")
    elif kind == "DiskLight":
        light = DiscLight(center=np.zeros(3), normal=_AHEAD, radius=number("radius"))
        area = float(np.pi * light.radius**2)
    elif kind == "SphereLight":
        radius = number("radius")
        area = float(4.0 * np.pi * radius**2)
        if flag("treatAsPoint"):
            light = PointLight(position=np.zeros(3))
        else:
            light = SphereLight(center=np.zeros(3), radius=radius)
    elif kind == "CylinderLight":
        half, radius = np.array([0.5 * number("length"), 0.0, 0.0]), number("radius")
        light = LinearLight(a=-half, b=half)
        area = float(4.0 * np.pi * radius * half[0])
        if radius > 0.0 and not flag("treatAsLine"):
            tell(f"the radius of light {prim.GetPath()} is left out: a cylinder shines as the line along its axis.")
    else:
        angle = number("angle")
        if not angle < 180.0:
            raise MeshError(f"light {prim.GetPath()} has the angle {angle:g} degrees, which must be below 180.")
        light = DirectionalLight(direction=_AHEAD, angle_deg=angle)
        area = float(np.pi * np.sin(0.5 * np.radians(angle)) ** 2)
    return _shining(light, prim, time, area)


def _shining(light: Light, prim: Any, time: Any, area: float) -> Light:
    """The light with its radiance: intensity, exposure, colour, temperature; over its area where it is normalised."""
    from pxr import UsdLux

    api = UsdLux.LightAPI(prim)
    color = np.array(api.GetColorAttr().Get(time), np.float64)
    if api.GetEnableColorTemperatureAttr().Get(time):
        color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(api.GetColorTemperatureAttr().Get(time)))
    with np.errstate(over="ignore"):
        strength = float(api.GetIntensityAttr().Get(time) * np.exp2(api.GetExposureAttr().Get(time)))
    if api.GetNormalizeAttr().Get(time) and area > 0.0:
        strength /= area
    red, green, blue = (strength * color).tolist()
    if not (np.isfinite([red, green, blue]).all() and min(red, green, blue) >= 0.0):
        raise MeshError(f"light {prim.GetPath()} has the radiance {red:g}, {green:g}, {blue:g}.")
    return replace(light, radiance=(red, green, blue))


def _tell_of_shaping(prim: Any, time: Any, tell: Callable[[str], None]) -> None:
    cone = prim.GetAttribute("inputs:shaping:cone:angle")
    focus = prim.GetAttribute("inputs:shaping:focus")
    if (cone and cone.Get(time) < 180.0) or (focus and focus.Get(time) != 0.0):
        tell(f"the cone of light {prim.GetPath()} is left out: it shines everywhere.")
    enabled = prim.GetAttribute("inputs:shadow:enable")
    if enabled and enabled.Get(time) is False:
        tell(f"light {prim.GetPath()} is to cast no shadows; it casts them.")
    for name in ("lightLink", "shadowLink"):
        targets = (
            prim.GetRelationship(f"collection:{name}:includes"),
            prim.GetRelationship(f"collection:{name}:excludes"),
        )
        if any(relation and relation.GetTargets() for relation in targets):
            tell(f"the {name} of light {prim.GetPath()} is left out: it reaches everything.")
