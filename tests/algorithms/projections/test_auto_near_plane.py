"""Key ``near``: the near plane at the nearest thing in sight, of this frame or of the last (Stingl 2011, section 4.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes
import warp as wp
from projection_cases import SUN, posts

from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from wkernels.frame import near_plane
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Scene

UP = np.array([0.0, 1.0, 0.0])
OVERHEAD = DirectionalLight(direction=-UP)
AHEAD = Camera(np.array([0.0, 20.0, -78.0]), np.array([0.0, 20.0, 0.0]), UP, 60.0, 0.5, 150.0)
LEAST = "least depth"


def hall(camera: Any = AHEAD, light: Any = OVERHEAD) -> Scene:
    """The posts before a wall of 40 units, so that the eye is within the scene's box."""
    wall, faces = small_scenes.box((0.0, 20.0, 79.0), (160.0, 40.0, 1.0))
    return small_scenes.scene([*posts(), small_scenes.mesh("wall", (wall, faces))], light, camera)


def session(scene: Scene, device: str, settings: dict[str, Any], skips: bool = True) -> Session:
    projection = compose({"fit": "focused", **settings})
    return Session(Geometry(scene, device), width=96, height=72, device=device, projection=projection, skips=skips)


def render(frame: Session, name: str = "shadow_map") -> FrameResult:
    technique = load_all()[name]
    return frame.render(technique(technique.Params(**({"resolution": 256} if name == "shadow_map" else {}))))


def left_out(result: FrameResult) -> set[str]:
    return {what for what, _, _ in result.left_out}


def test_psm_gains_the_ratio_of_the_near_planes(device: str) -> None:
    """m_z ends at (f - n) / (2 n tan theta) (Stingl 2011, equation 2.6)."""
    scene = hall()
    found, depth = {}, {}
    for near in ("user", "auto"):
        frame = session(scene, device, {"warp": "psm", "near": near})
        result = render(frame)
        found[near] = result.m_z_max
        depth[near] = frame.near_plane.used.near  # type: ignore[union-attr]
        assert (LEAST in dict(result.passes)) == (near == "auto")
    least = float(np.nanmin(frame.gbuffer().depth.numpy()))
    assert (
        depth == {"user": 0.5, "auto": least} and 30.0 < least < 35.0
    )  # the ground is 20 units below, and 30 degrees down
    expected = (AHEAD.far - least) / least / ((AHEAD.far - 0.5) / 0.5)
    assert found["auto"] / found["user"] == pytest.approx(expected, rel=1e-4)


def test_shadows_near_the_eye_are_finer(device: str) -> None:
    scene = hall(light=SUN)
    exact = render(session(scene, device, {}), "ray_cast_point_shadow").visibility
    wrong = {
        near: np.nanmean(np.abs(render(session(scene, device, {"warp": "psm", "near": near})).visibility - exact))
        for near in ("user", "auto")
    }
    assert wrong["auto"] < 0.5 * wrong["user"], wrong


@pytest.mark.parametrize("least", [np.inf, 1e-3, 1e-5, 1e6, 0.5])
@pytest.mark.parametrize("settings", [{"warp": "psm"}, {"splits": 4, "warp": "lispsm_nopt"}, {"partition": "faces"}])
def test_any_least_depth_is_taken(
    least: float, settings: dict[str, Any], device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All background (inf) and one pixel at 1e-3: the plane stays between the user's and the far plane."""
    monkeypatch.setattr(near_plane, "least_depth", lambda frame, gbuffer: least)
    frame = session(hall(replace(AHEAD, near=1e-4)), device, {"near": "auto", **settings})
    result = render(frame)
    assert frame.near_plane.used.near == min(max(least, 1e-4), AHEAD.far)  # type: ignore[union-attr]
    assert np.isfinite(result.visibility).any()
    assert ("focused light views" in left_out(result)) == (least >= AHEAD.far)
    assert all(np.isfinite(view.ws_to_ss).all() for view in frame.shown.views)


def test_nothing_seen_needs_no_pass(device: str) -> None:
    up = Camera(np.array([0.0, 60.0, 0.0]), np.array([0.0, 100.0, 1.0]), UP, 60.0, 0.5, 150.0)
    pictures = []
    for skips in (True, False):
        result = render(session(hall(up), device, {"near": "auto"}, skips))
        assert (LEAST in left_out(result)) == skips and (LEAST in dict(result.passes)) != skips
        assert ("focused light views", "the eye sees nothing that receives: the whole scene's are used", 1) in (
            result.left_out
        )
        pictures.append(result.visibility)
    np.testing.assert_array_equal(*pictures)
    assert np.isnan(pictures[0]).all()


def test_a_still_frame_is_not_searched_again(device: str) -> None:
    pictures = {}
    for skips in (True, False):
        frame = session(hall(light=SUN), device, {"near": "auto", "warp": "psm"}, skips)
        first = render(frame)
        frame.advance()
        frame.begin(1)
        second = render(frame)
        assert LEAST in dict(first.passes) and (LEAST in left_out(second)) == skips
        assert (LEAST in dict(second.passes)) != skips
        pictures[skips] = second.visibility
        np.testing.assert_array_equal(first.visibility, second.visibility)
    np.testing.assert_array_equal(pictures[True], pictures[False])


class MapFirst:
    """Asks for the map before the G-buffer."""

    def render(self, frame: Session) -> wp.array:
        frame.light_map(64)
        gbuffer = frame.gbuffer()
        out = frame.visibility_buffer(gbuffer)
        out.fill_(1.0)
        return out


class Overscanned:
    """Asks for a wider G-buffer."""

    def render(self, frame: Session) -> wp.array:
        gbuffer = frame.gbuffer(overscan=0.5)
        frame.light_map(64)
        out = frame.visibility_buffer(gbuffer)
        out.fill_(1.0)
        return out


def test_the_pass_takes_whatever_g_buffer_there_is(device: str) -> None:
    frame = session(hall(), device, {"near": "auto"})
    result = frame.render(MapFirst())
    assert {"g-buffer", LEAST} <= set(dict(result.passes))
    plain = frame.near_plane.used.near  # type: ignore[union-attr]
    wide = session(hall(), device, {"near": "auto"})
    wide.render(Overscanned())
    assert len(wide._gbuffers) == 1, "no second G-buffer"
    assert wide.near_plane.used.near < plain  # type: ignore[union-attr]


def test_the_last_frame_s_depth_lags_one_frame_and_clips(device: str) -> None:
    """An eye that drops to the ground sees before the plane of the frame before; a frame later all is well."""
    low = Camera(np.array([0.0, 3.0, -76.0]), np.array([0.0, 2.65, -75.0]), UP, 60.0, 0.5, 150.0)
    scene = hall(lambda frame: AHEAD if frame == 0 else low, SUN)
    frames = {near: session(scene, device, {"near": near, "warp": "psm"}) for near in ("auto", "auto_previous")}
    exact = session(scene, device, {})
    wrong: dict[str, list[float]] = {near: [] for near in frames}
    used: dict[str, list[float]] = {near: [] for near in frames}
    for index in range(3):
        exact.begin(index)
        truth = render(exact, "ray_cast_point_shadow").visibility
        for near, frame in frames.items():
            frame.begin(index)
            result = render(frame)
            frame.advance()
            wrong[near].append(float(np.nanmean(np.abs(result.visibility - truth))))
            used[near].append(frame.near_plane.used.near)  # type: ignore[union-attr]
            assert LEAST in dict(result.passes) or index == 2
    # what the frame before saw; there is none before the first
    assert used["auto_previous"] == [0.5, used["auto"][0], used["auto"][1]]
    assert wrong["auto_previous"][1] > 3.0 * wrong["auto"][1] > 0.0, "shadows before the plane are lost"
    assert wrong["auto_previous"][2] == wrong["auto"][2]
    frames["auto_previous"].reset()
    frames["auto_previous"].begin(0)
    render(frames["auto_previous"])
    assert frames["auto_previous"].near_plane.used.near == 0.5  # type: ignore[union-attr]
