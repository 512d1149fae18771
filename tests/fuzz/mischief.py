"""A target that does what no input may, so that tests see it found."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path

from isolation import Fault
from trying import Target

from wkernels.errors import InputError

DEEDS = (
    "is good",
    "refuses",
    "raises",
    "is wrong",
    "crashes",
    "hangs",
    "sleeps",
    "swells",
    "strays",
    "litters",
    "is good",
)


class Mischief:
    """The deed is a file; its index chooses it."""

    name = "mischief"

    def write(self, seed: int, index: int, folder: Path) -> None:
        """The file ``deed``."""
        (folder / "deed").write_text(DEEDS[index])

    def check(self, folder: Path, out: Path) -> str:
        """Does it."""
        deed = (folder / "deed").read_text()
        if deed == "refuses":
            try:
                raise InputError("no.")
            except InputError:
                return "refused"
        if deed == "raises":
            raise KeyError("x")
        if deed == "is wrong":
            raise Fault("7 is not 8")
        if deed == "crashes":
            os.kill(os.getpid(), signal.SIGSEGV)
        while deed == "hangs":
            pass
        if deed == "sleeps":
            time.sleep(1000.0)
        if deed == "swells":
            return str(len(bytearray(3 << 30)))
        if deed == "strays":
            Path("here").write_text("x")
        if deed == "litters":
            (folder / "more").write_text("x")
        (out / "mine").write_text("x")
        return "read"


def targets() -> Mapping[str, Target]:
    """It alone."""
    return {"mischief": Mischief()}
