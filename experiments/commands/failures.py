"""What a command says on stderr: a mistake of the user in one message, a defect with a log file, warnings in a line.

Nothing of ``wkernels`` is imported before it is needed: what that tells, such as a kernel cache that cannot be written
to, is to be shown as all else is.
"""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

INPUT_IS_WRONG = 2
DEFECT = 1


class OutputLost(Exception):
    """Standard output cannot be written: its disk is full, or nobody reads it any more."""


class ToldStream:
    """Standard output that raises OutputLost where it cannot be written, and writes what its encoding lacks as escapes.

    An OSError from here could not be told from one of a file that a command reads or writes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lost: OutputLost | None = None
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:  # a file name that is no text, or a terminal that only knows Latin-1
            reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        """Writes text; raises OutputLost."""
        with self._told():
            return self._stream.write(text)

    def flush(self) -> None:
        """Writes what waits; raises OutputLost, and ever after: some callers try first, and hide what they find."""
        with self._told():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        if self._lost is not None:
            raise self._lost
        try:
            yield
        except OSError as error:
            self._lost = OutputLost(f"standard output cannot be written: {error.strerror or error}.")
            with contextlib.suppress(OSError, ValueError):  # what waits goes nowhere: Python would try again at its end
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)
            raise self._lost from None


@contextlib.contextmanager
def stdout_told() -> Iterator[None]:
    """Meanwhile standard output is a ToldStream, which has written all when this ends.

    Raises:
        OutputLost: It could not; where a command failed as well, instead of that.
    """
    before = sys.stdout
    if before is None:  # it was closed before the process began
        yield
        return
    sys.stdout = told = ToldStream(before)
    try:
        yield
    finally:
        sys.stdout = before
        told.flush()


def report_failure(error: Exception) -> int:
    """Says what went wrong on stderr and returns the exit status that fits."""
    errors = sys.modules.get("wkernels.errors")  # loaded by whatever raised one of its errors
    if isinstance(error, OutputLost) or (errors is not None and isinstance(error, errors.InputError)):
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


@contextlib.contextmanager
def warnings_shown_once() -> Iterator[None]:
    """Meanwhile a warning is one line on stderr, without the place in our code, and the same words come once."""
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

    before, warnings.showwarning = warnings.showwarning, show
    try:
        yield
    finally:
        warnings.showwarning = before


def _write_log(text: str) -> Path | None:
    import platformdirs

    from wkernels import __version__

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
