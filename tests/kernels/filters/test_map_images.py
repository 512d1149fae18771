"""Images in the layout of a map, of every texel type in every storage, against NumPy on each layer alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from map_cases import LAYOUTS, MAPS, on_host, random_image, session

from wkernels.device import twin
from wkernels.device.lanes import LANES, flat_floats
from wkernels.device.launch import launch
from wkernels.filters.blur import box_weights, gaussian_weights
from wkernels.filters.levels import MapLevels, sides_of
from wkernels.filters.map_images import (
    MapImage,
    blur_image,
    fill_image,
    new_image,
    pull_blurred,
    pull_sums,
    sample_bilinear,
    sample_component_run,
    sum_image,
    texels_round_run,
)
from wkernels.filters.mips import find_mips, level_of_width, pull_mips, sample_trilinear
from wkernels.filters.moments import FIND_MOMENTS
from wkernels.filters.summed_area import box_mean
from wkernels.filters.texels import DOUBLE, components
from wkernels.light_maps.light_map import LightMap, depths_on_host
from wkernels.light_maps.receiver_lanes import ReceiverRun
from wkernels.workspace.workspace import Workspace

every_texel = pytest.mark.parametrize("texel", list(DOUBLE), ids=["float", "vec2", "vec4", "vec8"])
every_layout = pytest.mark.parametrize("case", LAYOUTS)


def map_like(image: MapImage) -> LightMap:
    """A map with the layout of an image."""
    out = LightMap()
    out.layer_begin = wp.array(image.layout.begin, dtype=int, device=image.texels.device)
    out.pitch, out.resolution, out.layers = image.layout.pitch, image.layout.resolution, len(image.layout.begin)
    return out


# ---- filling --------------------------------------------------------------------------------------------------------


@wp.kernel
def spread_depth(first: int, depth: wp.array2d(dtype=float), scale: float, image_out: wp.array2d(dtype=Any)):
    row, x = wp.tid()
    y = first + row
    texel = image_out.dtype(wp.abs(depth[y, x]) * scale)
    image_out[y, x] = texel * float(x + 1)


@every_texel
@pytest.mark.parametrize("storage", ["separate", "array", "cube6", "atlas4", "atlas9", "atlas16"])
def test_filling_reaches_every_texel_of_every_layer_and_no_other(storage: str, texel: type, device: str) -> None:
    light, projection = MAPS["six faces" if storage == "cube6" else "splits"]
    running = session(light, device, **{**projection, "storage": storage})
    light_map = running.light_map(20)
    image = new_image(running, light_map.layout, texel, None, light_map.slot)
    image.texels.fill_(np.nan)
    fill_image(running, spread_depth, light_map, [0.5], image)
    depth = np.abs(depths_on_host(light_map.map))
    expected = np.broadcast_to(
        (depth * np.float32(0.5) * np.arange(1, 21))[..., None], (*depth.shape, components(texel))
    )
    np.testing.assert_array_equal(on_host(image), expected.astype(np.float32))
    beside = image.texels.size - depth.size
    assert np.isnan(image.texels.numpy()).sum() == beside * components(texel)


@pytest.mark.parametrize("resolution", [7, 16, 20, 64])
@pytest.mark.parametrize("case", MAPS)
def test_lanes_fill_what_the_plain_kernel_fills(
    case: str, resolution: int, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    light, projection = MAPS[case]
    running, found = session(light, device, **projection), []
    light_map = running.light_map(resolution)
    for lanes in (False, True):
        monkeypatch.setattr(twin, "uses_lanes", lambda device, lanes=lanes: lanes)
        image = new_image(running, light_map.layout, wp.vec2, None)
        fill_image(running, FIND_MOMENTS, light_map, [wp.vec2(1.0, 0.1), 0], image)
        found.append(on_host(image))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
    depth = np.minimum((depths_on_host(light_map.map).astype(float) - 1.0) * 0.1, 1.0) - 0.5
    np.testing.assert_allclose(found[0], np.stack([depth, depth * depth], axis=-1), atol=1e-5)


def test_memory_is_taken_over_where_it_fits(device: str) -> None:
    work, (image, _) = Workspace(device), random_image("atlas4 x 4, 24", wp.vec4, device)
    again = new_image(work, image.layout, wp.vec4, image, "slot")
    assert again.texels is image.texels and again is not image and again.slot == "slot"
    other, _ = random_image("array x 2, 37", wp.vec4, device)
    for layout, texel in ((other.layout, wp.vec4), (image.layout, wp.vec2), (image.layout, float)):
        fresh = new_image(work, layout, texel, image)
        assert fresh.texel is texel and fresh.texels.size == layout.texels and fresh.texels.ptr != image.texels.ptr
    blurred, table, mips = (blur_image(work, image, box_weights(1)), sum_image(work, image), find_mips(work, image))
    assert blur_image(work, image, box_weights(1), blurred).texels is blurred.texels
    assert sum_image(work, image, table) is table
    assert find_mips(work, image, mips).texels is mips.texels
    assert sum_image(work, other, table) is not table


def test_products_follow_the_image(device: str) -> None:
    work, (image, _) = Workspace(device), random_image("atlas4 x 3, 7", wp.vec2, device)
    pulls = [
        lambda of: pull_blurred(work, "blur", of, gaussian_weights(2)),
        lambda of: pull_sums(work, "sums", of),
        lambda of: pull_mips(work, "mips", of),
    ]
    for pull in pulls:
        held = pull(image)
        assert pull(image) is held
    image.texels.zero_()
    filled_anew = MapImage(texels=image.texels, layout=image.layout)
    blurred, sums, mips = (pull(filled_anew) for pull in pulls)
    assert not on_host(blurred).any() and not sums.numpy().any() and not mips.texels.numpy().any()
    assert pull_blurred(work, "blur", filled_anew, gaussian_weights(1)) is not blurred


# ---- filters --------------------------------------------------------------------------------------------------------


def direct_blur(layer: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The whole two-dimensional kernel at once, on a layer (R, R, n) padded with its border."""
    side, radius = len(layer), len(weights) // 2
    padded = np.pad(layer.astype(float), ((radius, radius), (radius, radius), (0, 0)), mode="edge")
    return sum(
        weights[i] * weights[j] * padded[i : i + side, j : j + side] for i, j in np.ndindex(len(weights), len(weights))
    )


@every_texel
@every_layout
def test_blur_ends_at_the_border_of_a_layer(
    case: str, texel: type, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, (image, host) = Workspace(device, threads=2), random_image(case, texel, device)
    for weights in (box_weights(1), gaussian_weights(6)):
        found = on_host(blur_image(work, image, weights))
        np.testing.assert_allclose(found, [direct_blur(layer, weights) for layer in host], atol=2e-6)
        with monkeypatch.context() as patch:
            patch.setattr(twin, "uses_lanes", lambda device: False)
            np.testing.assert_allclose(on_host(blur_image(work, image, weights)), found, atol=1e-6)
    np.testing.assert_array_equal(on_host(image), host)


@wp.kernel
def ask_box_means(
    first: int,
    tables: wp.array3d(dtype=Any),
    layer: wp.array(dtype=int),
    boxes: wp.array(dtype=wp.vec4),
    mean_out: wp.array(dtype=Any),
):
    i = first + wp.tid()
    box = boxes[i]
    mean_out[i] = box_mean(tables[layer[i]], box[0], box[1], box[2], box[3])


@every_texel
@every_layout
def test_box_means_of_every_layer(case: str, texel: type, device: str) -> None:
    work, (image, host) = Workspace(device, threads=2), random_image(case, texel, device)
    tables = sum_image(work, image)
    sums = host.astype(float).cumsum(axis=2).cumsum(axis=1)
    found = tables.numpy().reshape(len(host), image.layout.resolution + 1, image.layout.resolution + 1, -1)
    np.testing.assert_array_equal(found[:, 1:, 1:], sums)
    assert not found[:, 0].any() and not found[:, :, 0].any()
    rng, side = np.random.default_rng(1), image.layout.resolution
    corners = np.sort(rng.integers(0, side + 1, (200, 2, 2)), axis=1)
    corners[:, 1] = np.maximum(corners[:, 1], corners[:, 0] + 1)
    corners = np.where(corners[:, 1:] > side, corners - 1, corners)
    layer = rng.integers(0, len(host), 200)
    boxes, out = corners.reshape(-1, 4).astype(np.float32), wp.zeros(200, dtype=texel, device=device)
    inputs = [tables, wp.array(layer, dtype=int, device=device), wp.array(boxes, dtype=wp.vec4, device=device)]
    launch(ask_box_means, 200, inputs, [out], device=device)
    expected = [host[l, y0:y1, x0:x1].mean(axis=(0, 1), dtype=float) for l, (x0, y0, x1, y1) in
                zip(layer, corners.reshape(-1, 4), strict=True)]  # fmt: skip
    np.testing.assert_allclose(out.numpy().reshape(200, -1), expected, atol=1e-6)


# ---- mips -----------------------------------------------------------------------------------------------------------


@every_texel
@every_layout
@pytest.mark.parametrize("lanes", [False, True], ids=["plain", "lanes"])
def test_mips_are_the_means_of_their_squares(
    case: str, texel: type, lanes: bool, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(twin, "uses_lanes", lambda device: lanes)
    image, host = random_image(case, texel, device)
    mips = find_mips(Workspace(device, threads=3), image)
    texels, begin = mips.texels.numpy().reshape(mips.texels.size, -1), 0
    sides = sides_of(mips.levels)
    assert sides[0] == image.layout.resolution and sides[-1] == 1 and len(sides) == mips.levels.levels
    for level, side in enumerate(sides[1:], 1):
        found = texels[begin : begin + len(host) * side * side].reshape(len(host), side, side, -1)
        for row, column in np.ndindex(side, side):
            rows, columns = (slice(i << level, (i + 1) << level) for i in (row, column))
            square = host[:, rows, columns].mean(axis=(1, 2), dtype=float)
            np.testing.assert_allclose(found[:, row, column], square, atol=1e-6)
        begin += len(host) * side * side
    assert begin == mips.levels.texels


# ---- lookups --------------------------------------------------------------------------------------------------------


def host_bilinear(layers: np.ndarray, layer: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Of layers (L, R, R, n) at positions (N, 2) in texels, float64."""
    last = layers.shape[1] - 1
    corner = np.floor(at - 0.5).astype(int)
    f = (at - 0.5 - corner)[..., None]
    (x0, y0), (x1, y1) = np.clip(corner, 0, last).T, np.clip(corner + 1, 0, last).T
    upper = layers[layer, y0, x0] * (1 - f[:, 0]) + layers[layer, y0, x1] * f[:, 0]
    lower = layers[layer, y1, x0] * (1 - f[:, 0]) + layers[layer, y1, x1] * f[:, 0]
    return upper * (1 - f[:, 1]) + lower * f[:, 1]


@wp.kernel
def ask_lookups(
    first: int,
    light_map: LightMap,
    image: wp.array(dtype=Any),
    mips: wp.array(dtype=Any),
    levels: MapLevels,
    layer: wp.array(dtype=int),
    at: wp.array(dtype=wp.vec2),
    level: wp.array(dtype=float),
    bilinear_out: wp.array(dtype=Any),
    trilinear_out: wp.array(dtype=Any),
):
    i = first + wp.tid()
    bilinear_out[i] = sample_bilinear(image, light_map, layer[i], at[i][0], at[i][1])
    trilinear_out[i] = sample_trilinear(image, mips, levels, layer[i], at[i][0], at[i][1], level[i])


@wp.kernel
def ask_component_runs(
    first: int,
    light_map: LightMap,
    image: wp.array(dtype=float),
    components: int,
    layer: wp.array2d(dtype=int),
    at: wp.array2d(dtype=wp.vec2),
    component_out: wp.array3d(dtype=float),
):
    """A run of lookups a cell, one component at a time."""
    run = first + wp.tid()
    receivers = ReceiverRun()
    for k in range(LANES):
        receivers.layer[k] = layer[run, k]
        receivers.x[k] = at[run, k][0]
        receivers.y[k] = at[run, k][1]
    around = texels_round_run(light_map, receivers)
    for component in range(components):
        values = sample_component_run(image, components, component, around)
        for k in range(LANES):
            component_out[run, k, component] = values[k]


@every_texel
@every_layout
def test_lookups_between_texels_and_levels(case: str, texel: type, device: str) -> None:
    image, host = random_image(case, texel, device)
    mips, light_map, count = find_mips(Workspace(device), image), map_like(image), 32 * int(LANES)
    rng, side = np.random.default_rng(4), image.layout.resolution
    at = rng.uniform(-2.0, side + 2.0, (count, 2)).astype(np.float32)
    layer = rng.integers(0, len(host), count)
    level = rng.uniform(-0.5, mips.levels.levels + 0.5, count).astype(np.float32)
    level[:40] = np.round(level[:40])
    places = [wp.array(layer, dtype=int, device=device), wp.array(at, dtype=wp.vec2, device=device)]
    inputs = [light_map, image.texels, mips.texels, mips.levels, *places, wp.array(level, dtype=float, device=device)]
    out = [wp.zeros(count, dtype=texel, device=device) for _ in range(2)]
    launch(ask_lookups, count, inputs, out, device=device, threads=2)
    bilinear, trilinear = (values.numpy().reshape(count, -1) for values in out)
    np.testing.assert_allclose(bilinear, host_bilinear(host.astype(float), layer, at.astype(float)), atol=4e-6)
    of_levels, begin, means = [host.astype(float)], 0, mips.texels.numpy().reshape(mips.texels.size, -1)
    for size in sides_of(mips.levels)[1:]:
        end = begin + len(host) * size * size
        of_levels.append(means[begin:end].reshape(len(host), size, size, -1).astype(float))
        begin = end
    for i in range(count):
        clamped = np.clip(level[i], 0.0, len(of_levels) - 1)
        fine, coarse = int(np.floor(clamped)), int(np.ceil(clamped))
        a, b = (
            host_bilinear(of_levels[l], layer[i : i + 1], at[i : i + 1].astype(float) / 2**l) for l in (fine, coarse)
        )
        np.testing.assert_allclose(trilinear[i], (a + (b - a) * (clamped - fine))[0], atol=4e-6)
    n, runs = components(texel), count // int(LANES)
    found = wp.zeros((runs, int(LANES), n), dtype=float, device=device)
    inputs = [light_map, flat_floats(image.texels), n, *(place.reshape((runs, int(LANES))) for place in places)]
    launch(ask_component_runs, runs, inputs, [found], device=device)
    np.testing.assert_allclose(found.numpy().reshape(count, n), bilinear, atol=1e-6)


@wp.kernel
def ask_levels(first: int, width: wp.array(dtype=float), level_out: wp.array(dtype=float)):
    i = first + wp.tid()
    level_out[i] = level_of_width(width[i])


def test_the_level_of_a_width_has_texels_as_wide(device: str) -> None:
    width = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 64.0], np.float32)
    out = wp.zeros(len(width), dtype=float, device=device)
    launch(ask_levels, len(width), [wp.array(width, dtype=float, device=device)], [out], device=device)
    np.testing.assert_allclose(out.numpy(), np.log2(np.maximum(width, 1.0)), atol=1e-6)
