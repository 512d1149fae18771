"""Where the files that a scene names lie: beside the scene file, among Warp's assets, or among fetched ones."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import platformdirs

from experiments.scenes.place import Place

WARP, FETCHED = "warp:", "fetched:"
PREFIXES = (WARP, FETCHED)
FOLDER_VARIABLE = "WKERNELS_SCENES"


def find_file(name: str, place: Place) -> Path:
    """The file that a scene file names.

    Args:
        name: Path relative to the scene file, ``warp:NAME`` for one of Warp's example assets, or ``fetched:NAME/FILE``
            for one that ``make scenes`` fetches.
        place: Where the scene file names it.

    Raises:
        InputError: There is no such file.
    """
    if name.startswith(WARP):
        return place.existing_file(name.removeprefix(WARP), _warp_assets())
    if name.startswith(FETCHED):
        path = fetched_folder() / name.removeprefix(FETCHED)
        if not path.is_file():
            raise place.error(f"no such file: '{path}'; `make scenes` fetches the real scenes.")
        return path
    return place.existing_file(name)


def without_prefix(name: str) -> str:
    """A name without what says where it lies."""
    for prefix in PREFIXES:
        name = name.removeprefix(prefix)
    return name


def fetched_folder() -> Path:
    """Where ``make scenes`` keeps what it fetches: ``WKERNELS_SCENES``, or a folder of the user's cache."""
    chosen = os.environ.get(FOLDER_VARIABLE, "")
    if chosen:
        return Path(chosen).expanduser().absolute()
    return Path(platformdirs.user_cache_dir("wkernels", appauthor=False)) / "scenes"


def _warp_assets() -> Path:
    spec = importlib.util.find_spec("warp")
    assert spec is not None and spec.origin is not None, "warp-lang is a dependency"
    return Path(spec.origin).parent / "examples" / "assets"
