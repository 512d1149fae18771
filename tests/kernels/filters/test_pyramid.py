"""The min/max pyramid against NumPy, and what it proves of a window against every comparison in it."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from light_map_probe import make_bias, upload
from map_cases import LAYOUTS, MAPS, random_image, session

from wkernels.device import twin
from wkernels.device.lanes import LANES, runs_per_row
from wkernels.device.launch import launch
from wkernels.filters.levels import sides_of
from wkernels.filters.penumbra import depth_at, tap_depth, tap_position
from wkernels.filters.pyramid import DepthPyramid, find_pyramid, pull_pyramid, window_range
from wkernels.filters.window_proofs import ALL_DARK, ALL_LIT, UNDECIDED, judge_window
from wkernels.filters.window_proofs_lanes import LanePyramid, WindowRun, judge_windows_run, lane_pyramid
from wkernels.light_maps.light_map import (
    BIAS_CONSTANT,
    BIAS_NONE,
    BIAS_NORMAL,
    BIAS_SLOPE,
    BORDER,
    Bias,
    LightMap,
    compare_texel,
    locate_receiver,
)
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.workspace import Workspace

BIASES = {"none": BIAS_NONE, "constant": BIAS_CONSTANT, "slope": BIAS_SLOPE, "normal": BIAS_NORMAL}


@pytest.mark.parametrize("lanes", [False, True], ids=["plain", "lanes"])
@pytest.mark.parametrize("case", LAYOUTS)
def test_squares_hold_the_range_of_their_texels(
    case: str, lanes: bool, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(twin, "uses_lanes", lambda device: lanes)
    image, host = random_image(case, float, device, empty=0.1)
    pyramid = find_pyramid(Workspace(device, threads=3), image.texels, image.layout)
    sides, begin, ranges = sides_of(pyramid.levels), 0, pyramid.ranges.numpy()
    assert sides[-1] == 1 and len(sides) == pyramid.levels.levels
    for level, side in enumerate(sides[1:], 1):
        for layer, row, column in np.ndindex(len(host), side, side):
            rows, columns = (slice(i << level, (i + 1) << level) for i in (row, column))
            square = np.abs(host[layer, rows, columns])
            assert tuple(ranges[begin]) == (square.min(), square.max())
            begin += 1
    assert begin == pyramid.levels.texels
    again = find_pyramid(Workspace(device, threads=1), image.texels, image.layout, pyramid)
    assert again.ranges.ptr == pyramid.ranges.ptr
    np.testing.assert_array_equal(again.ranges.numpy(), ranges)


@wp.kernel
def ask_ranges(
    first: int,
    light_map: LightMap,
    pyramid: DepthPyramid,
    windows: wp.array2d(dtype=int),
    reads: int,
    range_out: wp.array(dtype=wp.vec2),
):
    i = first + wp.tid()
    w = windows[i]
    range_out[i] = window_range(light_map, pyramid, w[0], w[1], w[2], w[3], w[4], reads)


@pytest.mark.parametrize("case", LAYOUTS)
def test_ranges_of_windows_are_conservative_and_close(case: str, device: str) -> None:
    image, host = random_image(case, float, device, empty=0.02)
    layout, light_map = image.layout, LightMap()
    pyramid = find_pyramid(Workspace(device), image.texels, layout)
    light_map.depth, light_map.resolution = image.texels, layout.resolution
    rng = np.random.default_rng(5)
    corners = np.sort(rng.integers(0, layout.resolution, (300, 2, 2)), axis=1)
    windows = np.column_stack([rng.integers(0, len(host), 300), corners.reshape(-1, 4)]).astype(np.int32)
    on_device = wp.array(windows, dtype=int, device=device)
    held = np.abs(host[..., 0])

    def bounds(layer: int, left: int, top: int, right: int, bottom: int) -> tuple[float, float]:
        part = held[layer, top : bottom + 1, left : right + 1]
        return part.min(), part.max()

    exact = np.array([bounds(*w) for w in windows])
    for reads in (1, 2, 3, 6, layout.resolution):
        out = wp.zeros(len(windows), dtype=wp.vec2, device=device)
        launch(ask_ranges, len(windows), [light_map, pyramid, on_device, reads], [out], device=device, threads=2)
        found = out.numpy()
        assert (found[:, 0] <= exact[:, 0]).all() and (found[:, 1] >= exact[:, 1]).all()
        if reads > 1:  # at most a square too much at each end, and a square is at most size / (reads - 1) * 2 wide
            size = (corners[:, 1] - corners[:, 0]).max(axis=1)
            reach = np.ceil(2 * size / (reads - 1)).astype(int)[:, None]
            wider = windows + np.hstack([0 * reach, -reach, -reach, reach, reach])
            wider[:, 1:] = np.clip(wider[:, 1:], 0, layout.resolution - 1)
            widest = np.array([bounds(*w) for w in wider])
            assert (found[:, 0] >= widest[:, 0]).all() and (found[:, 1] <= widest[:, 1]).all()
        if reads == layout.resolution:
            np.testing.assert_array_equal(found, exact)


@wp.kernel
def judge_all(
    first: int,
    light_map: LightMap,
    pyramid: DepthPyramid,
    bias: Bias,
    position_ws: wp.array(dtype=wp.vec3),
    normal_ws: wp.array(dtype=wp.vec3),
    window: wp.array(dtype=wp.vec4),
    taps: wp.array(dtype=wp.vec2),  # in [0, 1]
    reads: int,
    judged_out: wp.array(dtype=int),
    texels_out: wp.array(dtype=wp.vec2i),
    taps_out: wp.array(dtype=wp.vec2i),
):
    """Judges the window round each receiver, and compares its plane with every texel and at every tap in it."""
    i = first + wp.tid()
    receiver = locate_receiver(light_map, bias, position_ws[i], normal_ws[i])
    judged_out[i] = -1
    if receiver.layer < 0:
        return
    w = window[i] + wp.vec4(receiver.x, receiver.y, receiver.x, receiver.y)
    judged_out[i] = judge_window(light_map, pyramid, receiver, w[0], w[1], w[2], w[3], reads)
    lit = int(0)
    compared = int(0)
    for row in range(int(wp.floor(w[1])), int(wp.floor(w[3])) + 1):
        for column in range(int(wp.floor(w[0])), int(wp.floor(w[2])) + 1):
            lit += int(compare_texel(light_map, receiver, column, row))
            compared += 1
    texels_out[i] = wp.vec2i(lit, compared)
    lit = int(0)
    for j in range(taps.shape[0]):
        x = w[0] + taps[j][0] * (w[2] - w[0]) - receiver.x
        y = w[1] + taps[j][1] * (w[3] - w[1]) - receiver.y
        at = tap_position(light_map, receiver, wp.vec2(x, y), BORDER)
        depth = tap_depth(receiver, at[0] - receiver.x, at[1] - receiver.y)
        if depth <= depth_at(light_map, receiver.layer, at):
            lit += 1
    taps_out[i] = wp.vec2i(lit, taps.shape[0])


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("case", MAPS)
def test_windows_are_judged_as_all_their_comparisons(case: str, bias: str, device: str) -> None:
    light, projection = MAPS[case]
    running = session(light, device, **projection)
    light_map = running.light_map(50)
    pyramid = pull_pyramid(running, light_map)
    count, rng = 20000, np.random.default_rng(8)
    box = running.geometry.bounds(receivers=True)
    points = rng.uniform(box.low - 0.5, box.high + 0.5, (count, 3))
    normals = rng.normal(size=(count, 3))
    normals[: count // 2] = [0.0, 1.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    half = rng.uniform(0.0, 1.0, (count, 2)) ** 2 * 12.0
    middle = np.where(rng.random((count, 1)) < 0.5, 0.0, rng.uniform(-20.0, 20.0, (count, 2)))
    window = np.hstack([middle - half, middle + half]).astype(np.float32)
    inputs = [light_map.map, pyramid, make_bias(BIASES[bias]), upload(points, device), upload(normals, device)]
    inputs += [wp.array(window, dtype=wp.vec4, device=device), upload(rng.random((40, 2)), device)]
    decided = []
    for reads in (2, 5):
        out = [wp.zeros(count, dtype=kind, device=device) for kind in (int, wp.vec2i, wp.vec2i)]
        launch(judge_all, count, [*inputs, reads], out, device=device)
        judged, texels, taps = (image.numpy() for image in out)
        assert (judged >= 0).mean() > 0.3
        lit, dark = judged == ALL_LIT, judged == ALL_DARK
        for found, compared in (texels.T, taps.T):
            np.testing.assert_array_equal(found[lit], compared[lit])
            assert (found[dark] == 0).all()
        all_lit = (judged >= 0) & (texels[:, 0] == texels[:, 1])
        assert lit.sum() > 200 and dark.sum() > 100
        decided.append(lit.sum() / all_lit.sum())
    assert decided[1] >= decided[0] and decided[1] > 0.5


@wp.kernel
def judge_pixels(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    pyramid: DepthPyramid,
    window: wp.array2d(dtype=wp.vec4),
    reads: int,
    judged_out: wp.array2d(dtype=int),
):
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    judged_out[y, x] = UNDECIDED
    if receiver.layer >= 0:
        w = window[y, x] + wp.vec4(receiver.x, receiver.y, receiver.x, receiver.y)
        judged_out[y, x] = judge_window(light_map, pyramid, receiver, w[0], w[1], w[2], w[3], reads)


@wp.kernel
def judge_pixels_lanes(
    first: int,
    views: LaneViews,
    light_map: LightMap,
    bias: Bias,
    pyramid: LanePyramid,
    window: wp.array2d(dtype=wp.vec4),
    reads: int,
    judged_out: wp.array2d(dtype=int),
):
    row, run = wp.tid()
    y = first + row
    receivers = locate_run(views, light_map, bias, run * LANES, y)
    windows = WindowRun()
    own = wp.min(LANES, judged_out.shape[1] - run * LANES)
    for k in range(own):
        w = window[y, run * LANES + k]
        windows.x0[k] = receivers.x[k] + w[0]
        windows.y0[k] = receivers.y[k] + w[1]
        windows.x1[k] = receivers.x[k] + w[2]
        windows.y1[k] = receivers.y[k] + w[3]
    judged = judge_windows_run(views, light_map, pyramid, receivers, windows, reads)
    for k in range(own):
        judged_out[y, run * LANES + k] = judged[k]


@pytest.mark.parametrize("size", [0.0, 3.0, 30.0])
@pytest.mark.parametrize("case", MAPS)
def test_lanes_judge_as_the_plain_function(case: str, size: float) -> None:
    light, projection = MAPS[case]
    running = session(light, "cpu", **projection)
    gbuffer, light_map = running.gbuffer(), running.light_map(64)
    pyramid, (height, width) = pull_pyramid(running, light_map), gbuffer.depth.shape
    rng = np.random.default_rng(6)
    middle, half = rng.uniform(-size, size, (height, width, 2)), rng.uniform(0.0, 0.5 * size, (height, width, 2))
    window = wp.array(np.concatenate([middle - half, middle + half], axis=2), dtype=wp.vec4, device="cpu")
    seen = set()
    for bias in (BIAS_NONE, BIAS_SLOPE):
        for reads in (2, 5):
            plain, lanes = (wp.zeros((height, width), dtype=int, device="cpu") for _ in range(2))
            common = [light_map.map, make_bias(bias)]
            launch(judge_pixels, (height, width), [gbuffer, *common, pyramid, window, reads], [plain])
            inputs = [lane_views(gbuffer, light_map.map), *common, lane_pyramid(pyramid), window, reads]
            launch(judge_pixels_lanes, (height, runs_per_row(width)), inputs, [lanes])
            assert (lanes.numpy() != plain.numpy()).mean() <= 1e-3  # where rounding decides
            seen |= set(np.unique(plain.numpy()))
    assert seen >= {UNDECIDED, ALL_DARK} and (size < 3.0 or ALL_LIT in seen)
