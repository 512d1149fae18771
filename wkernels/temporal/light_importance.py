"""More samples where a light is contested: a density over strata of the light, learnt from frame to frame.

A stratum is contested where pixels disagree with what its points say: the mean of (tau - psi)^2 over the picture.
Points are drawn as the square root of that asks for (Neyman's allocation), and weighted by the inverse of their
density, which keeps sums unbiased: rho sums weight times tau, n the weights, and n counts for less where weights
differ. A share of all points stays uniform, so that no weight exceeds 1 / (1 - share).

It gains nothing on this project's scenes and is off by default: averaged over all pixels every stratum is probably
contested about as much, and weights that differ are worth less (not tested). RMSE against 128 rays, mean of every 8th
frame at 320 x 180 with shares of 0, 0.25, 0.5 and 0.8: overlap_walkthrough 0.0698, 0.0700, 0.0700, 0.0701;
big_penumbra_walkthrough 0.0487, 0.0489, 0.0489, 0.0491. A frame takes 1 to 2 % longer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from wkernels.frame.session import Session
from wkernels.light_maps.light_map import Bias, LightMap
from wkernels.raster.gbuffer import GBuffer
from wkernels.sampling.point_sets import light_set
from wkernels.scene.geometry import RECEIVES
from wkernels.temporal.shadow_buffer.record import shadow_test

SIDE = 4  # strata along each coordinate of the light
PROBES = (36, 64)  # rows and columns of pixels that are asked
MEMORY = 0.98  # what a stratum's contest keeps of itself with every frame
RECENT = 64  # weights that say what n is worth


@wp.kernel
def measure_contest(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    psi_depth: wp.array2d(dtype=wp.vec2),
    out: wp.array2d(dtype=float),
):
    """(tau - psi)^2 of a coarse grid of pixels for the light sample of one map; -1 where nothing receives.

    Args:
        first: Tile offset.
        gbuffer: Receivers, (H, W). light_map: Of the sample. bias: Of its comparisons.
        psi_depth: Hidden share of the light so far, and depth, (H, W).
        out: Of any smaller shape.
    """
    row, column = wp.tid()
    line = first + row
    y = (2 * line + 1) * psi_depth.shape[0] // (2 * out.shape[0])
    x = (2 * column + 1) * psi_depth.shape[1] // (2 * out.shape[1])
    result = float(-1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        test = shadow_test(gbuffer, y, x, light_map, bias)
        result = (test.tau - psi_depth[y, x][0]) * (test.tau - psi_depth[y, x][0])
    out[line, column] = result


@dataclass
class LightImportance:
    """What is known of the strata, and the weights of late.

    Attributes:
        contest: Sum of contest, and visits behind it, of each stratum; float64 (2, SIDE, SIDE).
        weights: Of the last ``RECENT`` samples.
        stratum: Of the last sample, or None.
        host: That sample, (4,) as ``Light.sample`` returns it. weight: Its weight.
        drawn: Count of its frame. learnt: Count of the frame whose map was measured last.
    """

    contest: np.ndarray = field(default_factory=lambda: np.zeros((2, SIDE, SIDE)))
    weights: list[float] = field(default_factory=list)
    stratum: tuple[int, int] | None = None
    host: np.ndarray = field(default_factory=lambda: np.zeros(4))
    weight: float = 1.0
    drawn: int = -1
    learnt: int = -1

    def add(self, stratum: tuple[int, int], contest: float) -> None:
        """One more measurement of a stratum."""
        self.contest *= MEMORY
        self.contest[0][stratum] += contest
        self.contest[1][stratum] += 1.0

    def density(self, share: float) -> np.ndarray:
        """Probability of each stratum, (SIDE, SIDE); uniform but for ``share``. What was not visited is average."""
        total, visits = self.contest
        seen = visits > 1e-6
        asks = np.sqrt(np.divide(total, visits, out=np.zeros_like(total), where=seen))
        asks[~seen] = asks[seen].mean() if seen.any() else 1.0
        if not asks.sum() > 0.0:
            asks = np.ones_like(asks)
        return (1.0 - share) / asks.size + share * asks / asks.sum()

    def effective_share(self) -> float:
        """What n is worth, (sum w)^2 / (n sum w^2) of the weights of late: 1 where all are the same (Kish 1965)."""
        w = np.array(self.weights[-RECENT:] or [1.0])
        return float(w.sum() ** 2 / (len(w) * (w**2).sum())) if w.any() else 1.0


def warp_point(u: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, float, tuple[int, int]]:
    """A point of the unit square or cube, moved to where a density of strata wants it.

    The inverse of the cumulative density, first along one axis, then in the column: neighbours stay neighbours, so that
    a low-discrepancy set remains one.

    Args:
        u: In [0, 1)^2 or more; what follows the first two stays.
        density: Probability of each stratum, (columns, rows), sum 1.

    Returns:
        The point, its weight (1 over its relative density), and its stratum.
    """
    out = np.array(u, float)
    stratum = []
    rest = density
    for axis in range(2):
        shares = rest.sum(axis=1) if rest.ndim == 2 else rest
        cumulative = np.concatenate([[0.0], np.cumsum(shares / shares.sum())])
        i = min(int(np.searchsorted(cumulative, u[axis], side="right")) - 1, len(shares) - 1)
        within = (u[axis] - cumulative[i]) / (cumulative[i + 1] - cumulative[i])
        out[axis] = min((i + min(within, 1.0)) / len(shares), np.nextafter(1.0, 0.0))
        stratum.append(i)
        rest = rest[i]
    column, row = stratum
    return out, float(1.0 / (density.size * density[column, row])), (column, row)


def pull_importance(frame: Session) -> LightImportance:
    """The session's, from its first frame on."""

    def build(old: LightImportance | None) -> LightImportance:
        return old or LightImportance()

    held: LightImportance = frame.product("light samples", "light importance", frame.count, build)
    return held


def draw_important(frame: Session, sample_set: str, share: float) -> LightImportance:
    """Draws the frame's point of the light, the same one however often the frame is rendered."""
    held = pull_importance(frame)
    if held.drawn != frame.count:
        u = light_set(sample_set, 1, 3, frame.count, 0 if frame.seed == 1 else frame.seed + 1)
        point, weight, held.stratum = warp_point(u[0], held.density(share))
        held.host = frame.light.sample(point[None])[0]
        held.weight = weight * float(frame.light.weights(point[None])[0])
        held.weights = [*held.weights[1 - RECENT :], held.weight]
        held.drawn = frame.count
    return held


def learn(frame: Session, gbuffer: GBuffer, light_map: LightMap, bias: Bias, psi_depth: wp.array) -> None:
    """Adds what a frame's map says of the stratum of its sample; reads some thousand numbers back from the device."""
    held = pull_importance(frame)
    if held.stratum is None or held.learnt == frame.count:
        return
    held.learnt = frame.count
    out = frame.buffer("contest of a light sample", PROBES, wp.float32)
    frame.launch(measure_contest, PROBES, [gbuffer, light_map, bias, psi_depth], [out])
    contest = out.numpy()
    known = contest[contest >= 0.0]
    if known.size:
        held.add(held.stratum, float(known.mean(dtype=np.float64)))
