"""The parts of a projection: what a fit, a warp and a stabiliser implement, each one class in one file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from wkernels.projections.clipping import ConvexBody
from wkernels.projections.focusing import LightSpace, WarpShape
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView

LEAST_ANGLE = np.radians(1.0)
"""Between light and view direction: below it the frusta duel and nothing is better than no warp."""

__all__ = ["Fit", "Part", "Stabiliser", "Warp", "WarpShape"]


class Part(ABC):
    """A part of a projection; subclasses of its kinds are final and live alone in their file.

    Attributes:
        name: File name = value of the key.
        paper: Keys in references.bib.
        title: In headings of pictures; empty for kind and name.
    """

    name: ClassVar[str]
    paper: ClassVar[tuple[str, ...]]
    title: ClassVar[str] = ""


class Fit(Part):
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


class Warp(Part):
    """Decides how strongly texels are moved towards the eye.

    Attributes:
        takes_distance: Whether it reads ``shape.distance``, the key ``warp_distance``, which it then requires.
    """

    takes_distance: ClassVar[bool] = False

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


class Stabiliser(Part):
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
