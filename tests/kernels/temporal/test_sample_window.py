"""Exponential windows: their closed form, and how the disagreement of history's texels shortens them; when sampling stops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from compare import assert_twin

from algorithms.plugins import find
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.sampling.estimators import add_test
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Camera
from wkernels.temporal.sample_window import SampleWindow, shorten, window_of
from wkernels.temporal.shadow_buffer.stillness import count_still_frames


@wp.kernel
def run_window(
    first: int, window: SampleWindow, start: wp.vec2, tau: wp.array(dtype=float), out: wp.array(dtype=wp.vec2)
):
    rho = start[0]
    n = start[1]
    for k in range(tau.shape[0]):
        sums = shorten(rho, n, window_of(rho / n, 0.0, window))
        sums = add_test(sums[0], sums[1], tau[k], 1.0, 1.0e9)
        rho = sums[0]
        n = sums[1]
        out[k] = sums


@pytest.mark.parametrize("largest", [8.0, 64.0, 1000.0])
def test_a_full_window_is_an_exponential_one(largest: float, device: str) -> None:
    """psi_k = psi_0 q^k + sum of (1 - q) q^(k - i) tau_i with q = 1 - 1 / N; N stays where it is."""
    tau = (np.random.default_rng(1).random(300) < 0.4).astype(np.float32)
    window = SampleWindow()
    window.largest = largest
    start = wp.vec2(0.9 * largest, largest)
    out = wp.empty(len(tau), dtype=wp.vec2, device=device)
    launch(run_window, 1, [window, start, wp.array(tau, dtype=float, device=device)], [out], device=device)
    q = 1.0 - 1.0 / largest
    k = np.arange(1, len(tau) + 1)
    weights = np.tril((1.0 - q) * q ** (k[:, None] - k[None, :]))
    expected = 0.9 * q**k + weights @ tau
    assert_twin(out.numpy()[:, 0] / out.numpy()[:, 1], expected, rtol=2e-5)
    assert_twin(out.numpy()[:, 1], np.full(len(tau), largest))
    # a change from 0 to 1 is seen to a share of 1 - 1 / e after N frames
    out = wp.empty(int(largest), dtype=wp.vec2, device=device)
    ones = wp.full(int(largest), 1.0, dtype=float, device=device)
    launch(run_window, 1, [window, wp.vec2(0.0, largest), ones], [out], device=device)
    assert abs(out.numpy()[-1, 0] / out.numpy()[-1, 1] - (1.0 - q**largest)) < 1e-4


@wp.kernel
def find_window(first: int, cases: wp.array(dtype=wp.vec2), window: SampleWindow, out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = window_of(cases[i][0], cases[i][1], window)


def test_windows_follow_the_variance_of_the_texels(device: str) -> None:
    rng = np.random.default_rng(2)
    psi = np.concatenate([rng.random(50), [0.0, 1.0, 0.5]])
    spread = np.concatenate([rng.random(50) ** 4 * 0.25, [0.1, 0.1, 0.0]])
    window = SampleWindow()
    window.largest, window.agreement, window.least = 101.0, 0.3, 4.0
    cases = np.stack([psi, spread], axis=1)
    out = wp.empty(len(psi), dtype=float, device=device)
    launch(find_window, len(psi), [wp.array(cases, dtype=wp.vec2, device=device), window], [out], device=device)
    with np.errstate(divide="ignore"):
        twin = np.clip(0.3 * psi * (1.0 - psi) / spread, 4.0, 100.0)
    twin[spread < 1e-6] = 100.0
    assert_twin(out.numpy(), twin, rtol=1e-4)
    assert (twin == 4.0).any() and (twin == 100.0).any() and ((twin > 4.0) & (twin < 100.0)).sum() > 10
    window.agreement = 0.0
    launch(find_window, len(psi), [wp.array(cases, dtype=wp.vec2, device=device), window], [out], device=device)
    np.testing.assert_array_equal(out.numpy(), 100.0)


def creeping(frame: int) -> Camera:
    return small.camera(eye=(0.013 * frame, 6.0, 8.0))


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
def test_agreement_limits_n_at_edges_under_a_moving_eye_only(name: str, device: str) -> None:
    held = {}
    for path in (creeping, small.camera()):
        scene = small.box_on_ground(small.light("rectangle", (2.0, 8.0, 1.0), 0.3), path)
        session = Session(Geometry(scene, device), width=96, height=72, device=device)
        plugin: Any = find(name)
        technique = plugin(plugin.Params(resolution=512, overscan=0.0, filter=False))
        for index in range(24):
            session.begin(index)
            session.render(technique)
            session.advance()
        texels = session.history("shadow buffer", lambda: None).previous.numpy()
        held[callable(path)] = texels[texels[..., 1] > 0.0]
    psi = held[True][:, 0] / held[True][:, 1]
    inner = (psi > 0.2) & (psi < 0.8)
    assert inner.sum() > 20 and held[True][inner, 1].min() < 8.0 and (held[True][inner, 1] < 20.0).mean() > 0.25
    assert np.median(held[True][(psi < 1e-6) | (psi > 1.0 - 1e-6), 1]) == 24.0, "where all agree nothing is limited"
    assert (held[False][:, 1] == 24.0).all(), "a still eye interpolates nothing"


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
def test_a_still_picture_stops_and_goes_on_when_the_eye_moves(name: str, device: str) -> None:
    def path(frame: int) -> Camera:
        return small.camera(eye=(0.0, 6.0, 8.0 if frame < 20 else 7.9))

    scene = small.box_on_ground(small.light("rectangle", (2.0, 8.0, 1.0), 1.0), path)
    plugin: Any = find(name)
    stopped, pictures = {}, {}
    for skips in (True, False):
        session = Session(Geometry(scene, device), width=48, height=36, device=device, skips=skips)
        technique = plugin(plugin.Params(resolution=128, stop_error=0.2, stop_samples=12, filter=False))
        stopped[skips], pictures[skips] = [], []
        for index in range(24):
            session.begin(index)
            result = session.render(technique)
            stopped[skips].append(any(what == "light sample" for what, _, _ in result.left_out))
            pictures[skips].append(result.visibility)
            session.advance()
    assert not any(stopped[True][:12]) and all(stopped[True][12:20]) and not any(stopped[True][20:])
    assert not any(stopped[False])
    np.testing.assert_array_equal(pictures[True][12], pictures[True][19])
    # the bound of what is left out: two standard errors
    assert np.nanmax(np.abs(pictures[True][19] - pictures[False][19])) < 2.0 * 0.2
    assert (pictures[True][20] != pictures[True][19]).any()


def test_still_frames_are_counted_once_a_frame(device: str) -> None:
    scene = small.box_on_ground(small.light("rectangle"), lambda f: small.camera(eye=(0.1 * max(f - 4, 0), 6.0, 8.0)))
    session = Session(Geometry(scene, device), width=8, height=8, device=device)
    counts = []
    for index in range(8):
        session.begin(index)
        counts.append((count_still_frames(session), count_still_frames(session)))
        session.advance()
    assert [a for a, _ in counts] == [0, 1, 2, 3, 4, 0, 0, 0] and all(a == b for a, b in counts)
    session.reset()
    session.begin(0)
    assert count_still_frames(session) == 0
