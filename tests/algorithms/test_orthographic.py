"""An orthographic eye: G-buffer, maps, rays and reprojection see what a pinhole from very far away sees."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from experiments import reference_visibility, render_visibility
from experiments.scenes import load_scene
from wkernels.errors import InputError
from wkernels.scene.model import Camera
from wkernels.scene.views import eye_view

AWAY = 1e5  # of the pinhole: its lines of sight differ from parallel by 6 / AWAY
TARGET = np.array([0.3, 0.5, -0.2])
VIEW = np.array([0.2, -0.8, -0.5]) / np.linalg.norm([0.2, -0.8, -0.5])
SCENE: dict[str, Any] = {
    "meshes": [
        {"primitive": "plane", "size": [12, 12]},
        {"primitive": "box", "size": [1, 1, 1], "transform": {"translate": [-1, 1, 0], "rotate_deg": [0, 30, 0]}},
        {"primitive": "sphere", "radius": 0.7, "transform": {"translate": [1.5, 1.2, 0.5]}},
    ],
    "lights": [{"kind": "rectangle", "center": [1, 6, 2], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}],
}
SIZE = {"width": 64, "height": 48}


def orthographic() -> dict[str, Any]:
    camera = {"projection": "orthographic", "height": 8.0, "near": 0.1, "far": 40.0}
    return SCENE | {"camera": camera | {"eye": (TARGET - 10 * VIEW).tolist(), "target": TARGET.tolist()}}


def far_pinhole() -> dict[str, Any]:
    camera = {"fov_deg": float(2 * np.degrees(np.arctan(4.0 / AWAY))), "near": AWAY - 10, "far": AWAY + 30}
    return SCENE | {"camera": camera | {"eye": (TARGET - AWAY * VIEW).tolist(), "target": TARGET.tolist()}}


def test_the_view_has_parallel_rays() -> None:
    camera = Camera(np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]), 60.0, 0.1, 9.0, height=4.0)
    view = eye_view(camera, 8, 4, np.array([1.0, 2.0, 3.0]))
    assert not view.perspective and view.window == (-4.0, 4.0, -2.0, 2.0)
    rows = view.ws_to_ss
    for point, wanted in (([2.0, 1.0, -5.0], [0.5, 0.5, 5.0, 1.0]), ([-4.0, -2.0, -1.0], [-1.0, -1.0, 1.0, 1.0])):
        np.testing.assert_allclose(rows @ np.append(np.array(point) - [1, 2, 3], 1.0), wanted, atol=1e-12)
    wide = eye_view(camera, 8, 4, np.zeros(3), margin=(1, 1))
    assert wide.window == (-5.0, 5.0, -3.0, 3.0)  # the same pixels, and more at each side


def test_sees_what_a_pinhole_from_far_away_sees() -> None:
    one = render_visibility(orthographic(), "reference_multisample", {"samples": 16}, **SIZE)
    other = render_visibility(far_pinhole(), "reference_multisample", {"samples": 16}, **SIZE)
    apart = np.linalg.norm(one.world_position - other.world_position, axis=-1)
    assert np.isfinite(apart).mean() > 0.9
    assert np.nanmedian(apart) < 0.02  # float32 depths of 1e5 are right to 0.01
    seen = apart < 0.05
    assert seen.mean() > 0.9
    assert np.mean(np.abs(one.visibility - other.visibility)[seen]) < 0.01
    assert 0.3 < np.nanmean(one.visibility) < 0.99


@pytest.mark.parametrize(
    ("technique", "params", "projection"),
    [
        ("shadow_map", {"resolution": 2048}, None),
        ("shadow_map", {"resolution": 1024}, {"fit": "focused", "splits": 3}),
        ("shadow_map", {"resolution": 1024}, {"fit": "focused", "warp": "lispsm_nopt", "partition": "faces"}),
        ("alias_free", {}, None),
        ("projection_shadows", {}, None),
    ],
)
def test_hard_techniques_agree_with_the_reference(technique: str, params: dict, projection: dict | None) -> None:
    scene = orthographic() | {"lights": [{"kind": "directional", "direction": [1.5, -1, 0.6]}]}
    ours = render_visibility(scene, technique, params, projection, **SIZE).visibility
    reference, _ = reference_visibility(scene, samples=1, **SIZE)
    assert np.array_equal(np.isnan(ours), np.isnan(reference))
    assert 0.05 < np.nanmean(1.0 - reference)
    assert np.nanmean(np.abs(ours - reference)) < 0.02  # a texel or two at edges


@pytest.mark.parametrize("stabilise", ["exact", "approximate"])
def test_stabilised_maps_hold_all_that_is_seen(stabilise: str) -> None:
    scene = orthographic() | {"lights": [{"kind": "directional", "direction": [1.5, -1, 0.6]}]}
    projection = {"fit": "focused", "stabilise": stabilise}
    ours = render_visibility(scene, "shadow_map", {"resolution": 2048}, projection, **SIZE).visibility
    reference, _ = reference_visibility(scene, samples=1, **SIZE)
    assert np.nanmean(np.abs(ours - reference)) < 0.01


def test_history_is_found_again_as_the_eye_moves() -> None:
    """A temporal technique on a sideways path ends with less noise than its first frame has: its history follows."""
    across = np.cross(VIEW, [0.0, 1.0, 0.0])
    keys = [
        {"frame": frame, "eye": (TARGET - 10 * VIEW + s * across).tolist(), "target": (TARGET + s * across).tolist()}
        for frame, s in ((0, 0.0), (12, 0.6))
    ]
    scene = orthographic() | {"path": {"keyframes": keys}}
    scene["camera"] = {key: value for key, value in scene["camera"].items() if key not in ("eye", "target")}
    reference, _ = reference_visibility(scene, samples=64, frame=12, **SIZE)
    errors = [
        np.nanmean(np.abs(render_visibility(scene, "tc_soft_paper", frame=12, frames=n, **SIZE).visibility - reference))
        for n in (1, 13)
    ]
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"projection": "orthographic"}, "camera.height: is required"),
        ({"height": 3.0}, "only a camera with projection: orthographic"),
        ({"projection": "orthographic", "height": 3.0, "fov_deg": 60.0}, "has no field of view"),
        ({"projection": "orthographic", "height": 0.0}, "camera.height"),
        ({"projection": "fisheye"}, "camera.projection"),
    ],
)
def test_keys_that_do_not_go_together(camera: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_scene(SCENE | {"camera": {"eye": [0, 5, 5], "target": [0, 0, 0]} | camera})
