"""Confidence of shadow tests and their blending: closed forms, a NumPy twin, and 100 000 frames without drift."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from compare import assert_twin

from wkernels.device.launch import launch
from wkernels.light_maps.light_map import BIAS_SLOPE, Bias, Receiver
from wkernels.projections.jitter import frame_jitter
from wkernels.temporal.confidence.blending import (
    Blending,
    blend_shares,
    chosen_power,
    confidence_of,
    kept_frames,
    mean_confidence,
    read_blur,
    spare_bias,
)


@wp.kernel
def confidences(first: int, places: wp.array(dtype=wp.vec2), power: int, out: wp.array(dtype=float)):
    i = first + wp.tid()
    receiver = Receiver()
    receiver.x = places[i][0]
    receiver.y = places[i][1]
    out[i] = confidence_of(receiver, power)


@wp.kernel
def constants(first: int, out: wp.array(dtype=float)):
    nowhere = Receiver()
    nowhere.layer = -1
    nowhere.x = 0.99
    out[0] = confidence_of(nowhere, 9)
    out[1] = read_blur(0.0, 0.0)
    out[2] = read_blur(0.5, 0.5)
    out[3] = mean_confidence(3.0)
    slanted = Receiver()
    slanted.x = 3.6
    slanted.y = 4.2
    slanted.plane_depth = wp.vec3(0.2, -0.1, 5.0)
    slanted.plane_scale = wp.vec3(0.02, 0.0, 1.0)
    bias = Bias()
    bias.slope = 2.0
    out[4] = spare_bias(slanted, bias)
    bias.kind = BIAS_SLOPE
    out[5] = spare_bias(slanted, bias)
    out[6] = spare_bias(nowhere, bias)


@pytest.mark.parametrize("power", [0, 3, 15])
def test_confidence_of_places_in_a_texel(power: int, device: str) -> None:
    line = (np.arange(200) + 0.5) / 200.0
    places = np.stack(np.meshgrid(line + 7.0, line + 3.0), axis=-1).reshape(-1, 2).astype(np.float32)
    out = wp.empty(len(places), dtype=float, device=device)
    launch(confidences, len(places), [wp.array(places, dtype=wp.vec2, device=device), power], [out], device=device)
    off = np.abs(places.astype(float) % 1.0 - 0.5).max(axis=1)
    # places in float32, 16 powers of it
    np.testing.assert_allclose(out.numpy(), np.maximum((1.0 - 2.0 * off) ** power, 1e-6), atol=1e-5)
    weight = out.numpy().astype(float)
    assert weight.mean() == pytest.approx(2.0 / ((power + 1.0) * (power + 2.0)), rel=5e-3)  # of a grid of 200 x 200
    assert (weight * off).sum() / weight.sum() == pytest.approx(1.0 / (power + 3.0), rel=2e-2)


def test_where_no_texel_is_asked_the_test_is_sure(device: str) -> None:
    out = wp.empty(7, dtype=float, device=device)
    launch(constants, 1, [], [out], device=device)
    # the plane's slopes are 0.2 - 5 * 0.02 and -0.1, the point lies 0.1 and 0.3 texels from the centre
    assert_twin(out.numpy(), np.array([1.0, 0.0, 0.25, 0.1, 0.0, 2.0 * (0.1 * 0.4 + 0.1 * 0.2), 0.0]), atol=1e-6)


# ---- the recursion --------------------------------------------------------------------------------------------------------


@wp.kernel
def accumulate(
    first: int,
    points: wp.array(dtype=wp.vec2),
    jitter: wp.array(dtype=wp.vec2),
    edge: float,
    frames: int,
    read: float,
    blending: Blending,
    state: wp.array(dtype=wp.vec3),
    psi_out: wp.array2d(dtype=float),
):
    """What tc_hard does with a point beside a straight shadow edge at x = ``edge``, frame after frame."""
    i = first + wp.tid()
    rho = state[i][0]
    n = state[i][1]
    blur = state[i][2]
    for frame in range(frames):
        shift = jitter[frame % jitter.shape[0]]
        receiver = Receiver()
        receiver.x = points[i][0] + shift[0]
        receiver.y = points[i][1] + shift[1]
        tau = wp.where(wp.floor(receiver.x) + 0.5 - shift[0] < edge, 1.0, 0.0)
        kept = kept_frames(n, blur + read, blending)
        power = chosen_power(kept, blending)
        shares = blend_shares(kept, blur + read, confidence_of(receiver, power), power, blending)
        share = wp.where(n > 0.0, wp.clamp(rho / wp.where(n > 0.0, n, 1.0), 0.0, 1.0), 0.0)
        rho = share * shares.kept + shares.weight * tau
        n = shares.kept + shares.weight
        blur = shares.blur
        psi_out[frame % psi_out.shape[0], i] = rho / n
    state[i] = wp.vec3(rho, n, blur)


POINTS = np.stack([10.0 + np.linspace(-0.6, 0.6, 25), np.full(25, 5.2)], axis=1)  # texels; the edge is at 10
JITTER = np.array([frame_jitter("r2", i, 1.0, 0.0)[:2] for i in range(4096)])


def blending_of(**values: float) -> Blending:
    out = Blending()
    for name, value in {"power": 9, "growth": 1.5, "memory": 256.0, "recursive": 0, "blur": 1.0, **values}.items():
        setattr(out, name, value)
    return out


def run(frames: int, device: str, held: int = 1, read: float = 0.0, points: np.ndarray = POINTS, **values: float):
    """(psi of the last ``held`` frames in ring order, final state) of each point."""
    count = len(points)
    state = wp.zeros(count, dtype=wp.vec3, device=device)
    psi = wp.zeros((held, count), dtype=float, device=device)
    arrays = [wp.array(a.astype(np.float32), dtype=wp.vec2, device=device) for a in (points, JITTER)]
    launch(accumulate, count, [*arrays, 10.0, frames, read, blending_of(**values)], [state, psi], device=device)
    return psi.numpy(), state.numpy()


def twin(frames: int, read: float, power: int, growth: float, memory: float, recursive: int, blur: float) -> np.ndarray:
    """``accumulate`` in float64."""
    points, jitter = POINTS.astype(np.float32).astype(float), JITTER.astype(np.float32).astype(float)
    psi, n, spread = np.zeros(len(points)), np.zeros(len(points)), np.zeros(len(points))
    for shift in jitter[:frames]:
        at = (points + shift).astype(np.float32).astype(float)
        tau = (np.floor(at[:, 0]) + 0.5 - shift[0] < 10.0).astype(float)
        nearness = 1.0 - 2.0 * np.abs(at - np.floor(at) - 0.5).max(axis=1)
        v = spread + read
        kept = np.minimum(n, memory)
        kept = np.where(v > blur, np.minimum(kept, blur / np.where(v > blur, v - blur, 1.0)), kept)
        if recursive:
            weight = np.maximum(nearness**power, 1.0 / (memory + 1.0))
            old = np.where(kept > 0.0, 1.0 - weight, 0.0)
        else:
            m = np.clip(np.floor(growth * np.sqrt(kept)) - 1.0, 0, power)
            weight = np.maximum(nearness**m, 1e-6) * 0.5 * (m + 1.0) * (m + 2.0)
            old = kept
        psi = (psi * old + weight * tau) / (old + weight)
        n, spread = old + weight, v * old / (old + weight)
    return psi


@pytest.mark.parametrize(
    "values",
    [
        {"power": 6, "growth": 1e3, "memory": 1e6, "recursive": 0, "blur": 1.0, "read": 0.0},
        {"power": 3, "growth": 1.3, "memory": 20.0, "recursive": 0, "blur": 1.0, "read": 0.1},
        {"power": 9, "growth": 0.0, "memory": 50.0, "recursive": 1, "blur": 1.0, "read": 0.0},
    ],
)
def test_the_recursion_is_its_twin(values: dict[str, float], device: str) -> None:
    psi, _ = run(400, device, **values)
    # a place that float32 puts on the other side of a texel's border has the least confidence there
    np.testing.assert_allclose(psi[0], twin(400, **values), atol=2e-3)  # type: ignore[arg-type]


@pytest.mark.parametrize("power", [3, 9])
def test_the_limit_is_the_edge_smoothed_by_the_kernel(power: int, device: str) -> None:
    psi, _ = run(4096, device, power=power, growth=1e3, memory=1e6)
    line = (np.arange(400) + 0.5) / 400.0 - 0.5
    x, y = np.meshgrid(line, line)
    kernel = (1.0 - 2.0 * np.maximum(np.abs(x), np.abs(y))) ** power
    # a texel's centre lies where the kernel's argument says, seen from the point
    expected = [(kernel * (px + x < 10.0)).sum() / kernel.sum() for px in POINTS[:, 0]]
    np.testing.assert_allclose(psi[0], expected, atol=0.02)  # 4096 points of R2 under a peaked kernel
    assert psi[0, 0] == 1.0 and psi[0, -1] == 0.0, "half a texel away every test says the same"


def test_100_000_frames_do_not_drift(device: str) -> None:
    """Float32 sums forget their rounding as they forget their tests; texels that all agree stay exactly 0 and 1."""
    early, _ = run(8192, device, held=4096)
    late, state = run(98304 + 4096, device, held=4096)
    np.testing.assert_allclose(late.mean(axis=0), early.mean(axis=0), atol=4e-3)
    np.testing.assert_allclose(late, early, atol=1e-4)  # the jitter repeats after 4096 frames, and so does everything
    assert (late[:, 0] >= 1.0 - 1e-6).all() and (late[:, -1] == 0.0).all()
    assert np.isfinite(state).all() and state[:, 1].max() <= 256.0 + 0.5 * 10.0 * 11.0


def test_published_blending_never_settles(device: str) -> None:
    """A confident test overrides the rest: near an edge the published recursion flickers for ever, the mean does not."""
    near = np.abs(POINTS[:, 0] - 10.0) < 0.2
    published, _ = run(4096, device, held=1024, power=3, recursive=1, memory=1e6)
    mean, _ = run(4096, device, held=1024, power=3, growth=1e3)
    steps = [np.sqrt(np.mean(np.diff(p[:, near], axis=0) ** 2)) for p in (published, mean)]
    assert steps[0] > 5.0 * steps[1], steps


def test_blur_is_held_where_it_is_asked(device: str) -> None:
    """Reads at half a pixel add 1/4 each; by default 1 pixel^2 is kept, and without a bound it would be 16 times that."""
    _, state = run(2000, device, read=0.25)
    assert 0.6 < np.median(state[:, 2]) < 1.2
    _, state = run(2000, device, read=0.25, blur=1e6, memory=64.0)
    assert 10.0 < np.median(state[:, 2]) < 22.0


def test_memory_is_forgotten(device: str) -> None:
    """A shadow that is suddenly elsewhere: half is gone after a memory, nine tenths after three."""
    points = np.concatenate([POINTS, np.stack([np.linspace(20.0, 21.0, 25), np.linspace(3.0, 4.0, 25)], axis=1)])
    for values in ({"memory": 16.0}, {"memory": 16.0, "recursive": 1, "power": 3}):
        state = wp.array(np.tile([64.0, 64.0, 0.0], (50, 1)).astype(np.float32), dtype=wp.vec3, device=device)
        psi = wp.zeros((48, 50), dtype=float, device=device)
        arrays = [wp.array(a.astype(np.float32), dtype=wp.vec2, device=device) for a in (points, JITTER)]
        launch(accumulate, 50, [*arrays, -100.0, 48, 0.0, blending_of(**values)], [state, psi], device=device)
        left = psi.numpy()
        assert (np.diff(left, axis=0) <= 0.0).all() and left[0].mean() > 0.8
        assert left[15].mean() < 0.5 and left[47].max() < 0.15 and left[47].mean() < 0.1, (
            left[15].mean(),
            left[47].max(),
        )
