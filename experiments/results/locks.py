"""A folder that one process writes to: a lock that goes with the process, however it ends, and leaves no file."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from wkernels.errors import InputError

try:
    import fcntl
except ImportError:  # no such locks on Windows; there an open table cannot be replaced anyway
    fcntl = None  # type: ignore[assignment]


class FolderLock:
    """The right to write to a folder."""

    def __init__(self) -> None:
        self._handle = -1

    def refuse_if_taken(self, folder: Path) -> None:
        """Raises InputError where somebody else holds the lock."""
        if folder.is_dir():
            self.take(folder)
            self.release()

    def take(self, folder: Path) -> None:
        """Takes the lock, giving back another that is held.

        Raises:
            InputError: Another run holds it.
        """
        self.release()
        if fcntl is None:
            return
        handle = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise InputError("another run is writing here; give another folder with --out.", file=folder) from None
        except OSError:  # a file system without locks
            os.close(handle)
            return
        self._handle = handle

    def release(self) -> None:
        """Gives the lock back; twice is fine."""
        if self._handle >= 0:
            with contextlib.suppress(OSError):
                os.close(self._handle)
            self._handle = -1
