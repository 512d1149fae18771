"""Moments of depth: bounds against closed forms and NumPy twins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp

from wkernels.device.launch import launch
from wkernels.filters.depth_ranges import depth_range
from wkernels.filters.moments import Chebyshev, find_moments, lit_share


@wp.kernel
def run_lit_share(
    first: int,
    chebyshev: Chebyshev,
    moments: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=float),
    share_out: wp.array(dtype=float),
):
    i = first + wp.tid()
    share_out[i] = lit_share(chebyshev, moments[i], depth[i])


@dataclass
class Bound:
    """A bound over one range of depth."""

    near: float
    far: float
    min_variance: float = 1e-9
    bleeding: float = 0.0

    @property
    def per_length(self) -> float:
        return 1.0 / (self.far - self.near)

    @property
    def range(self) -> wp.vec2:
        return wp.vec2(self.near, self.per_length)

    @property
    def on_device(self) -> Chebyshev:
        out = Chebyshev()
        out.min_variance, out.bleeding = self.min_variance, self.bleeding
        return out


def lit_shares(samples: list[np.ndarray], depth: np.ndarray, chebyshev: Bound, device: str) -> np.ndarray:
    """``lit_share`` of sets of depths, each seen from one receiver depth (scene units)."""
    scaled = [(z - chebyshev.near) * chebyshev.per_length - 0.5 for z in samples]
    moments = np.array([(z.mean(), (z * z).mean()) for z in scaled], np.float32)
    t = ((depth - chebyshev.near) * chebyshev.per_length - 0.5).astype(np.float32)
    out = wp.zeros(len(t), dtype=float, device=device)
    inputs = [wp.array(moments, dtype=wp.vec2, device=device), wp.array(t, dtype=float, device=device)]
    launch(run_lit_share, len(t), [chebyshev.on_device, *inputs], [out], device=device)
    return out.numpy()


def test_two_planes_give_the_exact_share(device: str) -> None:
    lit = np.arange(1, 20)
    samples = [np.repeat([2.0, 7.0], [20 - k, k]) for k in lit]
    np.testing.assert_allclose(
        lit_shares(samples, np.full(len(lit), 7.0), Bound(1.0, 9.0), device), lit / 20, rtol=1e-4
    )


def test_light_bleeds_as_the_closed_form_says(device: str) -> None:
    depth = np.array([6.01, 7.0, 10.0])
    bleed = lit_shares([np.array([2.0, 6.0])] * 3, depth, Bound(0.0, 12.0), device)
    np.testing.assert_allclose(bleed, 1.0 / (1.0 + (1.0 + 2.0 * (depth - 6.0) / 4.0) ** 2), rtol=1e-4)
    np.testing.assert_allclose(bleed, [0.498, 0.308, 0.100], atol=1e-3)
    cut = lit_shares([np.array([2.0, 6.0])] * 3, depth, Bound(0.0, 12.0, bleeding=0.3), device)
    np.testing.assert_allclose(cut, np.maximum(bleed - 0.3, 0.0) / 0.7, rtol=1e-4, atol=1e-6)


def test_the_bound_is_never_below_the_share_that_is_lit(device: str) -> None:
    rng = np.random.default_rng(3)
    samples = [rng.choice(rng.uniform(1.0, 9.0, 4), 25) for _ in range(200)]
    depth = rng.uniform(1.0, 9.0, 200)
    share = lit_shares(samples, depth, Bound(1.0, 9.0), device)
    truth = np.array([np.mean(z >= t) for z, t in zip(samples, depth, strict=True)])
    assert (share >= truth - 1e-4).all() and (share <= 1.0).all()
    assert np.mean(share > truth + 0.05) > 0.2  # and it is a bound, not the share


@pytest.mark.parametrize("slope", [False, True])
def test_moments_agree_with_numpy(slope: bool, device: str) -> None:
    rng = np.random.default_rng(8)
    near, far = 1e4, 1e4 + 10.0
    depth = rng.uniform(near, far, (2, 17, 17)).astype(np.float32)
    depth[:, 3:6, 4] = np.inf
    out = wp.zeros((17, 17), dtype=wp.vec2, device=device)
    layers = wp.array(depth, dtype=float, device=device)
    launch(find_moments, (17, 17), [layers[1], Bound(near, far).range, int(slope)], [out], device=device)
    z = np.minimum((depth[1].astype(float) - near) / (far - near), 1.0) - 0.5
    square = z * z
    if slope:
        padded = np.pad(z, 1, mode="edge")
        for a, b in ((padded[1:-1, :-2], padded[1:-1, 2:]), (padded[:-2, 1:-1], padded[2:, 1:-1])):
            square = square + 0.25 * np.minimum(np.abs(z - a), np.abs(b - z)) ** 2
    np.testing.assert_allclose(out.numpy()[..., 0], z, atol=1e-6)
    np.testing.assert_allclose(out.numpy()[..., 1], square, atol=1e-6)


def test_normalised_moments_keep_small_variances(device: str) -> None:
    """At depth 10^4, z^2 has an ulp of 8 in float32; of a variance of 1e-3 nothing would be left."""
    z = 1e4 + np.array([-1.0, 1.0]) * np.sqrt(1e-3)
    near, far = 1e4 - 1.0, 1e4 + 1.0
    share = lit_shares([z], np.array([1e4 + 0.1]), Bound(near, far, min_variance=1e-12), device)
    assert share[0] == pytest.approx(1e-3 / (1e-3 + 0.1**2), rel=2e-3)


def test_depth_range_is_that_of_the_boxes_inside_the_window() -> None:
    """Against points of the boxes, in front of lights of both kinds, warped ones and those that see a part."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        low = rng.uniform(-3.0, 2.0, (4, 3))
        boxes = np.stack([low, low + rng.uniform(0.0, 4.0, (4, 3)) * rng.integers(0, 2, (4, 3))], axis=1)
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rows = np.zeros((4, 4))
        rows[:3, :3], rows[:3, 3] = axes, rng.uniform(-1.0, 1.0, 3) + np.array((0.0, 0.0, 6.0))
        rows[:2] *= rng.uniform(0.3, 1.5)
        rows[3] = rows[2] if rng.random() < 0.5 else (0.0, 0.0, 0.0, 1.0)
        rows[3] += 0.03 * rows[1]
        share = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 25)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        points = (boxes[:, :1] + share * (boxes[:, 1:] - boxes[:, :1])).reshape(-1, 3)
        x, y, depth, w = rows[:, :3] @ points.T + rows[:, 3:]
        seen = depth[(np.abs(x) <= w) & (np.abs(y) <= w)]
        near, far = depth_range(rows, boxes)
        if len(seen):
            assert near <= seen.min().clip(0.0) + 1e-9 and far >= seen.max() - 1e-9
            grown = depth[(np.abs(x) <= w + 0.4) & (np.abs(y) <= w + 0.4)]  # further than from point to point
            assert near >= grown.min().clip(0.0) - 0.4 and far <= max(grown.max(), 0.0) + 0.4


def test_depth_range_without_boxes_in_the_window() -> None:
    down = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 10.0], [0, 0, 0, 1.0]])
    box = np.array([[[-1.0, 2.0, -1.0], [1.0, 3.0, 1.0]]])
    assert depth_range(down, box) == pytest.approx((7.0, 8.0))
    assert depth_range(down, box + np.array([5.0, 0.0, 0.0])) == (0.0, 1.0)
    assert depth_range(down, box[:0]) == (0.0, 1.0)
