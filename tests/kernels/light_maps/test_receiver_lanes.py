"""Receivers of a run of pixels, field by field, against those of each pixel; and the memory that runs show."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from twin_runs import BIASES, LIGHTS, SPLITS, session

from algorithms.plugins import find
from algorithms.projections.composition import compose
from algorithms.technique import MapParams
from wkernels.device.lanes import LANES, Floats, Ints, Vectors, flat_floats, runs_of, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import Bias, LightMap, locate_receiver, texels_per_length
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES

pytestmark = pytest.mark.usefixtures("on_cpu")


@pytest.fixture
def on_cpu(device: str) -> None:
    if not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")


@wp.kernel
def locate_plain(first: int, gbuffer: GBuffer, light_map: LightMap, bias: Bias, out: wp.array3d(dtype=float)):
    row, x = wp.tid()
    y = first + row
    out[0, y, x] = 1.0
    out[1, y, x] = -1.0
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        at = gbuffer.position_ws[y, x]
        if is_back_lit(gbuffer, y, x, to_light(light_map.light_ws, at)):
            out[0, y, x] = 0.0
        else:
            receiver = locate_receiver(light_map, bias, at, gbuffer.normal_ws[y, x])
            out[1, y, x] = float(receiver.layer)
            if receiver.layer >= 0:
                density = texels_per_length(light_map, receiver.layer, at)
                out[2, y, x] = receiver.x
                out[3, y, x] = receiver.y
                out[4, y, x] = receiver.depth
                out[5, y, x] = receiver.bias
                out[6, y, x] = receiver.plane_depth[0]
                out[7, y, x] = receiver.plane_depth[1]
                out[8, y, x] = receiver.plane_depth[2]
                out[9, y, x] = receiver.plane_scale[0]
                out[10, y, x] = receiver.plane_scale[1]
                out[11, y, x] = density[0]
                out[12, y, x] = density[1]


@wp.kernel
def locate_lanes(first: int, views: LaneViews, light_map: LightMap, bias: Bias, out: wp.array3d(dtype=float)):
    row, column = wp.tid()
    y = first + row
    x0 = column * LANES
    run = locate_run(views, light_map, bias, x0, y)
    found = int(0)
    for k in range(wp.min(LANES, out.shape[2] - x0)):
        x = x0 + k
        out[0, y, x] = run.visible[k]
        out[1, y, x] = float(run.layer[k])
        out[2, y, x] = run.x[k]
        out[3, y, x] = run.y[k]
        out[4, y, x] = run.depth[k]
        out[5, y, x] = run.bias[k]
        out[6, y, x] = run.rise_x[k]
        out[7, y, x] = run.rise_y[k]
        out[8, y, x] = run.rise[k]
        out[9, y, x] = run.scale_x[k]
        out[10, y, x] = run.scale_y[k]
        out[11, y, x] = run.density_x[k]
        out[12, y, x] = run.density_y[k]
        found += wp.where(run.layer[k] >= 0, 1, 0)
    out[13, y, x0] = float(wp.where(found > run.count, 1, 0))  # an early out would lose receivers


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("lamp", LIGHTS)
def test_receivers_of_a_run_are_those_of_its_pixels(lamp: str, bias: str) -> None:
    receivers_agree(session(small.cluttered(LIGHTS[lamp])), bias, 3 if lamp == "six faces" else 1)


@pytest.mark.parametrize("bias", ["slope", "normal"])
@pytest.mark.parametrize("lamp", ["perspective", "orthographic"])
@pytest.mark.parametrize("split", SPLITS)
def test_receivers_of_a_run_read_the_splits_that_its_pixels_do(split: str, lamp: str, bias: str) -> None:
    receivers_agree(session(small.cluttered(LIGHTS[lamp]), projection=compose(SPLITS[split])), bias, 2)


def test_receivers_that_no_split_holds_with_room_read_the_last_that_holds_them() -> None:
    """Views whose splits end before what they hold does: the reserve, or nothing."""
    views = compose(SPLITS["depth"])

    def ended(*arguments: Any) -> list[Any]:
        made = views(*arguments)
        assert len(made) > 2
        return [replace(view, choice=replace(view.choice, far=0.6 * view.choice.far)) for view in made[:-1]]  # type: ignore[attr-defined]

    receivers_agree(session(small.cluttered(LIGHTS["orthographic"]), projection=ended), "slope", 2)


def receivers_agree(running: Session, bias: str, layers: int) -> None:
    """``locate_run`` against ``locate_receiver`` of each pixel, on at least so many layers."""
    gbuffer = running.gbuffer()
    params = MapParams(resolution=256, bias=bias)
    light_map = running.light_map(256, cull=params.cull).map
    height, width = gbuffer.depth.shape
    plain, lanes = (wp.zeros((14, height, width), dtype=float, device="cpu") for _ in range(2))
    launch(locate_plain, (height, width), [gbuffer, light_map, params.device_bias], [plain])
    views = lane_views(gbuffer, light_map)
    launch(locate_lanes, (height, runs_per_row(width)), [views, light_map, params.device_bias], [lanes])
    expected, found = plain.numpy(), lanes.numpy()
    here = expected[1] >= 0
    assert here.sum() > 500 and (expected[0] == 0.0).sum() > 20
    assert len(np.unique(expected[1][here])) >= layers
    np.testing.assert_array_equal(found[:2], expected[:2])
    assert not found[13].any()
    # relative to each field's own size: rows of a plane seen at a grazing angle lose digits to cancellation
    size = np.maximum(np.abs(expected[2:13]), np.median(np.abs(expected[2:13][:, here]), axis=1)[:, None, None])
    worse = np.abs(found - expected)[2:13] > 1e-4 * size
    assert worse[:, here].mean() < 1e-3, worse[:, here].mean(axis=1)


@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map"])
def test_lanes_do_not_depend_on_threads(name: str) -> None:
    plugin = find(name)
    images = [
        session(small.cluttered(LIGHTS["perspective"]), threads=threads).render(plugin(plugin.Params())).visibility
        for threads in (1, 2, 3)
    ]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_runs_are_the_memory_they_show() -> None:
    values = wp.array(np.arange(200, dtype=np.float32), dtype=float, device="cpu")
    runs = runs_of(values, Floats).numpy()
    assert runs.shape == (200 - int(LANES) + 1, int(LANES))
    np.testing.assert_array_equal(runs[37], np.arange(37, 37 + int(LANES)))
    points = wp.array(np.arange(300, dtype=np.float32).reshape(100, 3), dtype=wp.vec3, device="cpu")
    np.testing.assert_array_equal(runs_of(points, Vectors).numpy()[6], np.arange(6, 6 + 3 * int(LANES)))
    np.testing.assert_array_equal(flat_floats(points).numpy(), np.arange(300))
    assert runs_of(wp.zeros(5, dtype=int, device="cpu"), Ints).shape == (0,)
