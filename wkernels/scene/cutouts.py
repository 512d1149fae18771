"""Cut-outs: surfaces that are there where a texture's alpha reaches a cutoff, such as leaves on cards.

Alpha is interpolated between the four nearest texels and then compared, without mip levels, as glTF's viewers do at
close range and as Mitsuba's bitmaps do (Khronos, glTF 2.0, sections 3.8.4 and 3.9.4). Every kernel asks ``is_cut_out``
with a point's barycentric coordinates, so that what the eye sees, what a map holds and what a ray meets are cut alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import warp as wp

if TYPE_CHECKING:
    from wkernels.scene.model import Mesh

Wrap = Literal["repeat", "mirror", "clamp"]
WRAPS: dict[str, int] = {"repeat": 0, "mirror": 1, "clamp": 2}
REPEAT, MIRROR = wp.constant(WRAPS["repeat"]), wp.constant(WRAPS["mirror"])
OPAQUE = wp.constant(-1)


@dataclass(frozen=True, eq=False)
class Mask:
    """Where a mesh is there.

    Attributes:
        uv: Texture coordinates of each vertex, float (V, 2), from the first texel's corner; v grows with rows.
        alpha: Texels, float (H, W), 0 to 1.
        cutoff: Least alpha that is there.
        wrap: What lies beyond the texture, along u and v.
        nearest: Whether the nearest texel alone counts, without interpolation.
    """

    uv: np.ndarray
    alpha: np.ndarray
    cutoff: float = 0.5
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    nearest: bool = False


@wp.struct
class Cutout:
    """One texture among the texels of all."""

    begin: int
    width: int
    height: int
    wrap_u: int
    wrap_v: int
    nearest: int
    cutoff: float


@wp.struct
class Cutouts:
    """All cut-outs of a geometry; a triangle is cut where its first corner has a texture."""

    uv: wp.array(dtype=wp.vec2)  # per vertex; empty where nothing is cut
    texture: wp.array(dtype=int)  # per vertex, OPAQUE where there is none
    textures: wp.array(dtype=Cutout)
    alpha: wp.array(dtype=float)
    count: int  # of textures; 0: nothing is cut, and no array is to be read


@wp.func
def wrapped(texel: int, size: int, wrap: int):
    """The texel in its texture that stands for one beyond it."""
    out = wp.clamp(texel, 0, size - 1)
    if wrap == REPEAT:
        out = texel - size * int(wp.floor(float(texel) / float(size)))
        out = wp.clamp(out, 0, size - 1)  # the quotient of large numbers is rounded
    if wrap == MIRROR:
        out = texel - 2 * size * int(wp.floor(float(texel) / float(2 * size)))
        out = wp.clamp(wp.min(out, 2 * size - 1 - out), 0, size - 1)
    return out


@wp.func
def texel_alpha(cutouts: Cutouts, own: Cutout, column: int, row: int):
    """Alpha of a texel, which may lie beyond the texture."""
    y = wrapped(row, own.height, own.wrap_v)
    return cutouts.alpha[own.begin + y * own.width + wrapped(column, own.width, own.wrap_u)]


@wp.func
def alpha_at(cutouts: Cutouts, own: Cutout, uv: wp.vec2):
    """Alpha of a texture at texture coordinates."""
    x = wp.clamp(uv[0] * float(own.width), -1.0e6, 1.0e6)
    y = wp.clamp(uv[1] * float(own.height), -1.0e6, 1.0e6)
    if own.nearest != 0:
        return texel_alpha(cutouts, own, int(wp.floor(x)), int(wp.floor(y)))
    column = wp.floor(x - 0.5)
    row = wp.floor(y - 0.5)
    right = x - 0.5 - column
    lower = y - 0.5 - row
    i = int(column)
    j = int(row)
    above = texel_alpha(cutouts, own, i, j) * (1.0 - right) + texel_alpha(cutouts, own, i + 1, j) * right
    below = texel_alpha(cutouts, own, i, j + 1) * (1.0 - right) + texel_alpha(cutouts, own, i + 1, j + 1) * right
    return above * (1.0 - lower) + below * lower


@wp.func
def is_cut_out(cutouts: Cutouts, a: int, b: int, c: int, w_a: float, w_b: float, w_c: float):
    """Whether a triangle is not there at a point.

    Args:
        cutouts: Of its geometry.
        a, b, c: Its vertices.
        w_a, w_b, w_c: Barycentric coordinates times any factor, which may be negative. What rounding puts beyond an
            edge is taken onto it.
    """
    cut = bool(False)
    if cutouts.count > 0:
        texture = cutouts.texture[a]
        if texture != OPAQUE:
            sign = wp.where(w_a + w_b + w_c < 0.0, -1.0, 1.0)
            u_a = wp.max(sign * w_a, 0.0)
            u_b = wp.max(sign * w_b, 0.0)
            u_c = wp.max(sign * w_c, 0.0)
            total = wp.max(u_a + u_b + u_c, 1.0e-38)
            uv = (cutouts.uv[a] * u_a + cutouts.uv[b] * u_b + cutouts.uv[c] * u_c) / total
            own = cutouts.textures[texture]
            cut = alpha_at(cutouts, own, uv) < own.cutoff
    return cut


def no_cutouts(device: str = "cpu") -> Cutouts:
    """What a geometry has of which nothing is cut."""
    out = Cutouts()
    out.uv, out.texture = wp.zeros(1, dtype=wp.vec2, device=device), wp.zeros(1, dtype=int, device=device)
    out.textures, out.alpha = wp.zeros(1, dtype=Cutout, device=device), wp.zeros(1, dtype=float, device=device)
    return out


def upload_cutouts(meshes: Sequence[Mesh], device: str = "cpu") -> Cutouts:
    """The cut-outs of meshes whose vertices lie one after the other; a texture that several share is held once."""
    masked = [mesh for mesh in meshes if mesh.mask is not None]
    if not masked:
        return no_cutouts(device)
    places: dict[tuple[int, float, tuple[Wrap, Wrap], bool], int] = {}
    begins: dict[int, int] = {}
    textures: list[Cutout] = []
    texels: list[np.ndarray] = []
    uv = [np.zeros((len(mesh.vertices), 2)) if mesh.mask is None else mesh.mask.uv for mesh in meshes]
    owner = []
    for mesh in meshes:
        mask = mesh.mask
        if mask is None:
            owner.append(np.full(len(mesh.vertices), int(OPAQUE)))
            continue
        if id(mask.alpha) not in begins:
            begins[id(mask.alpha)] = sum(part.size for part in texels)
            texels.append(np.asarray(mask.alpha, np.float32).ravel())
        key = (id(mask.alpha), mask.cutoff, mask.wrap, mask.nearest)
        if key not in places:
            places[key] = len(textures)
            one = Cutout()
            one.begin, (one.height, one.width) = begins[id(mask.alpha)], mask.alpha.shape
            one.wrap_u, one.wrap_v = (WRAPS[wrap] for wrap in mask.wrap)
            one.nearest, one.cutoff = int(mask.nearest), mask.cutoff
            textures.append(one)
        owner.append(np.full(len(mesh.vertices), places[key]))
    out = Cutouts()
    out.uv = wp.array(np.concatenate(uv).astype(np.float32), dtype=wp.vec2, device=device)
    out.texture = wp.array(np.concatenate(owner).astype(np.int32), dtype=int, device=device)
    out.textures = wp.array(textures, dtype=Cutout, device=device)
    out.alpha = wp.array(np.concatenate(texels), dtype=float, device=device)
    out.count = len(textures)
    return out


def cutouts_of(cutouts: Cutouts, vertices: slice) -> Cutouts:
    """Those of a range of the vertices."""
    if cutouts.count == 0:
        return cutouts
    out = Cutouts()
    out.uv, out.texture = cutouts.uv[vertices], cutouts.texture[vertices]
    out.textures, out.alpha, out.count = cutouts.textures, cutouts.alpha, cutouts.count
    return out


def cut_triangles(indices: wp.array, cutouts: Cutouts) -> np.ndarray:
    """Which triangles of an index array (3 T,) are cut out, bool (T,)."""
    if cutouts.count == 0 or len(indices) < 3:
        return np.zeros(len(indices) // 3, bool)
    out: np.ndarray = cutouts.texture.numpy()[indices.numpy()[0::3]] != int(OPAQUE)
    return out
