"""Maps of many points of a light in one array against each of them alone, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from light_map_probe import make_bias
from map_cases import INSIDE, MAPS, session

from wkernels.device.lanes import LANES, flat_floats, runs_per_row
from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.light_maps import many_maps
from wkernels.light_maps.comparison_lanes import compare_nearest_run
from wkernels.light_maps.drawing import CasterBlocks, Drawing, draw_light_map
from wkernels.light_maps.light_map import (
    BIAS_CONSTANT,
    BIAS_NORMAL,
    BIAS_SLOPE,
    Bias,
    LightMap,
    compare_bilinear,
    compare_nearest,
    depths_on_host,
)
from wkernels.light_maps.many_maps import LightMaps, draw_light_maps, map_of
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.light_maps.receivers import receiver_of_pixel
from wkernels.light_maps.storage import PLACES, MapOptions
from wkernels.raster import CULL_NONE
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.views import HostView

SAMPLES = 5


def looks_of(running: Session, resolution: int) -> tuple[list[tuple[HostView, ...]], np.ndarray]:
    """Views and samples of several points of the frame's light."""
    samples = running.light_samples(SAMPLES).host
    looks = [running.light_map(resolution, sample, slot=i) for i, sample in enumerate(samples)]
    return [look.views for look in looks], samples


def drawing_of(running: Session, storage: str, drawing: str = "passes") -> Drawing:
    return Drawing(
        geometry=running.geometry,
        rasteriser=running.rasteriser,
        cull=CULL_NONE,
        options=MapOptions(storage=storage, drawing=drawing),
        blocks=CasterBlocks(running.geometry, running.device, running.threads),
    )


@wp.kernel
def sum_single(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    bias: Bias,
    nearest_out: wp.array2d(dtype=float),
    bilinear_out: wp.array2d(dtype=float),
):
    row, x = wp.tid()
    y = first + row
    receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
    nearest = receiver.visible
    bilinear = receiver.visible
    if receiver.layer >= 0:
        nearest = compare_nearest(light_map, receiver)
        bilinear = compare_bilinear(light_map, receiver, 0.3, -0.2)
    nearest_out[y, x] += nearest
    bilinear_out[y, x] += bilinear


@wp.kernel
def sum_many(
    first: int,
    gbuffer: GBuffer,
    maps: LightMaps,
    bias: Bias,
    nearest_out: wp.array2d(dtype=float),
    bilinear_out: wp.array2d(dtype=float),
):
    """``sum_single`` over all maps at once."""
    row, x = wp.tid()
    y = first + row
    nearest = float(0.0)
    bilinear = float(0.0)
    for i in range(maps.maps):
        light_map = map_of(maps, i)
        receiver = receiver_of_pixel(gbuffer, light_map, bias, y, x)
        if receiver.layer >= 0:
            nearest += compare_nearest(light_map, receiver)
            bilinear += compare_bilinear(light_map, receiver, 0.3, -0.2)
        else:
            nearest += receiver.visible
            bilinear += receiver.visible
    nearest_out[y, x] = nearest
    bilinear_out[y, x] = bilinear


@wp.kernel
def sum_many_lanes(first: int, views: LaneViews, maps: LightMaps, bias: Bias, nearest_out: wp.array2d(dtype=float)):
    row, run = wp.tid()
    y = first + row
    for i in range(maps.maps):
        light_map = map_of(maps, i)
        receivers = locate_run(views, light_map, bias, run * LANES, y)
        visible = compare_nearest_run(views, light_map, receivers)
        for k in range(wp.min(LANES, nearest_out.shape[1] - run * LANES)):
            nearest_out[y, run * LANES + k] += visible[k]


def depths_of(maps: LightMaps, i: int) -> np.ndarray:
    """The layers of one map, (layers, R, R)."""
    begin, rows = maps.layer_begin.numpy()[i, : maps.layers.numpy()[i]], np.arange(maps.resolution)
    assert (begin >= i * maps.stride).all() and (begin < (i + 1) * maps.stride).all()
    return maps.depth.numpy()[begin[:, None, None] + rows[:, None] * maps.pitch + rows]


def assert_as_alone(maps: LightMaps, singles: list[LightMap], gbuffer: GBuffer, bias: Bias, device: str) -> None:
    """Depths, and what kernels make of them."""
    for i, single in enumerate(singles):
        np.testing.assert_array_equal(depths_of(maps, i), depths_on_host(single))
    shape = gbuffer.depth.shape
    alone = [wp.zeros(shape, dtype=float, device=device) for _ in range(2)]
    for single in singles:
        launch(sum_single, shape, [gbuffer, single, bias], alone, device=device)
    together = [wp.zeros(shape, dtype=float, device=device) for _ in range(2)]
    launch(sum_many, shape, [gbuffer, maps, bias], together, device=device, threads=2)
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(b.numpy(), a.numpy())
        assert len(np.unique(a.numpy())) > 2
    if device == "cpu":
        views, lanes = lane_views(gbuffer), wp.zeros(shape, dtype=float, device=device)
        views.depth = flat_floats(maps.depth)
        launch(sum_many_lanes, (shape[0], runs_per_row(shape[1])), [views, maps, bias], [lanes])
        assert (lanes.numpy() != alone[0].numpy()).mean() <= 1e-3


@pytest.mark.parametrize("storage", PLACES)
@pytest.mark.parametrize("case", MAPS)
def test_many_maps_are_those_of_each_point_alone(case: str, storage: str, device: str) -> None:
    light, projection = MAPS[case]
    if case == "directional" or "sun" in case:
        light = small.light("directional", size=3.0)
    running = session(light, device, **projection)
    views, samples = looks_of(running, 48)
    drawing = drawing_of(running, storage)
    maps, _ = draw_light_maps(drawing, views, samples)
    assert maps.maps == SAMPLES and maps.stride % 1024 == 0 and maps.depth.size == SAMPLES * maps.stride
    assert len(np.unique(samples, axis=0)) == SAMPLES
    np.testing.assert_array_equal(maps.light_ws.numpy(), samples.astype(np.float32))
    singles = [draw_light_map(drawing, own, sample)[0] for own, sample in zip(views, samples, strict=True)]
    for kind in (BIAS_SLOPE, BIAS_NORMAL, BIAS_CONSTANT):
        assert_as_alone(maps, singles, running.gbuffer(), make_bias(kind), device)


@pytest.mark.parametrize("how", ["cloned", "instanced"])
def test_many_maps_drawn_at_once(how: str, device: str) -> None:
    light, projection = MAPS["splits"]
    running = session(light, device, **projection)
    views, samples = looks_of(running, 40)
    maps, beside = draw_light_maps(drawing_of(running, "atlas4", how), views, samples)
    plain, _ = draw_light_maps(drawing_of(running, "atlas4"), views, samples)
    for i in range(SAMPLES):
        np.testing.assert_array_equal(depths_of(maps, i), depths_of(plain, i))
    single = [
        draw_light_map(drawing_of(running, "atlas4", how), own, s)[1] for own, s in zip(views, samples, strict=True)
    ]
    assert beside == sum(single)


def test_maps_with_another_number_of_layers_each(device: str) -> None:
    """A light whose points lie inside and outside of the scene: six faces for some, one view for others."""
    running = session(INSIDE, device)
    six = running.light_map(40)
    outside = session(MAPS["perspective"][0], device).light_map(40)
    views = [six.views, outside.views, six.views[:2], outside.views]
    samples = np.stack([six.light_ws, outside.light_ws, six.light_ws, outside.light_ws])
    drawing = drawing_of(running, "cube6")
    maps, _ = draw_light_maps(drawing, views, samples)
    np.testing.assert_array_equal(maps.layers.numpy(), [6, 1, 2, 1])
    singles = [draw_light_map(drawing, own, sample)[0] for own, sample in zip(views, samples, strict=True)]
    assert_as_alone(maps, singles, running.gbuffer(), make_bias(BIAS_SLOPE), device)


def test_memory_is_taken_over_and_maps_without_casters_are_cleared(device: str) -> None:
    running = session(MAPS["perspective"][0], device)
    views, samples = looks_of(running, 32)
    drawing = drawing_of(running, "separate")
    maps, _ = draw_light_maps(drawing, views, samples)
    before = maps.depth.numpy().copy()
    again, _ = draw_light_maps(drawing, views, samples, maps, [True, False, True, True, True])
    assert again.depth.ptr == maps.depth.ptr
    found, texels = again.depth.numpy().reshape(SAMPLES, -1)[:, : 32 * 32], before.reshape(SAMPLES, -1)[:, : 32 * 32]
    assert np.isposinf(found[1]).all() and np.isfinite(texels[1]).any()
    np.testing.assert_array_equal(found[[0, 2, 3, 4]], texels[[0, 2, 3, 4]])
    other, _ = draw_light_maps(drawing, views[:3], samples[:3], maps)
    assert other.depth.ptr != maps.depth.ptr and other.maps == 3


def test_too_many_texels_are_refused(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    running = session(MAPS["perspective"][0], device)
    views, samples = looks_of(running, 32)
    monkeypatch.setattr(many_maps, "MOST_TEXELS", 5000)
    with pytest.raises(InputError, match="5 maps of 1024 texels are more than one array holds"):
        draw_light_maps(drawing_of(running, "separate"), views, samples)


def test_a_frame_gives_many_maps_and_keeps_them_while_nothing_moves() -> None:
    """The bits of single pulls; kept for the next frame, drawn anew with other samples, and told."""
    running = session(INSIDE, "cpu")
    samples = running.light_samples(SAMPLES).host
    singles = [depths_on_host(running.light_map(32, sample, slot=i).map) for i, sample in enumerate(samples)]
    maps = running.light_maps(32, samples)
    assert maps.maps == SAMPLES
    begin = maps.layer_begin.numpy()
    depth = maps.depth.numpy()
    for i, single in enumerate(singles):
        for layer, expected in enumerate(single):
            found = depth[begin[i, layer] : begin[i, layer] + 32 * 32].reshape(32, 32)
            np.testing.assert_array_equal(found, expected)
    assert running.light_maps(32, samples) is maps
    assert running.light_maps(32, samples[:3], slot="others").maps == 3
    assert running.light_maps(32, samples[::-1].copy()) is not maps
