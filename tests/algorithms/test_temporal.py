"""tc_soft_paper: its limits, convergence, start, filter, movers and cameras (Scherzer et al. 2009, sections 3 and
4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from pydantic import ValidationError
from sessions import SIZE, open_session, small_technique, true_visibility, walk

from algorithms.plugins import find
from wkernels.frame.session import FrameResult
from wkernels.sampling.point_sets import halton
from wkernels.scene.lights import Light, RectangleLight

NAME = "tc_soft_paper"
LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
SAMPLING = {"start": "sample", "filter": False}


def slide(offset: Callable[[int], float]) -> Callable[[int], np.ndarray]:
    """A pose that moves along x."""

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = offset(frame)
        return out

    return pose


# ---- limits and convergence ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["rectangle", "directional", "sphere"])
@pytest.mark.parametrize("buffer", ["float32", "float16"])
def test_sampling_alone_equals_multi_shadow_map(kind: str, buffer: str, device: str) -> None:
    scene = small.cluttered(small.light(kind, (1.0, 8.0, 0.5)))
    ours = walk(scene, device, NAME, 16, resolution=128, buffer=buffer, overscan=0.0, **SAMPLING)[-1]
    maps = open_session(scene, device).render(small_technique("multi_shadow_map", resolution=128, samples=16))
    np.testing.assert_allclose(ours.visibility, maps.visibility, atol=1e-6)
    np.testing.assert_allclose(ours.standard_error, maps.standard_error, atol=1e-5)
    assert len(np.unique(maps.visibility[np.isfinite(maps.visibility)])) > 8
    # an overscanned G-buffer rounds its positions differently: a comparison may flip where a texel ends
    wider = walk(scene, device, NAME, 16, resolution=128, buffer=buffer, **SAMPLING)[-1]
    assert np.nanmean(np.abs(wider.visibility - maps.visibility) > 1e-6) < 0.02


def test_sampling_alone_weights_a_textured_light(device: str) -> None:
    assert isinstance(LAMP, RectangleLight)
    scene = small.box_on_ground(replace(LAMP, texture=np.array([[0.0, 3.0], [1.0, 2.0]])))
    ours = walk(scene, device, NAME, 8, overscan=0.0, **SAMPLING)[-1]
    maps = open_session(scene, device).render(small_technique("multi_shadow_map", samples=8))
    np.testing.assert_allclose(ours.visibility, maps.visibility, atol=1e-6)


@pytest.mark.parametrize("smooth", [True, False])
def test_converges_to_the_reference(smooth: bool, device: str) -> None:
    scene = small.box_on_ground(LAMP)
    expected = true_visibility(scene, device, samples=1024)
    frames = walk(scene, device, NAME, 256, resolution=1024, filter=smooth)
    error = [rmse(frames[n - 1].visibility, expected) for n in (16, 64, 256)]
    assert error[1] < 0.5 * error[0] and error[2] < 0.5 * error[1], error  # slope 1/2 or better
    print("rmse at N = 16, 64, 256:", [round(e, 5) for e in error])


def test_the_published_filter_width_keeps_its_bias(device: str) -> None:
    """As wide as the penumbra to the end, it blurs what is above t, where the narrowing one follows the samples."""
    scene = small.box_on_ground(LAMP)
    expected = true_visibility(scene, device, samples=1024)
    ours, published = (walk(scene, device, NAME, 64, filter_width=width) for width in ("error", "penumbra"))
    np.testing.assert_array_equal(ours[0].visibility, published[0].visibility)  # new pixels: both the whole penumbra
    assert rmse(ours[63].visibility, expected) < 0.7 * rmse(published[63].visibility, expected)


def test_filter_ends_where_the_standard_error_falls_below_the_threshold(device: str) -> None:
    """t = 1/10 is reached for every psi at n = 26: from there on the image is that of sampling alone."""
    scene = small.box_on_ground(LAMP)
    smoothed = walk(scene, device, NAME, 30, error_threshold=0.1)
    plain = walk(scene, device, NAME, 30, filter=False)
    for n in (2, 10):
        assert not np.array_equal(smoothed[n - 1].visibility, plain[n - 1].visibility, equal_nan=True)
        confident = plain[n - 1].standard_error <= 0.1
        np.testing.assert_array_equal(smoothed[n - 1].visibility[confident], plain[n - 1].visibility[confident])
    for n in (26, 30):
        assert np.nanmax(plain[n - 1].standard_error) <= 0.1
        np.testing.assert_array_equal(smoothed[n - 1].visibility, plain[n - 1].visibility)


def test_filter_steadies_the_first_frames(device: str) -> None:
    """Figure 2: less flicker than sampling alone, and a better first frame, while n is small.

    The depth range is wider than by default, as a pixel of this small image spans 1 % of the depth of the ground.
    """
    scene = small.box_on_ground(LAMP)
    expected = true_visibility(scene, device)
    ours = walk(scene, device, NAME, 8, filter_depth_range=0.05)
    published = walk(scene, device, NAME, 8, filter_depth_range=0.05, filter_width="penumbra")
    sampled = walk(scene, device, NAME, 8, **SAMPLING)

    def flicker(frames: list[FrameResult]) -> float:
        return float(np.mean([rmse(b.visibility, a.visibility) for a, b in pairwise(frames)]))

    assert flicker(published) < 0.6 * flicker(sampled)
    assert flicker(ours) < 0.7 * flicker(sampled)  # narrower from the sixth frame on
    assert rmse(published[0].visibility, expected) < 0.8 * rmse(sampled[0].visibility, expected)
    assert flicker(walk(scene, device, NAME, 8, start_weight=4.0)) < 0.6 * flicker(sampled)


def test_standard_error_is_that_of_the_samples(device: str) -> None:
    frames = walk(small.box_on_ground(LAMP), device, NAME, 9, filter=False)
    receives = np.isfinite(frames[0].visibility)
    assert (frames[0].standard_error[receives] == 1.0).all()
    psi = 1.0 - frames[8].visibility[receives].astype(float)
    np.testing.assert_allclose(
        frames[8].standard_error[receives], np.sqrt(np.maximum(psi * (1.0 - psi), 0.0) / 8.0), atol=2e-4
    )


# ---- start --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["rectangle", "disc"])
def test_first_frame_is_pcss_from_the_first_sample(kind: str, device: str) -> None:
    """The same light, moved so that its centre is the first sample, gives pcss the same map and the same light size."""
    lamp = small.light(kind, (1.0, 8.0, 0.5), 2.0)
    offset = lamp.sample(halton(1))[0, :3] - lamp.centre[:3]
    assert np.linalg.norm(offset) > 0.1
    ours = walk(small.cluttered(lamp), device, NAME, 1, filter=False, overscan=0.0)[0]
    scene = small.cluttered(lamp.moved(offset))
    pcss = open_session(scene, device).render(small_technique("pcss", kernel="box", bilinear=False)).visibility
    assert len(np.unique(pcss[np.isfinite(pcss)])) > 8
    # the moved light is rounded once more, which moves its map by a rounding error
    assert np.nanmean(np.abs(ours.visibility - pcss) > 1e-6) < 0.005


def test_start_weight_counts_as_so_many_samples(device: str) -> None:
    scene = small.box_on_ground(LAMP)
    light, heavy = (walk(scene, device, NAME, 2, filter=False, start_weight=w, overscan=0.0) for w in (1.0, 4.0))
    np.testing.assert_array_equal(light[0].visibility, heavy[0].visibility)
    start = light[0].visibility
    second = 2.0 * light[1].visibility - start  # the test of the second frame, 0 or 1
    np.testing.assert_allclose(second, np.round(second), atol=1e-5)
    np.testing.assert_allclose(heavy[1].visibility, (4.0 * start + second) / 5.0, atol=1e-5)
    assert np.nanmax(np.abs(heavy[1].visibility - light[1].visibility)) > 0.1


# ---- movers -------------------------------------------------------------------------------------------------------------


def test_a_shadow_that_leaves_leaves_no_trail(device: str) -> None:
    """The box hovers for 12 frames, then jumps out of the light: one frame later the ground is wholly lit."""
    scene = small.moved(small.box_on_ground(LAMP), 1, lambda frame: 0.0 if frame < 12 else 200.0)
    for weight in (1.0, 4.0):
        frames = walk(scene, device, NAME, 13, start_weight=weight)
        assert np.nanmean(frames[11].visibility < 0.5) > 0.02
        np.testing.assert_array_equal(frames[12].visibility[np.isfinite(frames[12].visibility)], 1.0)


def test_a_moving_shadow_keeps_up(device: str) -> None:
    """No worse than a start in every frame, and nothing is left where the box was before."""
    scene = small.moved(small.box_on_ground(LAMP), 1, lambda frame: 0.12 * frame - 1.5)
    forgetful, made = open_session(scene, device), small_technique(NAME)
    ours, started = [], []
    for index, result in enumerate(walk(scene, device, NAME, 24)):
        forgetful.reset()
        forgetful.count = index  # the same sample of the light, and no past
        forgetful.begin(index)
        expected = true_visibility(scene, device, index, samples=64)
        ours.append(rmse(result.visibility, expected))
        started.append(rmse(forgetful.render(made).visibility, expected))
    assert ours[0] == started[0] and ours[1:] != started[1:]
    assert np.mean(ours) < 1.1 * np.mean(started), (np.mean(ours), np.mean(started))
    now_lit = (true_visibility(scene, device, 0) < 0.5) & (expected == 1.0)
    assert now_lit.sum() > 20
    assert np.nanmin(result.visibility[now_lit]) > 0.95


def test_static_shadows_keep_their_history_beside_a_mover(device: str) -> None:
    scene = small.box_on_ground(LAMP)
    mover = small.mesh("mover", small.box((-4.0, 1.0, 2.5), (0.5, 0.5, 0.5)), receives=False)
    both = small.moved(replace(scene, meshes=(*scene.meshes, mover)), 2, lambda frame: 0.05 * frame)
    alone, beside = walk(scene, device, NAME, 24, filter=False)[-1], walk(both, device, NAME, 24, filter=False)[-1]
    assert np.nanmean(beside.standard_error == 1.0) > 0.002, "the mover's shadow starts anew in every frame"
    far = np.isfinite(alone.visibility) & (alone.world_position[..., 0] > -2.0)
    penumbra = far & (alone.visibility > 0.0) & (alone.visibility < 1.0)
    assert penumbra.sum() > 50
    # the map fits the same receivers, so that the static shadow is the same, test by test
    np.testing.assert_allclose(beside.visibility[far], alone.visibility[far], atol=1e-6)


@pytest.mark.parametrize("rises", [False, True])
def test_a_moving_receiver_keeps_history_only_within_its_plane(rises: bool, device: str) -> None:
    """A tray under a static box: where it slides its points keep their history, where it rises they are new."""
    scene = small.box_on_ground(LAMP)
    tray = small.mesh("tray", small.plane(16.0, 0.2), casts=False)
    pose = slide(lambda frame: 0.1 * frame)

    def rise(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[1, 3] = 0.02 * frame
        return out

    moving = replace(scene, meshes=(*scene.meshes, replace(tray, object_to_ws=rise if rises else pose, moving=True)))
    result = walk(moving, device, NAME, 24, filter=False)[-1]
    is_new = result.standard_error[np.isfinite(result.visibility)] == 1.0
    if rises:
        assert is_new.all()
    else:
        assert is_new.mean() < 0.02, "only what the edge of the tray uncovers is new"
        assert rmse(result.visibility, true_visibility(moving, device, 23)) < 0.02


# ---- cameras ------------------------------------------------------------------------------------------------------------


def test_history_follows_a_slow_eye(device: str) -> None:
    """At 0.3 pixels a frame the nearest texel is always the same one: history sticks to the screen."""
    panning = small.box_on_ground(LAMP, small.sideways(0.3, SIZE[1]))
    expected = true_visibility(panning, device, 39)
    error = {
        h: rmse(walk(panning, device, NAME, 40, filter=False, history=h)[-1].visibility, expected)
        for h in ("bilinear", "nearest")
    }
    started = rmse(true_visibility(panning, device, 39, samples=16), expected)
    assert error["bilinear"] < 2.0 * started, error
    assert error["nearest"] > 3.0 * error["bilinear"], error


def test_slanted_ground_keeps_its_history(device: str) -> None:
    """The depth of a slanted plane differs by far more than epsilon within a pixel, and still no point is new."""
    frames = walk(small.box_on_ground(LAMP, small.sideways(0.3, SIZE[1])), device, NAME, 6, depth_epsilon=1e-5)
    receives = np.isfinite(frames[-1].visibility)
    assert (frames[-1].standard_error[receives] < 1.0).mean() > 0.99


@pytest.mark.parametrize("buffer", ["float32", "float16"])
def test_overscan_covers_the_border(buffer: str, device: str) -> None:
    """2 pixels a frame enter at one side: they are new without overscan, and within it they have history."""
    size = SIZE
    new = {}
    for overscan in (0.0, 0.1):
        result = walk(
            small.box_on_ground(LAMP, small.sideways(2.0, SIZE[1])), device, NAME, 3, overscan=overscan, buffer=buffer
        )[-1]
        assert result.visibility.shape == (size[1], size[0])
        receives = np.isfinite(result.visibility)
        new[overscan] = ((result.standard_error == 1.0) & receives).sum() / receives.sum()
    assert new[0.0] > 0.01
    assert new[0.1] < 0.2 * new[0.0]


def test_a_rapid_eye_starts_anew_where_nothing_is_known(device: str) -> None:
    """A turn of 20 degrees a frame: what was seen before goes on, the rest starts, and nothing is undefined."""
    scene = replace(small.cluttered(LAMP), camera=small.circling(20.0))
    frames = walk(scene, device, NAME, 5)
    for index, result in enumerate(frames[1:], 1):
        receives = np.isfinite(result.visibility)
        is_new = (result.standard_error == 1.0)[receives]
        assert 0.02 < is_new.mean() < 0.8
        assert (
            receives.any() and (result.visibility[receives] >= 0.0).all() and (result.visibility[receives] <= 1.0).all()
        )
        assert rmse(result.visibility, true_visibility(scene, device, index, samples=64)) < 0.15


# ---- input --------------------------------------------------------------------------------------------------------------


def test_nothing_casts(device: str) -> None:
    scene = small.scene([small.mesh("ground", small.plane(8.0), casts=False)], LAMP)
    for result in walk(scene, device, NAME, 2):
        receives = np.isfinite(result.visibility)
        assert receives.any() and (result.visibility[receives] == 1.0).all()
        assert (result.standard_error[receives] == 0.0).all()
        assert not any(name == "light depth map" for name, _ in result.passes)


@pytest.mark.parametrize(
    "lamp", [small.light(kind, (0.5, 7.0, 0.5)) for kind in ("linear", "disc", "polygon", "directional")]
)
def test_every_light_with_an_area_converges(lamp: Light, device: str) -> None:
    scene = small.box_on_ground(lamp)
    frames = walk(scene, device, NAME, 48, {"size": (48, 36)}, filter=False)
    expected = true_visibility(scene, device, size=(48, 36))
    assert 0.01 < np.nanmean((expected > 0.02) & (expected < 0.98))
    assert rmse(frames[-1].visibility, expected) < 0.02


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"blocker_taps": 10}, "take 9 or 16"),
        ({"filter_taps": 0}, "filter_taps"),
        ({"taps": 7}, "multiple of 2"),
        ({"start": "pcs"}, "pcss"),
        ({"buffer": "float8"}, "float16"),
        ({"error_threshold": -0.1}, "error_threshold"),
        ({"depth_epsilon": float("nan")}, "depth_epsilon"),
        ({"overscan": 2.0}, "overscan"),
        ({"samples": 4}, "samples"),
    ],
)
def test_wrong_parameters_are_named(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        find("tc_soft_paper").Params(**params)
