"""Projections: where light depth maps look, composed of a fit, a warp, splits and a stabilisation.

A fit is a plugin: one class in one file of ``algorithms/projections/``, found by scanning that folder. A warp of
``none``, a single split and a stabilisation of ``none`` are the identity and need no file. Every technique that reads a
light depth map does so through whatever composition its session was given.
"""

from __future__ import annotations

import importlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from wkernels.errors import InputError, nearest
from wkernels.frame import LightViews
from wkernels.geometry import Bounds
from wkernels.views import HostView

FOLDER = Path(__file__).parent / "projections"
SPLIT_KEYS = frozenset({"scheme", "lambda", "selection", "storage"})
"""Keys that say how several splits are spaced, chosen and stored: without effect while there is one."""


class Fit(ABC):
    """Lays light views over a scene; subclasses are final and live alone in their file.

    Attributes:
        name: File name = value of the key ``fit``.
        paper: Keys in references.bib.
    """

    name: ClassVar[str]
    paper: ClassVar[tuple[str, ...]]

    @abstractmethod
    def views(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        """The views of one light sample.

        Args:
            light_ws: Light sample, float64 (4,), rebased world: a point (w = 1) or the direction towards the light
                (w = 0).
            receivers: Box of what is to be covered, rebased world; never empty.
            casters: Box of what can cast; may be empty.
            resolution: Texels per side of each view.
            eye: The eye's view of the frame.

        Returns:
            One view per layer of the light depth map, all ``resolution`` square.
        """


def fits() -> dict[str, type[Fit]]:
    """Every fit by name.

    Raises:
        InputError: A file of the folder cannot be imported or does not hold exactly one fit named like the file.
    """
    return {path.stem: _fit_of(path) for path in sorted(FOLDER.glob("*.py")) if path.stem != "__init__"}


def compose(settings: Mapping[str, Any] | None = None) -> LightViews:
    """The projection that a mapping with the keys of an experiment file's ``projection`` stands for.

    Args:
        settings: ``fit``, ``warp``, ``splits``, ``stabilise`` and the keys of ``SPLIT_KEYS``; what is left out is the
            plainest value (``scene``, ``none``, 1, ``none``).

    Raises:
        InputError: An unknown key, or a value that does not exist; the message lists those that do.
    """
    settings = dict(settings or {})
    table = fits()
    known: dict[str, list[Any]] = {"fit": list(table), "warp": ["none"], "splits": [1], "stabilise": ["none"]}
    for key, value in settings.items():
        if key not in known and key not in SPLIT_KEYS:
            raise InputError(f"is not a known key.{nearest(str(key), [*known, *SPLIT_KEYS])}", key=f"projection.{key}")
        # a bool compares equal to 1 and is no number of splits
        if key in known and (isinstance(value, bool) or value not in known[key]):
            choices = ", ".join(str(choice) for choice in known[key])
            raise InputError(f"{value!r} is not available; available: {choices}.", key=f"projection.{key}")
    return table[settings.get("fit", "scene")]().views


def _fit_of(path: Path) -> type[Fit]:
    try:
        module = importlib.import_module(f"algorithms.projections.{path.stem}")
    except Exception as error:
        raise InputError(f"cannot be imported: {type(error).__name__}: {error}", file=path) from error
    found = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, Fit) and value.__module__ == module.__name__
    ]
    names = [getattr(value, "name", None) for value in found]
    if names != [path.stem]:
        raise InputError(
            f"a projection file holds exactly one Fit with the file's name, this one holds {names}", file=path
        )
    return found[0]
