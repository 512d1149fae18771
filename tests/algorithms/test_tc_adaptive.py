"""tc_adaptive: convergence and standard error, carried history, movers, and what is drawn when."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from sessions import SIZE, open_session, small_technique, true_visibility, walk

from wkernels.frame.session import FrameResult
from wkernels.scene.lights import DiscLight, Light

NAME = "tc_adaptive"
LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
LIGHTS: dict[str, Light] = {
    "perspective": LAMP,
    "orthographic": small.light("directional", (1.0, 8.0, 0.5)),
    "six faces": DiscLight(center=np.array([0.2, 3.2, 1.5]), normal=np.array([0.0, -1.0, 0.0]), radius=0.2),
}


# ---- convergence --------------------------------------------------------------------------------------------------------


def test_a_still_view_converges(device: str) -> None:
    """With low-discrepancy samples the error falls faster than 1 / sqrt(n)."""
    scene = small.box_on_ground(LAMP)
    expected = true_visibility(scene, device, samples=4096)
    frames = walk(scene, device, NAME, 250, resolution=1024, still_samples=248)
    errors = [rmse(frames[at].visibility, expected) for at in (1, 15, 247)]  # 2, 16 and 244 points of the light
    assert errors[1] < 0.3 * errors[0] and errors[2] < 0.35 * errors[1], errors
    assert errors[2] < 1.0 / 128.0, errors
    assert any("stood still" in reason for _, reason, _ in frames[-1].left_out)
    np.testing.assert_array_equal(frames[-1].visibility, frames[-2].visibility)


def test_two_standard_errors_cover_the_error(device: str) -> None:
    """Of 16 and 64 points, under lights of several shapes; 1 is the size that the errors have on average."""
    sphere = small.light("sphere", (2.0, 8.0, 1.0), 2.0)
    sizes, shares = [], []
    for scene in (small.box_on_ground(LAMP), small.box_on_ground(sphere), small.cluttered(LAMP)):
        expected = true_visibility(scene, device, samples=4096)
        penumbra = (expected > 0.01) & (expected < 0.99)
        frames = walk(scene, device, NAME, 68, resolution=2048)
        for at in (15, 67):
            error = np.abs(frames[at].visibility - expected)[penumbra]
            reported = frames[at].standard_error[penumbra]
            shares.append((error <= 2.0 * reported).mean())
            sizes.append(np.sqrt((reported**2).mean() / (error**2).mean()))
    assert min(shares) >= 0.9 and np.mean(shares) <= 0.999, shares
    assert min(sizes) > 0.8 and max(sizes) < 1.9, sizes


def test_history_follows_a_slow_eye(device: str) -> None:
    """0.3 pixels a frame: the nearest texel is always the same one, and still history does not stick to the screen."""
    scene = small.box_on_ground(LAMP, small.sideways(0.3, SIZE[1]))
    expected = true_visibility(scene, device, 39, samples=256)
    walked = walk(scene, device, NAME, 40, samples=32, clip=0.0)[-1].visibility  # clipping would hide what sticks
    alone = open_session(scene, device)
    alone.begin(39)
    direct = alone.render(small_technique("multi_shadow_map", samples=32)).visibility
    # places that are half a pixel off cost some; history that sticks is 12 pixels off after 40 frames
    assert rmse(walked, expected) < 1.6 * rmse(direct, expected), (rmse(walked, expected), rmse(direct, expected))


# ---- movers -------------------------------------------------------------------------------------------------------------


def test_a_shadow_that_leaves_leaves_no_trail(device: str) -> None:
    scene = small.moved(small.box_on_ground(LAMP), 1, lambda frame: 0.0 if frame < 12 else 200.0)
    frames = walk(scene, device, NAME, 13)
    assert np.nanmean(frames[11].visibility < 0.5) > 0.02
    last = frames[12].visibility
    np.testing.assert_array_equal(last[np.isfinite(last)], 1.0)


@pytest.mark.parametrize("lamp", ["perspective", "orthographic"])
def test_movers_and_what_stands_still_hide_together(lamp: str, device: str) -> None:
    """A box that hides a part of the light beside or behind another: the same share as of maps that hold both."""
    other = small.mesh("other", small.box((0.6, 2.6, 0.3), (1.0, 0.4, 1.2)), receives=False)
    scene = small.box_on_ground(LIGHTS[lamp])
    scene = small.moved(replace(scene, meshes=(*scene.meshes, other)), 2, lambda frame: 0.05 * frame)
    result = walk(scene, device, NAME, 9, samples=16, draws=2, mover_maps=16, resolution=512)[-1].visibility
    session = open_session(scene, device)
    session.begin(8)
    both = session.render(small_technique("multi_shadow_map", samples=16, resolution=512)).visibility
    assert np.nanmean((both > 0.1) & (both < 0.9)) > 0.01
    assert rmse(result, both) < 0.02, rmse(result, both)
    without = walk(small.box_on_ground(LIGHTS[lamp]), device, NAME, 9, samples=16, resolution=512)[-1].visibility
    assert rmse(without, both) > 0.03


# ---- sessions -----------------------------------------------------------------------------------------------------------


def test_a_frame_rendered_again_is_the_same(device: str) -> None:
    session, made = (
        open_session(small.moved(small.cluttered(LAMP), 1, lambda frame: 0.1 * frame), device),
        small_technique(NAME),
    )
    for index in range(20):
        session.begin(index)
        once: FrameResult = session.render(made)
        session.begin(index)
        again = session.render(made)
        np.testing.assert_array_equal(once.visibility, again.visibility)
        session.advance()


def test_maps_are_drawn_once_where_nothing_moves(device: str) -> None:
    def path(frame: int) -> Any:
        return small.camera((0.1 * frame, 6.0, 8.0))

    frames = walk(small.box_on_ground(LAMP, path), device, NAME, 20, samples=16, draws=2)
    drawn = ["light depth map" in dict(result.passes) for result in frames]
    assert drawn == [True] * 8 + [False] * 12


def test_layers_of_a_map_are_spread_over_frames(device: str) -> None:
    """Six faces, three a frame: the same picture in the end, as a still view counts every map once."""
    scene = small.cluttered(LIGHTS["six faces"])
    spread = walk(scene, device, NAME, 7, samples=4, draws=0.5)
    at_once = walk(scene, device, NAME, 1, samples=4, draws=4)[0].visibility
    changes = [rmse(b.visibility, a.visibility) > 0.0 for a, b in itertools.pairwise(spread)]
    assert changes == [False, True] * 3, changes  # the first map takes a frame, the others two each
    np.testing.assert_allclose(spread[-1].visibility, at_once, atol=1e-6)


def test_threads_change_nothing(device: str) -> None:
    scene = small.moved(small.cluttered(LAMP), 1, lambda frame: 0.1 * frame)
    images = [walk(scene, device, NAME, 4, {"threads": threads})[-1].visibility for threads in (1, 3)]
    np.testing.assert_array_equal(images[0], images[1])


@pytest.mark.parametrize(
    "projection",
    [{"fit": "focused"}, {"fit": "focused", "splits": 3}, {"fit": "focused", "depth": "tight", "near": "auto"}],
)
def test_projections_that_follow_the_eye(projection: dict[str, Any], device: str) -> None:
    def path(frame: int) -> Any:
        return small.camera((0.1 * frame, 6.0, 8.0))

    scene = small.box_on_ground(LAMP, path)
    result = walk(scene, device, NAME, 20, {"projection": projection}, samples=16)[-1].visibility
    assert rmse(result, true_visibility(scene, device, 19, samples=256)) < 0.05
