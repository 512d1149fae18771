"""Reads everything in a USD file and ends: a process of its own, which ``usd_binary`` starts. Imports USD alone."""

from __future__ import annotations

import contextlib
import sys


def limit(seconds: int, megabytes: int) -> None:
    """Ends this process after so much processor time, and refuses it more memory than that."""
    with contextlib.suppress(ImportError, OSError, ValueError):  # a system without limits, or with lower ones
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def read_everything(path: str) -> None:
    """Opens a stage and takes every value of it at every time."""
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(path)
        for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
            for attribute in prim.GetAttributes():
                for time in [Usd.TimeCode.EarliestTime(), *map(Usd.TimeCode, attribute.GetTimeSamples())]:
                    attribute.Get(time)
            for relationship in prim.GetRelationships():
                relationship.GetForwardedTargets()
    except Tf.ErrorException:
        pass  # whoever reads the file next gets it too, and says so


if __name__ == "__main__":
    limit(int(sys.argv[2]), int(sys.argv[3]))
    read_everything(sys.argv[1])
