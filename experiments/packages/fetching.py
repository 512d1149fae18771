"""Fetches assets: what is there and right stays, what cannot be had is told in a line, and the others go on."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from experiments.packages.manifest import Asset
from experiments.packages.tools import PackageError, download
from experiments.packages.unpacking import listing_digest, unpack

SOURCE = "SOURCE.txt"
"""Beside an asset's files: the package that they came in, and their licence."""


def fetch(assets: Sequence[Asset], folder: Path, say: Callable[[str], None] = print) -> list[str]:
    """Brings assets into a folder, each a folder of its own that is there as a whole or not at all.

    Args:
        assets: Which; a package that several share is downloaded once.
        folder: Where they are kept; made where it is missing.
        say: Takes a line per asset.

    Returns:
        Names of those that are not there in the end.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = []
    for _, group in itertools.groupby(sorted(assets, key=lambda one: str(one.source)), lambda one: one.source):
        wanted = []
        for asset in group:
            if is_there(asset, folder):
                say(f"{asset.name}: there already")
            else:
                wanted.append(asset)
        if wanted:
            with tempfile.TemporaryDirectory(dir=folder, prefix=".fetching-") as work:
                missing += _fetch_package(wanted, folder, Path(work), say)
    return missing


def is_there(asset: Asset, folder: Path) -> bool:
    """Whether the files of an asset are there, and are what they should be."""
    own = folder / asset.name
    return own.is_dir() and listing_digest(own, [SOURCE]) == asset.sha256


def _fetch_package(assets: Sequence[Asset], folder: Path, work: Path, say: Callable[[str], None]) -> list[str]:
    missing = []
    (work / "package").mkdir()
    try:
        archive = download(assets[0], work / "package")
    except PackageError as error:
        for asset in assets:
            say(f"missing: {asset.name} ({asset.origin}): {error}")
        return [asset.name for asset in assets]
    for asset in assets:
        unpacked = work / asset.name
        unpacked.mkdir()
        try:
            unpack(archive, asset.inside, asset.take, unpacked)
            digest = listing_digest(unpacked)
            if digest != asset.sha256:
                raise PackageError(f"its files are not those that were expected (sha256 {digest}).")
        except PackageError as error:
            say(f"missing: {asset.name} ({asset.origin}): {error}")
            missing.append(asset.name)
            continue
        (unpacked / SOURCE).write_text(f"package: {asset.origin}\nlicence: {asset.licence}\n", encoding="utf-8")
        own = folder / asset.name
        if own.exists():
            shutil.rmtree(own)
        os.replace(unpacked, own)
        say(f"{asset.name}: from {asset.origin}; licence: {asset.licence}")
    return missing
