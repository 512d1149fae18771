"""Points of a light as the host, the device and the shaft rays see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.rays.few_rays import FewSamples, few_samples
from wkernels.rays.shaft_rays import SampleBatches, sample_batches


@dataclass
class LightSamples:
    """Points of one light, as the host and the device see them.

    Attributes:
        host: float64 (n, 4), homogeneous, rebased world.
        points_ws: vec4 (n,), the same.
        weights: float (n,), relative radiance, mean about 1.
        weights_host: float64 (n,), the same.
    """

    host: np.ndarray
    points_ws: wp.array
    weights: wp.array
    weights_host: np.ndarray
    _batches: SampleBatches | None = None
    _few: FewSamples | None = None

    @property
    def batches(self) -> SampleBatches:
        """The same for ``shaft_rays``."""
        if self._batches is None:
            self._batches = sample_batches(self.host, self.weights_host, str(self.points_ws.device))
        return self._batches

    @property
    def few(self) -> FewSamples:
        """The same for ``few_rays``, of at most ``few_rays.MOST_HELD``."""
        if self._few is None:
            self._few = few_samples(self.host, self.weights_host, str(self.points_ws.device))
        return self._few
