"""Binary USD files that are broken are found in a process of their own, because USD ends the process that reads them.

Offsets and counts of the binary form are trusted by its library: one flipped bit is a segmentation fault, or a buffer
of any size. Text is parsed, and its faults are exceptions.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from experiments.scenes.meshes import usd_probe
from experiments.scenes.meshes.reading import MeshError

_BINARY = (b"PXR-USDC", b"PK")  # a crate; a package, which may hold crates
_SECONDS, _SECONDS_PER_MB = 4, 1  # of processor time
_MEGABYTES, _MEGABYTES_PER_MB = 3000, 300  # of address space; USD itself takes one thousand
_IDLE = 10  # times as long by the clock, for one that waits


def check_binary(path: Path, data: bytes) -> None:
    """Raises MeshError where USD cannot read a file without ending its process, or does not come to an end.

    Nothing is done for text that refers to no other file, nor where no process can be started.

    Args:
        path: The file.
        data: What is in it.
    """
    if not data.startswith(_BINARY) and b"@" not in data:
        return
    size = len(data) / 1e6
    seconds, megabytes = int(_SECONDS + _SECONDS_PER_MB * size), int(_MEGABYTES + _MEGABYTES_PER_MB * size)
    try:
        ended = subprocess.run(
            [sys.executable, "-I", usd_probe.__file__, str(path.resolve()), str(seconds), str(megabytes)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_IDLE * seconds,
            env={**os.environ, "PXR_WORK_THREAD_LIMIT": "1"},  # every thread takes address space
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"cannot be read: USD does not come to an end in {_IDLE * seconds} s.") from None
    except OSError:
        return
    if ended.returncode == -signal.SIGXCPU:
        raise MeshError(f"cannot be read: USD does not come to an end in {seconds} s.")
    if ended.returncode < 0:
        name = signal.Signals(-ended.returncode).name
        raise MeshError(f"cannot be read: it is damaged, and ends the process that tries to ({name}).")
