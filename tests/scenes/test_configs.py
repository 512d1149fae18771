"""The scene files that come with the project: they load, their cameras are where they should be, nothing is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.scenes import analytic, generators, load_scene

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
FILES = sorted(SCENES.glob("*.yaml"))
NAMES = {file.stem for file in FILES}
USD = {"bunny", "rocks"}


def test_the_named_scenes_are_there():
    walkthroughs = {"paris", "winter", "overlap", "bunny", "rocks", "test_plane", "moving_blocker", "big_penumbra"}
    assert walkthroughs | {"light_close_to_blocker", "elongated_along_axis"} <= NAMES
    assert set(analytic.CLOSED_FORMS) <= NAMES
    assert set(generators.names()) - {"torus_knot"} <= NAMES  # which is a part of others


@pytest.mark.parametrize("file", FILES, ids=[file.stem for file in FILES])
def test_scene_loads_and_its_camera_sees_it(file: Path):
    if file.stem in USD:
        pytest.importorskip("pxr")
    scene = load_scene(file)
    assert scene.name == file.stem and len(scene.content_hash) == 64
    points = np.concatenate(
        [m.vertices @ m.object_to_ws(0)[:3, :3].T + m.object_to_ws(0)[:3, 3] for m in scene.meshes if m.receives]
    )
    for frame in range(0, scene.frames, max(1, scene.frames // 12)):
        camera = scene.camera(frame)
        forward = camera.target - camera.eye
        depth = (points - camera.eye) @ (forward / np.linalg.norm(forward))
        # Every primary ray's hit must lie between near and far.
        assert depth.max() < camera.far
        assert np.min(np.linalg.norm(points - camera.eye, axis=1)) > camera.near


@pytest.mark.parametrize(("name", "frames"), [("paris", 240), ("winter", 240), ("overlap", 120)])
def test_walkthroughs_move_steadily(name: str, frames: int):
    scene = load_scene(SCENES / f"{name}.yaml")
    assert scene.frames == frames
    eyes = np.array([scene.camera(frame).eye for frame in range(frames)])
    step = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    assert step.max() < 6.0 * np.median(step) and step.min() > 0.0
    assert scene.lights[0].has_area


BURSTS = ("overlap_walkthrough", "big_penumbra_walkthrough", "moving_blocker_walkthrough", "static_moving_overlap")


@pytest.mark.parametrize("name", BURSTS)
def test_walkthroughs_of_temporal_coherence_turn_cut_and_fly_between_slow_stretches(name: str) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    assert scene.frames == 100
    cameras = [scene.camera(frame) for frame in range(100)]
    eyes, views = (np.array([getattr(c, what) for c in cameras]) for what in ("eye", "target"))
    views = (views - eyes) / np.linalg.norm(views - eyes, axis=1, keepdims=True)
    turned = np.degrees(np.arccos(np.clip(np.sum(views[1:] * views[:-1], axis=1), -1.0, 1.0)))  # to frame i + 1
    moved = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    fast = np.zeros(99, bool)
    fast[24:29], fast[49], fast[74:79] = True, True, True
    assert turned[~fast].max() < 1.0 and moved[~fast].max() < 0.06
    assert 30.0 < turned[24:29].sum() < 40.0 and turned[24:29].max() > 5.0
    assert moved[49] > 5.0  # the cut
    assert moved[74:79].sum() > 3.0


def test_static_and_moving_penumbrae_overlap() -> None:
    scene = load_scene(SCENES / "static_moving_overlap.yaml")
    assert [mesh.name for mesh in scene.meshes if mesh.moving] == ["ball"]
    ball = next(mesh for mesh in scene.meshes if mesh.moving)
    np.testing.assert_array_equal(ball.object_to_ws(36), ball.object_to_ws(48))  # it rests


def test_overlap_has_a_moving_blocker_and_about_70000_triangles():
    scene = load_scene(SCENES / "overlap.yaml")
    assert [mesh.name for mesh in scene.meshes if mesh.moving] == ["mover/torus_knot"]
    assert sum(len(mesh.faces) for mesh in scene.meshes) == pytest.approx(70_000, rel=0.01)


def test_test_plane_has_the_published_camera():
    scene = load_scene(SCENES / "test_plane.yaml")
    camera = scene.camera(0)
    assert (camera.fov_deg, camera.near, camera.far) == (60.0, 1.0, 97.04)
    view = camera.target - camera.eye
    towards = scene.lights[0].centre[:3]
    angle = np.degrees(np.arccos(abs(view @ towards) / np.linalg.norm(view)))
    assert angle == pytest.approx(84.0, abs=0.1)
    assert sum(len(mesh.faces) for mesh in scene.meshes) == 2044
