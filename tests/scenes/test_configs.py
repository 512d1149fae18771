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


def test_the_scenes_of_the_catalogue_are_there():
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
