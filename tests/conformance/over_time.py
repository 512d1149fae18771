"""Checks of sequences: no frame may see what it should not, and history must converge and be forgotten."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import small_scenes
from compare import rmse
from rig import (
    check,
    has_history,
    has_no_history,
    is_hard,
    kinds_of,
    lamp,
    render,
    small_params,
    small_session,
    truth,
)
from sessions import render_frames

from algorithms.technique import Technique
from wkernels.scene.model import Camera, Scene


def moving_scene(technique: type[Technique]) -> Scene:
    """A box that travels and an eye that circles it."""
    scene = small_scenes.box_on_ground(lamp(technique))
    ground, box = scene.meshes

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[:3, 3] = (0.4 * frame, 0.1 * frame, -0.3 * frame)
        return out

    def camera(frame: int) -> Camera:
        angle = 0.1 * frame
        return small_scenes.camera((8.0 * np.sin(angle), 6.0, 8.0 * np.cos(angle)))

    return replace(scene, meshes=(ground, replace(box, object_to_ws=pose, moving=True)), camera=camera)


@check(has_no_history)
def earlier_frames_leave_no_trace(technique: type[Technique], device: str) -> None:
    """After a walk through a moving scene a frame has the bits that it has on its own."""
    scene = moving_scene(technique)
    walked = small_session(scene, device)
    after_a_walk = render_frames(walked, technique(small_params(technique)), 4)[-1]
    (alone,) = render_frames(small_session(scene, device), technique(small_params(technique)), 1, 3)
    np.testing.assert_array_equal(after_a_walk.visibility, alone.visibility)
    np.testing.assert_array_equal(after_a_walk.standard_error, alone.standard_error)
    still = render(technique, replace(scene, camera=lambda i: scene.camera(0)), device)
    assert np.nansum(np.abs(np.nan_to_num(still.visibility) - np.nan_to_num(alone.visibility))) > 1.0


@check(has_history)
def a_still_view_converges(technique: type[Technique], device: str) -> None:
    kind = kinds_of(technique)[0]
    expected = truth(technique, small_scenes.box_on_ground, device, kind)
    session = small_session(small_scenes.box_on_ground(small_scenes.light(kind)), device)
    # with texels much smaller than pixels a hard shadow has nothing to converge to but the pixel that lies on its edge
    made = technique(small_params(technique, resolution=64 if is_hard(technique) else 512))
    error: dict[int, float] = {}
    previous = np.zeros(0)
    for frame in range(128):
        visibility = render_frames(session, made, 1, frame)[0].visibility
        if frame + 1 in (4, 128):
            error[frame + 1] = rmse(visibility, expected)
        if frame == 127:
            change = float(np.nanmax(np.abs(visibility - previous)))
        previous = visibility
    assert error[128] < 0.6 * error[4], f"rmse {error}"
    assert error[128] < 0.03, f"rmse {error}"
    assert change < 0.03, f"the image still changes by {change:.3f} after 128 frames"


def looking_down(x: float, z: float) -> Camera:
    """Sees about a unit around (x, 0, z), from below the boxes."""
    return Camera(np.array([x, 1.2, z]), np.array([x, 0.0, z]), np.array([0.0, 0.0, -1.0]), 60.0, 0.05, 50.0)


@check(has_history)
def disoccluded_pixels_ignore_history(technique: type[Technique], device: str) -> None:
    """Two eyes with nothing in common jump to the same new place: one comes from the dark, the other from the light."""
    dark_side = small_scenes.mesh("roof", small_scenes.box((-4.5, 2.0, 0.0), (3.5, 0.5, 3.5)), receives=False)
    scene = small_scenes.box_on_ground(lamp(technique))
    scene = replace(scene, meshes=(*scene.meshes, dark_side))
    images, pasts = [], []
    for x in (-4.7, 4.7):
        path = [looking_down(x, 0.0)] * 6 + [looking_down(1.4, 0.1)]
        session = small_session(replace(scene, camera=lambda frame, path=path: path[min(frame, 6)]), device)
        made = technique(small_params(technique))
        pasts.append(render_frames(session, made, 6)[-1].visibility)
        images.append(render_frames(session, made, 1, 6)[-1].visibility)
    assert np.nanmean(pasts[0]) < 0.3 and np.nanmean(pasts[1]) > 0.9, "the two pasts must differ"
    assert np.nanmin(images[0]) < 0.2 and np.nanmax(images[0]) > 0.8, "the new place must have light and shadow"
    np.testing.assert_array_equal(images[0], images[1])


@check(has_history)
def a_reset_forgets_everything(technique: type[Technique], device: str) -> None:
    scene = small_scenes.box_on_ground(lamp(technique))
    session = small_session(scene, device)
    made = technique(small_params(technique))
    render_frames(session, made, 5)
    session.reset()
    again = render_frames(session, made, 2)[-1]
    fresh = render(technique, scene, device, frames=2)
    np.testing.assert_array_equal(again.visibility, fresh.visibility)
    np.testing.assert_array_equal(again.standard_error, fresh.standard_error)
