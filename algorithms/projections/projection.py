"""Projections: where light depth maps look, composed of a fit, a warp, splits and a stabilisation.

Each part is a plugin, one class in one file, found by scanning its folder: ``projections/fits`` (what the view is
fitted to), ``projections/warps`` (how its texels are moved towards the eye), ``projections/stabilisers`` (what keeps
its texels still). Partition schemes are formulas (``splits``). Every technique that reads a light depth map
does so through whatever composition its session was given; ``algorithms.projections.composition`` puts one together.
"""

from __future__ import annotations

import importlib
import inspect
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from wkernels.errors import InputError
from wkernels.projections.clipping import ConvexBody
from wkernels.projections.focusing import LightSpace, WarpShape
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView

LEAST_ANGLE = np.radians(1.0)
"""Between light and view direction: below it the frusta duel and nothing is better than no warp."""

__all__ = ["Fit", "Stabiliser", "Warp", "WarpShape", "fits", "stabilisers", "warps"]

FOLDER = Path(__file__).parent


class Plugin(ABC):
    """A part of a projection; subclasses of its kinds are final and live alone in their file.

    Attributes:
        name: File name = value of the key.
        paper: Keys in references.bib.
    """

    name: ClassVar[str]
    paper: ClassVar[tuple[str, ...]]


class Fit(Plugin):
    """Decides what a light view has to cover.

    Attributes:
        follows_eye: Whether it covers a part of the eye's frustum, so that warps and splits make sense.
    """

    follows_eye: ClassVar[bool] = False

    @abstractmethod
    def views(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        """The plain views of one light sample, without warp and splits.

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

    def body(self, receivers: Bounds, eye: HostView) -> ConvexBody:
        """What has to be covered of the receivers in the eye's view; empty where it sees none.

        Only for fits that follow the eye.
        """
        raise NotImplementedError


class Warp(Plugin):
    """Decides how strongly texels are moved towards the eye."""

    @abstractmethod
    def distance(self, shape: WarpShape) -> float:
        """n', from the warp's centre to the near side of what is covered, in the units of ``shape.extent``.

        Returns:
            Above 0; infinite for no warp.
        """

    def bounded_distance(self, shape: WarpShape) -> float:
        """``distance``, but infinite where light and view are nearly parallel or there is nothing to be warped."""
        if shape.gamma < LEAST_ANGLE or not (shape.extent > 0.0 and shape.near > 0.0 and shape.far > shape.near):
            return float(np.inf)
        distance = self.distance(shape)
        return distance if distance > 0.0 else float(np.inf)


class Stabiliser(Plugin):
    """Keeps the texels of an unwarped directional view where they were as the eye moves.

    Attributes:
        adjusts: Whether the depth range may follow what the eye sees.
    """

    adjusts: ClassVar[bool]

    @abstractmethod
    def window(self, space: LightSpace, body: np.ndarray, eye: HostView, resolution: int) -> np.ndarray:
        """What the view covers instead of a tight fit.

        Args:
            space: The light's axes, which do not depend on the eye.
            body: Corners of what must be covered, rebased world (n, 3).
            eye: The eye's view, its depth range that of the split.
            resolution: Texels per side.

        Returns:
            (left, right, bottom, top) in map units.
        """


def fits() -> dict[str, type[Fit]]:
    """Every fit by name. Raises InputError where a file cannot be imported or does not hold exactly one such plugin."""
    return _found("fits", Fit)


def warps() -> dict[str, type[Warp]]:
    """Every warp by name; see ``fits``."""
    return _found("warps", Warp)


def stabilisers() -> dict[str, type[Stabiliser]]:
    """Every stabiliser by name; see ``fits``."""
    return _found("stabilisers", Stabiliser)


def _found(folder: str, kind: Any) -> dict[str, Any]:
    files = sorted((FOLDER / folder).glob("*.py"))
    return {path.stem: _plugin_of(path, kind) for path in files if path.stem[0] != "_"}


def _plugin_of(path: Path, kind: Any) -> Any:
    try:
        module = importlib.import_module(f"algorithms.projections.{path.parent.name}.{path.stem}")
    except Exception as error:
        raise InputError(f"cannot be imported: {type(error).__name__}: {error}", file=path) from error
    found: list[Any] = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, kind) and value.__module__ == module.__name__
    ]
    names = [getattr(value, "name", None) for value in found]
    if names != [path.stem]:
        message = f"a projection file holds exactly one {kind.__name__} with the file's name, this one holds {names}"
        raise InputError(message, file=path)
    return found[0]
