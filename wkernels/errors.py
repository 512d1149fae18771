"""The one exception for wrong input (configs, scenes, meshes, plugins, command lines)."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class InputError(Exception):
    """The user's input is wrong: shown as one message without a traceback, exit status 2.

    Args:
        message: What is wrong and what would be right, one sentence.
        file: The file that holds the mistake, if there is one.
        line: 1-based line in that file.
        key: Dotted path of the offending key (``camera.fov_deg``).
    """

    def __init__(
        self, message: str, *, file: str | Path | None = None, line: int | None = None, key: str | None = None
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.key = key
        super().__init__(str(self))

    def __str__(self) -> str:
        place = "" if self.file is None else f"{self.file}:{self.line}: " if self.line else f"{self.file}: "
        key = f"{self.key}: " if self.key else ""
        return f"{place}{key}{self.message}"


def one_line(said: object) -> str:
    """What another library says, short and without line breaks.

    Args:
        said: Its exception, whose type is told where it has no words; or a function that asks for its words.
    """
    try:
        text = said() if callable(said) else str(said)
    except UnicodeError:  # they quote the file, in whatever encoding it is
        text = ""
    nameless = type(said).__name__ if isinstance(said, BaseException) else ""
    return " ".join(text.split())[:200].rstrip(".") or nameless


def nearest(name: str, known: Iterable[str]) -> str:
    """Returns `` Did you mean 'x'?`` or a list of the valid names, to be appended to a message about ``name``."""
    known = sorted(set(known))
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return f" Did you mean '{close[0]}'?"
    return f" Valid names: {', '.join(known)}." if known else ""
