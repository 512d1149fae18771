"""The blend of samples and neighbourhood against its NumPy twin, by the plain kernel and by lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from compare import assert_twin

from wkernels.device.lanes import uses_lanes
from wkernels.device.launch import launch
from wkernels.scene.geometry import RECEIVES
from wkernels.temporal.neighbourhood_blend import BLEND, BLEND_PLAIN, BlendSettings
from wkernels.temporal.shadow_buffer.record import TEXEL_TYPES

SHAPE = (23, 37)  # no whole number of runs
LEAST, LARGEST, GATE, START, RANGE = 0.02, 0.2, 16.0, 16.0, 0.05


def images(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    flags = np.where(rng.random(SHAPE) < 0.85, int(RECEIVES), 0).astype(np.int32)
    psi = np.where(rng.random(SHAPE) < 0.5, 0.0, rng.random(SHAPE)) * (flags != 0)
    width = rng.uniform(-5.0, 5.0, SHAPE) * (rng.random(SHAPE) < 0.7) * (flags != 0)
    n = rng.integers(1, 40, SHAPE) * (rng.random(SHAPE) < 0.95)
    texels = np.stack([psi * n, n, rng.uniform(0.1, 0.9, SHAPE), rng.uniform(0.1, 0.9, SHAPE)], axis=-1)
    return {
        "flags": flags,
        "depth": rng.choice([4.0, 4.1, 6.0], SHAPE).astype(np.float32),
        "psi": psi.astype(np.float32),
        "error": (0.3 * rng.random(SHAPE)).astype(np.float32),
        "width": width.astype(np.float32),
        "texels": texels.astype(np.float32),
        "taps": rng.uniform(-1.0, 1.0, (6, 2)).astype(np.float32),
    }


def twin(held: dict[str, np.ndarray], rejects: bool) -> tuple[np.ndarray, np.ndarray, int]:
    """(Visibility, texels, neighbourhoods that are wholly lit)."""
    shown, texels, lit = held["psi"].astype(float), held["texels"].astype(float), 0
    for y, x in np.argwhere(np.abs(held["width"]) >= 0.5):
        values = []
        for tap in held["taps"]:
            at = np.array([x, y], np.float32) + np.abs(held["width"][y, x]) * tap
            column, row = (int(np.floor(abs(v) + 0.5) * np.sign(v)) for v in at)
            if not (0 <= column < SHAPE[1] and 0 <= row < SHAPE[0]) or not held["flags"][row, column]:
                continue
            if abs(held["depth"][row, column] - held["depth"][y, x]) < RANGE * held["depth"][y, x]:
                values.append(held["psi"][row, column])
        lit += bool(values) and not any(values)
        if not values or (rejects and not any(values)):
            continue
        blur, psi, n = np.mean(values), held["psi"][y, x], held["texels"][y, x, 1]
        if held["width"][y, x] < 0.0:
            shown[y, x] = 0.5 * (blur + psi)
            if n > 0.0:
                texels[y, x, :2] = START * shown[y, x], START
        else:
            weight = 0.0 if n < GATE else np.clip((LARGEST - held["error"][y, x]) / (LARGEST - LEAST), 0.0, 1.0)
            shown[y, x] = blur * (1.0 - weight) + psi * weight
    return 1.0 - shown, texels, lit


def blend(held: dict[str, np.ndarray], rejects: bool, format: str, lanes: bool, device: str) -> tuple[Any, Any]:
    depth = np.where(held["flags"] != 0, held["depth"], np.float32(0.0))
    packed = wp.array(np.stack([held["psi"], depth], axis=-1), dtype=wp.vec2, device=device)
    settings = BlendSettings()
    settings.depth_range, settings.least_error, settings.largest_error = RANGE, LEAST, LARGEST
    settings.least_samples, settings.start_weight, settings.rejects_lit = GATE, START, int(rejects)
    texels = wp.array(held["texels"].astype(np.float16 if format == "float16" else np.float32), dtype=TEXEL_TYPES[format], device=device)  # fmt: skip
    arrays = [wp.array(held[name], dtype=float, device=device) for name in ("error", "width")]
    taps = wp.array(held["taps"], dtype=wp.vec2, device=device)
    out = wp.empty(SHAPE, dtype=float, device=device)
    kernel = (BLEND if lanes else BLEND_PLAIN)[TEXEL_TYPES[format]]
    launch(kernel, SHAPE, [packed, *arrays, taps, settings], [texels, out], device=device, threads=2)
    return out.numpy(), texels.numpy().astype(float)


@pytest.mark.parametrize("rejects", [False, True])
@pytest.mark.parametrize(("format", "lanes"), [("float32", False), ("float32", True), ("float16", False)])
def test_blend_equals_its_twin(format: str, lanes: bool, rejects: bool, device: str) -> None:
    if lanes and not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")
    held = images(8)
    visibility, texels, lit = twin(held, rejects)
    assert lit > 10 and (texels != held["texels"]).any(axis=-1).sum() > 50
    found, stored = blend(held, rejects, format, lanes, device)
    assert_twin(found, visibility, atol=1e-6)
    np.testing.assert_allclose(stored, texels, rtol=1e-3 if format == "float16" else 2e-6, atol=1e-6)
