"""Lane kernels against their plain twins: receivers field by field, and the techniques' images."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from algorithms.plugins import find
from algorithms.projections.composition import compose
from algorithms.technique import MapParams
from experiments.scenes.loader import load_scene
from wkernels.device.lanes import LANES, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.filters import neighbourhood_filter
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import Bias, LightMap, locate_receiver, texels_per_length
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views, locate_run
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES, Geometry
from wkernels.scene.lights import Light, SphereLight
from wkernels.scene.model import Scene
from wkernels.temporal.shadow_buffer import step as shadow_buffer_step
from wkernels.temporal.shadow_buffer.record import mover_shadow

pytestmark = pytest.mark.usefixtures("on_cpu")
BIASES = ("none", "constant", "slope", "back_face", "slope_back_face", "normal")
LIGHTS: dict[str, Light] = {
    "perspective": small.light("rectangle"),
    "orthographic": small.light("directional"),
    "six faces": SphereLight(center=np.array([0.2, 3.2, 1.5]), radius=0.2),
}
WIDTHS = (1, 15, 16, 17, 63, 100)


@pytest.fixture
def on_cpu(device: str) -> None:
    if not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")


def session(scene: Scene, width: int = 100, height: int = 60, **options: Any) -> Session:
    return Session(Geometry(scene, "cpu"), width=width, height=height, **options)


def twins(
    scene: Scene,
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    width: int = 100,
    height: int = 60,
    projection: dict[str, Any] | None = None,
    **params: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """The technique's image by its plain kernel and by its lane kernel."""
    plugin = find(name)
    module = sys.modules[plugin.__module__]
    launched: list[str] = []
    images = []
    for lanes in (False, True):
        running = session(scene, width, height, projection=compose(projection) if projection else None)
        monkeypatch.setattr(module, "uses_lanes", lambda device, lanes=lanes: lanes)
        real = running.launch
        monkeypatch.setattr(
            running, "launch", lambda kernel, *rest, real=real: launched.append(kernel.key) or real(kernel, *rest)
        )
        images.append(running.render(plugin(plugin.Params(**params))).visibility)
    assert any(key.endswith("_lanes") for key in launched) and any(key + "_lanes" in launched for key in launched)
    return images[0], images[1]


def assert_same(plain: np.ndarray, lanes: np.ndarray) -> None:
    """Equal but for comparisons that are a tie: the compiler may fuse other multiplications with additions."""
    np.testing.assert_array_equal(np.isnan(plain), np.isnan(lanes))
    differs = np.nan_to_num(np.abs(plain - lanes)) > 1e-6
    assert np.mean(differs) <= 1e-3, f"{differs.sum()} of {differs.size} pixels differ"


# ---- receivers ----------------------------------------------------------------------------------------------------------


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


SPLIT = {
    "depth": {"fit": "focused", "splits": 4, "scheme": "log"},
    "best, atlas": {"fit": "focused", "splits": 4, "scheme": "log", "selection": "best", "storage": "atlas9"},
    "warped": {"fit": "focused", "splits": 4, "scheme": "log", "warp": "lispsm_nopt"},
    "warped, best": {"fit": "focused", "splits": 8, "warp": "lispsm_nrepar", "selection": "best"},
}


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("lamp", LIGHTS)
def test_receivers_of_a_run_are_those_of_its_pixels(lamp: str, bias: str) -> None:
    receivers_agree(session(small.cluttered(LIGHTS[lamp])), bias, 3 if lamp == "six faces" else 1)


@pytest.mark.parametrize("bias", ["slope", "normal"])
@pytest.mark.parametrize("lamp", ["perspective", "orthographic"])
@pytest.mark.parametrize("split", SPLIT)
def test_receivers_of_a_run_read_the_splits_that_its_pixels_do(split: str, lamp: str, bias: str) -> None:
    receivers_agree(session(small.cluttered(LIGHTS[lamp]), projection=compose(SPLIT[split])), bias, 2)


def test_receivers_that_no_split_holds_with_room_read_the_last_that_holds_them() -> None:
    """Views whose splits end before what they hold does: the reserve, or nothing."""
    views = compose(SPLIT["depth"])

    def ended(*arguments: Any) -> list[Any]:
        made = views(*arguments)
        assert len(made) > 2
        return [replace(view, choice=replace(view.choice, far=0.6 * view.choice.far)) for view in made[:-1]]  # type: ignore[attr-defined]

    receivers_agree(session(small.cluttered(LIGHTS["orthographic"]), projection=ended), "slope", 2)


def receivers_agree(running: Session, bias: str, layers: int) -> None:
    """``locate_run`` against ``locate_receiver`` of each pixel, on at least so many layers."""
    gbuffer = running.gbuffer()
    params = MapParams(resolution=256, bias=bias)
    light_map = running.light_map(256, cull=params.cull)
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


# ---- techniques ---------------------------------------------------------------------------------------------------------

CASES: list[tuple[str, dict[str, Any]]] = [
    ("shadow_map", {}),
    ("pcf", {}),
    ("pcf", {"bilinear": False, "kernel": "box", "radius": 5.0}),
    ("pcf", {"kernel": "box", "taps": 9, "radius": 8.0}),
    ("pcss", {}),
    ("pcss", {"rotate": True}),
    ("pcss", {"bilinear": True, "rotate": True}),
    ("pcss", {"kernel": "box", "blocker_taps": 9, "filter_taps": 25}),
    ("multi_shadow_map", {"samples": 5}),
    ("vsm", {}),
    ("vsm", {"taps": 21, "bleeding": 0.2}),
]


@pytest.mark.parametrize("lamp", LIGHTS)
@pytest.mark.parametrize(("name", "params"), CASES)
def test_lanes_and_plain_kernel_make_the_same_image(
    name: str, params: dict[str, Any], lamp: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, lanes = twins(small.cluttered(LIGHTS[lamp]), name, monkeypatch, resolution=256, **params)
    assert name == "shadow_map" or ((plain > 0.05) & (plain < 0.95)).sum() > 50
    darkest = 0.05 if name == "vsm" else 0.0  # an upper bound is hardly ever 0
    assert (plain == 1.0).sum() > 200 and (plain <= darkest).sum() > 100
    assert_same(plain, lanes)


@pytest.mark.parametrize("lamp", ["perspective", "orthographic"])
@pytest.mark.parametrize("split", SPLIT)
@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map", "vsm", "multi_shadow_map"])
def test_lanes_and_plain_kernel_make_the_same_image_of_splits(
    name: str, split: str, lamp: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = {"samples": 3} if name == "multi_shadow_map" else {}
    scene = small.cluttered(LIGHTS[lamp])
    assert_same(*twins(scene, name, monkeypatch, projection=SPLIT[split], resolution=128, **params))


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("lamp", LIGHTS)
@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map"])
def test_lanes_and_plain_kernel_agree_for_every_bias(
    name: str, lamp: str, bias: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert_same(*twins(small.cluttered(LIGHTS[lamp]), name, monkeypatch, resolution=256, bias=bias, bias_constant=2.0))


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map"])
def test_lanes_reach_the_end_of_rows_of_any_width(name: str, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, lanes = twins(small.cluttered(LIGHTS["perspective"]), name, monkeypatch, width, 50, resolution=256)
    assert 0.0 in plain and 1.0 in plain
    assert_same(plain, lanes)


@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map"])
def test_lanes_and_plain_kernel_agree_where_the_map_ends(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = small.scene([small.mesh("ground", small.plane(6.0))], LIGHTS["perspective"])
    assert_same(*twins(scene, name, monkeypatch, resolution=16))
    assert_same(*twins(load_scene("configs/scenes/overlap.yaml"), name, monkeypatch, 150, 84))


@pytest.mark.parametrize("name", ["pcf", "pcss", "shadow_map"])
def test_lanes_do_not_depend_on_threads(name: str) -> None:
    plugin = find(name)
    images = [
        session(small.cluttered(LIGHTS["perspective"]), threads=threads).render(plugin(plugin.Params())).visibility
        for threads in (1, 2, 3)
    ]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


# ---- over time ----------------------------------------------------------------------------------------------------------


OVER_TIME: list[tuple[str, dict[str, Any]]] = [
    ("tc_soft_paper", {}),
    ("tc_soft_paper", {"start": "sample"}),
    ("tc_soft_paper", {"history": "nearest", "filter_width": "penumbra"}),
    ("tc_soft_paper", {"movers": "gradual", "start_weight": 4.0, "mover_surfaces": "own_motion"}),
    ("tc_soft_paper", {"movers": "at_once", "start": "sample"}),
    ("tc_soft_paper", {"ageing": "frames", "age_factor": 0.7}),
    ("tc_soft_paper", {"mover_map": "centre"}),
    ("tc_soft_paper", {"kept_views": 3, "kept_overlap": 0.97}),
    ("tc_soft_thesis", {"mover_map": "centre", "mover_overlap": "max", "mover_taps": 9}),
    ("tc_soft_thesis", {}),
    ("tc_soft_thesis", {"start": "blur", "blocker_mean": "frames", "mover_surfaces": "own_motion"}),
    ("tc_soft_thesis", {"start": "blur", "movers": "at_once", "kernel": "poisson", "zero_blur": "rejected"}),
]


@pytest.mark.parametrize(("name", "params"), OVER_TIME)
@pytest.mark.parametrize("scene", ["overlap", "moving_blocker", "moving_light"])
def test_a_shadow_buffer_in_lanes_remembers_what_the_plain_one_does(
    scene: str, name: str, params: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Along a path with movers, disocclusion and history at fractions of a pixel."""
    plugin = find(name)
    own = sys.modules[plugin.__module__]
    modules = [neighbourhood_filter, shadow_buffer_step, mover_shadow, *([own] if hasattr(own, "uses_lanes") else [])]
    loaded = load_scene(f"configs/scenes/{scene}.yaml")
    running = {lanes: session(loaded, 150, 84) for lanes in (False, True)}
    technique = plugin(plugin.Params(resolution=256, **params))
    worst, settled = 0.0, 0
    for frame in range(0, 60, 4):
        made = {}
        for lanes, own in running.items():
            for module in modules:
                monkeypatch.setattr(module, "uses_lanes", lambda device, lanes=lanes: lanes)
            own.begin(frame)
            made[lanes] = own.render(technique)
            own.advance()
        difference = np.abs(made[True].visibility - made[False].visibility)
        seen = np.isfinite(difference)
        np.testing.assert_array_equal(seen, np.isfinite(made[False].visibility))
        # a texel of history that just passes or just fails its depth test changes what its pixel remembers
        worst = max(worst, float((difference[seen] > 1e-4).mean()))
        errors = made[True].standard_error[seen] - made[False].standard_error[seen]
        assert (np.abs(errors) > 1e-4).mean() <= 0.01
        settled += int(((made[True].standard_error[seen] < 0.3) & (made[True].visibility[seen] > 0.0)).sum())
    assert worst <= 0.01 and settled > 1000
