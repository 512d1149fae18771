"""What one input may do: 2 GiB, 10 s, and no file outside its output folder. Everything else is a fault with a name."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MOST_BYTES = 2 << 30
MOST_SECONDS = 10.0
"""Of processor time."""
MOST_IDLE_SECONDS = 30.0
"""Of sleep, for an input that waits for ever; time in which others had the processor does not count."""

_OWN = ("input", "out", "home", "tmp", "cwd", "log", "healthy")
COMPILER = "wp_pch_"
"""How the temporary folders begin that Warp's compiler makes and removes."""

_WRITES = {
    "os.mkdir": 2,
    "os.rename": 2,
    "os.remove": 1,
    "os.rmdir": 1,
    "os.link": 2,
    "os.symlink": 2,
    "os.truncate": None,
}
"""Events of Python's audit that change files, and which of their arguments is the folder that a name is relative to."""


class Fault(Exception):
    """An input was neither read rightly nor refused with a message: the sentence says what happened instead."""


@dataclass(frozen=True)
class Rooms:
    """Folders of one worker.

    Attributes:
        root: Holds the others, and nothing else.
        allowed: Folders besides ``out`` that may be written: caches.
    """

    root: Path
    allowed: tuple[Path, ...] = ()

    @property
    def input(self) -> Path:
        """Where inputs lie; they are read and stay as they are."""
        return self.root / "input"

    @property
    def out(self) -> Path:
        """The output folder."""
        return self.root / "out"

    def make(self) -> None:
        """Makes all folders."""
        for name in ("input", "out", "home", "tmp", "cwd"):
            (self.root / name).mkdir(parents=True, exist_ok=True)

    def strays(self) -> list[str]:
        """Files that lie where none should: in the home, the working or the temporary folder, or beside them."""
        found = [path for path in self.root.iterdir() if path.name not in _OWN]
        for name in ("home", "tmp", "cwd"):
            found += [path for path in (self.root / name).iterdir() if not path.name.startswith(COMPILER)]
        return [path.relative_to(self.root).as_posix() for path in found]


class Watch:
    """Notes every file that Python opens for writing, or makes, moves and deletes, outside the rooms it may."""

    def __init__(self, rooms: Rooms) -> None:
        self._good = tuple(
            str(path) for path in (rooms.out, rooms.root / "tmp", *rooms.allowed, Path("/dev"), Path("/proc"))
        )
        self._watched = False
        self.found: list[str] = []
        sys.addaudithook(self._hook)

    def __enter__(self) -> Watch:
        self.found.clear()
        self._watched = True
        return self

    def __exit__(self, *_: object) -> None:
        self._watched = False

    def _hook(self, event: str, arguments: tuple) -> None:
        if not self._watched:
            return
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, int) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                return
        elif event in _WRITES:
            path, relative = arguments[0], _WRITES[event]
            if isinstance(path, int) or (relative is not None and arguments[relative] not in (-1, None)):
                return  # in a folder that was opened, as shutil.rmtree does: what it opened was seen
        else:
            return
        try:
            where = os.path.abspath(os.fsdecode(path))
        except (TypeError, ValueError):  # a descriptor, or a name that no file can have
            return
        if not where.startswith(self._good):
            self.found.append(f"{event} {where}")


def enter(rooms: Rooms) -> None:
    """Makes this process one that only touches its rooms, with a limit on its memory."""
    rooms.make()
    os.environ["HOME"] = str(rooms.root / "home")
    os.environ["TMPDIR"] = str(rooms.root / "tmp")
    for name in [key for key in os.environ if key.startswith("XDG_")]:
        del os.environ[name]
    tempfile.tempdir = None
    os.chdir(rooms.root / "cwd")
    sys.dont_write_bytecode = True


def limit_memory(more: int = MOST_BYTES) -> None:
    """Lets this process take so many bytes more than it has; what asks for further ones gets a MemoryError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def tree(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Names and contents of all files below a folder."""
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            yield path.relative_to(folder).as_posix(), path.read_bytes()


def processor_seconds(pid: int) -> tuple[float, bool]:
    """Processor time that a process and its children that ended have taken; whether it sleeps, but not for a child."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        children = _children(pid)
    except OSError:
        return 0.0, False
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK"), fields[0] == "S" and not children


def _children(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/task/{pid}/children").read_text()
    except OSError:  # a kernel that does not tell
        return ""
