"""Textures that cut meshes out: alpha channels of image files, and masks of meshes with natural texture coordinates."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

from experiments.scenes import schema
from experiments.scenes.meshes.reading import MeshError
from experiments.scenes.place import Place
from experiments.scenes.primitives import Triangles
from wkernels.errors import one_line
from wkernels.scene.cutouts import Mask

LARGEST_TEXTURE = 16384
"""Texels along a side."""


def image_channel(path: Path, channel: str = "alpha") -> np.ndarray:
    """A channel of an image file as stored, without a colour transform, float32 (H, W), the first row on top.

    Args:
        path: The file.
        channel: ``red``, ``green``, ``blue`` or ``alpha``. An image of fewer channels has its last colour for each of
            the others; alpha that it does not have is 1.

    Raises:
        MeshError: It cannot be read as an image, is too large, or has texels that are no number.
    """
    import OpenImageIO as oiio  # slow to load, and few scenes have textures

    options = oiio.ImageSpec()
    options["oiio:UnassociatedAlpha"] = 1  # colours are not to be multiplied
    image = oiio.ImageBuf(str(path), 0, 0, options)
    spec = image.spec()
    if image.has_error or not (0 < spec.width <= LARGEST_TEXTURE and 0 < spec.height <= LARGEST_TEXTURE):
        why = one_line(image.geterror) or f"{spec.width} x {spec.height} texels"
        raise MeshError(f"the texture '{path.name}' cannot be read: {why}.")
    colors = [i for i in range(spec.nchannels) if i != spec.alpha_channel]
    if channel == "alpha":
        wanted = spec.alpha_channel
    else:
        order = ("red", "green", "blue").index(channel)
        wanted = colors[min(order, len(colors) - 1)] if colors else -1
    if wanted < 0:
        return np.ones((1, 1), np.float32)
    pixels = image.get_pixels(oiio.FLOAT)
    if pixels is None or not np.isfinite(pixels).all():
        raise MeshError(f"the texture '{path.name}' has texels that are no number, or that cannot be read.")
    out = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, -1)[..., wanted]
    return np.ascontiguousarray(out)


def decoded_channel(data: bytes, name: str, channel: str = "alpha") -> np.ndarray:
    """``image_channel`` of the bytes of an image file, which messages call ``name``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "texture")
        path.write_bytes(data)
        return image_channel(path, channel)


@functools.lru_cache(maxsize=32)
def _file_channel(path: Path, changed_ns: int) -> np.ndarray:
    """The alpha of a file, or the first channel of one that has none; one array for all that name it."""
    alpha = image_channel(path)
    return alpha if alpha.size > 1 else image_channel(path, "red")


def flat_mask(options: schema.Cutout, triangles: Triangles, size: tuple[float, float], place: Place) -> Mask:
    """The mask of a flat primitive in XZ: u runs along x, v along z, the texture's first row lies at the least z.

    Raises:
        InputError: The texture is missing or no image.
    """
    path = place.at("texture").existing_file(options.texture)
    try:
        alpha = _file_channel(path, path.stat().st_mtime_ns)
    except MeshError as error:
        raise place.at("texture").error(str(error)) from None
    uv = (triangles[0][:, [0, 2]] / np.array(size) + 0.5) * np.array(options.repeat)
    return Mask(uv, alpha, options.cutoff, ("repeat", "repeat"), options.filter == "nearest")
