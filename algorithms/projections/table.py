"""Which fits, warps and stabilisers there are: files of their folders, of installed packages, and of a user."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from algorithms.modules import defined_in, files_in, import_own, installed
from algorithms.projections.projection import Fit, Part, Stabiliser, Warp
from wkernels.errors import InputError

FOLDER = Path(__file__).parent
KINDS: dict[str, Any] = {"fits": Fit, "warps": Warp, "stabilisers": Stabiliser}

Parts = dict[str, dict[str, type[Part]]]
"""Parts by folder, or where it would be, and name."""


def fits() -> dict[str, type[Fit]]:
    """Every fit by name. Raises InputError where a file cannot be imported or does not hold exactly one such part."""
    return _table("fits")


def warps() -> dict[str, type[Warp]]:
    """Every warp by name; see ``fits``."""
    return _table("warps")


def stabilisers() -> dict[str, type[Stabiliser]]:
    """Every stabiliser by name; see ``fits``."""
    return _table("stabilisers")


def holds_part(module: ModuleType) -> bool:
    """Whether a plugin's module is that of a part."""
    return bool(defined_in(module, Part))


def add(modules: Iterable[tuple[ModuleType, Path]]) -> None:
    """Takes parts from other files into the tables, for the rest of the process.

    Args:
        modules: Modules of one part each, and their files. A part that an earlier call added gives way to its namesake.

    Raises:
        InputError: A file does not hold exactly one part, of the file's name, or two of them, or one of ours, have one.
    """
    for folder, parts in _parts_of(modules).items():
        for name, part in parts.items():
            if earlier := (_own(folder) | _installed()[folder]).get(name):
                raise _taken(part, earlier)
        _added[folder].update(parts)


def outside_files(names: Iterable[str]) -> dict[str, Path]:
    """The files of those parts of these names that are none of ours, by folder and name, such as ``warps/mine``."""
    found = [(folder, name, (_installed()[folder] | _added[folder]).get(name)) for folder in KINDS for name in names]
    return {f"{folder}/{name}": Path(inspect.getfile(part)) for folder, name, part in found if part}


def _table(folder: str) -> dict[str, Any]:
    return dict(sorted((_own(folder) | _installed()[folder] | _added[folder]).items()))


def _own(folder: str) -> dict[str, type[Part]]:
    return {path.stem: _part_of(import_own(path), path, KINDS[folder]) for path in files_in(FOLDER / folder)}


@functools.cache
def _installed() -> Parts:
    return _parts_of((module, path) for module, path in installed() if holds_part(module))


def _parts_of(modules: Iterable[tuple[ModuleType, Path]]) -> Parts:
    out: Parts = {folder: {} for folder in KINDS}
    for module, path in modules:
        part = _part_of(module, path, Part)
        own = next(parts for folder, parts in out.items() if issubclass(part, KINDS[folder]))
        if part.name in own:
            raise _taken(part, own[part.name])
        own[part.name] = part
    return out


def _part_of(module: ModuleType, path: Path, kind: type[Part]) -> type[Part]:
    found = [part for part in defined_in(module, kind) if issubclass(part, tuple(KINDS.values()))]
    names = [getattr(part, "name", None) for part in found]
    if names != [path.stem]:
        message = f"a projection file holds exactly one {kind.__name__} with the file's name, this one holds {names}"
        raise InputError(message, file=path)
    if missing := getattr(found[0], "__abstractmethods__", None):
        raise InputError(f"{found[0].__name__} does not implement `{min(missing)}`", file=path)
    return found[0]


def _taken(part: type[Part], earlier: type[Part]) -> InputError:
    return InputError(f"'{part.name}' exists already, in {inspect.getfile(earlier)}", file=inspect.getfile(part))


_added: Parts = {folder: {} for folder in KINDS}
