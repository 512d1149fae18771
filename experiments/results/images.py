"""Image files through OpenImageIO: raw float images for machines (EXR), views for people (PNG)."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

import numpy as np

from experiments.results.tables import replace_file
from wkernels.errors import InputError, one_line

NO_RECEIVER = (74, 80, 96)  # slate in views: a pixel without a receiver is neither lit nor dark
ERROR_SCALE = "colour = sign(error) x sqrt(|error|), from -1 (darker than the reference) to +1 (lighter)"
_HEAD = 65536  # bytes of a file that are not pixels, and what incompressible pixels grow by; amply
_ERROR_COLORS = "berlin"  # diverging with a dark middle, so that small errors stand out


def check_path(path: Path) -> None:
    """Raises InputError where a path is bytes that are no UTF-8, by which OpenImageIO cannot open a file."""
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError:
        raise InputError("cannot be written: the path is not UTF-8, which image files need.", file=path) from None


def write_exr(path: Path, image: np.ndarray, note: str = "") -> None:
    """Writes float32 (H, W) losslessly, NaN included, as channel Y; the file appears whole or not at all."""
    _write(path, image.astype(np.float32)[:, :, None], "float", {"compression": "zip", "ImageDescription": note})


def write_png(path: Path, rgb: np.ndarray) -> None:
    """Writes uint8 (H, W, 3)."""
    _write(path, rgb, "uint8", {})


def write_jpeg(path: Path, rgb: np.ndarray) -> None:
    """Writes uint8 (H, W, 3) at quality 90, for pages that hold many pictures."""
    _write(path, rgb, "uint8", {"compression": "jpeg:90"})


def read_exr(path: Path) -> np.ndarray:
    """The first channel, float32 (H, W).

    Raises:
        InputError: The file is missing or unreadable.
    """
    return np.ascontiguousarray(_read(path, "float")[:, :, 0])


def read_png(path: Path) -> np.ndarray:
    """uint8 (H, W, 3).

    Raises:
        InputError: The file is missing or unreadable.
    """
    return np.ascontiguousarray(_read(path, "uint8")[:, :, :3])


def visibility_view(visibility: np.ndarray) -> np.ndarray:
    """Grey picture, 0 = umbra = black, 1 = lit = white (linear in the pixel value); uint8 (H, W, 3)."""
    with np.errstate(invalid="ignore"):
        grey = np.rint(255.0 * np.clip(visibility, 0.0, 1.0))
    out = np.repeat(np.nan_to_num(grey).astype(np.uint8)[:, :, None], 3, axis=2)
    out[~np.isfinite(visibility)] = NO_RECEIVER
    return out


def shaded_view(color: np.ndarray) -> np.ndarray:
    """sRGB picture of linear colours (H, W, 3), clipped at 1; uint8 (H, W, 3)."""
    linear = np.clip(np.nan_to_num(color), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1.0 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)


def error_colors(error: np.ndarray) -> np.ndarray:
    """Heat colours of signed errors in [-1, 1] on the scale ``ERROR_SCALE``; uint8 (..., 3)."""
    from matplotlib import colormaps

    table = colormaps[_ERROR_COLORS](np.arange(256))[:, :3]
    place = 0.5 + 0.5 * np.sign(error) * np.sqrt(np.clip(np.abs(error), 0.0, 1.0))
    place = 255.0 * np.nan_to_num(place, nan=0.5)
    # Interpolated, because an even number of entries has none in the middle: no error must not look like a little.
    channels = [np.interp(place, np.arange(256), table[:, channel]) for channel in range(3)]
    return np.rint(255.0 * np.stack(channels, axis=-1)).astype(np.uint8)


def standard_error_view(standard_error: np.ndarray) -> np.ndarray:
    """Heat map of a technique's own standard error on the positive half of ``ERROR_SCALE``; uint8 (H, W, 3)."""
    return error_view(standard_error, np.zeros_like(standard_error))


def error_view(visibility: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Heat map of ``visibility - reference`` on ``ERROR_SCALE``, the same in every picture; uint8 (H, W, 3)."""
    error = visibility - reference
    out = error_colors(error)
    out[~np.isfinite(error)] = NO_RECEIVER
    return out


def _write(path: Path, image: np.ndarray, kind: str, attributes: dict[str, str]) -> None:
    import OpenImageIO as oiio

    height, width, channels = image.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    if channels == 1:
        spec.channelnames = ("Y",)
    for name, value in attributes.items():
        if value:
            spec.attribute(name, value)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".part-{path.name}")
    try:
        _reserve(part, image.nbytes + _HEAD)
        out = oiio.ImageOutput.create(str(part))
        if out is None:
            raise RuntimeError(f"OpenImageIO cannot write {path.suffix} files: {oiio.geterror()}")
        done = out.open(str(part), spec) and out.write_image(np.ascontiguousarray(image)) and out.close()
        # a PNG that did not fit counts as done, but has an error
        if (message := out.geterror()) or not done:
            raise OSError(errno.EIO, message.splitlines()[0] if message else "OpenImageIO gives no reason", str(path))
        replace_file(part, path, now=False)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error


def _reserve(part: Path, size: int) -> None:
    """Refuses to begin what does not fit: where the disk is full libjpeg ends the process, and libpng goes on.

    Raises:
        OSError: There is no room for ``size`` bytes, or the file cannot be made.
    """
    with open(part, "wb") as file:
        if hasattr(os, "posix_fallocate"):
            try:
                os.posix_fallocate(file.fileno(), 0, size)
            except OSError as error:
                if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):  # a file system that cannot tell
                    raise


def _read(path: Path, kind: str) -> np.ndarray:
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    if image is None:
        raise InputError(f"cannot read the image ({one_line(oiio.geterror) or 'no reason given'}).", file=path)
    pixels = image.read_image(kind)
    image.close()
    if pixels is None:
        raise InputError(f"cannot read the image ({one_line(image.geterror) or 'no reason given'}).", file=path)
    return np.asarray(pixels)
