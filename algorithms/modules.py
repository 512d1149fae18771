"""Modules that plugins come from: our own folders, entry points of installed packages, and files that a user names."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from wkernels.errors import InputError

ENTRY_POINTS = "wkernels.algorithms"
ROOT = Path(__file__).parent


def files_in(folder: Path) -> list[Path]:
    """The plugin files of a folder, sorted; names that begin with ``_`` are helpers of theirs."""
    return [path for path in sorted(folder.glob("*.py")) if path.stem[0] != "_"]


def import_own(path: Path) -> ModuleType:
    """Imports a file of this package; InputError names it where that fails."""
    try:
        return importlib.import_module(".".join(("algorithms", *path.relative_to(ROOT).with_suffix("").parts)))
    except InputError:
        raise
    except Exception as error:
        raise _failure(path, error) from error


def import_file(path: Path) -> ModuleType:
    """Imports a file from anywhere, once; InputError names it where that fails."""
    if not path.is_file():
        raise InputError("plugin file does not exist", file=path)
    if path.suffix != ".py":
        raise InputError("a plugin is a Python file (.py)", file=path)
    name = f"wkernels_plugin_{path.stem}"
    known = sys.modules.get(name)
    if known is not None and known.__file__ and Path(known.__file__) == path.resolve():
        return known
    spec = importlib.util.spec_from_file_location(name, path.resolve())
    if spec is None or spec.loader is None:
        raise InputError("this file cannot be imported", file=path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # Warp looks a kernel's module up here
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, Exception):
            raise _failure(path, error) from error
        raise
    return module


def installed() -> Iterator[tuple[ModuleType, Path]]:
    """The modules of installed packages that have an entry point, and their files; InputError names one that fails."""
    for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINTS), key=lambda e: e.name):
        try:
            loaded = entry.load()
        except Exception as error:
            raise InputError(f"entry point '{entry.name}' of {ENTRY_POINTS} cannot be loaded: {error}") from error
        module = loaded if isinstance(loaded, ModuleType) else sys.modules[loaded.__module__]
        yield module, Path(module.__file__ or entry.value)


def defined_in(module: ModuleType, kind: type) -> list[Any]:
    """Subclasses of a class that a module defines itself."""
    return [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, kind) and value.__module__ == module.__name__
    ]


def _failure(path: Path, error: Exception) -> InputError:
    """Names the last place inside the plugin that the failed import passed through."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if Path(frame.filename) == path.resolve():
            line = frame.lineno
    return InputError(f"cannot be imported: {type(error).__name__}: {error}", file=path, line=line)
