"""What a command says on stderr: a mistake of the user in one message, a defect with a log file, warnings in a line."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import TextIO

from wkernels import __version__
from wkernels.errors import InputError

INPUT_IS_WRONG = 2
DEFECT = 1


def report_failure(error: Exception) -> int:
    """Says what went wrong on stderr and returns the exit status that fits."""
    if isinstance(error, InputError):
        print(f"error: {error}", file=sys.stderr)
        return INPUT_IS_WRONG
    # by name: importing the runner here would cost a second
    if type(error).__name__ in ("TechniquesFailed", "SweepFailed"):
        print(f"error: {error}", file=sys.stderr)
        return DEFECT
    short = "".join(traceback.format_exception_only(error)).strip().splitlines()
    print(f"error: this is a defect in wkernels, not in your input: {short[0]}", file=sys.stderr)
    log = _write_log("".join(traceback.format_exception(error)))
    if log is not None:
        print(f"Please report it with the file {log}", file=sys.stderr)
    else:
        traceback.print_exception(error)
    return DEFECT


def show_warnings_once() -> None:
    """From here on a warning is one line on stderr, without the place in our code, and the same words come once."""
    shown: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = f"warning: {message}" if issubclass(category, UserWarning) else f"{category.__name__}: {message}"
        if text not in shown:
            shown.add(text)
            print(text, file=sys.stderr)

    warnings.showwarning = show


def _write_log(text: str) -> Path | None:
    import platformdirs

    head = f"wkernels {__version__}, Python {platform.python_version()}, {platform.platform()}\n{sys.argv}\n\n"
    for folder in (Path(platformdirs.user_log_dir("wkernels", appauthor=False)), Path(tempfile.gettempdir())):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"defect-{os.getpid()}.log"
            path.write_text(head + text, encoding="utf-8")
            return path
        except OSError:
            continue
    return None
