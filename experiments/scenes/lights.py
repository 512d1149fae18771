"""Lights of a scene file as ``wkernels.scene.lights`` objects."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from experiments.scenes import schema
from experiments.scenes.place import Place
from experiments.scenes.poses import KeyframedPose, check_order
from wkernels.errors import one_line
from wkernels.scene.light_motion import transformed
from wkernels.scene.lights import LIGHT_KINDS, Light

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec. 709 colours (ITU-R BT.709)
_RELATIVE_TOLERANCE = 1e-6  # of a polygon's extent: how far from planar and convex it may be


class LightWarning(UserWarning):
    """A light is not what its kind promises."""


def build_light(place: Place) -> Light:
    """The light that the mapping at ``place`` describes; raises InputError."""
    options = place.validated(place.choice("kind", schema.LIGHTS))
    values: dict[str, Any] = options.model_dump(exclude={"kind", "texture", "motion"})
    fields: dict[str, Any] = {
        key: np.array(value, np.float64) if isinstance(value, (tuple, list)) and key != "radiance" else value
        for key, value in values.items()
    }
    if isinstance(options, schema.Rectangle):
        _check_parallelogram(fields["edge_u"], fields["edge_v"], place)
    if isinstance(options, schema.Polygon):
        fields["vertices"] = _convex(fields["vertices"], place.at("vertices"))
    if isinstance(options, (schema.Rectangle, schema.Polygon)) and options.texture is not None:
        fields["texture"] = read_luminance(options.texture, place.at("texture"))
    light = LIGHT_KINDS[place.data["kind"]](**fields)
    return light if options.motion is None else _moving(light, options.motion, place.at("motion", "keyframes"))


def _moving(light: Light, motion: schema.Motion, place: Place) -> Light:
    """The light with a motion, or moved for good where no keyframe differs from the first; raises InputError."""
    check_order([key.frame for key in motion.keyframes], place)
    for i, key in enumerate(motion.keyframes):
        if light.is_directional and any(key.translate):
            raise place.at(i, "translate").error("a directional light is everywhere; only rotate_deg moves it.")
        if light.is_directional and key.scale != (1.0, 1.0, 1.0):
            raise place.at(i, "scale").error("a directional light has no size to scale; only rotate_deg moves it.")
        if light.kind in ("disc", "sphere") and len(set(key.scale)) > 1:
            raise place.at(i, "scale").error(f"a {light.kind} stays round: one factor for all axes.")
    pose = KeyframedPose(motion, np.eye(4))
    return replace(light, motion=pose) if pose.moving else transformed(light, pose(0))


def _check_parallelogram(edge_u: np.ndarray, edge_v: np.ndarray, place: Place) -> None:
    """Raises InputError where the edges are parallel, and tells of one without length: the light has no area then."""
    zero = [key for key, edge in (("edge_u", edge_u), ("edge_v", edge_v)) if not edge.any()]
    if zero:
        what = "a point" if len(zero) == 2 else "a line"
        keys = " and ".join(zero)
        warnings.warn(LightWarning(str(place.at(zero[0]).error(f"{keys} zero: the light is {what}."))), stacklevel=4)
    length_u, length_v = np.linalg.norm(edge_u), np.linalg.norm(edge_v)
    area = np.linalg.norm(np.cross(edge_u, edge_v))
    if length_u > 0.0 and length_v > 0.0 and not area > _RELATIVE_TOLERANCE * length_u * length_v:
        raise place.at("edge_v").error("must not be parallel to edge_u (a light along a line is kind: linear).")


def _convex(vertices: np.ndarray, place: Place) -> np.ndarray:
    """The vertices without those on straight edges, after checking that they are planar, convex and in order."""
    vertices = vertices[np.any(vertices != np.roll(vertices, 1, axis=0), axis=1)]
    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    # Newell's normal is twice the area vector, whatever the shape of the polygon.
    local = vertices - vertices.mean(axis=0) if len(vertices) else vertices
    normal = np.cross(local, np.roll(local, -1, axis=0)).sum(axis=0)
    area = np.linalg.norm(normal)
    if not area > _RELATIVE_TOLERANCE * extent**2:
        raise place.error("the polygon has no area.")
    normal /= area
    if np.abs(local @ normal).max() > _RELATIVE_TOLERANCE * extent:
        raise place.error("the polygon must be planar.")
    ahead = np.roll(local, -1, axis=0) - local
    behind = np.roll(ahead, 1, axis=0)
    sine = np.cross(behind, ahead) @ normal
    turn = np.arctan2(sine, np.sum(behind * ahead, axis=1))
    lengths = np.linalg.norm(behind, axis=1) * np.linalg.norm(ahead, axis=1)
    # A star turns the same way everywhere too, but more than once round.
    if np.any(sine < -_RELATIVE_TOLERANCE * lengths) or turn.sum() > 3.0 * np.pi:
        raise place.error("the polygon must be convex, its vertices in order around it.")
    return vertices[sine > _RELATIVE_TOLERANCE * lengths]


def read_luminance(name: str, place: Place) -> np.ndarray:
    """Linear luminance of an image file, float64 (rows, cols), row 0 its top; 8-bit colours are decoded as sRGB.

    Raises:
        InputError: The file is missing, no image, all black, or has negative or non-finite pixels.
    """
    import OpenImageIO as oiio  # slow to load, and few scenes have textured lights

    path = place.existing_file(name)
    image = oiio.ImageBuf(str(path))
    pixels = image.get_pixels(oiio.FLOAT)
    if image.has_error or pixels is None:
        raise place.error(f"'{path}' cannot be read as an image: {one_line(image.geterror) or 'no reason given'}.")
    values = np.asarray(pixels, np.float64).reshape(image.spec().height, image.spec().width, -1)
    if image.spec().format == oiio.UINT8:
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    luminance = values[..., :3] @ _LUMINANCE if values.shape[2] >= 3 else values[..., 0]
    if not np.all(np.isfinite(luminance)) or luminance.min() < 0.0:
        raise place.error(f"'{path}' has negative or non-finite pixels.")
    if not luminance.max() > 0.0:
        raise place.error(f"'{path}' is black, the light would not shine.")
    return luminance
