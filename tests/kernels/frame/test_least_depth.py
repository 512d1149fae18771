"""The reduction to the least eye depth, against NumPy, and the clamp of depths before a near plane."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp

from wkernels.device import twin
from wkernels.device.lanes import uses_lanes
from wkernels.frame.near_plane import least_depth
from wkernels.frame.session import Session
from wkernels.light_maps.depth_clamp import clamp_casters
from wkernels.scene.geometry import Geometry

SIZES = [(1, 1), (1, 5), (7, 3), (3, 15), (4, 16), (5, 17), (33, 31), (64, 48), (45, 129)]


@pytest.mark.parametrize("lanes", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_the_least_depth_is_that_of_numpy(
    size: tuple[int, int], lanes: bool, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if lanes and not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")
    monkeypatch.setattr(twin, "uses_lanes", lambda device: lanes)
    height, width = size
    geometry = Geometry(small_scenes.box_on_ground(small_scenes.light("directional")), device)
    session = Session(geometry, width=width, height=height, device=device)
    gbuffer = session.gbuffer()
    rng = np.random.default_rng(height * width)
    # the least at every border, corner and inner place of the image: none may be lost
    for y, x in {(0, 0), (height - 1, width - 1), (0, width - 1), (height - 1, 0), (height // 2, width // 3)}:
        depth = rng.uniform(2.0, 90.0, size).astype(np.float32)
        depth[rng.random(size) < 0.2] = np.inf
        depth[rng.random(size) < 0.2] = np.nan
        depth[y, x] = 1e-3
        gbuffer.depth.assign(depth)
        assert least_depth(session, gbuffer) == np.nanmin(depth) == np.float32(1e-3)
        depth[y, x] = np.nan
        gbuffer.depth.assign(depth)
        assert least_depth(session, gbuffer) == np.nanmin(np.append(depth.ravel(), np.inf))
    for nothing in (np.inf, np.nan):
        gbuffer.depth.assign(np.full(size, nothing, np.float32))
        assert least_depth(session, gbuffer) == np.inf


@pytest.mark.parametrize("lanes", [False, True])
@pytest.mark.parametrize("size", [(1, 1), (5, 7), (16, 16), (12, 20)])
def test_depths_before_the_near_plane_are_moved_onto_it(
    size: tuple[int, int], lanes: bool, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if lanes and not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")
    monkeypatch.setattr(twin, "uses_lanes", lambda device: lanes)
    depth = np.random.default_rng(7).uniform(-9.0, 9.0, size).astype(np.float32)
    depth[0, 0] = np.inf
    out = wp.array(depth, dtype=float, device=device)
    clamp_casters(out, 4.0)
    expected = np.where(np.abs(depth) < 4.0, np.where(depth < 0.0, -4.0, 4.0), depth).astype(np.float32)
    np.testing.assert_array_equal(out.numpy(), expected)
