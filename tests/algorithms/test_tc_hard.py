"""tc_hard: convergence under every projection, flicker, movers, cameras, history (Scherzer, Jeschke and Wimmer 2007)."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from pydantic import ValidationError
from sessions import SIZE, open_session, render, render_frames, small_technique, true_visibility, walk

from algorithms.plugins import find
from experiments.metrics.carry_over import carry_over
from experiments.scenes.loader import load_scene
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.lights import Light, PointLight
from wkernels.scene.model import Scene

NAME = "tc_hard"
SUN = small.light("directional", (3.0, 8.0, 2.0), 0.0)
LAMPS: dict[str, Light] = {
    "directional": SUN,
    "point": PointLight(position=np.array([2.0, 9.0, 1.0])),
    "cube": PointLight(position=np.array([0.2, 1.9, 1.5])),
}
WARPED = {"fit": "focused", "warp": "lispsm_nopt", "splits": 4}


def remembered(session: Session) -> np.ndarray:
    """Frames that each pixel knows of after the last ``advance``, (H, W) of the overscanned size."""
    return session.history("hard shadows", lambda: None).previous.numpy()[..., 1]


def turned_box(lamp: Light) -> Scene:
    """A box whose edges do not run along the rows of any map."""
    scene = small.box_on_ground(lamp)
    pose = np.eye(4)
    pose[:3, :3] = [[0.9, 0.0, 0.19**0.5], [0.0, 1.0, 0.0], [-(0.19**0.5), 0.0, 0.9]]
    return replace(scene, meshes=(scene.meshes[0], replace(scene.meshes[1], object_to_ws=lambda frame: pose)))


# ---- convergence ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lamp", "projection"),
    [
        ("directional", None),
        ("point", None),
        ("cube", None),
        ("directional", {"fit": "focused"}),
        ("directional", {"fit": "focused", "warp": "lispsm_nrepar"}),
        ("directional", {"fit": "focused", "splits": 4, "selection": "best"}),
        ("directional", WARPED),
        ("point", WARPED),
    ],
)
def test_a_still_view_converges_below_a_texel(lamp: str, projection: dict[str, Any] | None, device: str) -> None:
    scene = turned_box(LAMPS[lamp])
    expected = true_visibility(scene, device, centre=True)
    one_map = rmse(
        render(scene, device, "shadow_map", {"projection": projection}, resolution=64).visibility,
        expected,
    )
    frames = walk(scene, device, NAME, 64, {"projection": projection}, resolution=64, overscan=0.0)
    error = [rmse(frames[n - 1].visibility, expected) for n in (1, 4, 16, 64)]
    assert error[0] == one_map, "the first frame has no jitter"
    assert error[1] < 0.8 * error[0] and error[3] < 0.8 * error[1], error
    assert error[3] < 0.6 * error[0], error


def test_error_keeps_falling_to_its_plateau(device: str) -> None:
    """1, 4, 16, 64, 256 frames: down to 0.4 of what one map of that size gives."""
    scene = small.cluttered(SUN)
    frames = walk(scene, device, NAME, 256, overscan=0.0)
    expected = true_visibility(scene, device, centre=True)
    error = [rmse(frames[n - 1].visibility, expected) for n in (1, 4, 16, 64, 256)]
    assert all(b < 0.95 * a for a, b in pairwise(error)), error
    assert error[4] < 0.4 * error[0], error
    bias = float(np.nanmean(frames[-1].visibility - expected))
    assert abs(bias) < 0.001, "smoothed to both sides alike"
    published = walk(scene, device, NAME, 64, overscan=0.0, blend="published", power=3)
    assert rmse(published[59].visibility, expected) < 0.5 * error[0]  # converged in 10 to 60 frames
    assert error[4] < 0.8 * np.mean([rmse(f.visibility, expected) for f in published[48:]])


def test_a_bias_that_knows_its_place_moves_shadows_less(device: str) -> None:
    """On smooth casters that shadow themselves and each other: nearer to the truth."""
    scene = load_scene("configs/scenes/overlap.yaml")
    expected = true_visibility(scene, device, centre=True)
    error = {}
    for scaled in (True, False):
        session, made = open_session(scene, device), small_technique(NAME, overscan=0.0, scale_bias=scaled)
        for _ in range(32):  # of a still scene
            visibility = session.render(made).visibility
            session.advance()
        error[scaled] = rmse(visibility, expected)
    assert error[True] < 0.9 * error[False], error


def test_without_jitter_nothing_converges(device: str) -> None:
    scene = small.cluttered(SUN)
    frames = walk(scene, device, NAME, 12, jitter=0.0, overscan=0.0)
    np.testing.assert_allclose(frames[-1].visibility, frames[0].visibility, atol=1e-6)


@pytest.mark.parametrize("params", [{"rotation": 90.0}, {"sample_set": "halton"}, {"sample_set": "random"}])
def test_any_jitter_converges(params: dict[str, Any], device: str) -> None:
    scene = small.cluttered(SUN)
    expected = true_visibility(scene, device, centre=True)
    frames = walk(scene, device, NAME, 64, **params)
    assert rmse(frames[-1].visibility, expected) < 0.5 * rmse(
        walk(scene, device, "shadow_map", 1)[0].visibility, expected
    )


# ---- moving eyes ----------------------------------------------------------------------------------------------------------


def flicker(session: Session, made: Any, frames: int, skip: int = 12) -> tuple[float, list[FrameResult]]:
    """Mean change from frame to frame at points seen in both, after ``skip`` frames; and all frames."""
    changes: list[float] = []
    results = render_frames(session, made, 1)
    eye = session.eye()
    for index in range(1, frames):
        result = render_frames(session, made, 1, index)[0]
        matrix = eye.ws_to_ss.copy()
        matrix[:, 3] = matrix @ np.append(-session.geometry.origin_ws, 1.0)
        last = results[-1]
        before = carry_over(
            last.visibility, last.world_position, matrix, result.world_position, across_edges=True
        )  # edges of maps are hard, those of a history are not
        if index >= skip:
            changes.append(rmse(result.visibility, before))
        eye = session.eye()
        results.append(result)
    return float(np.mean(changes)), results


def test_the_swimming_of_warped_maps_averages_out(device: str) -> None:
    """A translating eye under LiSPSM with four splits: what the source names as remedy."""
    scene = small.box_on_ground(SUN, small.sideways(0.37, SIZE[1]))
    expected = true_visibility(scene, device, 35, centre=True)
    measured = {
        name: flicker(open_session(scene, device, projection=WARPED), small_technique(name, resolution=64), 36)
        for name in ("shadow_map", "tc_hard")
    }
    assert measured["tc_hard"][0] < 0.4 * measured["shadow_map"][0], {k: v[0] for k, v in measured.items()}
    error = {name: rmse(frames[-1].visibility, expected) for name, (_, frames) in measured.items()}
    assert error["tc_hard"] < 0.8 * error["shadow_map"], error


def test_reads_blur_and_the_bound_holds(device: str) -> None:
    """At 0.3 pixels a frame bilinear reads smear edges, unless frames are forgotten; the nearest texel sticks."""
    scene = small.box_on_ground(SUN, small.sideways(0.3, SIZE[1]))
    expected = true_visibility(scene, device, 47, centre=True)
    error = {}
    for key, params in {
        "half": {"blur": 0.5},
        "one": {"blur": 1.0},
        "any": {"blur": 1000.0},
        "nearest": {"history": "nearest"},
    }.items():
        session = open_session(scene, device)
        error[key] = rmse(
            render_frames(session, small_technique(NAME, resolution=512, **params), 48)[-1].visibility, expected
        )
        blur = session.history("hard shadows", lambda: None).previous.numpy()[..., 3]
        assert {"half": 0.15 < np.median(blur) < 0.4, "one": 0.7 < np.median(blur) < 1.5}.get(key, True), np.median(
            blur
        )
    assert error["half"] < error["one"] < 0.75 * error["any"] < error["nearest"], error


def test_slanted_ground_keeps_its_history(device: str) -> None:
    session = open_session(small.box_on_ground(SUN, small.sideways(0.3, SIZE[1])), device)
    render_frames(session, small_technique(NAME, depth_epsilon=1e-5, blur=1000.0), 6)
    ground = np.isfinite(session.gbuffer(0.05).depth.numpy())
    assert (remembered(session)[ground] > 2.0).mean() > 0.9


def test_overscan_covers_the_border(device: str) -> None:
    """2 pixels a frame enter at one side: they know nothing without overscan, and earlier tests within it."""
    known = {}
    for overscan in (0.0, 0.1):
        session = open_session(small.box_on_ground(SUN, small.sideways(2.0, SIZE[1])), device)
        render_frames(session, small_technique(NAME, overscan=overscan, blur=1000.0), 6)
        n = remembered(session)
        margin = session.margin(overscan)
        frame = n[margin[1] : n.shape[0] - margin[1], margin[0] : n.shape[1] - margin[0]]
        assert frame.shape == (SIZE[1], SIZE[0])
        known[overscan] = float((frame[:, -2:] > 1.5).mean())
    assert known[0.0] < 0.4 and known[0.1] > known[0.0] + 0.3, known


def test_a_camera_cut_starts_anew(device: str) -> None:
    """What the new eye sees for the first time is the first frame of a session that begins with the same jitter."""
    there = small.camera((0.0, 4.0, -9.0), (0.0, 1.0, -3.0))
    scene = small.cluttered(SUN)
    scene = replace(scene, camera=lambda frame: small.camera((2.0, 1.5, 2.0), (2.5, 0.0, 2.5)) if frame < 8 else there)
    session = open_session(scene, device)
    after = render_frames(session, small_technique(NAME), 9)[-1]
    fresh = open_session(scene, device)
    fresh.begin(8)
    fresh.count = 8
    assert_equal = np.testing.assert_array_equal
    assert_equal(after.visibility, fresh.render(small_technique(NAME)).visibility)
    assert 0.02 < np.nanmean(after.visibility == 0.0) < 0.98


# ---- moving casters -------------------------------------------------------------------------------------------------------


def jumping(frame: int, offset: float = 200.0) -> Scene:
    """A box that hovers until ``frame`` and is gone, or ``offset`` away, from then on."""

    def pose(index: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = (0.0 if index < frame else offset) + 1e-6 * (index % 2)  # what stays where it is would rest
        return out

    scene = small.box_on_ground(SUN)
    return replace(scene, meshes=(scene.meshes[0], replace(scene.meshes[1], object_to_ws=pose, moving=True)))


def test_a_shadow_that_leaves_leaves_no_trail(device: str) -> None:
    frames = walk(jumping(12), device, NAME, 13)
    assert np.nanmean(frames[11].visibility < 0.5) > 0.015
    np.testing.assert_array_equal(frames[12].visibility[np.isfinite(frames[12].visibility)], 1.0)


@pytest.mark.parametrize("params", [{}, {"blend": "published", "power": 3}])
def test_a_trail_has_the_stated_sign_and_length(params: dict[str, Any], device: str) -> None:
    """``movers: keep``: too dark where the shadow was, too light where it is, half of the shadow after a memory or so, a tenth after three."""
    scene, memory = jumping(24, 2.5), 8.0
    frames = walk(scene, device, NAME, 24 + 24, movers="keep", memory=memory, **params)
    before, after = true_visibility(scene, device, 0, centre=True), true_visibility(scene, device, 24, centre=True)
    was, now = (before < 0.5) & (after > 0.5), (before > 0.5) & (after < 0.5)
    assert was.sum() > 50 and now.sum() > 50
    trail = [(f.visibility[was].mean() - 1.0, f.visibility[now].mean()) for f in frames[24:]]
    assert trail[0][0] < -0.5 and trail[0][1] > 0.5, trail[0]
    assert trail[9][0] > -0.5 and trail[9][1] < 0.5, trail[9]
    assert trail[23][0] > -0.1 and trail[23][1] < 0.1, trail[23]
    assert all(b[0] >= a[0] - 1e-3 for a, b in pairwise(trail)), "the trail only fades"


def test_a_mover_moves_what_it_shadows_only(device: str) -> None:
    """Beside a mover static shadows are what they are without it."""
    scene = small.box_on_ground(SUN)

    def slide(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.05 * frame
        return out

    mover = small.mesh(
        "mover", small.box((-4.0, 1.0, 2.5), (0.5, 0.5, 0.5)), receives=False, object_to_ws=slide, moving=True
    )
    both = replace(scene, meshes=(*scene.meshes, mover))
    alone, beside = (walk(s, device, NAME, 24, resolution=64)[-1] for s in (scene, both))
    far = np.isfinite(alone.visibility) & (alone.world_position[..., 0] > -2.0)
    edge = far & (alone.visibility > 0.0) & (alone.visibility < 1.0)
    assert edge.sum() > 20
    np.testing.assert_allclose(beside.visibility[far], alone.visibility[far], atol=1e-6)
    touched = remembered_shadow(both, device)
    assert touched.sum() > 5, "the mover's shadow remembers nothing"


def remembered_shadow(scene: Scene, device: str) -> np.ndarray:
    """Receiver pixels that remember nothing after 24 frames."""
    session = open_session(scene, device)
    render_frames(session, small_technique(NAME), 24)
    return (remembered(session) == 0.0) & (session.gbuffer(0.05).mesh.numpy() == 0)


# ---- input ----------------------------------------------------------------------------------------------------------------


def test_nothing_casts(device: str) -> None:
    scene = small.scene([small.mesh("ground", small.plane(8.0), casts=False)], SUN)
    for result in walk(scene, device, NAME, 2):
        assert (result.visibility[np.isfinite(result.visibility)] == 1.0).all()


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"jitter": 1.5}, "jitter"),
        ({"rotation": -1.0}, "rotation"),
        ({"power": 65}, "power"),
        ({"memory": float("inf")}, "memory"),
        ({"blend": "average"}, "published"),
        ({"movers": "fade"}, "reset"),
        ({"history": "cubic"}, "bilinear"),
        ({"depth_epsilon": 0.0}, "depth_epsilon"),
        ({"blur": 0.0}, "blur"),
        ({"samples": 4}, "samples"),
    ],
)
def test_wrong_parameters_are_named(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        find(NAME).Params(**params)
