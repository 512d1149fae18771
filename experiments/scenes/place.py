"""Where in a scene file something was said."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from experiments.config.messages import shown
from experiments.config.source import Source, validate
from wkernels.errors import InputError, nearest

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Place:
    """A key path within a source, and the folder that its relative file names are looked up in."""

    source: Source
    base: Path
    loc: tuple[str | int, ...] = ()

    def at(self, *keys: str | int) -> Place:
        """The place of a key, list item or path of both below this one."""
        return Place(self.source, self.base, (*self.loc, *keys))

    @property
    def data(self) -> Any:
        """What the source holds here."""
        return self.source.get(self.loc)

    def error(self, message: str) -> InputError:
        """An InputError about this place, to be raised by the caller."""
        return self.source.error(message, self.loc)

    def validated(self, model: type[M]) -> M:
        """The data here as a ``model``; raises InputError."""
        return validate(model, self.source, self.loc)

    def choice(self, key: str, models: dict[str, type[M]]) -> type[M]:
        """The model named by the value of ``key``; raises InputError where it is missing or unknown."""
        data = self.data
        if not isinstance(data, dict):
            raise self.error(f"must be a mapping of keys to values, not {shown(data)}.")
        if key not in data:
            wrong = misspelt(key, data)
            if wrong is not None:
                raise self.at(wrong).error(f"is not a known key. Did you mean '{key}'?")
            raise self.error(f"needs the key {key}, which is one of: {', '.join(models)}.")
        name = data[key]
        if not isinstance(name, str) or name not in models:
            raise self.at(key).error(f"{shown(name)} is not a valid name." + nearest(str(name), models))
        return models[name]

    def existing_file(self, name: str, folder: Path | None = None) -> Path:
        """The file ``name`` relative to ``folder`` (default: the base folder); raises InputError if it is missing."""
        path = (folder or self.base) / Path(name).expanduser()
        if path.is_file():
            return path
        if path.is_dir():
            raise self.error(f"'{path}' is a folder, not a file.")
        if not path.parent.is_dir():
            raise self.error(f"no such file: '{path}' (there is no folder '{path.parent}').")
        siblings = [p.name for p in path.parent.iterdir() if p.is_file() and p.suffix.lower() == path.suffix.lower()]
        raise self.error(f"no such file: '{path}'." + nearest(path.name, siblings[:1000]))


def misspelt(key: str, data: Iterable[str]) -> str | None:
    """The one of the given keys that looks like a misspelling of ``key``."""
    close = difflib.get_close_matches(key, data, n=1, cutoff=0.7)
    return close[0] if close and close[0] != key else None


class FreeNames:
    """Names that are taken, and the next number for each that is asked for again: many meshes share a name."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._next

    def take(self, name: str) -> str:
        """The name itself where it is free, else with the least number behind it, from 2, that is."""
        free, number = name, self._next.get(name, 1)
        while free in self._next:
            number += 1
            free = f"{name}_{number}"
        self._next[name] = number
        self._next.setdefault(free, 1)
        return free
