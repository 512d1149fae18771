"""The reference that techniques are scored by: ray cast, with its own standard error, cached on disk by content.

A reference depends on the triangles at its frame, the camera, the light, the sample set and the code that traces it.
All of these are hashed into the name of its cache file, so that nothing has to be invalidated. A file that is damaged,
or is not what its name promises, counts as absent and is written anew. The sets of samples are sequences, so that a
reference of more samples goes on where a cached one of fewer ends, to the same bits.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import tempfile
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
import warp as wp

import wkernels
from algorithms.plugins import file_of, find
from algorithms.technique import Technique
from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.rays.single_rays import binomial_standard_error
from wkernels.scene.geometry import Geometry

CACHE_VARIABLE = "WKERNELS_CACHE"
MAX_SAMPLES = 1_000_000
PART = 1024  # samples after which what is there is cached, so that an interruption costs no more than these
AREA_TECHNIQUE, POINT_TECHNIQUE = "reference_multisample", "ray_cast_point_shadow"
TRACING_ROOMS = ("rays", "raster", "scene", "sampling")
"""Rooms of wkernels whose text decides a reference's values."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference visibility of one frame.

    Attributes:
        visibility: float32 (H, W), 1 = whole light visible; NaN where no receiver is seen.
        standard_error: float32 (H, W), that of independent samples and so an upper estimate; 0 for a light without
            area, whose one ray is exact; NaN where no receiver is seen.
        from_cache: Whether it was read from the cache.
    """

    visibility: np.ndarray
    standard_error: np.ndarray
    from_cache: bool


class ReferenceRenderer:
    """References of one geometry, frame by frame; keeps the casters' ray structure between frames.

    Args:
        geometry: Scene triangles; moved to the frame that is asked for.
        samples: Points on the light, 1 to a million; a light without area takes one ray.
        width, height: Pixels.
        light: Index of the light.
        centre: Whether to ask for the light's centre alone, by one ray: the reference of hard shadows.
        device: The geometry's Warp device.
        threads: CPU threads; None for all. Never changes the result.
        seed: Seed of the sample set.
        cache: Whether to read and write the cache.

    Raises:
        InputError: ``samples`` out of range.
    """

    def __init__(
        self,
        geometry: Geometry,
        *,
        samples: int,
        width: int,
        height: int,
        light: int = 0,
        centre: bool = False,
        device: str = "cpu",
        threads: int | None = None,
        seed: int = 1,
        cache: bool = True,
    ) -> None:
        if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or not 1 <= samples <= MAX_SAMPLES:
            raise InputError(f"must be a whole number from 1 to {MAX_SAMPLES}, not {samples!r}.", key="samples")
        self.geometry, self.cache = geometry, cache
        self._size, self._light_index = (width, height), light
        self._device, self._threads, self._seed = device, threads, seed
        self._has_area = geometry.scene.lights[light].has_area and not centre
        self._samples = int(samples) if self._has_area else 1
        self._session: Session | None = None
        self._technique = _technique(self._has_area, self._samples)

    def render(self, frame: int) -> Reference:
        """The reference of a frame of the scene's path."""
        self.geometry.set_frame(frame)
        file = cache_folder() / f"{self._key(frame)}.npz" if self.cache else None
        held = _read(file, self._size) if file else None
        if held is not None:
            return held
        if file is None:
            return self._trace(frame, self._samples)
        if not self._has_area or not self._even:
            whole = self._trace(frame, self._samples)
            _write(file, whole)
            return whole
        return self._trace_in_parts(frame, file)

    def _trace_in_parts(self, frame: int, file: Path) -> Reference:
        """Goes on from the cached reference of the most samples and caches what it has after every ``PART`` samples."""
        stem = self._key(frame, samples=0)
        begun = self._largest_part(stem)
        done, made = begun if begun else (0, None)
        own: Path | None = None  # the part that this call wrote last
        while made is None or done < self._samples:
            more = min(PART, self._samples - done)
            traced = self._trace(frame, more, done)
            made = traced if made is None else self._merge(made, done, traced, more)
            done += more
            part = file.with_name(f"{stem}-{done}.npz")
            _write(part, made)
            if own:
                with contextlib.suppress(OSError):
                    own.unlink()
            own = part
        return made

    def _largest_part(self, stem: str) -> tuple[int, Reference] | None:
        """The cached reference of the most samples, but fewer than wanted."""
        counts = (path.stem.removeprefix(f"{stem}-") for path in cache_folder().glob(f"{stem}-*.npz"))
        for samples in sorted((int(c) for c in counts if c.isdigit() and int(c) < self._samples), reverse=True):
            held = _read(cache_folder() / f"{stem}-{samples}.npz", self._size)
            if held is not None:
                return samples, held
        return None

    def _merge(self, first: Reference, samples: int, second: Reference, more: int) -> Reference:
        """The mean of two parts of one set. Of equal weights both are counts, so that nothing is rounded twice."""
        total, parts = samples + more, (first.visibility * np.float32(samples), second.visibility * np.float32(more))
        seen = parts[0] + parts[1]
        visibility = ((np.rint(seen) if self._even else seen) / np.float32(total)).astype(np.float32)
        on_device = wp.array(visibility, dtype=float, device=self._device)
        error = wp.empty_like(on_device)
        inputs = [on_device, float(total)]
        launch(binomial_standard_error, error.shape, inputs, [error], device=self._device, threads=self._threads)
        return Reference(visibility, np.where(np.isnan(visibility), np.float32(np.nan), error.numpy()), False)

    @property
    def _even(self) -> bool:
        """Whether all samples weigh the same."""
        return getattr(self.geometry.scene.lights[self._light_index], "texture", None) is None

    def _trace(self, frame: int, samples: int, start: int = 0) -> Reference:
        if self._session is None:
            width, height = self._size
            self._session = Session(
                self.geometry,
                width=width,
                height=height,
                light_index=self._light_index,
                device=self._device,
                threads=self._threads,
                seed=self._seed,
            )
        self._session.begin(frame)
        result = self._session.render(_technique(self._has_area, samples, start))
        self._session.advance()
        error = result.standard_error
        if error is None or not self._has_area:
            error = np.where(np.isnan(result.visibility), np.float32(np.nan), np.float32(0.0))
        return Reference(result.visibility, error, False)

    def _key(self, frame: int, samples: int | None = None) -> str:
        """Hex digest of everything but the number of samples that the reference of a frame depends on, and that number.

        With ``samples`` 0 the digest alone.
        """
        geometry, digest = self.geometry, hashlib.sha256()
        scene = geometry.scene
        light, camera = scene.light(self._light_index, frame), scene.camera(frame)
        _add(digest, _code_version(self._technique), type(light).__name__, wp.get_device(self._device).is_cpu)
        _add(digest, *self._size, self._seed)
        for part in (geometry.points_ws, geometry.indices, geometry.triangle_mesh, geometry.mesh_flags):
            _add(digest, part.numpy())
        _add(digest, geometry.caster_triangles, geometry.origin_ws)
        cutouts = geometry.cutouts
        if cutouts.count:
            for part in (cutouts.uv, cutouts.texture, cutouts.textures, cutouts.alpha):
                digest.update(part.numpy().tobytes())
        for item in (light, camera):
            for attribute in fields(item):
                _add(digest, attribute.name, getattr(item, attribute.name))
        stem = digest.hexdigest()
        return stem if samples == 0 else f"{stem}-{self._samples}"


def cache_folder() -> Path:
    """Where references are kept: under ``WKERNELS_CACHE`` if it is set, else under the user's cache folder."""
    chosen = os.environ.get(CACHE_VARIABLE, "")
    root = Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("wkernels", appauthor=False))
    return root / "reference"


def _technique(has_area: bool, samples: int, start: int = 0) -> Technique:
    if not has_area:
        return find(POINT_TECHNIQUE)()
    chosen = find(AREA_TECHNIQUE)
    return chosen(chosen.Params.model_validate({"samples": samples, "start": start}))


@functools.cache
def _source_digest(files: tuple[Path, ...]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def tracing_files() -> list[Path]:
    """The files of ``TRACING_ROOMS``."""
    folder = Path(wkernels.__file__).parent
    return [path for room in TRACING_ROOMS for path in sorted((folder / room).rglob("*.py"))]


def _code_version(technique: Technique) -> str:
    files = (*tracing_files(), file_of(type(technique)))
    return f"{wp.config.version} {_source_digest(files)}"


def _add(digest: Any, *values: Any) -> None:
    for value in values:
        array = np.ascontiguousarray("" if value is None else value)
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())


def _read(file: Path, size: tuple[int, int]) -> Reference | None:
    """What a cache file holds; None where it is absent, damaged or of another size."""
    try:
        with np.load(file, allow_pickle=False) as data:
            visibility, error = data["visibility"], data["standard_error"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    expected = (size[1], size[0])
    if any(image.shape != expected or image.dtype != np.float32 for image in (visibility, error)):
        return None
    return Reference(visibility, error, True)


def _write(file: Path, reference: Reference) -> None:
    """Stores a reference whole or not at all; a cache that cannot be written to is no reason to stop."""
    part: str | None = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=file.parent, prefix=file.stem, suffix=".part")
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, visibility=reference.visibility, standard_error=reference.standard_error)
        os.replace(part, file)
    except OSError:
        if part is not None:
            Path(part).unlink(missing_ok=True)
