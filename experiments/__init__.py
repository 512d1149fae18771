"""Experiments with shadow techniques: scenes, reference, metrics, walkthroughs, reports.

Rooms, bottom up: ``config``, ``metrics``; ``scenes``; ``schema``; ``rendering``; ``results``; ``report``; ``views``,
``bench``; ``kinds``; ``api``; ``commands``; ``cli``. Begin with ``schema.experiment`` and ``kinds.walkthrough.run``.

``render_visibility`` and ``reference_visibility`` are the calls for scripts and notebooks; importing this package alone
loads neither Warp nor any technique.
"""

from __future__ import annotations

import os as _os
import sys as _sys
from typing import TYPE_CHECKING, Any

# As wkernels does it, but earlier: most modules here import NumPy before the first one of wkernels, and OpenBLAS, whose
# threads keep spinning beside our kernels, reads this when NumPy is imported.
if "numpy" not in _sys.modules:
    _os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if TYPE_CHECKING:
    from experiments.api import reference_visibility, render_visibility

__all__ = ["reference_visibility", "render_visibility"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from experiments import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
